"""Soft supports beside stiff parts: recognised, delivered rightly, or refused; free bodies stay free."""

from __future__ import annotations

import logging
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.certificate.certify import certify
from morembs.fem import DofMap, FEModel, Nodes
from morembs.fem.geometric_stiffness import geometric_stiffness
from morembs.fem.interface import make_interface
from morembs.linalg.rigid import decimal_precision
from morembs.problem import Problem
from morembs.reducers import AutoReducer, CraigBampton, Guyan, Modal
from morembs.reducers.family_search import distances_to_shift
from tests.support.meshes import box, steel, where

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "attack"))
import structured

from tests.support.refusals import refusal

MASS, SPRING = 191.0, 1e5
CORNERS = np.array([[x, y, z] for x in (0.0, 0.4) for y in (0.0, 0.3) for z in (0.0, 0.2)])


def block(link: float, spring: float = SPRING, everywhere: bool = False) -> FEModel:
    """A stiff block of eight masses on springs of its corners: three along z, two along y, one along x."""
    n = len(CORNERS)
    K = np.zeros((3 * n, 3 * n))
    for b in range(n):
        for a in range(b):
            d = (CORNERS[b] - CORNERS[a]) / np.linalg.norm(CORNERS[b] - CORNERS[a])
            v = np.zeros((n, 3))
            v[a], v[b] = -d, d
            K += (link if (a, b) == (0, 1) else 1e11) * np.outer(v, v)
    held = range(3 * n) if everywhere else (2, 3 * 2 + 2, 3 * 6 + 2, 1, 3 * 4 + 1, 3 * 3)
    for dof in held:
        K[dof, dof] += spring
    nodes = Nodes(ids=np.arange(n), xyz=CORNERS)
    return FEModel(K=K, M=np.eye(3 * n) * MASS / n, nodes=nodes, dofs=DofMap.translations(n))


def rigid_block(model: FEModel) -> np.ndarray:
    """Frequencies (6,) in Hz of the block as one rigid body on its springs."""
    R = np.zeros((24, 6))
    for i, (x, y, z) in enumerate(CORNERS - CORNERS.mean(axis=0)):
        R[3 * i : 3 * i + 3] = np.hstack([np.eye(3), [[0, z, -y], [-z, 0, x], [y, -x, 0]]])
    springs = [2, 8, 20, 1, 13, 9]
    K = R[springs].T @ R[springs] * SPRING
    return np.sqrt(sl.eigvalsh(K, R.T @ (model.M @ R))) / (2 * np.pi)


@pytest.mark.parametrize("link", [1e11, 1e13, 1e14, 1e15])
def test_a_block_on_springs_keeps_them_beside_a_stiff_link(link: float) -> None:
    model = block(link)
    exact = rigid_block(model)
    tip = make_interface(model, name="tip", nodes=np.array([7]), coupling="direct")
    with Problem(model, [tip]) as problem:
        assert problem.rigid.shape[1] == 0
        modal = Modal(modes=8).reduce(problem)
        whole = CraigBampton(modes=21).reduce(problem)
    for body in (modal, whole):
        values = 1 / sl.eigh(body.M, body.K, eigvals_only=True)[::-1]
        assert np.sqrt(values[:6]) / (2 * np.pi) == pytest.approx(exact, rel=1e-5)
    force = np.array([0.0, 0.0, 1.0])
    # One spring more than the three along z would hold the tip; at 1 Hz the block all but follows statics.
    omega = 2 * np.pi * 1.0
    moved = whole.C @ np.linalg.solve(whole.K - omega**2 * whole.M, whole.B @ force)
    full = np.linalg.solve(model.K.toarray() - omega**2 * model.M.toarray(), problem.B @ force)
    assert moved == pytest.approx(problem.B.T @ full, rel=1e-4)


@pytest.mark.parametrize("spring", [1.0, 100.0])
def test_a_soft_ground_under_every_node_is_kept(spring: float) -> None:
    model = block(1e11, spring, everywhere=True)
    with Problem(model) as problem:
        assert problem.rigid.shape[1] == 0
        values = problem.elastic_modes(count=6).eigenvalues
    assert values == pytest.approx(spring / (MASS / 8), rel=1e-3)


def test_a_free_plate_with_a_rigid_side_of_thousands_of_nodes_is_free() -> None:
    """Rows of its frame sum up a million terms: round-off reaches 7e-14 of them, and is no support."""
    mesh = box("hex8", (100, 100, 1), (1.0, 1.0, 0.01))
    model = steel(mesh)
    side = make_interface(model, name="side", nodes=np.flatnonzero(mesh.nodes.xyz[:, 2] < 1e-9))
    with Problem(model, [side]) as problem:
        assert problem.rigid.shape[1] == 6


def test_automatic_on_soft_springs_keeps_its_promise() -> None:
    model = block(1e12)
    tip = make_interface(model, name="tip", nodes=np.array([7]), coupling="direct")
    hz = np.linspace(1.0, 5.0, 5)
    with Problem(model, [tip]) as problem:
        body = AutoReducer(band_hz=[1.0, 5.0], tolerance=1e-3).reduce(problem)
        (certificate,) = certify(problem, [body], [1.0, 5.0])
        c = 1 + 0.02j
        dense = [
            problem.B.T
            @ np.linalg.solve(c * problem.K.toarray() - (2 * np.pi * f) ** 2 * problem.M.toarray(), problem.B.toarray())
            for f in hz
        ]
        responses = [body.C @ np.linalg.solve(c * body.K - (2 * np.pi * f) ** 2 * body.M, body.B) for f in hz]
    true = np.array([np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in zip(responses, dense, strict=True)])
    assert certificate.kind == "proven" and certificate.damping_floor == 0.01 and certificate.limit.upper <= 1e-3
    assert (true <= certificate.limits["pointwise"].upper).all() and (true < 1e-3).all()


def test_a_support_within_round_off_is_refused() -> None:
    with refusal("model", "supports"):
        Problem(block(1e11, spring=4e-3, everywhere=True))


@pytest.mark.parametrize("digits", [9, 10, 12])
@pytest.mark.parametrize("kind", ["hex8", "tet10"])
def test_free_bodies_of_few_digits_stay_free(digits: int, kind: str) -> None:
    model = steel(box(kind, (4, 2, 2), (0.5, 0.07, 0.03)))
    K = model.K.copy()
    K.data = np.array([float(f"{value:.{digits - 1}e}") for value in K.data])
    with Problem(replace(model, K=K)) as problem:
        assert problem.rigid.shape[1] == 6


@pytest.mark.parametrize("far", [0.0, 10.0, 1e4])
@pytest.mark.parametrize("scale", [1.0, 1e3, 1e9, 1e-6])
def test_free_bodies_far_away_and_in_other_units_stay_free(far: float, scale: float) -> None:
    mesh = box("hex8", (4, 2, 2), (0.5, 0.07, 0.03))
    model = steel(replace(mesh, nodes=replace(mesh.nodes, xyz=mesh.nodes.xyz + far)))
    model = replace(model, nodes=replace(model.nodes, xyz=model.nodes.xyz * scale))
    interface = make_interface(model, name="end", nodes=where(model, 0, far * scale), coupling="rigid")
    with Problem(model, [interface]) as problem:
        assert problem.rigid.shape[1] == 6


def test_soft_springs_on_a_solid_hold_it_whatever_the_units() -> None:
    model = steel(box("hex20", (4, 1, 1), (0.5, 0.05, 0.03)))
    for scale in (1.0, 1e3, 1e-3):
        # One node held along x, y, z: rotations about it stay free. Then all nodes of an end.
        for rows, free in ((where(model, 0, 0.0)[:1], 3), (where(model, 0, 0.0), 0)):
            K = model.K.tolil()
            for dof in model.dofs.of_nodes(rows).ravel():
                K[dof, dof] += 10.0
            other = replace(model, K=sp.csr_array(K) * scale, nodes=replace(model.nodes, xyz=model.nodes.xyz * scale))
            with Problem(other) as problem:
                assert problem.rigid.shape[1] == free


@pytest.mark.parametrize(
    "number",
    [
        *((6, number) for number in (56, 66, 141, 196)),
        (7, 16),
        (7, 74),
        (8, 192),
        (10, 206),
        *((31, number) for number in (103, 136, 173)),
    ],
)
def test_models_that_came_out_wrong_or_were_refused_once(number: tuple[int, int]) -> None:
    logging.disable(logging.WARNING)
    try:
        ((case, verdict),) = structured.main(0, number[0], only=number[1], automatic=1000)
    finally:
        logging.disable(logging.NOTSET)
    assert verdict.kind == "right" or (verdict.kind == "refused" and case.decade >= 8), verdict.words


def test_the_delivered_stiffness_of_a_free_body_resists_rigid_motion_by_its_rounding_only() -> None:
    case = structured.random_case(np.random.default_rng([10, 206]))
    model = case.model()
    ends = [make_interface(model, name=str(a), nodes=np.array([a]), coupling="direct") for a in range(4)]
    with Problem(model, ends) as problem:
        body = Guyan().reduce(problem)
    values, Y = body.modes()
    Y = np.abs(Y[:, :6])
    rounding = 2.0**-52 * np.einsum("ij,ij->j", Y, np.abs(body.K) @ Y)
    # Loads that are not refined leave some twenty times as much.
    assert (np.abs(values[:6]) <= 4 * rounding).all()


def test_round_off_is_that_of_the_equilibrated_matrix_before_and_after_a_reduction() -> None:
    roundings = []
    for first in (False, True):
        model = block(1e13)
        tip = make_interface(model, name="tip", nodes=np.array([7]), coupling="direct")
        with Problem(model, [tip]) as problem:
            if first:
                Guyan().reduce(problem)
            roundings.append(problem.system.roundoff(problem.elastic_modes(count=8).vectors))
    assert roundings[1] == pytest.approx(roundings[0], rel=1e-9)


@pytest.mark.parametrize("on", [0, 1, 2])
@pytest.mark.filterwarnings("error")
def test_a_sample_on_an_undamped_resonance_is_no_trouble(on: int) -> None:
    model = block(1e11)
    tip = make_interface(model, name="tip", nodes=np.array([7]), coupling="direct")
    with Problem(model, [tip]) as problem:
        exact = problem.elastic_modes(count=6).frequencies_hz
        # The ends of a band are samples.
        band = [float(exact[on]), 1.1 * float(exact[5])]
        body = AutoReducer(band_hz=band, tolerance=1e-3).reduce(problem)
        assert body.recipe["damping_floor"] == 0.01 and body.recipe["certified"] <= 1e-3
        with refusal("unsupported", "damping", "damping_floor"):
            AutoReducer(band_hz=band, tolerance=1e-3, damping_floor=0.0).reduce(problem)


def test_a_shift_on_a_resonance_gives_finite_columns() -> None:
    values = np.array([1.0, 4.0, 9.0])
    moved = distances_to_shift(values, 2.0)
    assert (np.abs(moved) >= 1e-3 * values).all() and np.isfinite(1.0 / moved).all()
    assert np.array_equal(distances_to_shift(values, 1.5), values - 1.5**2)


def test_random_models_over_twelve_decades_of_stiffness() -> None:
    logging.disable(logging.WARNING)
    try:
        verdicts = structured.main(12, 11, automatic=100, largest=24)
    finally:
        logging.disable(logging.NOTSET)
    assert not [verdict.words for _, verdict in verdicts if verdict.kind == "wrong"]
    assert not [verdict.words for case, verdict in verdicts if verdict.kind == "refused" and case.decade < 8]


@pytest.mark.parametrize(
    "form",
    [
        sp.csr_matrix,
        sp.coo_matrix,
        sp.csc_matrix,
        sp.bsr_matrix,
        sp.dia_matrix,
        sp.lil_matrix,
        sp.dok_matrix,
        sp.coo_array,
        sp.csr_array.toarray,
        sp.csr_array.todense,
    ],
)
def test_matrices_of_any_form_give_the_same_body(form) -> None:
    model = steel(box("hex8", (3, 1, 1), (0.5, 0.05, 0.03)))
    matrices = []
    for K, M in ((model.K, model.M), (form(model.K), form(model.M))):
        other = replace(model, K=K, M=M)
        ends = [
            make_interface(other, name=name, nodes=where(other, 0, x), coupling="direct")
            for name, x in (("a", 0), ("b", 0.5))
        ]
        with Problem(other, ends) as problem:
            matrices.append(CraigBampton(modes=3).reduce(problem))
    assert pytest.approx(matrices[0].K, rel=1e-12, abs=1e-6) == matrices[1].K


def test_integers_and_wide_indices_are_taken_and_other_things_are_not() -> None:
    model = steel(box("hex8", (2, 1, 1), (0.5, 0.05, 0.03)))
    whole = sp.csr_matrix(model.K).astype(np.int64)
    whole.indices, whole.indptr = whole.indices.astype(np.int64), whole.indptr.astype(np.int64)
    assert replace(model, K=whole).K.dtype == np.float64
    for wrong, words in (
        ("K", ("value", "K")),
        (None, ("value", "K")),
        (np.zeros(3), ("value", "K")),
        (model.K[:2], ("value", "K")),
    ):
        with refusal(*words):
            replace(model, K=wrong)


@pytest.mark.parametrize("interfaces", ["free", "fixed"])
def test_a_body_without_elastic_coordinates_is_refused(interfaces: str) -> None:
    model = steel(box("hex8", (2, 1, 1), (0.5, 0.05, 0.03)))
    end = make_interface(model, name="end", nodes=where(model, 0, 0.0), coupling="rigid")
    with Problem(model, [end]) as problem, refusal("value", "modes"):
        Modal(modes=0, interfaces=interfaces).reduce(problem)


def oblique(model: FEModel, stiffness: float, nodes: range) -> FEModel:
    """``model`` with an oblique spring to the ground at each of ``nodes``, whose rows do work of either sign."""
    K = model.K.toarray()
    for node in nodes:
        d = np.array([[1.0, -2.0, 3.0], [2.0, 1.0, -1.0], [-3.0, 1.0, 1.0]][node % 3])
        at = slice(3 * node, 3 * node + 3)
        K[at, at] += stiffness * np.outer(d, d) / (d @ d)
    return replace(model, K=K)


@pytest.mark.parametrize("far", [0.0, 100.0])
@pytest.mark.parametrize("count", [1, 2, 3, 8])
@pytest.mark.parametrize("stiffness", [1e3, 1e5, 1e7])
def test_oblique_springs_are_counted_and_not_taken_for_few_digits(stiffness: float, count: int, far: float) -> None:
    model = oblique(block(1e11, 0.0), stiffness, range(count))
    model = replace(model, nodes=replace(model.nodes, xyz=model.nodes.xyz + far))
    with Problem(model) as problem:
        assert problem.rigid.shape[1] == max(6 - count, 0)


@pytest.mark.parametrize("part", [1e-8, 3e-8, 1e-6])
def test_a_support_beside_numbers_of_few_digits_is_not_lost(part: float) -> None:
    model = steel(box("hex8", (4, 2, 2), (0.5, 0.07, 0.03)))
    K = model.K.toarray()
    K[:] = [[float(f"{value:.9e}") for value in row] for row in K]
    node = where(model, 0, 0.0)[:1]
    for dof in model.dofs.of_nodes(node).ravel():
        K[dof, dof] *= 1 + part
    if part == 1e-8:
        with refusal("model", "supports"):
            Problem(replace(model, K=K))
        return
    with Problem(replace(model, K=K)) as problem:
        assert problem.rigid.shape[1] == 3


def test_coordinates_of_another_order_are_refused_a_bedding_and_a_preload_are_not() -> None:
    model = steel(box("hex8", (6, 3, 3), (0.5, 0.07, 0.03)))
    mesh, n = model.mesh, len(model.nodes)
    mixed = replace(model.nodes, xyz=model.nodes.xyz[np.random.default_rng(0).permutation(n)])
    wrong = replace(model, nodes=mixed)
    side = make_interface(wrong, name="side", nodes=where(model, 0, 0.0), coupling="rigid")
    # A rigid side that K does not fit holds the body: the matrices without it say that it is free.
    for interfaces in ([], [side]):
        with Problem(wrong, interfaces) as problem, refusal("model", "K"):
            Modal(modes=2).reduce(problem)
    pull = np.zeros(3 * n)
    pull[::3] = 0.005 * model.nodes.xyz[:, 0]
    stress = geometric_stiffness(mesh, model.materials, pull)
    for added in (sp.diags_array(np.full(model.size, 1e8)), sp.kron(stress, np.eye(3))):
        with Problem(replace(model, K=model.K + added)) as problem:
            assert problem.rigid.shape[1] < 6


@pytest.mark.parametrize("n", [(4, 2, 2), (6, 4, 4), (2, 2, 2)])
def test_fourteen_digits_of_a_regular_mesh_are_no_support_and_hide_none(n: tuple[int, int, int]) -> None:
    """The same entries are rounded alike everywhere, which looks like a ground."""
    model = steel(box("tet4", n, tuple(map(float, n))))
    rounded = model.K.copy()
    rounded.data = np.array([float(f"{value:.13e}") for value in rounded.data])
    with Problem(replace(model, K=rounded), []) as problem:
        assert problem.rigid.shape[1] == 6
    spring = sp.csr_array(([1e-10 * rounded.max()] * 3, ([0, 1, 2], [0, 1, 2])), shape=rounded.shape)
    with Problem(replace(model, K=sp.csr_array(rounded + spring)), []) as problem:
        assert problem.rigid.shape[1] == 3


@pytest.mark.parametrize("digits", [6, 12, 13, 14, 15, 17])
@pytest.mark.parametrize("factor", [1.0, 1e3, 1e-9])
def test_decimal_numbers_are_told_by_their_last_digit(digits: int, factor: float) -> None:
    values = np.random.default_rng(2).lognormal(0.0, 5.0, 500)
    told = decimal_precision(factor * np.array([float(f"{value:.{digits - 1}e}") for value in values]))
    assert told == (0.5 * 10.0 ** (1 - digits) if digits in (12, 13, 14) else 0.0)
    assert decimal_precision(np.arange(1.0, 400.0)) == 0.0 and decimal_precision(values[:3]) == 0.0
