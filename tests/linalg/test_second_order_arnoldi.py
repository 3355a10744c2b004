"""Second-order Krylov spaces against dense recurrences and derivatives."""

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.linalg.columns import orthonormal
from morembs.linalg.second_order_arnoldi import SecondOrderArnoldi
from morembs.linalg.space import Space

N = 300


def chain():
    """Masses on springs to each other and to the ground, dashpots not in proportion; and loads (N, 3)."""
    rng = np.random.default_rng(4)

    def ladder(c):
        return np.diag(c[:-1] + c[1:]) - np.diag(c[1:-1], 1) - np.diag(c[1:-1], -1)

    M = np.diag(1 + rng.random(N))
    K = ladder(1e6 * (1 + rng.random(N + 1))) + np.diag(1e6 * rng.random(N))
    D = ladder(50 * rng.random(N + 1))
    return M, D, K, rng.standard_normal((N, 3))


def grown(s0, blocks, loads=None):
    M, D, K, F = chain()
    F = F if loads is None else loads
    factor = sl.lu_factor(s0**2 * M + s0 * D + K)

    def solve(X):
        return sl.lu_solve(factor, X)

    space = SecondOrderArnoldi(Space(sp.csr_array(M)), sp.csr_array(D), solve(F), shift=s0, scale=300.0)
    for _ in range(blocks - 1):
        space.expand(solve)
    return space


@pytest.mark.parametrize("s0", [0.0, 300.0, 300.0j])
def test_forty_blocks_stay_orthonormal(s0):
    M = chain()[0]
    space = grown(s0, 40)
    Q = np.hstack(space.blocks)
    assert Q.shape[1] == 120 and Q.dtype.kind == ("c" if complex(s0).imag else "f")
    assert np.abs(Q.conj().T @ M @ Q - np.eye(120)).max() < 1e-12
    S = np.vstack([space.upper, space.lower])
    assert np.abs(S.conj().T @ S - np.eye(S.shape[1])).max() < 1e-12


@pytest.mark.parametrize("s0", [0.0, 300.0, 300.0j])
def test_every_block_holds_its_derivative(s0):
    """r_0 to r_4 of the plain recurrence lie in as many blocks, and r_5 does not."""
    M, D, K, F = chain()
    Q = np.hstack(grown(s0, 5).blocks)
    A = s0**2 * M + s0 * D + K
    E = 2 * s0 * M + D
    r = [np.linalg.solve(A, F)]
    r.append(-np.linalg.solve(A, E @ r[0]))
    for _ in range(4):
        r.append(-np.linalg.solve(A, E @ r[-1] + M @ r[-2]))
    outside = []
    for j, x in enumerate(r):
        P = Q[:, : 3 * (j + 1)]
        outside.append(np.linalg.norm(x - P @ (P.conj().T @ (M @ x))) / np.linalg.norm(x))
    assert max(outside[:5]) < 1e-11
    assert outside[5] > 1e-5


@pytest.mark.parametrize("s0", [0.0, 300.0])
def test_collocated_moments_of_the_damped_transfer_function(s0):
    """J blocks match 2J Taylor coefficients of F' A(s)^-1 F for real s0, not the next."""
    M, D, K, F = chain()
    V = np.hstack(grown(s0, 3).blocks)
    m = [taylor(*(A for A in (M, D, K)), F, s0, 8), taylor(*(V.T @ A @ V for A in (M, D, K)), V.T @ F, s0, 8)]
    error = [np.linalg.norm(a - b) / np.linalg.norm(a) for a, b in zip(*m, strict=True)]
    assert max(error[:6]) < 1e-10
    assert error[6] > 1e-5


def taylor(M, D, K, F, s0, count):
    """Coefficients of F' A(s)^-1 F in s - s0, by the recurrence of A(s) X(s) = F."""
    A, E = s0**2 * M + s0 * D + K, 2 * s0 * M + D
    x = [np.linalg.solve(A, F)]
    for _ in range(count - 1):
        x.append(-np.linalg.solve(A, E @ x[-1] + (M @ x[-2] if len(x) > 1 else 0.0)))
    return [F.T @ y for y in x]


def test_dependent_loads_are_counted_and_the_chain_goes_on():
    M, D, K, F = chain()
    space = grown(0.0, 6, np.column_stack([F, F[:, 0] + F[:, 1]]))
    assert space.deflated[0] == 1 and space.size == 18
    Q = np.hstack(space.blocks)
    x = -np.linalg.solve(K, D @ np.linalg.solve(K, F))
    assert np.linalg.norm(x - Q @ (Q.T @ (M @ x))) < 1e-12 * np.linalg.norm(x)


def test_blocks_that_hardly_differ_from_the_space_are_orthogonal_to_it():
    """Loads next to modes, proportional damping: a block adds a part of 1e-3 only, in nearly one direction."""
    M, _, K, F = chain()
    X = sl.eigh(K, M)[1]
    D = sp.csr_array(1e-4 * K)
    factor = sl.lu_factor(K)
    rest = F[:, :1] + 1e-6 * F
    start = X[:, 5:8] + 1e-3 * rest / np.linalg.norm(rest, axis=0)
    space = SecondOrderArnoldi(Space(sp.csr_array(M)), D, start, shift=0.0, scale=1000.0)
    for _ in range(3):
        space.expand(lambda G: sl.lu_solve(factor, G))
    Q = np.hstack(space.blocks)
    assert Q.shape[1] > 5
    assert np.abs(Q.T @ M @ Q - np.eye(Q.shape[1])).max() < 1e-12


def test_a_small_system_is_spanned_and_the_chain_ends():
    """Six masses and three loads: nothing is left after all directions, whatever is asked."""
    rng = np.random.default_rng(1)
    A = rng.standard_normal((3, 6, 6))
    M, D, K = (sp.csr_array(a @ a.T + 6 * np.eye(6)) for a in A)
    factor = sl.lu_factor(K.toarray())
    space = SecondOrderArnoldi(Space(M), D, sl.lu_solve(factor, np.eye(6)[:, :3]), shift=0.0, scale=1.0)
    for _ in range(6):
        if not space.finished:
            space.expand(lambda X: sl.lu_solve(factor, X))
    assert space.size == 6 and space.finished


def test_orthonormal_keeps_directions_far_below_the_others():
    rng = np.random.default_rng(2)
    Q = np.linalg.qr(rng.standard_normal((80, 4)) + 1j * rng.standard_normal((80, 4)))[0]
    W = np.column_stack([Q[:, 0], Q[:, 0] + 1e-8 * Q[:, 1], Q[:, 2], Q[:, 0] - 2 * Q[:, 2]])
    P = orthonormal(W, None, passes=3)
    assert P.shape[1] == 3
    assert np.abs(P.conj().T @ P - np.eye(3)).max() < 1e-13
    assert np.linalg.norm(Q[:, 1] - P @ (P.conj().T @ Q[:, 1])) < 1e-6
