"""Springs and preloads as parameters: the bound against models that are assembled at the values."""

from dataclasses import replace

import numpy as np
import pytest

from morembs.body.floating.preload import Preload, apply_preload
from morembs.fem.interface import make_interface
from morembs.fem.material import isotropic
from morembs.parametric.added import with_preload
from morembs.parametric.parameter import Parameter, Spring
from morembs.parametric.space import GlobalSpace
from morembs.parametric.terms import AffineProblem, varied_model
from morembs.problem import Problem
from morembs.problem.damping import Damping
from morembs.reducers import ParametricReducer
from tests.support.meshes import box
from tests.support.refusals import refusal

STEEL = isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)
LENGTH, SIDE = 0.5, 0.02
E = Parameter(name="E", kind="young", low=1.6e11, high=2.4e11, nominal=2.1e11)
LOAD = Preload(wrench={"root": [-4e4, 0, 0, 0, 0, 0], "tip": [4e4, 0, 0, 0, 0, 0]})
DAMPING = Damping(beta=1e-6)
BAND = 6000.0


def factor(low=0.25, high=2.0):
    return Parameter(name="k", kind="preload", low=low, high=high, nominal=1.0)


def spring(stiffness, to=None, interface="root"):
    held = Spring(interface=interface, to=to, stiffness=stiffness)
    return Parameter(name="k", kind="spring", low=0.5, high=4.0, nominal=1.0, spring=held)


def beam(parameters, coupling="rigid"):
    """Square beam along x, and its ends as interfaces."""
    varied = varied_model(box("hex20", (6, 1, 1), (LENGTH, SIDE, SIDE)), [STEEL], parameters)
    model = varied.model(varied.box.nominal)
    ends = [
        make_interface(model, name=name, nodes=np.flatnonzero(np.isclose(model.nodes.xyz[:, 0], x)), coupling=coupling)
        for name, x in (("root", 0.0), ("tip", LENGTH))
    ]
    return varied, ends


def search(problem, high):
    return ParametricReducer(band_hz=[0.0, high], tolerance=1e-2, training=8).search(problem)


def compared(basis, references, high, seed=1):
    """Bound over error of H (nf,) at random values; ``references`` gives K, M, B, D at a value, dense."""
    rng, rates = np.random.default_rng(seed), []
    for p in rng.uniform(basis.model.box.low, basis.model.box.high, (4, len(basis.model.box.low))):
        at = basis.model.at(p)
        assert at.bound_kind == "bound"
        hz = rng.uniform(0.1 * high, high, 4)
        K, M, B, R, D = references(p)
        S = np.outer(basis.model.scale, basis.model.scale)
        G = R.T @ M @ R
        for f, bound, H in zip(hz, at.bound(hz), at.response(hz), strict=True):
            s = 2j * np.pi * f
            free = B - M @ R @ np.linalg.solve(G, R.T @ B)
            true = B.T @ np.linalg.solve(K + s * D + s * s * M, free)
            error = np.linalg.norm((true - H) * S)
            assert error <= bound + 1e-9 * np.linalg.norm(true * S) and np.isfinite(bound)
            rates.append(bound / error)
    return np.array(rates)


def assembled(varied, ends, p, added=0.0):
    """K (of ``added`` stiffness too), M, B, rigid motions and D of the model at ``p`` without terms."""
    with Problem(varied.assemble_at(p), ends) as there:
        K, M = there.K.toarray() + added, there.M.toarray()
        lost = np.abs(K @ there.coupling.R).max() > 1e-6 * np.abs(K).max() * SIDE
        R = there.coupling.R[:, :0] if lost else there.coupling.R
        return K, M, there.B.toarray(), R, DAMPING.beta * K


@pytest.fixture(scope="module")
def sprung():
    """Basis of a beam on a spring, and what assembles its stiffness at values."""
    stiffness = (3e7, 2e7, 2e7, 4e3, 5e3, 6e3)
    plain, ends = beam([E], "average")
    varied, _ = beam([E, spring(stiffness)], "average")
    with AffineProblem(varied, ends, damping=DAMPING) as problem:
        assert problem.rigid.shape[1] == 0
        basis = search(problem, BAND)
        F = problem.coupling.frames[:, problem.coupling.frame_columns["root"]].toarray()
    held = F @ np.diag(stiffness) @ F.T
    return basis, lambda p: assembled(plain, ends, p[:1], p[1] * held)


def test_a_body_on_a_spring_keeps_its_bound(sprung):
    basis, full = sprung
    rates = compared(basis, full, BAND)
    assert np.median(rates) < 5 and basis.model.order < 40


def test_loads_on_the_supports_leave_coordinates_of_loads_orthonormal():
    """The supports are those of the frame of an interface here, so that its loads are round-off in the dual norm."""
    varied = varied_model(box("hex8", (3, 1, 1), (0.3687, 0.0691, 0.0324)), [STEEL], [E])
    model = varied.model(varied.box.nominal)
    x = model.nodes.xyz[:, 0]
    ends = [
        make_interface(model, name=name, nodes=np.flatnonzero(np.isclose(x, at)))
        for name, at in (("L", 0.0), ("R", 0.3687))
    ]
    with AffineProblem(varied, ends) as problem:
        space = GlobalSpace(problem)
        Q = np.hstack(space.coordinates.basis)
        np.testing.assert_allclose(Q.T @ (problem.K @ Q), np.eye(Q.shape[1]), atol=1e-9)


def test_a_spring_between_interfaces_strains_no_rigid_motion():
    varied, ends = beam([spring((2e7, 1e6, 1e6, 1e3, 1e3, 1e3), to="tip")])
    with AffineProblem(varied, ends) as problem:
        assert problem.rigid.shape[1] == 6
        term = problem.K_terms[1]
        assert np.abs(term @ problem.coupling.R).max() < 1e-12 * np.abs(term).max()
        # Opposite motions of the ends along the beam pull the spring.
        pull = problem.B[:, [6]].toarray()[:, 0] - problem.B[:, [0]].toarray()[:, 0]
        assert pull @ term @ pull == pytest.approx(4 * 2e7)
        basis = search(problem, BAND)
        with problem.at(np.array([3.0])) as there:
            true = there.elastic_modes(count=3).frequencies_hz
        np.testing.assert_allclose(basis.model.at(np.array([3.0])).frequencies_hz[:3], true, rtol=1e-5)


def test_a_preloaded_body_keeps_its_bound_at_other_loads():
    plain, ends = beam([E])
    varied, _ = beam([E, factor()])
    with Problem(plain.assemble_at(plain.box.nominal), ends) as bare:
        found = apply_preload(bare, LOAD)
        varied = with_preload(varied, found.model.K - bare.model.K, found.critical_factor)
    with AffineProblem(varied, ends, damping=DAMPING) as problem:
        basis = search(problem, BAND)

    def stressed(p):
        with Problem(plain.assemble_at(p[:1]), ends) as bare:
            load = Preload(wrench={name: p[1] * np.array(f) for name, f in LOAD.wrench.items()})
            K = apply_preload(bare, load).model.K - bare.model.K
        T = bare.coupling.T.toarray()
        return assembled(plain, ends, p[:1], T.T @ K @ T)

    rates = compared(basis, stressed, BAND)
    assert np.median(rates) < 5
    # Tension stiffens, which a body without the term would miss.
    low, high = (basis.model.at(np.array([2.1e11, k])).frequencies_hz[0] for k in (0.25, 2.0))
    assert high > 1.05 * low


def test_buckling_at_some_value_of_the_box_is_refused():
    plain, ends = beam([E])
    varied, _ = beam([E, factor(high=2.5)])
    load = Preload(wrench={name: -np.array(f) for name, f in LOAD.wrench.items()})
    with Problem(plain.assemble_at(plain.box.nominal), ends) as bare:
        found = apply_preload(bare, load)
    # Only where the beam is softer than the nominal one.
    assert 2.5 * E.low / E.nominal < 2.5 < found.critical_factor < 2.5 * E.nominal / E.low
    varied = with_preload(varied, found.model.K - bare.model.K, found.critical_factor)
    with AffineProblem(varied, ends) as problem, refusal("model", "preload"):
        search(problem, BAND)


def test_derivatives_by_springs_are_those_of_differences(sprung):
    model = sprung[0].model
    slope = model.at(np.array([2e11, 2.0])).sensitivity(3).frequencies_hz["k"]
    above, below = (model.at(np.array([2e11, 2.0 + h])).frequencies_hz[:3] for h in (1e-4, -1e-4))
    np.testing.assert_allclose(slope, (above - below) / 2e-4, rtol=1e-5)


@pytest.mark.parametrize("stiffness", [(1.0, 1, 1, 1e-2, 1e-2, 1e-2), (1e-3, 0, 0, 0, 0, 0)])
def test_springs_below_the_round_off_of_the_elements_are_refused(stiffness):
    varied, ends = beam([spring(stiffness)])
    with refusal("model", "stiffness"):
        AffineProblem(varied, ends)


def test_springs_and_preloads_that_do_not_fit_are_refused():
    def made(parameters):
        varied, ends = beam(parameters)
        return AffineProblem(varied, ends)

    with refusal("unknown", "", "tap", "tip"):
        made([spring((1.0,) * 6, interface="tap")])
    with refusal("value", "stiffness"):
        spring((1.0, 0, 0, 0, 0, -1.0))
    with refusal("value", "range"):
        Parameter(name="k", kind="spring", low=0.0, high=1.0, nominal=1.0, spring=spring((1.0,) * 6).spring)
    d = np.zeros((len(beam([E])[0].morph.mesh.nodes), 3))
    d[:, 0] = beam([E])[0].morph.mesh.nodes.xyz[:, 0]
    morph = Parameter(name="t", kind="morph", low=-0.1, high=0.1, nominal=0.0, displacement=d)
    with refusal("conflict", "morph"):
        made([morph, spring((1.0,) * 6, to="tip")])
    varied, _ = beam([E, factor()])
    with refusal("model", "preload", "1.5"):
        with_preload(varied, None, 1.5)
    varied, _ = beam([morph, factor()])
    with refusal("unsupported", "preload"):
        with_preload(varied, None, None)


def exact_response(K, M, B, damping, hz):
    """B' (c K + g M)^-1 B with 192 bits for dense ``K``, ``M``, ``B``."""
    flint = pytest.importorskip("flint")
    bits, flint.ctx.prec = flint.ctx.prec, 192
    K, M, B = (flint.acb_mat([[flint.acb(float(x)) for x in row] for row in A.toarray()]) for A in (K, M, B))
    s = flint.acb(0, 2 * np.pi * hz)
    H = B.transpose() * (K * (1 + s * damping.beta) + M * (s * s)).solve(B)
    rows, columns = H.nrows(), H.ncols()
    flint.ctx.prec = bits
    return np.array([[complex(H[i, j]) for j in range(columns)] for i in range(rows)])


@pytest.mark.parametrize("assembled", [False, True])
def test_the_bound_of_a_soft_spring_holds_with_round_off(assembled):
    """Beside its resonances, where digits of the stiffness of the elements are most of the error."""
    varied = varied_model(box("hex8", (3, 1, 1), (LENGTH, SIDE, SIDE)), [STEEL], [E, spring((3e4, 2e4, 2e4, 4, 5, 6))])
    model = varied.model(varied.box.nominal)
    ends = [
        make_interface(model, name=name, nodes=np.flatnonzero(np.isclose(model.nodes.xyz[:, 0], x)))
        for name, x in (("root", 0.0), ("tip", LENGTH))
    ]
    worse, rates = 0, []
    with AffineProblem(varied, ends, damping=DAMPING) as problem:
        model = search(problem, BAND).model
        S = np.outer(model.scale, model.scale)
        for p in np.random.default_rng(1).uniform(model.box.low, model.box.high, (3, 2)):
            at = model.at(p)
            hz = np.concatenate([[20.0, 400.0, 3000.0], at.frequencies_hz[:3] * (1 + 1e-3)])
            with problem.at(p, assembled=assembled) as full:
                true = [exact_response(full.K, full.M, full.B, DAMPING, f) for f in hz]
            bounds, exact_matrices = at.bound(hz), replace(at.bound_at, unsure_K=0 * at.bound_at.unsure_K)
            error = [np.linalg.norm((H - own) * S) for H, own in zip(true, at.response(hz), strict=True)]
            assert at.bound_kind == "bound" and (error <= bounds).all()
            worse += (error > exact_matrices.error(2 * np.pi * hz)).sum()
            rates += (bounds[:3] / error[:3]).tolist()
    # It is round-off that this is about, and away from resonances it costs little.
    assert worse > 3 and np.median(rates) < 10
