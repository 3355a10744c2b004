"""Linear complementarity problems by Lemke's method: w = M z + q, w >= 0, z >= 0, w'z = 0.

Ties in the ratio test are broken by the lexicographic rule, so degenerate problems do not cycle (Cottle, Pang and
Stone 1992, algorithm 4.4.5 and section 4.9). For copositive M the method ends with a solution, or on a ray that
proves that there is none (theorem 4.4.12); contact with a pyramid of friction is of that kind (Stewart, Trinkle 1996).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from morembs.base.errors import InputError, SolverError
from morembs.base.types import Floats
from morembs.dynamics.multibody.contact.tolerances import TOL


@dataclass(frozen=True, kw_only=True, eq=False)
class Complementary:
    """A solution: ``z`` and ``w`` (m,), the rows ``basic`` (m,) bool where z may be positive, and the pivots taken."""

    z: Floats
    w: Floats
    basic: NDArray[np.bool_]
    pivots: int

    @property
    def residual(self) -> float:
        """Largest |min(w, z)|."""
        return float(np.abs(np.minimum(self.z, self.w)).max(initial=0.0))


class RayError(SolverError):
    """Lemke's method ended on a ray: no complementary solution is within its reach.

    ``direction`` (m,) of z along the ray; its largest entries say which rows are in conflict.
    """

    def __init__(self, message: str, *, direction: Floats) -> None:
        super().__init__(message)
        self.direction = direction


def lemke(M: ArrayLike, q: ArrayLike) -> Complementary:
    """Solve w = M z + q >= 0, z >= 0, w'z = 0 for M (m, m) and q (m,), dense.

    The covering vector is one in every row after M is scaled to a diagonal of ones; rows with a zero there keep theirs.

    Raises:
        InputError: shapes that do not fit, numbers that are not finite.
        RayError: no solution is found; for copositive M there is none.
        SolverError: too many pivots, or a basis too ill-conditioned for a solution to pass its check.
    """
    A, right = np.array(M, dtype=float), np.array(q, dtype=float)
    if right.ndim != 1 or A.shape != (len(right), len(right)):
        raise InputError(
            f"a matrix {A.shape} and a vector {right.shape} were given to lemke; expected (m, m) and (m,)", keyword="A"
        )
    if not (np.isfinite(A).all() and np.isfinite(right).all()):
        raise InputError(
            "the complementarity problem has entries that are not finite; expected finite numbers", keyword="A"
        )
    m = len(right)
    if m == 0 or right.min() >= 0:
        return Complementary(z=np.zeros(m), w=right, basic=np.zeros(m, dtype=bool), pivots=0)
    scale = _scale(A)
    table, pivots = _pivot(A * np.outer(scale, scale), right * scale, scale)
    return _solution(A, right, scale, table, pivots)


def _scale(A: Floats) -> Floats:
    """(m,) positive: A scaled by it from both sides has a diagonal of ones where it is positive."""
    diagonal = np.diag(A)
    scale = np.ones(len(A))
    positive = diagonal > TOL.no_diagonal * np.abs(A).max(initial=0.0)
    scale[positive] = 1 / np.sqrt(diagonal[positive])
    return scale


def _pivot(A: Floats, q: Floats, scale: Floats) -> tuple[dict[int, float], int]:
    """The complementary basis as rows where z is basic with its values, and the number of pivots."""
    m = len(q)
    size = max(float(np.abs(q).max()), np.finfo(float).tiny)
    q = q / size
    # Columns are w, z, the covering variable and q.
    table = np.hstack((np.eye(m), -A, -np.ones((m, 1)), q[:, None]))
    basis = np.arange(m)
    entering, row = 2 * m, _choose_leaving(table, q < 0, np.ones(m), m)
    for pivots in range(1, TOL.pivots_per_row * m + TOL.pivots_at_least):
        leaving = int(basis[row])
        table[row] /= table[row, entering]
        factors = table[:, entering].copy()
        factors[row] = 0.0
        table -= np.outer(factors, table[row])
        basis[row] = entering
        if leaving == 2 * m:
            return {int(k) - m: size * float(table[i, -1]) for i, k in enumerate(basis) if k >= m}, pivots
        entering = leaving + m if leaving < m else leaving - m
        column = table[:, entering]
        candidates = column > TOL.least_pivot * max(1.0, float(np.abs(column).max()))
        if not candidates.any():
            raise RayError(
                f"the complementarity problem of {m} rows ends on a ray after {pivots} pivots: no solution satisfies "
                "all its inequalities",
                direction=_ray(basis, column, entering, m) * scale,
            )
        ends = np.flatnonzero(basis == 2 * m)
        row = _choose_leaving(table, candidates, column, m, int(ends[0]))
    raise SolverError(f"the complementarity problem of {m} rows is not solved within {pivots} pivots")


def _ray(basis: NDArray[np.int_], column: Floats, entering: int, m: int) -> Floats:
    direction = np.zeros(m)
    if m <= entering < 2 * m:
        direction[entering - m] = 1.0
    for row, variable in enumerate(basis):
        if m <= variable < 2 * m:
            direction[variable - m] = max(0.0, -float(column[row]))
    return direction


def _choose_leaving(table: Floats, candidates: NDArray[np.bool_], column: Floats, m: int, wanted: int = -1) -> int:
    """Row with the lexicographically smallest (q, rows of the inverse of the basis) / column among candidates.

    The row ``wanted`` (of the covering variable) is taken as soon as it ties: the problem is then solved.
    """
    rows = np.flatnonzero(candidates)
    for k in (2 * m + 1, *range(m)):
        ratios = table[rows, k] / column[rows]
        least = float(ratios.min())
        rows = rows[ratios <= least + TOL.tied_ratio * max(1.0, abs(least))]
        if k == 2 * m + 1 and wanted in rows:
            return wanted
        if len(rows) == 1:
            break
    return int(rows[0])


def _solution(A: Floats, q: Floats, scale: Floats, table: dict[int, float], pivots: int) -> Complementary:
    """z and w of a complementary basis: from a fresh factorisation, which takes round-off of the pivots away, or where
    that is singular (contact that is redundant) from the pivots themselves."""
    basic = np.zeros(len(q), dtype=bool)
    basic[list(table)] = True
    pivoted, fresh = np.zeros(len(q)), np.zeros(len(q))
    pivoted[list(table)] = list(table.values())
    inner = A[np.ix_(basic, basic)] * np.outer(scale[basic], scale[basic])
    candidates = [pivoted * scale]
    try:
        fresh[basic] = np.linalg.solve(inner, -q[basic] * scale[basic]) * scale[basic]
        candidates.insert(0, fresh)
    except np.linalg.LinAlgError:
        pass
    worst = [_measure_violation(A, q, scale, basic, z) for z in candidates]
    best = 0 if worst[0] <= TOL.negative_variable else int(np.argmin(worst))
    if not worst[best] <= TOL.negative_variable:
        raise SolverError(
            f"Lemke's method ends with conditions broken by {worst[best]:.2g} (relative): its basis is too "
            "ill-conditioned"
        )
    z = np.maximum(candidates[best], 0.0)
    w = A @ z + q
    w[basic] = 0.0
    return Complementary(z=z, w=np.maximum(w, 0.0), basic=basic, pivots=pivots)


def _measure_violation(A: Floats, q: Floats, scale: Floats, basic: NDArray[np.bool_], z: Floats) -> float:
    """By how much z breaks the conditions, in the scaled units of the pivots.

    What is small against the whole problem is round-off."""
    if not np.isfinite(z).all():
        return np.inf
    size = float(np.abs(q * scale).max())
    reach = (np.abs(A) @ np.abs(z) + np.abs(q)) * scale + TOL.equation_scale * size
    w, own = (A @ z + q) * scale / reach, z / scale
    low = -float(own.min()) / max(float(np.abs(own).max()), size)
    return max(float(np.abs(w[basic]).max(initial=0.0)), float((-w).max()), low)
