"""Matrices reduced in one call: a chain of masses, whose transfer function dense solutions give."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp

import morembs
from morembs.base.errors import ArgumentError
from morembs.body.file import read_body
from tests.support import commands
from tests.support.refusals import Refusal, refusal

SIZE = 30
K = 1e4 * sp.diags_array([np.full(SIZE, 2.0), -np.ones(SIZE - 1), -np.ones(SIZE - 1)], offsets=[0, 1, -1]).tocsr()
M = np.linspace(1.0, 2.0, SIZE)
B, C = np.eye(SIZE)[:, :1], np.eye(SIZE)[-2:]
BAND = np.linspace(0.1, 4.0, 40)
RAYLEIGH = morembs.Damping(alpha=0.2, beta=1e-4)


def exact(frequencies_hz: np.ndarray) -> np.ndarray:
    full, mass = K.toarray(), np.diag(M)
    D = RAYLEIGH.alpha * mass + RAYLEIGH.beta * full
    return np.array([C @ np.linalg.solve(full + 1j * w * D - w**2 * mass, B) for w in 2 * np.pi * frequencies_hz])


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("modal", {"modes": 16}),
        ("craig-bampton", {"modes": 14}),
        ("free-interface", {"modes": 12}),
        ("krylov", {"shifts_hz": [0, 2, 4], "order": 14}),
        ("gramian", {"band_hz": [0, 5], "order": 12}),
        ("balanced-truncation", {"order": 14, "band_hz": [0, 5]}),
        ("irka", {"order": 16, "band_hz": [0, 5]}),
        ("auto", {"band_hz": [0, 5], "tolerance": 1e-4}),
    ],
)
def test_outputs_follow_those_of_dense_solutions(method: str, options: dict[str, object]) -> None:
    system = morembs.reduce(K, M, B=B, C=C, method=method, damping=RAYLEIGH, **options)
    H, reference = system.frequency_response(BAND), exact(BAND)
    assert H.shape == (len(BAND), 2, 1) and system.order < SIZE
    assert np.abs(H - reference).max() < 0.02 * np.abs(reference).max()


def test_every_kind_of_matrix_gives_the_same() -> None:
    whole = np.diag(M)
    made = [
        morembs.reduce(stiffness, mass, B=loads, method="craig-bampton", modes=5).K
        for stiffness, mass, loads in (
            (K, M, B),
            (K.tocoo(), sp.diags_array(M), sp.csc_array(B)),
            (K.toarray(), whole, B[:, 0]),
            (K.toarray().tolist(), sp.dia_matrix(whole), B.tolist()),
        )
    ]
    for other in made[1:]:
        assert np.array_equal(other, made[0])


def test_modal_coordinates_are_taken_as_they_are() -> None:
    w = 2 * np.pi * np.arange(1.0, 21.0)
    system = morembs.reduce(w**2, np.ones(20), B=np.ones((20, 1)), method="modal", modes=6)
    assert np.allclose(system.frequencies_hz(), np.arange(1.0, 7.0), rtol=1e-12)


def test_what_other_packages_make_of_it_has_the_same_response() -> None:
    system = morembs.reduce(K, M, B=B, C=C, method="balanced_truncation", damping=RAYLEIGH, order=8)
    H = system.frequency_response(BAND)
    space = system.to_scipy()
    s = 2j * np.pi * BAND
    values = np.array([space.C @ np.linalg.solve(each * np.eye(16) - space.A, space.B) for each in s])
    assert np.allclose(values, H, rtol=1e-9)
    control = pytest.importorskip("control")
    assert np.allclose(system.to_control()(s).transpose(2, 0, 1), H, rtol=1e-9) and control is not None
    magnitude, phase = system.bode(BAND)
    assert np.allclose(10 ** (magnitude / 20) * np.exp(1j * np.radians(phase)), H)


def test_the_plot_has_a_curve_for_each_output() -> None:
    upper, lower = morembs.reduce(K, M, B=B, C=C, method="irs").plot().axes
    assert len(upper.lines) == len(lower.lines) == 2 and [each.get_text() for each in upper.get_legend().texts] == [
        "output 1, input 1",
        "output 2, input 1",
    ]
    assert isinstance(upper.figure, mpl.figure.Figure)


def test_structural_damping_has_no_state_space() -> None:
    system = morembs.reduce(K, M, B=B, modes=3, damping=morembs.Damping(structural=0.02))
    assert np.abs(system.frequency_response(0.0).imag).min() > 0
    with refusal("unsupported", "structural", "0.02"):
        system.to_scipy()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"A": K, "E": M}, ("unsupported", "B")),
        ({"K": K, "M": M, "method": "bt", "order": 3}, ("unknown", "method", "balanced-truncation")),
        ({"K": K, "M": M, "method": "krylov", "order": 3}, ("missing", "method")),
        ({"K": K, "M": M, "n_modes": 3}, ("unknown", "n_modes", "modes")),
        ({"K": K, "M": M[:-1], "modes": 3}, ("conflict", "M", "29", "30")),
        ({"K": K}, ("missing", "M")),
    ],
)
def test_calls_that_do_not_fit_are_answered(given: dict[str, object], message: Refusal) -> None:
    with refusal(*message):
        morembs.reduce(**given)


@pytest.mark.parametrize(
    ("call", "answer"),
    [
        (lambda: morembs.CraigBampton(10), ("value", "", "10")),
        (lambda: morembs.CraigBampton(n_modes=10), ("unknown", "n_modes", "modes")),
        (lambda: morembs.Guyan(modes=1), ("unknown", "modes")),
        (lambda: morembs.Gramian(order=3), ("missing", "band_hz", "HIGH")),
    ],
)
def test_arguments_of_a_method_are_told(call, answer: Refusal) -> None:
    with refusal(*answer, by=ArgumentError) as caught:
        call()
    assert isinstance(caught.value, TypeError)


@pytest.mark.parametrize(("method", "options"), [("modal", {"modes": 3}), ("gramian", {"band_hz": [0, 5], "order": 4})])
def test_matrices_that_are_no_system_are_refused(method: str, options: dict[str, object]) -> None:
    with refusal("model", "", "21", "-1"):
        morembs.reduce(K, np.where(np.arange(SIZE) < 20, 1.0, -1.0), B=B, method=method, **options)
    with pytest.warns(UserWarning, match="damping matrix D is indefinite"):
        morembs.reduce(K, M, -1e-4 * K, B=B, method=method, **options)


@pytest.mark.parametrize(
    ("damping", "loads"), [(1e-4 * K, B), (None, np.hstack([B, B])), (None, np.eye(SIZE)[:, [3, 3, 4]])]
)
def test_krylov_takes_the_moments_that_its_order_needs(damping: object, loads: np.ndarray) -> None:
    for order in (4, 12):
        assert morembs.reduce(K, M, damping, B=loads, method="krylov", order=order).order == order


def test_matrices_on_the_command_line_are_those_of_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sub").mkdir()
    for place, factor in (("sub", 1.0), (".", 4.0)):
        scipy.io.mmwrite(tmp_path / place / "K.mtx", K)
        scipy.io.mmwrite(tmp_path / place / "M.mtx", factor * sp.diags_array(M).tocsr())
        scipy.io.mmwrite(tmp_path / place / "B.mtx", B)
    monkeypatch.chdir(tmp_path)
    own = {factor: morembs.reduce(K, factor * M, modes=3).frequencies_hz() for factor in (1.0, 4.0)}
    for files, factor in ((("sub/K.mtx", "M.mtx"), 4.0), (("sub/K.mtx", "sub/M.mtx"), 1.0)):
        commands.run("reduce", *files, "--input", "sub/B.mtx", "--modes", "3", "-o", "q.h5", "-q")
        assert np.allclose(read_body(tmp_path / "q.h5").bodies["modal"].frequencies_hz, own[factor])
