"""The search for one basis of a bracket, its bound against direct solutions, and the proofs on cells."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sl

from morembs.parametric.bound_at import ritz_pairs
from morembs.parametric.cells import Proofs
from morembs.parametric.parameter import Parameter
from morembs.parametric.space import GlobalSpace
from morembs.parametric.terms import AffineProblem
from morembs.parametric.varied import varied_model
from morembs.problem import Problem
from morembs.problem.damping import Damping
from morembs.reducers import ParametricReducer
from morembs.responses.direct import elastic_states
from morembs.storage.lemma import kind_of
from tests.support.parametric import ARM, REST, STEEL, bracket, interfaces, longer
from tests.support.refusals import refusal

BAND = [0.0, 12000.0]


def problem_of(mesh, parameters, damping=None):
    varied = varied_model(mesh, [STEEL], parameters)
    model = varied.model(varied.box.nominal)
    return AffineProblem(varied, interfaces(model), model=model, damping=damping)


def moduli(low=1.5e11, high=2.7e11):
    return [
        Parameter(name=name, kind="young", low=low, high=high, nominal=2.1e11, sets=sets)
        for name, sets in (("E_arm", ARM), ("E_rest", REST))
    ]


RHO = Parameter(name="rho", kind="density", low=7000.0, high=8700.0, nominal=7850.0)


@pytest.fixture(scope="module")
def mesh():
    return bracket()


@pytest.fixture(scope="module")
def problem(mesh):
    with problem_of(mesh, [moduli()[0], RHO, longer(mesh)], Damping(beta=2e-7)) as problem:
        yield problem


@pytest.fixture(scope="module")
def basis(problem):
    return ParametricReducer(band_hz=BAND, tolerance=1e-2, training=8).search(problem)


def test_the_basis_keeps_its_tolerance_at_other_values_and_no_error_exceeds_the_bound(problem, basis):
    assert basis.kind == "bound" and basis.box_bound < 0.02
    assert basis.model.order <= 60 and basis.factorisations <= 6
    rng = np.random.default_rng(3)
    for _ in range(3):
        p = rng.uniform(problem.box.low, problem.box.high)
        hz = rng.uniform(*BAND, 3)
        at = basis.model.at(p)
        bound = at.bound(hz)
        S = np.outer(basis.model.scale, basis.model.scale)
        with problem.at(p, assembled=True) as there:
            B = there.B.toarray()
            H = np.stack([B.T @ elastic_states(there.system, 2j * np.pi * f, B) for f in hz])
        error = np.linalg.norm((at.response(hz) - H) * S, axis=(1, 2))
        assert at.bound_kind == "bound"
        assert (error <= bound).all() and (bound <= 30 * error).all()


def test_the_reduced_model_at_nominal_values_is_that_of_the_reducer(problem, basis):
    reduced = ParametricReducer(band_hz=BAND, tolerance=1e-2, training=8).reduce(problem)
    at = basis.model.at(problem.box.nominal)
    assert np.abs(reduced.K - at.K).max() <= 1e-12 * np.abs(at.K).max()
    assert np.abs(reduced.M - at.M).max() <= 1e-12
    assert reduced.recipe["bound_kind"] == "bound"


def test_rigid_motion_is_free_of_stiffness_at_all_values(problem, basis):
    for p in np.random.default_rng(0).uniform(problem.box.low, problem.box.high, (5, 3)):
        K, _ = basis.model.matrices(p)
        R = basis.model.rigid_at(p)
        R = R / np.linalg.norm(R, axis=0)
        assert np.abs(K @ R).max() <= 1e-9 * np.abs(K).max()


def test_a_proven_stiffness_beside_the_nominal_one_is_the_least_one(problem):
    proofs = Proofs(GlobalSpace(problem))
    [cell] = proofs.cells()
    assert cell.proven and cell.corner == pytest.approx(0.475, abs=0.002)
    assert 0.95 * cell.corner < cell.alpha < cell.corner


def test_the_proven_eigenvalue_beside_deflated_modes_is_not_above_that_of_the_model(mesh):
    with problem_of(mesh, [*moduli(), RHO]) as problem:
        space = GlobalSpace(problem)
        space.add(problem.elastic_modes(count=6).vectors.copy())
        F = np.eye(space.size)
        for p in (problem.box.low, problem.box.high):
            with problem.at(p) as there:
                space.add(there.elastic_modes(count=12).vectors.copy())
        F = np.eye(space.size, len(F))
        proofs = Proofs(space)
        sigma = 1e11
        cells = proofs.least(proofs.cells(), F, sigma, 0.0, proof=True)
        W = problem.M @ (space.columns() @ F)
        K, M = problem.stiffness_sum(problem.law_K(proofs.soft)), problem.mass_sum(problem.law_M(proofs.soft))
        true = sl.eigh(K.toarray() + sigma * W @ W.T, M.toarray(), eigvals_only=True, subset_by_index=[0, 0])[0]
        assert cells.proven.all()
        assert 0.9 * true < cells.least[0] <= true
        assert not proofs.is_positive(K - 1.01 * true * M, W=W, sigma=sigma)


def test_compression_leaves_the_bound_what_it_was(problem, basis):
    p, hz = problem.box.point({"E_arm": 1.7e11, "t": 2.0}), np.linspace(0, BAND[1], 20)
    fewer = replace(basis.model, bound=basis.model.bound.compress(3e-4))
    assert len(fewer.bound.residual_B) < 0.9 * len(basis.model.bound.residual_B)
    before, after = basis.model.at(p).bound(hz), fewer.at(p).bound(hz)
    assert (after >= 0.99 * before).all() and (after < 2 * before).all()


def test_a_tolerance_that_is_not_reached_is_told_with_its_place(mesh):
    with problem_of(mesh, moduli()) as problem:
        reducer = ParametricReducer(band_hz=BAND, tolerance=1e-3, training=4, order_limit=18)
        with refusal("value", "", "18", "E_arm", "E_rest"):
            reducer.search(problem)
        basis = replace(reducer, accept_bound=True).search(problem)
        assert basis.model.order == 18 and basis.box_bound > 1e-3


def test_a_model_without_parameters_is_refused(problem):
    with Problem(problem.model, problem.interfaces) as plain, refusal("missing", "method"):
        ParametricReducer(band_hz=BAND).reduce(plain)


@pytest.mark.parametrize(
    ("options", "limits"),
    [({"tolerance": 2.0}, ("2.0", "0", "1,")), ({"training": 0}, ("0", "1")), ({"order_limit": 0}, ("0", "1"))],
)
def test_wrong_options_are_refused(options, limits):
    with refusal("value", *options, *limits):
        ParametricReducer(band_hz=BAND, **options)


def test_low_ritz_pairs_are_beside_exact_rigid_motion(problem, basis):
    p = problem.box.point({"t": -2.5})
    K, M = basis.model.matrices(p)
    Z, values, Y = ritz_pairs(K, M, basis.model.rigid_at(p))
    np.testing.assert_allclose(Z.T @ M @ Z, np.eye(6), atol=1e-10)
    assert np.abs(Z.T @ M @ Y).max() < 1e-10
    with problem.at(p, assembled=True) as there:
        # The only one in the band.
        true = there.elastic_modes(count=1).eigenvalues
    np.testing.assert_allclose(values[:1], true, rtol=1e-5)


def test_the_bound_is_a_chain_of_lemmas_at_a_value_and_on_the_box(problem, basis):
    names = ["cells-of-the-box", "parametric-residual", "interpolated-geometry", "damping", "round-off-of-terms"]
    at, model = basis.model.at(problem.box.nominal), basis.model
    for proof in (at.proof, model.proof):
        assert [lemma.name for lemma in proof] == names and kind_of(proof) == "proven"
    cells = model.bound.cells
    assert model.proof[0].numbers["alpha"] == cells.alpha.min() and model.proof[0].numbers["cells"] == len(cells.low)
    # What breaks a link is named by it, and makes an estimate of the whole.
    unproven = replace(model.bound, cells=replace(cells, proven=np.zeros_like(cells.proven)))
    for changed, link in (
        (replace(model, bound=unproven), "cells-of-the-box"),
        (replace(model, damping=Damping(modal=0.01)), "damping"),
        (replace(model, bound=replace(model.bound, rounding_K=None)), "round-off-of-terms"),
    ):
        for proof in (changed.proof, changed.at(problem.box.nominal).proof):
            assert [lemma.name for lemma in proof if lemma.kind == "estimate"] == [link]
        assert changed.at(problem.box.nominal).bound_kind == "estimate"
    assert replace(model, bound=None).proof == () and replace(model, bound=None).at(problem.box.nominal).proof == ()
