"""Shifts that look for a small H2 error, against dense responses of the full model."""

import importlib.util
import re

import numpy as np
import pytest
import scipy.linalg as sl

from benchmarks.certificates import truss
from morembs.base.progress import listening
from morembs.certificate.response import full_response, reduced_response
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers.irka import Irka
from morembs.reducers.krylov import Krylov
from tests.support.meshes import box, steel, where
from tests.support.progress import Heard
from tests.support.refusals import refusal
from tests.support.solvers import CountingSolver

BAND = [50.0, 6000.0]


def tip(components=(1,), place=0.5):
    """A beam with the sideways motion of its tip as the only interface."""
    model = steel(box("hex20", (8, 1, 1), (0.5, 0.05, 0.03)))
    return model, [
        make_interface(model, name="tip", nodes=where(model, 0, place), coupling="average", components=components)
    ]


def h2_error(problem, r, omega):
    """Relative, by the trapezoidal rule on a fine grid."""
    H, h = full_response(problem, omega), reduced_response(r, omega)
    S = np.outer(problem.motion_scale, problem.motion_scale)
    sizes = [np.trapezoid(np.linalg.norm(S * x, axis=(1, 2)) ** 2, omega) for x in (h - H, H)]
    return np.sqrt(sizes[0] / sizes[1])


@pytest.mark.parametrize(
    ("damping", "order"),
    [(Damping(alpha=200.0, beta=5e-6), 4), (Damping(modal=0.03), 2), (Damping(modal=0.03), 5)],
    ids=repr,
)
def test_error_in_the_band_is_measured_and_no_larger_than_at_the_start(damping, order):
    model, interfaces = tip((1, 2, 5))
    omega = 2 * np.pi * np.linspace(*BAND, 2000)
    with Problem(model, interfaces, damping=damping) as problem:
        r = Irka(order=order, band_hz=BAND).reduce(problem)
        error = h2_error(problem, r, omega)
    assert r.order == 6 + order
    assert r.recipe["h2_error"] <= r.recipe["first_h2_error"]
    assert r.recipe["h2_error"] == pytest.approx(error, rel=0.02)


# Bands where the best model is one of the last: its shifts have come to rest, and mirror poles this well.
@pytest.mark.parametrize(
    ("components", "order", "band", "mirrored"), [((5,), 2, [1000.0, 3000.0], 0.02), ((2,), 6, [0.0, 3000.0], 0.03)]
)
def test_converged_shifts_are_mirrored_poles_where_the_transfer_function_is_tangent(components, order, band, mirrored):
    """One load, proportional damping: H and dH/ds of the dense model at the shifts, which mirror poles of the model."""
    damping = Damping(alpha=200.0, beta=5e-6)
    model, interfaces = tip(components)
    with Problem(model, interfaces, damping=damping) as problem:
        r = Irka(order=order, band_hz=band, tolerance=1e-7).reduce(problem)
        K, M, Z = problem.K.toarray(), problem.M.toarray(), problem.rigid
        B = problem.B.toarray() - M @ Z @ (Z.T @ problem.B.toarray())
    assert r.recipe["kept"] == "shifts" and r.recipe["converged"] and r.recipe["kept_step"] > 0
    assert len(r.recipe["shifts"]) == order // 2
    D = damping.alpha * (M - M @ Z @ Z.T @ M) + damping.beta * K
    m, d, k, b = r.M[6:, 6:], r.D[6:, 6:], r.K[6:, 6:], r.B[6:]
    poles = np.linalg.eigvals(np.block([[np.zeros_like(k), np.eye(order)], [-k, -d]]))

    def both(M, D, K, B, s):
        x = np.linalg.solve(s * s * M + s * D + K, B)
        return (B.T @ x).item(), (-x.T @ (2 * s * M + D) @ x).item()

    for shift in r.recipe["shifts"]:
        s = complex(*shift)
        assert s.real > 0
        full, of_reduced = both(M, D, K, B, s), both(m, d, k, b, s)
        assert abs(full[0] - of_reduced[0]) < 1e-7 * abs(full[0])
        assert abs(full[1] - of_reduced[1]) < 1e-6 * abs(full[1])
        assert np.abs(-poles - s).min() < mirrored * abs(s)


def test_few_coordinates_beat_shifts_chosen_by_hand():
    damping = Damping(alpha=200.0, beta=5e-6)
    model, interfaces = tip((1,))
    omega = 2 * np.pi * np.linspace(*BAND, 2000)
    with Problem(model, interfaces, damping=damping) as problem:
        chosen = h2_error(problem, Irka(order=4, band_hz=BAND).reduce(problem), omega)
        by_hand = h2_error(problem, Krylov(shifts_hz=[0.0, 2000.0, 4000.0, 6000.0]).reduce(problem), omega)
    assert chosen < 0.5 * by_hand


def test_undamped_models_are_moved_off_the_axis_and_told():
    model, interfaces = tip((2,))
    with Problem(model, interfaces) as problem:
        r = Irka(order=6, band_hz=[0.0, 3000.0]).reduce(problem)
        assert np.abs(r.D).max() == 0.0
    delta = r.recipe["delta"]
    assert delta == pytest.approx(0.005 * 2 * np.pi * 3000.0)
    # A pole on the axis has its image across the line Re s = delta at 2 delta.
    assert r.recipe["converged"] and r.recipe["h2_error"] < 1e-9
    assert [re for re, _ in r.recipe["shifts"]] == pytest.approx([2 * delta] * 3, rel=0.05)


def test_the_best_model_is_kept_when_the_shifts_do_not_rest():
    model, interfaces = tip((1, 2, 5))
    heard = Heard()
    with Problem(model, interfaces, damping=Damping(modal=0.03)) as problem, listening(heard):
        r = Irka(order=5, band_hz=BAND, max_steps=7, tolerance=1e-14).reduce(problem)
    assert not r.recipe["converged"] and r.recipe["steps"] == 7
    assert "best model met was kept" in r.recipe["not_converged"]
    # Eight models from each of two starts, and that of the strongest modes; errors are told with three digits.
    errors = [float(error) for text in heard.news for error in re.findall(r"H2 error ([^,]+),", text)]
    assert len(errors) == 17
    assert r.recipe["h2_error"] == pytest.approx(min(errors), rel=5e-3) and min(errors) < 0.9 * max(errors)


def test_no_shift_is_factorised():
    model, interfaces = tip()
    solver = CountingSolver()
    with Problem(model, interfaces, damping=Damping(modal=0.01), solver=solver) as problem:
        assert Irka(order=4, band_hz=BAND).reduce(problem).order == 10
    # That of the statics alone.
    assert len(solver.factorisations) == 1


def test_options_that_make_no_sense_are_refused():
    for options in ({"order": 0}, {"band_hz": [5.0]}, {"band_hz": [5.0, 4.0]}, {"max_steps": 0}, {"tolerance": 0.0}):
        with refusal("value", next(iter(options)), next(iter(options))):
            Irka(**{"order": 4, "band_hz": BAND, **options})
    model, interfaces = tip()
    with Problem(model, interfaces) as problem, refusal("conflict", "order"):
        Irka(order=100, band_hz=BAND).reduce(problem)
    with Problem(model) as problem, refusal("unsupported", "", '"irka"', "[[interface]]"):
        Irka(order=2, band_hz=BAND).reduce(problem)


@pytest.mark.skipif(not importlib.util.find_spec("pymor"), reason="pyMOR is not installed")
@pytest.mark.parametrize(("damping", "order"), [(0.005, 8), (0.1, 4)])
def test_h2_error_is_no_larger_than_that_of_pymor_or_of_modes(damping, order):
    """60 modes within the band: with little damping pairs of shifts are worse than single modes."""
    from pymor.core.logger import set_log_levels
    from pymor.models.iosys import SecondOrderModel
    from pymor.reductors.sor_irka import SORIRKAReductor

    set_log_levels({"pymor": "ERROR"})
    rng = np.random.default_rng(1)
    model = truss(rng, 20, held=True, twins=False)
    faces = [
        make_interface(model, name=f"i{n}", nodes=np.array([n]), coupling="direct", components=(n % 3,))
        for n in (5, 10, 18)
    ]
    values, modes = sl.eigh(model.K.toarray(), model.M.toarray())
    omega = np.sqrt(values)
    grid = np.unique(
        np.concatenate(
            [np.linspace(0, 1.2 * omega[-1], 1000), *np.outer(1 + damping * np.linspace(-10, 10, 21), omega)]
        )
    )
    with Problem(model, faces, damping=Damping(modal=damping)) as problem:
        ours = h2_error(problem, Irka(order=order, band_hz=[0.0, 1.2 * omega[-1] / (2 * np.pi)]).reduce(problem), grid)
        B = modes.T @ problem.B.toarray()
    theirs = SORIRKAReductor(
        SecondOrderModel.from_matrices(np.eye(len(B)), np.diag(2 * damping * omega), np.diag(values), B, B.T)
    ).reduce(order, maxit=10, irka_options={"maxit": 10})
    H = np.einsum("ki,wk,kj->wij", B, 1 / (values - grid[:, None] ** 2 + 2j * damping * grid[:, None] * omega), B)
    m, d, k, b, c, *_ = theirs.to_matrices()
    w = grid[:, None, None]
    h = c @ np.linalg.solve(k + 1j * w * d - w**2 * m, np.broadcast_to(b + 0j, (len(grid), *b.shape)))
    strongest = np.argsort(-(B**2).sum(axis=1) / omega**1.5)[:order]
    truncated = np.einsum(
        "ki,wk,kj->wij",
        B[strongest],
        1 / (values - grid[:, None] ** 2 + 2j * damping * grid[:, None] * omega)[:, strongest],
        B[strongest],
    )
    sizes = [np.trapezoid(np.linalg.norm(x, axis=(1, 2)) ** 2, grid) for x in (h - H, truncated - H, H)]
    assert ours < np.sqrt(sizes[0] / sizes[2])
    assert ours < 1.001 * np.sqrt(sizes[1] / sizes[2])
