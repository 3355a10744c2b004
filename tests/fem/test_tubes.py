"""Tubes that carry flow, against the literature on straight pipes and beam theory."""

from dataclasses import replace

import numpy as np
import pytest

from morembs import Flow, Problem, Tube, add_flow, split_unsymmetric, tube_model
from morembs.base.errors import SingularMatrixError
from morembs.body.floating.spinning_modes import still_modes
from tests.support.refusals import refusal
from tests.support.tubes import BORE, STEEL, arch, dense, eigenvalues, pipe


@pytest.mark.parametrize(
    ("speed", "beta", "ends", "known"),
    [
        (2.0, 0.5, "pinned", [7.45357, 37.63213, 87.1044]),
        (3.0, 0.5, "clamped", [19.08507, 58.57839, 117.71574]),
        (4.0, 0.2, "cantilever", [4.01168 + 4.75516j, 17.03644 + 2.52575j]),
    ],
)
def test_frequencies_are_those_of_the_exact_determinant(speed, beta, ends, known):
    """Of exp(i w t), by the quartic of the differential equation (Paidoussis 1998, ch. 3)."""
    model, unit = pipe(speed, beta, ends)
    np.testing.assert_allclose(eigenvalues(model)[: len(known)] / (1j * unit), known, rtol=5e-5)


def test_a_pinned_pipe_diverges_at_pi():
    for speed, stable in ((0.999 * np.pi, True), (1.001 * np.pi, False)):
        first = eigenvalues(pipe(speed, 0.3, "pinned")[0])[0]
        assert (abs(first.real) < 1e-6 * abs(first)) == stable and (first.imag > 1.0) == stable


@pytest.mark.parametrize(("beta", "critical"), [(0.2, 5.591), (0.5, 9.323)])
def test_a_cantilever_flutters_where_gregory_and_paidoussis_say(beta, critical):
    """Gregory and Paidoussis 1966: 5.6 and 9.3; here to one part in a thousand."""
    growth = [eigenvalues(pipe(factor * critical, beta, "cantilever")[0])[:12].real.max() for factor in (0.999, 1.001)]
    assert growth[0] < 0 < growth[1]


def test_modes_of_the_sparse_model_are_those_of_qz_and_complete():
    model = arch()
    exact = eigenvalues(model)
    with Problem(model) as problem:
        modes = still_modes(problem, (), 8)
    np.testing.assert_allclose(modes.eigenvalues, exact[:8], rtol=1e-7)
    assert (modes.eigenvalues.real == 0).all() and exact[7].imag < modes.verified_below < exact[8].imag


def test_modes_of_a_circulatory_model_are_not_counted():
    """Below flutter and above divergence, where the stiffness is indefinite."""
    model, _ = pipe(4.0, 0.2, "cantilever")
    with Problem(model) as problem:
        modes = still_modes(problem, (), 4)
    np.testing.assert_allclose(modes.eigenvalues, eigenvalues(model)[:4], rtol=1e-6)
    assert modes.verified_below == 0 and modes.no_count == "damping" and modes.residuals.max() < 1e-7
    model, _ = pipe(1.1 * np.pi, 0.3, "pinned")
    with Problem(model) as problem:
        modes = still_modes(problem, (), 3)
        assert modes.eigenvalues[0].imag == 0 and "indefinite" in modes.no_count
        with refusal("model", by=SingularMatrixError):
            _ = problem.statics


def test_a_tube_bends_stretches_and_twists_as_a_beam():
    """In any direction in space: static displacements of the tip of a cantilever (beam theory), and the whole mass."""
    t = np.array([2.0, 3.0, 6.0]) / 7
    model = tube_model(np.linspace(0, 0.3 * t, 7), STEEL, held=(0,))
    turn = np.linalg.qr(np.column_stack([t, np.eye(3)[:, :2]]))[0]
    area, second = np.pi / 4 * (3e-3**2 - 2.6e-3**2), np.pi / 64 * (3e-3**4 - 2.6e-3**4)
    expected = [
        0.3 / (195e9 * area),
        *2 * [0.3**3 / (3 * 195e9 * second)],
        0.3 * 2.6 / (195e9 * 2 * second),
        *2 * [0.3 / (195e9 * second)],
    ]
    for k, value in enumerate(expected):
        load = np.zeros(model.size)
        direction = slice(-6, -3) if k < 3 else slice(model.size - 3, None)
        load[direction] = turn[:, k % 3]
        u = np.linalg.solve(model.K.toarray(), load)
        assert turn[:, k % 3] @ u[direction] == pytest.approx(value, rel=1e-7)
    free = tube_model(np.linspace(0, 0.3 * t, 7), STEEL)
    moved = np.where(free.dofs.component == 1, 1.0, 0.0)
    assert moved @ (free.M @ moved) == pytest.approx(8000.0 * area * 0.3, rel=1e-12)


def test_a_model_splits_into_symmetric_and_skew_parts_in_one_way():
    """Whether a file holds N beside K or both in one matrix; G likewise."""
    model, _ = pipe(4.0, 0.2, "cantilever")
    assert all(abs(A + A.T).max() == 0 for A in (model.G, model.N))
    joined = replace(model, K=model.K + model.N, D=model.D + model.G, N=None, G=None)
    with refusal("unsupported", "K", "split"):
        Problem(joined)
    with refusal("unsupported", "D"):
        Problem(replace(joined, K=model.K))
    parts, given = dense(split_unsymmetric(joined)), dense(model)
    for name in "KMDGN":
        np.testing.assert_allclose(parts[name], given[name], rtol=0, atol=1e-12 * np.abs(given[name]).max())


def test_bad_input_is_refused_in_one_sentence():
    tube = tube_model(np.linspace([0.0, 0, 0], [1.0, 0, 0], 9), STEEL)
    flow = Flow(mass_flow=1e-3, density=1000.0, area=BORE)
    for held in ((0, -1), (9,)):
        with refusal("value", "held", "8"):
            tube_model(tube.nodes.xyz, STEEL, held=held)
    with refusal("model", "path", "5"):
        add_flow(tube, np.array([0, 1, 2, 4, 3, 5, 6, 7, 8]), flow)
    with refusal("value", "path"):
        add_flow(tube, np.array([0, 1, 1]), flow)
    G = tube.K.toarray() * 0
    G[3, 8], G[8, 3] = 2.0, 1.5
    with refusal("value", "G", "tube", "3.5"):
        replace(tube, G=G)
    upper = np.triu(tube.K.toarray(), 1)
    with refusal("model", "supports"):
        Problem(replace(tube, N=1e-3 * (upper - upper.T)))
    for wrong, words in (({"outer": 1e-3}, ("value", "thickness")), ({"young": 0.0}, ("value", "young", "0.0"))):
        with refusal(*words):
            Tube(**{"outer": 3e-3, "inner": 2.6e-3, "young": 195e9, "density": 8000.0, **wrong})
    with refusal("value", "outlet", "held", "free"):
        Flow(mass_flow=1.0, density=1.0, area=1.0, outlet="open")
