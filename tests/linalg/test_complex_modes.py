"""Complex modes and their count, against dense solutions; congruence of skew matrices."""

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.linalg.complex_modes import complex_modes, frequencies_below, small_complex_modes
from morembs.linalg.congruence import congruence
from morembs.linalg.sparse.select import select_solver
from tests.support.refusals import refusal


def chain(n=60, seed=3, gyroscopic=1.0, damping=0.0):
    """K, M, G, D of a chain with a random skew band."""
    rng = np.random.default_rng(seed)
    K = sp.diags_array([-np.ones(n - 1), 2.1 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1])
    M = sp.diags_array(1 + rng.random(n))
    upper = sp.diags_array([rng.standard_normal(n - 2)], offsets=[2], shape=(n, n))
    G = gyroscopic * (upper - upper.T)
    return sp.csr_array(K), sp.csr_array(M), sp.csr_array(G), sp.csr_array(damping * (K + M))


def dense(K, M, C):
    """All eigenvalues on or above the real axis, by size."""
    n = K.shape[0]
    K, M, C = (A.toarray() for A in (K, M, C))
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    values = sl.eigvals(A)
    values = values[values.imag > -1e-9 * np.abs(values)]
    return values[np.argsort(np.abs(values), kind="stable")]


@pytest.mark.parametrize(("gyroscopic", "damping"), [(0.0, 0.0), (1.0, 0.0), (3.0, 0.0), (1.0, 0.2), (0.0, 1.5)])
def test_modes_are_those_of_the_dense_problem(gyroscopic, damping):
    K, M, G, D = chain(gyroscopic=gyroscopic, damping=damping)
    modes = complex_modes(K, M, G=G, D=D if damping else None, count=9, solver=select_solver())
    assert modes.eigenvalues == pytest.approx(dense(K, M, G + D)[:9], rel=1e-8)
    R = (M @ modes.vectors) * modes.eigenvalues**2 + ((G + D) @ modes.vectors) * modes.eigenvalues + K @ modes.vectors
    assert np.abs(R).max() < 1e-6 * np.abs(K @ modes.vectors).max()
    assert (modes.eigenvalues.real == 0).all() == (not damping)
    assert (modes.verified_below > 0) == (not damping)


def test_the_count_is_that_of_the_dense_problem_at_every_frequency():
    K, M, G, _ = chain(n=24, gyroscopic=2.0)
    w = dense(K, M, G).imag
    for k in range(1, 23):
        assert frequencies_below(K, M, G, 0.5 * (w[k - 1] + w[k]), select_solver()) == k


def test_a_mode_that_is_there_twice_comes_twice():
    K, M, _, _ = chain(n=40)
    K2, M2 = (sp.csr_array(sp.block_diag([A, A])) for A in (K, M))
    modes = complex_modes(K2, M2, count=6, solver=select_solver())
    once = dense(K, M, 0 * K)[:3].imag
    assert modes.frequencies == pytest.approx(np.repeat(once, 2), rel=1e-9)
    assert modes.verified_below > once[-1]


def test_gyroscopic_forces_hold_what_stiffness_throws_off():
    # A spinning ball on a peak: K < 0 and stable, G^2 > 4 k m.
    K, M, G = -np.eye(2), np.eye(2), np.array([[0.0, 3.0], [-3.0, 0.0]])
    values, _ = small_complex_modes(K, M, G)
    root = np.sqrt(np.roots([1, -7, 1]))
    assert np.sort(values.imag) == pytest.approx(np.sort(root))
    assert (values.real == 0).all()
    modes = complex_modes(*(sp.csr_array(A) for A in (K, M)), G=sp.csr_array(G), count=2, solver=select_solver())
    assert modes.frequencies == pytest.approx(np.sort(root))
    assert "indefinite" in modes.no_count


def test_too_many_modes_are_refused():
    K, M, _, _ = chain(n=5)
    with refusal("value", "count", "6", "5"):
        complex_modes(K, M, count=6, solver=select_solver())


def test_congruence_keeps_the_sign_of_skew_couplings():
    rng = np.random.default_rng(1)
    A = rng.standard_normal((9, 9))
    A = sp.csr_array(A - A.T)
    T = sp.csr_array(sp.block_diag([np.eye(5), rng.standard_normal((4, 3))]))
    product = congruence(T, A, skew=True).toarray()
    assert product == pytest.approx((T.T @ A @ T).toarray())
    assert np.array_equal(product, -product.T)
