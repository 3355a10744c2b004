"""Block conjugate gradients: the refinement of rough factors, and the outer loop of multigrid.

All right-hand sides share one Krylov space (O'Leary 1980), so the few modes that a preconditioner misses are
found once for all of them. The directions are orthonormalised in each step and dependent ones left out, which
keeps the block regular when its columns converge or resemble each other (after Dubrulle 2001). They are made
conjugate to the last ones by their product with A (flexible, Notay 2000), as a preconditioner in single
precision is not exactly linear. Inner products are not conjugated, so complex symmetric matrices are served as
well (COCG, van der Vorst and Melissen 1990) and, with a good preconditioner, indefinite ones (simplified QMR,
Freund and Nachtigal 1994, without its smoothing).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.base.types import Bools, Floats, Values
from morembs.linalg.sparse.tolerances import TOL

Operator = Callable[[Values], Values]


@dataclass(frozen=True, kw_only=True)
class Solution:
    """``X`` (n, k) of A X = B after ``steps``.

    ``residual`` (k,) are backward errors ||b - A x|| / (||A|| ||x|| + ||b||) of true residuals; ``stagnated`` says
    that at least one column stays above ``stalled_error`` and did not converge.
    """

    X: Values
    steps: int
    residual: Floats
    stagnated: bool


def conjugate_gradients(
    apply: Operator,
    precondition: Operator,
    B: Values,
    *,
    norm: float,
    accuracy: float = TOL.iteration_accuracy,
    backward: float = TOL.iteration_roundoff,
    max_steps: int = TOL.iteration_steps,
) -> Solution:
    """X of A X = B for symmetric A, real or complex.

    A column is done when ||precondition(r)||, an estimate of its error, is below ``accuracy`` ||x||, or when its
    residual is round-off, ||r|| <= ``backward`` (``norm`` ||x|| + ||b||). It then leaves the block.
    Peak memory in columns of length n: 5 k with X and the results of ``apply`` and ``precondition`` (4 k while these
    run, with their workspace and results); k more if they return arrays that are not in Fortran order, or if ``B``
    is not. Besides the two calls a step costs about 14 n k^2 operations, all in products of dense matrices.

    Args:
        apply: A X for a Fortran-ordered block (n, j); must not change it.
        precondition: approximates A^-1 R for a Fortran-ordered block (n, j); must not change it.
        B: right-hand sides (n, k), not changed.
        norm: estimate of ||A||.
        accuracy: relative error wanted of each column.
        backward: backward error that counts as round-off.
        max_steps: limit of the steps, each with one call of ``apply`` and one of ``precondition``.
    """
    run = _Run(apply, precondition, np.asfortranarray(B), norm, accuracy, backward)
    steps = 0
    while steps < max_steps and run.drop_finished() and run.step():
        steps += 1
    run.finish()
    failed = ~(run.residual <= TOL.stalled_error) & ~run.converged
    return Solution(X=run.X, steps=steps, residual=run.residual, stagnated=bool(failed.any()))


class _Run:
    """State of one solution; ``columns`` (j,) are those of B still in the block, R (n, j) their residuals.

    P (n, p) is an orthonormal basis of the last directions, Q = A P and S (p, p) = P'Q.
    """

    def __init__(
        self, apply: Operator, precondition: Operator, B: Values, norm: float, accuracy: float, backward: float
    ) -> None:
        self.apply, self.precondition, self.B = apply, precondition, B
        self.norm, self.accuracy, self.backward = norm, accuracy, backward
        k = B.shape[1]
        self.X = np.zeros_like(B)
        self.residual = np.full(k, np.inf)
        self.converged = np.zeros(k, dtype=bool)
        self.columns = np.arange(k)
        self.size_b = _norms(B)
        self.R = B.copy(order="F")
        self._directions = np.empty_like(B)
        self.P = self._directions[:, :0]
        self.Q: Values | None = None
        self.S: Values | None = None
        # Per column of the block: least backward error, steps since then; last true residual.
        self.least = np.full(k, np.inf)
        self.since = np.zeros(k, dtype=int)
        self.true = np.full(k, np.inf)

    def drop_finished(self) -> bool:
        """Drop the columns whose residual is round-off or has stalled; whether any is left."""
        size, unit = _norms(self.R), self._unit()
        # A new least only counts when it is half of the one before: slow crawling is a stall too.
        error = size / np.where(unit > 0, unit, 1.0)
        better = error < 0.5 * self.least
        self.least = np.where(better, error, self.least)
        self.since = np.where(better, 0, self.since + 1)
        stalled = (self.since >= TOL.stalled_steps) | ~np.isfinite(size)
        self._verify((size <= self.backward * unit) | stalled, stalled)
        return bool(len(self.columns))

    def _gradients(self) -> Values | None:
        """Preconditioned residuals Z (n, j) of the columns that go on; None when none does."""
        Z = np.asfortranarray(self.precondition(self.R))
        done = _norms(Z) <= self.accuracy * _norms_of(self.X, self.columns)
        if not done.any():
            return Z
        keep, again = self._verify(done, np.zeros(len(done), dtype=bool))
        if not keep.any():
            return None
        Z = _compact(Z, keep)
        if again.any():
            Z[:, again] = self.precondition(np.asfortranarray(self.R[:, again]))
        return Z

    def step(self) -> bool:
        """One step along the gradients made conjugate to the directions before; False: nothing left to do."""
        Z = self._gradients()
        if Z is None:
            return False
        if self.Q is not None and self.S is not None:
            _subtract(Z, self.P, _solve(self.S, self.Q.T @ Z))
        self.Q = None
        T = _basis(Z)
        if not T.size:
            return False
        self.P = _product(Z, T, self._directions)
        del Z
        self.Q = np.asfortranarray(self.apply(self.P))
        self.S = self.P.T @ self.Q
        step = _solve(self.S, self.P.T @ self.R)
        if not np.isfinite(step).all():
            return False
        _subtract(self.R, self.Q, step)
        _subtract(self.X, self.P, -step, self.columns)
        return True

    def finish(self) -> None:
        """True residuals of the columns that ran out of steps."""
        stop = np.ones(len(self.columns), dtype=bool)
        self._verify(stop, stop)

    def _verify(self, done: Bools, stop: Bools) -> tuple[Bools, Bools]:
        """Remove the columns ``done`` (j,) whose true residual agrees, and all of those to ``stop``.

        The others go on with their true residual, unless that does not halve any more.
        Returns which columns stayed (j,), and which of these got another residual.
        """
        fresh = np.zeros(len(done), dtype=bool)
        if not done.any():
            return ~done, fresh
        at = np.flatnonzero(done)
        column = self.columns[at]
        T = np.asfortranarray(self.apply(_part(self.X, column)))
        np.subtract(_part(self.B, column), T, out=T)
        size, unit = _norms(T), self._unit()[at]
        floor = self.backward * unit
        agrees = (size <= TOL.residual_drift * np.maximum(_norms_of(self.R, at), floor)) & ~stop[at]
        leaves = agrees | stop[at] | ~(size < 0.5 * self.true[at])
        self.residual[column] = np.where(unit > 0, size / np.where(unit > 0, unit, 1.0), np.where(size > 0, np.inf, 0))
        self.converged[column] = agrees
        self.true[at] = size
        for i in np.flatnonzero(~leaves):
            self.R[:, at[i]] = T[:, i]
        fresh[at[~leaves]] = True
        # The least of a recurrence that was wrong is no measure.
        self.least[fresh], self.since[fresh] = np.inf, 0
        keep = np.ones(len(done), dtype=bool)
        keep[at[leaves]] = False
        self._drop(keep)
        return keep, fresh[keep]

    def _drop(self, keep: Bools) -> None:
        if keep.all():
            return
        self.R = _compact(self.R, keep)
        self.columns = self.columns[keep]
        self.least, self.since, self.true = self.least[keep], self.since[keep], self.true[keep]

    def _unit(self) -> Floats:
        """||A|| ||x|| + ||b|| of the columns in the block: what residuals are measured by."""
        return self.norm * _norms_of(self.X, self.columns) + self.size_b[self.columns]


def _solve(S: Values, C: Values) -> Values:
    """S^-1 C of a small symmetric S."""
    try:
        return np.asarray(sl.solve(S, C, assume_a="gen", check_finite=False))
    except (np.linalg.LinAlgError, ValueError):
        return np.full(C.shape, np.nan)


def _basis(Z: Values) -> Values:
    """T (j, p) such that Z T is orthonormal and spans what Z does, columns that depend on others left out."""
    size = _norms(Z)
    nonzero = np.flatnonzero((size > 0) & np.isfinite(size))
    if not len(nonzero):
        return Z[:0, :0]
    scale = 1.0 / size[nonzero]
    G = (Z.conj().T @ Z if Z.dtype.kind == "c" else Z.T @ Z)[np.ix_(nonzero, nonzero)] * np.outer(scale, scale)
    values, V = np.linalg.eigh(G)
    good = values > TOL.dependent_direction * values[-1]
    T = np.zeros((Z.shape[1], int(good.sum())), dtype=Z.dtype)
    T[nonzero] = scale[:, None] * V[:, good] / np.sqrt(values[good])
    return T


def _subtract(Y: Values, P: Values, C: Values, columns: NDArray[np.int64] | None = None) -> None:
    """Y -= P C in place, or these columns of Y, a slice of rows at a time."""
    step = TOL.product_rows
    is_part = columns is not None and len(columns) < Y.shape[1]
    for first in range(0, len(Y), step):
        rows = slice(first, first + step)
        if is_part:
            Y[rows, columns] -= P[rows] @ C
        else:
            Y[rows] -= P[rows] @ C


def _product(Z: Values, T: Values, memory: Values) -> Values:
    """Z T in ``memory``, a slice of rows at a time."""
    step = TOL.product_rows
    result = memory[:, : T.shape[1]]
    for first in range(0, len(Z), step):
        result[first : first + step] = Z[first : first + step] @ T
    return result


def _norms(X: Values) -> Floats:
    return np.array([np.linalg.norm(x) for x in X.T], dtype=np.float64)


def _norms_of(X: Values, columns: NDArray[np.int64]) -> Floats:
    return np.array([np.linalg.norm(X[:, column]) for column in columns], dtype=np.float64)


def _part(X: Values, columns: NDArray[np.int64]) -> Values:
    """These columns, without a copy where they follow each other."""
    first, last = int(columns[0]), int(columns[-1]) + 1
    return X[:, first:last] if last - first == len(columns) else np.asfortranarray(X[:, columns])


def _compact(X: Values, keep: Bools) -> Values:
    """The columns to keep, moved to the front in place."""
    for to, column in enumerate(np.flatnonzero(keep)):
        if to != column:
            X[:, to] = X[:, column]
    return X[:, : int(keep.sum())]
