"""Sturm counts: K - sigma M on a constrained subspace, its inverse, and how many of the modes lie below sigma.

Sylvester's law counts negative pivots. Rigid modes are simply not counted; rows that are held drop out of the matrix.
For general constraints C' u = 0 the negative pivots of K - sigma M less those of C' (K - sigma M)^-1 C are the count
(Haynsworth 1968).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TypeVar

import numpy as np
import scipy.linalg as sl

from morembs.base.budget import current_budget
from morembs.base.closing import Closing
from morembs.base.errors import BudgetError, SingularMatrixError, SolverError, enough_megabytes
from morembs.base.types import Floats
from morembs.base.units import eigenvalue_in_hz
from morembs.linalg.columns import dense
from morembs.linalg.dense import symmetric
from morembs.linalg.dynamic_stiffness import with_fixed_rows
from morembs.linalg.sparse.select import select_solver
from morembs.linalg.sparse.solver import Forecast, LinearSolver
from morembs.linalg.sparse.symmetric import Lower
from morembs.linalg.statics import ConstrainedStatics
from morembs.linalg.tolerances import TOL

Used = TypeVar("Used")


class ShiftedInverse(Closing):
    """(K - sigma M)^-1 on the subspace of ``body``, and the number of its modes ``below`` sigma.

    ``System.inverse`` of a problem does not serve here: the count is in the pivots of the factor, which it does not
    show; rows that are held change the matrix; and sqrt(-sigma), squared, is not -sigma to the last bit.
    """

    def __init__(self, body: ConstrainedStatics, sigma: float) -> None:
        self.body, self.sigma = body, sigma
        A = _matrix(body, sigma)
        self.factor = _counter(body).factorize(A, "symmetric", f"K - sigma M at {eigenvalue_in_hz(sigma):.6g} Hz")
        self.below = self.factor.negative_pivots()
        if body.mean_axes:
            self.below -= body.count
        elif body.rows is None:
            self.X = body.statics.space.map_columns(self.factor.solve, body.C)
            S = dense(body.C.T @ self.X)
            # Scaled: constraints on displacements and on rotations differ by orders of magnitude.
            self.scale = 1.0 / np.sqrt(np.maximum(np.abs(S).max(axis=1), np.finfo(float).tiny))
            S = self.scale[:, None] * symmetric(S) * self.scale
            self.schur = sl.lu_factor(S)
            self.below -= int(np.count_nonzero(sl.eigvalsh(S) < 0))

    def apply(self, F: Floats) -> Floats:
        """u (N, k) with (K - sigma M) u = f - C lam and C'u = 0."""
        if self.body.rows is not None:
            F = F.copy()
            F[self.body.rows] = 0.0
        U = np.asarray(self.factor.solve(F))
        if self.body.mean_axes:
            # C = M Z; by columns, as the solver leaves them.
            U -= ((self.body.C.T @ U).T @ self.body.statics.Z.T).T
        elif self.body.rows is None:
            # Twice: round-off of the first time would leave the subspace.
            for _ in range(2):
                constraint_forces = self.scale[:, None] * (self.body.C.T @ U)
                U -= self.X @ (self.scale[:, None] * sl.lu_solve(self.schur, constraint_forces))
        return U

    def close(self) -> None:
        """Release the factor."""
        self.factor.close()


def count_below(body: ConstrainedStatics, sigma: float) -> int:
    """Number of eigenvalues of (K, M) on the subspace of ``body`` below ``sigma`` > 0.

    Raises:
        SolverError: eigenvalues lie so close to ``sigma`` that no count is possible.
    """
    words = " and cannot be counted there; move the limit by a percent"
    return off_eigenvalues(sigma, partial(_count_below, body), words=words)


def _count_below(body: ConstrainedStatics, sigma: float) -> int:
    if body.rows is None and not body.mean_axes:
        with ShiftedInverse(body, sigma) as shifted:
            return shifted.below
    # Solvers that count alone keep no factor.
    A = _matrix(body, sigma)
    return _counter(body).negative_eigenvalues(A, "K - sigma M") - (body.count if body.mean_axes else 0)


def _matrix(body: ConstrainedStatics, sigma: float) -> Lower:
    """K - sigma M with the rows that are held."""
    A = body.statics.pencil.shift(sigma)
    return A if body.rows is None else with_fixed_rows(A, body.rows)


def _counter(body: ConstrainedStatics) -> LinearSolver:
    """The solver for indefinite matrices, which counts negative eigenvalues."""
    return _select_counting(body.statics.pencil.solver).with_memory(body.statics.budget.room_for_factor())


def _select_counting(solver: LinearSolver) -> LinearSolver:
    return solver if solver.counts else select_solver(scratch=solver.scratch)


def off_eigenvalues(sigma: float, use: Callable[[float], Used], *, side: int = 1, words: str = "") -> Used:
    """``use`` (sigma), or where that hits an eigenvalue of a place a little above ``sigma``, with ``side`` -1 below it.

    Raises:
        SolverError: eigenvalues cluster there, or round-off hides them.
    """
    for nudge in TOL.shift_nudges:
        try:
            return use(sigma * (1 + side * nudge))
        except SingularMatrixError:
            continue
    raise SolverError(f"many eigenfrequencies cluster at {eigenvalue_in_hz(sigma):.6g} Hz{words}")


def require_room_to_count(solver: LinearSolver, lower: Lower, room: int | None) -> Forecast:
    """What a Sturm count will need, refused now where it would be refused after hours of work.

    Args:
        room: bytes that may be allocated once all pages that can be released are; None for no limit.

    Raises:
        BudgetError: the count has no room within the budget; the message says how much more it takes.
    """
    solver = _select_counting(solver)
    if room is None:
        return solver.with_memory(None).inertia_forecast(lower)
    # The values of K - sigma M, and the blocks of the eigensolver that wait.
    beside = 8 * lower.nnz + TOL.count_columns * 8 * lower.n + TOL.count_bytes
    try:
        return solver.with_memory(max(room - beside, 0)).inertia_forecast(lower)
    except BudgetError as error:
        budget = current_budget().raise_for(error.needed + beside - room)
        raise BudgetError(
            f"the memory budget leaves {room / 1e6:.0f} MB for the Sturm count that proves the modes complete; it "
            f"needs {(error.needed + beside) / 1e6:.0f} MB: raise the budget by {enough_megabytes(budget)} MB or more, "
            "or take a coarser mesh",
            needed=error.needed + beside,
        ) from None
