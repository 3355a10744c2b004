"""Gramian reduction of a band against other methods, full factorisations and dense solutions."""

from functools import cache

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.certificate.certify import certify
from morembs.certificate.response import full_response, reduced_response
from morembs.fem import FEModel
from morembs.fem.interface import make_interface
from morembs.linalg.quadrature import gauss
from morembs.problem import Damping, Problem
from morembs.reducers import FreeInterface, Modal
from morembs.reducers.gramian import Gramian
from morembs.responses.loads import inertia_loads
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal

BAND = [50.0, 2600.0]
RAYLEIGH = Damping(alpha=5.0, beta=2e-6)


@cache
def beam(n=(24, 2, 2)):
    return steel(box("hex8", n, (0.5, 0.05, 0.03)), density=7800.0)


def problem_of(model, damping=RAYLEIGH):
    interfaces = [
        make_interface(model, name=name, nodes=where(model, 0, x), coupling="average")
        for name, x in (("left", 0.0), ("right", 0.5))
    ]
    return Problem(model, interfaces, damping=damping)


def short(damping=RAYLEIGH):
    return problem_of(beam((10, 2, 1)), damping)


def deviation(problem, reduced, omega):
    """Largest relative error over the frequencies, moments counted over the length of the body."""
    scale = np.outer(problem.motion_scale, problem.motion_scale)
    H = full_response(problem, omega, tolerance=1e-12) * scale
    h = reduced_response(reduced, omega) * scale
    return (np.linalg.norm(h - H, axis=(1, 2)) / np.linalg.norm(H, axis=(1, 2))).max()


def angles(problem, first, second):
    """Cosines of the angles between the elastic spaces of two reduced models, in M."""
    r = problem.rigid.shape[1]
    return sl.svdvals(first.V[:, r:].T @ (problem.M @ second.V[:, r:]))


def test_the_free_beam_of_the_method_comparison():
    """24 elastic coordinates each: the Gramian wins by two decades over residual statics, those by three over modes."""
    omega = 2 * np.pi * np.linspace(*BAND, 120)
    with problem_of(beam()) as problem:
        reduced = [
            reducer.reduce(problem)
            for reducer in (Modal(modes=24), FreeInterface(modes=12), Gramian(band_hz=BAND, order=24, points=12))
        ]
        assert [r.order - r.rigid_count for r in reduced] == [24, 24, 24]
        modal, statics, gramian = (deviation(problem, r, omega) for r in reduced)
    assert 1.1e-1 / 3 < modal < 1.1e-1 * 3
    assert 2.9e-5 / 3 < statics < 2.9e-5 * 3
    assert gramian < 1e-6 and gramian < 0.1 * statics < 0.01 * modal
    with problem_of(beam()) as problem:
        # The published 1.1e-7 counts a newton metre like a newton.
        problem.motion_scale = np.ones(12)
        plain = Gramian(band_hz=BAND, order=24, points=12).reduce(problem)
        assert deviation(problem, plain, omega) < 3 * 1.1e-7


def test_more_points_hardly_change_the_error():
    omega = 2 * np.pi * np.linspace(*BAND, 120)
    with problem_of(beam()) as problem:

        def error(points):
            return deviation(problem, Gramian(band_hz=BAND, order=24, points=points).reduce(problem), omega)

        assert error(24) == pytest.approx(error(12), rel=0.1)
        assert error(None) == pytest.approx(error(600), rel=0.1)


@pytest.mark.parametrize("options", [{}, {"static": True}, {"weight": "velocity"}, {"inertia_loads": True}], ids=str)
def test_full_factorisations_give_the_same_space(options):
    omega = 2 * np.pi * np.linspace(*BAND, 40)
    with short() as problem:
        spaces = [
            Gramian(band_hz=BAND, order=20, points=8, direct=direct, **options).reduce(problem)
            for direct in (False, True)
        ]
        fast, slow = (deviation(problem, reduced, omega) for reduced in spaces)
        assert angles(problem, *spaces).min() > 1 - 1e-6
    assert fast == pytest.approx(slow, rel=0.03)
    assert spaces[0].recipe["part_left_out"] == pytest.approx(spaces[1].recipe["part_left_out"], rel=1e-4)


@pytest.mark.parametrize("weight", ["position", "velocity"])
@pytest.mark.parametrize(("order", "static"), [(6, False), (15, False), (18, True)])
def test_the_part_left_out_is_the_projection_error_of_dense_solutions(weight, order, static):
    """The identity of the method, with snapshots from dense solves of the damped equations."""
    with short() as problem:
        reduced = Gramian(band_hz=BAND, order=order, points=6, weight=weight, static=static).reduce(problem)
        K, M, Z = problem.K.toarray(), problem.M.toarray(), problem.rigid
        F = problem.B.toarray() * problem.motion_scale
        F -= M @ Z @ (Z.T @ F)
        omega, weights = gauss(*(2 * np.pi * np.array(BAND)), 6)
        X = K + omega.mean() ** 2 * M
        V = reduced.V[:, 6:]
        project = V @ np.linalg.solve(V.T @ X @ V, V.T @ X)
        left = whole = 0.0
        for w, part in zip(omega, weights, strict=True):
            A = (1 + 2e-6j * w) * K + (5j * w - w**2) * M
            U = np.linalg.solve(A, F) * (1j * w if weight == "velocity" else 1)
            U -= Z @ (Z.T @ M @ U)
            rest = U - project @ U
            left += part * np.einsum("ij,ij->", rest.conj(), X @ rest).real
            whole += part * np.einsum("ij,ij->", U.conj(), X @ U).real
    assert reduced.recipe["part_left_out"] == pytest.approx(np.sqrt(left / whole), rel=1e-5)


def test_a_tolerance_chooses_the_smallest_order_that_keeps_it():
    with short() as problem:
        chosen = Gramian(band_hz=BAND, tolerance=1e-3).reduce(problem)
        fewer = Gramian(band_hz=BAND, order=chosen.order - 7).reduce(problem)
        same = Gramian(band_hz=BAND, order=chosen.order - 6).reduce(problem)
    assert chosen.recipe["part_left_out"] <= 1e-3 < fewer.recipe["part_left_out"]
    assert np.abs(chosen.K - same.K).max() < 1e-9 * chosen.K.max()


@pytest.mark.parametrize("direct", [False, True])
def test_statics_at_the_interfaces_are_kept_on_demand(direct):
    with short() as problem:
        G = problem.free_free.flexibility(problem.B.toarray())
        exact = problem.B.T @ G
        scale = np.outer(problem.motion_scale, problem.motion_scale)
        for static in (True, False):
            reducer = Gramian(band_hz=[1000.0, 2600.0], order=18, points=8, static=static, direct=direct)
            reduced = reducer.reduce(problem)
            h = reduced_response(reduced, np.zeros(1))[0].real
            error = np.linalg.norm((h - exact) * scale) / np.linalg.norm(exact * scale)
            assert error < 1e-10 if static else error > 1e-9
            assert reduced.recipe["static_directions"] == (12 if static else 0)


def test_inertia_loads_are_followed_where_they_are_asked_for():
    """Response to centrifugal loads in the band, projected: much better with them among the loads."""
    with short() as problem:
        F, K, M = inertia_loads(problem), problem.K.toarray(), problem.M.toarray()
        w = 2 * np.pi * 2000.0
        U = np.linalg.solve((1 + 2e-6j * w) * K + (5j * w - w**2) * M, F.astype(complex))
        error = []
        for loads in (False, True):
            reduced = Gramian(band_hz=BAND, order=30, inertia_loads=loads).reduce(problem)
            A = reduced.K + 1j * w * reduced.D - w**2 * reduced.M
            projected = reduced.V @ np.linalg.solve(A, reduced.V.T @ F)
            error.append(np.linalg.norm(projected - U) / np.linalg.norm(U))
    assert error[1] < 0.1 * error[0] and error[1] < 1e-3


@pytest.mark.parametrize("direct", [False, True])
def test_units_do_not_matter(direct):
    """Kilograms with metres or millimetres: forces, moments and inertia loads keep their proportions."""
    responses = []
    for size, change in ((1.0, {"density": 7800.0}), (1e3, {"density": 7.8e-6, "young": 2.1e8})):
        model = steel(box("hex8", (6, 2, 1), (0.5 * size, 0.05 * size, 0.03 * size)), **change)
        interfaces = [
            make_interface(model, name=name, nodes=where(model, 0, x * size), coupling="average")
            for name, x in (("left", 0.0), ("right", 0.5))
        ]
        with Problem(model, interfaces, damping=RAYLEIGH) as problem:
            reducer = Gramian(band_hz=BAND, order=20, points=5, inertia_loads=True, direct=direct)
            reduced = reducer.reduce(problem)
        responses.append([reduced.recipe["part_left_out"], *np.diag(reduced.K)[6:]])
    assert responses[1] == pytest.approx(responses[0], rel=1e-5)


@pytest.mark.parametrize("direct", [False, True])
def test_an_undamped_resonant_band_is_integrated_beside_the_axis_and_says_so(direct):
    omega = 2 * np.pi * np.array([60.0, 500.0, 1300.0, 2500.0])
    with short(Damping()) as problem:
        reduced = Gramian(band_hz=BAND, order=24, direct=direct).reduce(problem)
        assert reduced.recipe["delta_1_per_s"] == pytest.approx(0.01 * 2 * np.pi * BAND[1])
        assert deviation(problem, reduced, omega) < 1e-5
        below = Gramian(band_hz=[0.0, 400.0], order=12).reduce(problem)
        assert problem.elastic_modes(count=1).frequencies_hz[0] > 600
        assert below.recipe["delta_1_per_s"] == 0.0
    with short() as problem:
        assert Gramian(band_hz=BAND, order=24, direct=direct).reduce(problem).recipe["delta_1_per_s"] == 0.0


def test_light_damping_makes_more_points_and_no_worse_bases():
    omega = 2 * np.pi * np.linspace(*BAND, 30)
    points = []
    for ratio in (0.02, 1e-4):
        with short(Damping(modal=ratio)) as problem:
            reduced = Gramian(band_hz=BAND, order=24).reduce(problem)
            assert deviation(problem, reduced, omega) < 3e-5
            points.append(reduced.recipe["quadrature_points"])
    assert points[1] > 1.5 * points[0]


def test_a_damping_matrix_of_the_model_is_solved_directly():
    """A damper between the ends, which is no proportional damping."""
    free = beam((10, 2, 1))
    end = [free.dofs.of_nodes(where(free, 0, x)).ravel()[1] for x in (0.0, 0.5)]
    d = np.zeros((free.size, 1))
    d[end] = [[1.0], [-1.0]]
    column = sp.csr_array(d)
    model = FEModel(
        K=free.K,
        M=free.M,
        D=sp.csr_array(200.0 * column @ column.T + 2e-6 * free.K),
        nodes=free.nodes,
        dofs=free.dofs,
        mesh=free.mesh,
    )
    with problem_of(model, Damping()) as problem:
        bodies = [Gramian(band_hz=BAND, order=24, direct=direct).reduce(problem) for direct in (False, True)]
        assert bodies[1].recipe["delta_1_per_s"] == 0.0
        K, M, D, Z = problem.K.toarray(), problem.M.toarray(), problem.D.toarray(), problem.rigid
        B = problem.B.toarray()
        for w in 2 * np.pi * np.array([100.0, 1084.0, 2400.0]):
            exact = B.T @ np.linalg.solve(K + 1j * w * D - w**2 * M, (B - M @ Z @ (Z.T @ B)).astype(complex))
            for reduced in bodies:
                A = reduced.K + 1j * w * reduced.D - w**2 * reduced.M
                loads = reduced.B.copy()
                loads[:6] = 0.0
                response = reduced.C @ np.linalg.solve(A, loads)
                assert np.linalg.norm(response - exact) < 1e-4 * np.linalg.norm(exact)
    with problem_of(model, Damping(beta=1e-6)) as problem, refusal("unsupported", "", '"gramian"', "alpha", "beta"):
        Gramian(band_hz=BAND, order=24, direct=True).reduce(problem)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"band_hz": [50.0], "order": 3}, ("value", "band_hz", "HIGH")),
        ({"band_hz": [50.0, 50.0], "order": 3}, ("value", "band_hz", "HIGH")),
        ({"band_hz": [-1.0, 50.0], "order": 3}, ("value", "band_hz", "HIGH")),
        ({"band_hz": [1.0, float("nan")], "order": 3}, ("value", "band_hz", "HIGH")),
        ({"band_hz": BAND}, ("missing", "order")),
        ({"band_hz": BAND, "order": 3, "tolerance": 0.1}, ("missing", "order")),
        ({"band_hz": BAND, "order": 0}, ("value", "order")),
        ({"band_hz": BAND, "tolerance": 0.0}, ("value", "tolerance")),
        ({"band_hz": BAND, "tolerance": 1.0}, ("value", "tolerance")),
        ({"band_hz": BAND, "order": 3, "weight": "speed"}, ("value", "weight", "position", "velocity")),
        ({"band_hz": BAND, "order": 3, "points": 0}, ("value", "points")),
    ],
)
def test_options_that_make_no_sense_are_refused_before_any_work(options, message):
    with refusal(*message):
        Gramian(**options)


def test_orders_and_bands_that_do_not_fit_the_model_are_refused():
    with short() as problem:
        for direct in (False, True):
            with refusal("value", "order") as refused:
                Gramian(band_hz=BAND, order=300, points=3, direct=direct).reduce(problem)
            reachable = int(str(refused.value).split("span ")[1].split()[0])
            fits = Gramian(band_hz=BAND, order=reachable, points=3, direct=direct).reduce(problem)
            assert fits.order == 6 + reachable
            with refusal("value", "band_hz"):
                Gramian(band_hz=[0.0, 0.02], order=5, points=3, direct=direct).reduce(problem)
            with refusal("value", "order", "12"):
                Gramian(band_hz=BAND, order=5, points=3, static=True, direct=direct).reduce(problem)
    with short(Damping(modal=0.01)) as problem, refusal("unsupported", "", '"gramian"', "direct"):
        Gramian(band_hz=BAND, order=5, direct=True).reduce(problem)
    with Problem(beam((2, 1, 1))) as problem, refusal("unsupported", "", '"gramian"', "[[interface]]"):
        Gramian(band_hz=BAND, order=5).reduce(problem)


def test_modal_damping_of_a_large_model_is_no_worse_than_structural_damping_of_the_same_ratio():
    # The change of H by a block of the reference stays above 1e-11 by round-off, where the model has many more modes.
    model = steel(box("hex20", (5, 2, 2), (0.5, 0.06, 0.04)))
    limits = []
    for damping in (Damping(modal=0.01), Damping(structural=0.02)):
        with problem_of(model, damping) as problem:
            reduced = Gramian(band_hz=[0.0, 4000.0], order=18).reduce(problem)
            (certificate,) = certify(problem, [reduced], [0.0, 4000.0])
            limits.append(certificate.limit.upper)
            assert reduced.order == 24 and certificate.kind == "proven"
    assert limits[0] < 2 * limits[1] < 0.1, limits
