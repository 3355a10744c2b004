r"""What holds on whole parts of a box: lower bounds of K(p) and of K(p) beside M(p), each proven by counts.

On a cell of the morphs t the terms are polynomials of t, K(t) = sum_j beta_j(t) K_j with the Bernstein polynomials
beta_j >= 0, sum_j beta_j = 1. What holds for all control matrices K_j holds on the whole cell (Garloff 1986 for the
scalar case; quadratic forms are such polynomials). Without a morph the only control matrix is K itself.

- alpha: K_j - alpha K(p_a) >= 0 with the dofs S held: no negative pivot.
- Lam^: K_j - Lam^ M_j + sigma W W' >= 0. By Haynsworth (1968), applied to both diagonal blocks of
  [[T, W], [W', -1 / sigma]] with T = K_j - Lam^ M_j, it has as many negative eigenvalues as T less those of
  1 / sigma + W' T^-1 W.

Candidates come from eigenvalues that are not proven; the counts decide.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from numpy.typing import NDArray
from scipy.special import comb

from morembs.budget import UNLIMITED, Budget
from morembs.errors import SingularMatrixError
from morembs.linalg.columns import map_columns, symmetric
from morembs.linalg.dynamic_stiffness import constrained
from morembs.linalg.sparse.select import select_solver
from morembs.linalg.sparse.solver import LinearSolver
from morembs.linalg.sparse.symmetric import Lower
from morembs.parametric.law import LAGRANGE, Law

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# Parts of what eigenvalues promise that are tried, one after the other.
TRIED = (0.97, 0.9, 0.8, 0.65)
# Cells are split until alpha is this, up to so many of them.
ENOUGH, MOST = 0.4, 8


def control_points(low: Floats, high: Floats, degree: int) -> tuple[Floats, Floats]:
    """Points (s, t) of a cell of t morphs from ``low`` to ``high`` (t,) and the matrix (s, s) that turns values there of
    polynomials of ``degree`` in each into their Bernstein coefficients; one point and [[1]] for t = 0."""
    if not len(low):
        return np.zeros((1, 0)), np.ones((1, 1))
    x = np.sin(0.5 * np.pi * np.linspace(0.0, 1.0, degree + 1)) ** 2
    j = np.arange(degree + 1)
    B = comb(degree, j) * x[:, None] ** j * (1 - x[:, None]) ** (degree - j)
    one, whole = np.linalg.inv(B), np.ones((1, 1))
    for _ in low:
        whole = np.kron(whole, one)
    points = np.array(list(product(x, repeat=len(low))))
    return low + points * (high - low), whole


def morphs_of(law: Law) -> Ints:
    """Numbers of the parameters whose factors are polynomials."""
    return np.flatnonzero((law.factors >= LAGRANGE).any(axis=0))


def degree_of(*laws: Law) -> int:
    """Degree of the polynomials of morphs."""
    return max((len(points) - 1 for law in laws for points in law.points if len(points)), default=0)


def controls(law: Law, p: Floats, morphs: Ints, low: Floats, high: Floats, degree: int) -> Floats:
    """Bernstein coefficients (s, Q) of the terms of ``law`` on a cell of ``morphs``, the others as in ``p`` (P,)."""
    points, turn = control_points(low, high, degree)
    at = np.tile(p, (len(points), 1))
    at[:, morphs] = points
    return np.asarray(turn @ law(at))


def halves(low: Floats, high: Floats, whole: Floats) -> Iterator[tuple[Floats, Floats]]:
    """The two halves of a cell across its longest side, relative to those of the ``whole`` box (t,)."""
    longest = int(np.argmax((high - low) / whole))
    middle = 0.5 * (low[longest] + high[longest])
    for end, value in ((1, middle), (0, middle)):
        part = [low.copy(), high.copy()]
        part[end][longest] = value
        yield part[0], part[1]


def is_positive(
    A: sp.csr_array, solver: LinearSolver, rows: Ints | None = None, *, W: Floats | None = None, sigma: float = 0.0,
    budget: Budget = UNLIMITED,
) -> bool:  # fmt: skip
    """Whether ``A`` + ``sigma`` W W', with ``rows`` held, has no negative eigenvalue, by a count of pivots."""
    lower = Lower.of(A, "a control matrix", regular=False)
    if rows is not None:
        lower = constrained(lower, rows)
    counter = solver if solver.counts else select_solver(scratch=solver.scratch)
    try:
        if W is None:
            return counter.negative_eigenvalues(lower, "a control matrix") == 0
        with counter.factorize(lower, "symmetric", "a control matrix") as factor:
            negative = factor.negative_pivots()
            X = map_columns(factor.solve, W, budget)
    except SingularMatrixError:
        return False
    S = symmetric(np.eye(W.shape[1]) / sigma + W.T @ X)
    return bool(negative == (np.linalg.eigvalsh(S) < 0).sum())


def least_ratio(
    A: sp.csr_array, K: sp.csr_array, flexibility: Callable[[Floats], Floats], rows: Ints
) -> float:
    """Estimate of the least eigenvalue of (A, K) with ``rows`` held, by Lanczos with the ``flexibility`` of K."""
    free = np.ones(len(rows) and K.shape[0] or K.shape[0], dtype=bool)
    free[rows] = False
    keep = np.flatnonzero(free)

    def solve(f: Floats) -> Floats:
        F = np.zeros((K.shape[0], 1))
        F[keep, 0] = f.ravel()
        return np.asarray(flexibility(F)[keep, 0])

    n = len(keep)
    inverse = spl.LinearOperator((n, n), matvec=solve, dtype=np.float64)
    A, K = (B[keep][:, keep] for B in (A, K))
    start = np.random.default_rng(3).standard_normal(n)
    value = spl.eigsh(A, k=1, M=K, Minv=inverse, which="SA", v0=start, tol=1e-4, return_eigenvectors=False)
    return float(value[0])
