"""Quadrature of resonances and streamed singular value decompositions against dense references."""

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.linalg.gramians import StreamedSVD, WeightedSVD, snapshot_factor
from morembs.linalg.quadrature import gauss, modal_poles, resonant, trapezoid
from morembs.linalg.space import Space
from tests.support.refusals import refusal

RATIOS = np.array([1e-3, 1e-2, 2e-2, 5e-3, 1e-2, 3e-2])
VALUES = (2 * np.pi * np.array([20.0, 33.0, 33.5, 70.0, 180.0, 400.0])) ** 2


def states(omega, values, damping, B):
    return B / (values + 1j * omega[:, None] * damping - omega[:, None] ** 2)[:, :, None]


@pytest.mark.parametrize("overdamped", [False, True])
def test_gramians_by_quadrature_solve_the_lyapunov_equation(overdamped):
    """Six damped modes, two of them close, in a band almost without end."""
    damping = 2 * RATIOS * np.sqrt(VALUES)
    if overdamped:
        damping[0] = 400 * np.sqrt(VALUES[0])
    B = np.random.default_rng(1).standard_normal((6, 2))
    A = np.block([[np.zeros((6, 6)), np.eye(6)], [-np.diag(VALUES), -np.diag(damping)]])
    loads = np.vstack([np.zeros_like(B), B])
    exact = sl.solve_continuous_lyapunov(A, -loads @ loads.T)
    omega, weights = resonant(0.0, 1e13, modal_poles(VALUES, damping))
    U = states(omega, VALUES, damping, B)
    for part, block in ((U, exact[:6, :6]), (1j * omega[:, None, None] * U, exact[6:, 6:])):
        S = snapshot_factor(part, weights)
        assert np.abs(S @ S.T - block).max() < 1e-8 * np.abs(block).max()


def test_a_sharp_resonance_is_resolved_where_even_points_miss_it():
    """One mode of damping ratio 1e-5: its variance is 1 / (2 d lam), all of it in a band of 1e-5 of the frequency."""
    values = np.array([1e6])
    damping = 2e-5 * np.sqrt(values)
    exact = 1 / (2 * damping[0] * values[0])
    omega, weights = resonant(0.0, 2000.0, modal_poles(values, damping))
    energy = float((snapshot_factor(states(omega, values, damping, np.ones((1, 1))), weights) ** 2).sum())
    assert energy == pytest.approx(exact, rel=1e-4)
    even = np.linspace(0.5, 2000.0, len(omega))
    w = trapezoid(even)
    missed = float((snapshot_factor(states(even, values, damping, np.ones((1, 1))), w) ** 2).sum())
    assert abs(missed - exact) > 0.5 * exact


def test_gauss_points_integrate_polynomials():
    x, w = gauss(-1.0, 3.0, 3)
    for power in range(6):
        assert (w * x**power).sum() == pytest.approx((3.0 ** (power + 1) - (-1.0) ** (power + 1)) / (power + 1))


def test_bands_without_an_integral_are_refused():
    with refusal("value", "band_hz"):
        resonant(3.0, 2.0, np.array([1.0 + 1j]))
    with refusal("model", "damping"):
        resonant(1.0, 3.0, np.array([2.0 + 0j]))


@pytest.mark.parametrize("pole", [3.5, 3.0001, 0.2, -40.0])
def test_undamped_poles_outside_the_band_do_no_harm(pole):
    """The integral of 1 / (omega - pole)^2, and no poles at all."""
    omega, weights = resonant(1.0, 3.0, np.array([pole + 0j]))
    assert (weights / (omega - pole) ** 2).sum() == pytest.approx(1 / (1.0 - pole) - 1 / (3.0 - pole), rel=1e-9)
    omega, weights = resonant(1.0, 3.0, np.zeros(0, dtype=complex))
    assert (weights * omega**5).sum() == pytest.approx((3.0**6 - 1) / 6)


def decaying(n, columns, rng):
    """Snapshots (n, columns) whose singular values fall over fourteen decades."""
    turn = np.linalg.qr(rng.standard_normal((columns, columns)))[0]
    return rng.standard_normal((n, columns)) @ np.diag(np.logspace(0, -14, columns)) @ turn


@pytest.mark.parametrize("blocks", [1, 5, 60])
def test_streamed_decompositions_are_that_of_all_snapshots(blocks):
    """Twelve decades of singular values: the Gram matrix of the snapshots would keep eight."""
    rng = np.random.default_rng(3)
    n = 200
    metric = np.logspace(0, 6, n)
    X = sp.diags_array(metric).tocsr()
    S = decaying(n, 60, rng)
    exact = sl.svd(np.sqrt(metric)[:, None] * S, compute_uv=False)
    streams = (StreamedSVD(Space(X), 60), WeightedSVD(metric))
    for svd in streams:
        for part in np.array_split(S, blocks, axis=1):
            svd.add(part.copy())
        keep = len(svd.sigma)
        assert abs(keep - (exact > 1e-12 * exact[0]).sum()) <= 1
        assert np.abs(svd.sigma - exact[:keep]).max() < 1e-12 * exact[0]
        assert svd.sigma[exact[:keep] > 1e-9 * exact[0]] == pytest.approx(exact[exact > 1e-9 * exact[0]], rel=1e-3)
        V = svd.vectors
        assert np.abs(V.T @ (X @ V) - np.eye(keep)).max() < 1e-12
        left = S - V @ (V.T @ (X @ S))
        assert np.sqrt((metric[:, None] * left**2).sum()) < 1e-11 * exact[0]


def test_more_snapshots_than_dimensions_fill_the_space():
    rng = np.random.default_rng(4)
    A = rng.standard_normal((12, 12))
    X = A @ A.T + 12 * np.eye(12)
    svd = StreamedSVD(Space(sp.csr_array(X)), 60)
    S = rng.standard_normal((12, 60))
    for part in np.array_split(S, 12, axis=1):
        svd.add(part.copy())
    assert svd.sigma == pytest.approx(sl.svd(np.linalg.cholesky(X).T @ S, compute_uv=False), rel=1e-12)


def test_what_is_left_out_is_the_tail_of_the_singular_values():
    """sum of sigma_k^2 beyond n = 1/pi sum of w |U - Pi U|_X^2, to ten digits, for a stiffness that is no diagonal."""
    rng = np.random.default_rng(5)
    n = 30
    A = rng.standard_normal((n, n))
    K, B = A @ A.T + np.eye(n), rng.standard_normal((n, 2))
    X = K + 4.0 * np.eye(n)
    omega, weights = gauss(0.5, 4.0, 7)
    U = np.array([np.linalg.solve(K * (1 + 0.02j * w) - w**2 * np.eye(n), B.astype(complex)) for w in omega])
    svd = StreamedSVD(Space(sp.csr_array(X)), 28)
    for k in range(len(omega)):
        svd.add(snapshot_factor(U[k : k + 1], weights[k : k + 1]))
    for order in (1, 3, 8):
        V = svd.vectors[:, :order]
        left = U - V @ (V.T @ X @ U)
        norms = np.einsum("kij,il,klj->k", left.conj(), X, left).real
        assert (svd.sigma[order:] ** 2).sum() == pytest.approx((weights * norms).sum() / np.pi, rel=1e-10)
