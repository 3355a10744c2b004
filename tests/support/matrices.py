"""Matrices that solvers have to handle, and the measure of how well they did."""

from __future__ import annotations

from functools import cache

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

COUPLING = np.array([[2.0, 0.3, 0.1], [0.3, 2.0, 0.2], [0.1, 0.2, 2.0]])


def random(*shape: int, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


def chain(nodes: int, held: bool = True) -> sp.csc_array:
    """Springs in a row, three coupled displacements at each node; without ``held`` its ends are free."""
    main = np.full(nodes, 2.0)
    if not held:
        main[[0, -1]] = 1.0
    L = sp.diags_array([-np.ones(nodes - 1), main, -np.ones(nodes - 1)], offsets=[-1, 0, 1])
    return sp.csc_array(sp.kron(L, COUPLING))


@cache
def brick(nodes: int) -> sp.csc_array:
    """27-point stencil on a cube of ``nodes`` to the power 3, three displacements each; positive definite."""
    row = sp.diags_array([np.ones(nodes - 1), np.ones(nodes), np.ones(nodes - 1)], offsets=[-1, 0, 1])
    P = sp.csr_array(sp.kron(sp.kron(row, row), row)) - sp.eye_array(nodes**3)
    L = sp.diags_array(np.asarray(P.sum(axis=1)).ravel() + 0.01) - P
    return sp.csc_array(sp.kron(L, COUPLING))


def mass(K: sp.csc_array) -> sp.csc_array:
    """A positive definite matrix with the pattern of the nearest neighbours of ``K``: thinner than K."""
    size = K.shape[0]
    near = sp.diags_array([np.ones(size - 1), np.ones(size - 1)], offsets=[-1, 1])
    return sp.csc_array(near.multiply(K != 0) + sp.diags_array(np.linspace(3.0, 6.0, size)))


def slender_beam(elements: int) -> sp.csc_array:
    """Deflections and slopes of a clamped Bernoulli beam: its condition grows with the fourth power of the elements."""
    h = 1.0 / elements
    k = (
        np.array(
            [
                [12.0, 6 * h, -12, 6 * h],
                [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                [-12, -6 * h, 12, -6 * h],
                [6 * h, 2 * h * h, -6 * h, 4 * h * h],
            ]
        )
        / h**3
    )
    K = np.zeros((2 * elements + 2, 2 * elements + 2))
    for e in range(elements):
        K[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += k
    return sp.csc_array(K[2:, 2:])


def shifted(A: sp.csc_array, shift: complex) -> sp.csc_array:
    return sp.csc_array(A - shift * sp.eye_array(A.shape[0]))


def damped(K: sp.csc_array, omega: float) -> sp.csc_array:
    """K + i omega D - omega^2 M with D = 0.02 K + 0.1 M: complex symmetric."""
    M = mass(K)
    return sp.csc_array(K + 1j * omega * (0.02 * K + 0.1 * M) - omega**2 * M)


def skewed(A: sp.csc_array, part: float) -> sp.csc_array:
    """``A`` with its entries below the diagonal larger, and those above smaller, by ``part`` of them."""
    result = sp.csc_array(A).astype(A.dtype)
    column = np.repeat(np.arange(A.shape[0]), np.diff(result.indptr))
    result.data = result.data * (1 + part * np.sign(result.indices - column))
    return result


def badly_scaled(A: sp.csc_array) -> sp.csc_array:
    """D A D with D between 1e-4 and 1e4 in random places: the rows differ by sixteen powers of ten."""
    D = sp.diags_array(10.0 ** np.random.default_rng(9).permutation(np.linspace(-4.0, 4.0, A.shape[0])))
    return sp.csc_array(D @ A @ D)


def sparse_loads(n: int, columns: int, seed: int = 12) -> sp.csc_array:
    """About two entries in each column, a column of zeros and one that is full."""
    rng = np.random.default_rng(seed)
    B = np.zeros((n, columns))
    for column in range(1, columns):
        B[rng.integers(0, n, 2), column] = rng.standard_normal(2)
    B[:, columns - 1] = rng.standard_normal(n)
    return sp.csc_array(B)


def backward_error(A: sp.sparray, X: np.ndarray, B: np.ndarray) -> float:
    """Largest ||S (A x - b)|| / (||S A S|| ||x / S|| + ||S b||) of a column, where S brings the rows to unit size."""
    s = 1.0 / np.sqrt(abs(A).max(axis=1).toarray()).reshape(-1, 1)
    X, B = (Y.reshape(len(s), -1) for Y in (X, B))
    S = sp.diags_array(s[:, 0])
    norm = float((S @ abs(A) @ S).sum(axis=1).max())
    size = norm * np.linalg.norm(X / s, axis=0) + np.linalg.norm(s * B, axis=0)
    error = np.linalg.norm(s * (A @ X - B), axis=0)
    return float(np.divide(error, size, out=error.copy(), where=size > 0).max())


def dense_gramians(
    M: np.ndarray | sp.sparray, D: np.ndarray | sp.sparray, K: np.ndarray | sp.sparray, F: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """P and Q of A P E' + E P A' + [0; F][0; F]' = 0 and A' Q E + E' Q A + [F; 0][F; 0]' = 0 by scipy.

    Solved for the coordinates (Omega a, a') of the undamped modes, where A has no large condition number.
    """
    M, D, K = (sp.csr_array(A).toarray() for A in (M, D, K))
    values, Phi = sl.eigh(K, M)
    omega, zero = np.sqrt(values), np.zeros_like(M)
    A = np.block([[zero, np.diag(omega)], [-np.diag(omega), -Phi.T @ D @ Phi]])
    B, C = (np.vstack(X) for X in ((0 * F, Phi.T @ F), (Phi.T @ F / omega[:, None], 0 * F)))
    T = sl.block_diag(Phi / omega, Phi)
    back = sl.block_diag(M @ Phi * omega, Phi)
    P = T @ sl.solve_continuous_lyapunov(A, -B @ B.T) @ T.T
    return P, back @ sl.solve_continuous_lyapunov(A.T, -C @ C.T) @ back.T


def difference(actual: np.ndarray, exact: np.ndarray) -> float:
    """Largest difference of entries of unit diagonal."""
    d = 1 / np.sqrt(np.diag(exact))
    return float(np.abs(d[:, None] * (actual - exact) * d).max())
