"""The factor of the Sturm count finds the modes that it counts: one Krylov space at two shifts.

A space at shift zero shows soon where the modes wanted end. The factor of K - sigma M in the gap there counts them, and
the same space goes on with it (Grimes, Lewis and Simon 1994; Ruhe 1998): modes near either shift converge in few steps.
"""

from __future__ import annotations

import numpy as np

from morembs.base import progress
from morembs.base.errors import SolverError
from morembs.base.memory import installed_bytes
from morembs.base.types import Floats
from morembs.base.units import eigenvalue_in_hz
from morembs.linalg.lanczos import BlockLanczos
from morembs.linalg.statics import ConstrainedStatics
from morembs.linalg.sturm import ShiftedInverse
from morembs.linalg.tolerances import TOL


def keeps_two_factors(body: ConstrainedStatics) -> bool:
    """Whether there is room for the factor of the Sturm count beside that of the stiffness: not under a budget."""
    stats = body.statics.factor.stats
    unlimited = body.statics.budget.memory is None and not stats.out_of_core
    return unlimited and TOL.factor_room * stats.memory_bytes < installed_bytes()


def first_look(lanczos: BlockLanczos, count: int, *, what: str) -> float | None:
    """Grow the space until a gap behind mode ``count`` is known roughly: a shift in it, None where the space ends."""
    while lanczos.pending.shape[1] and not lanczos.full():
        lanczos.expand()
        if lanczos.size <= count:
            continue
        theta, _, residual = lanczos.ritz()
        accurate = int(np.argmin(np.append(residual <= TOL.rough_residual * np.abs(theta), False)))
        progress.update(f"{min(accurate, count)} of {count} {what} known roughly")
        if accurate > count:
            values = 1.0 / theta[count - 1 : min(accurate, count + max(2, count // 10))]
            k = int(np.argmax(values[1:] / values[:-1]))
            return float(0.5 * (values[k] + values[k + 1]))
    return None


def modes_below(lanczos: BlockLanczos, shifted: ShiftedInverse, *, what: str) -> tuple[Floats, Floats]:
    """All modes below the shift: eigenvalues ascending (m,), vectors (N, m); the space goes on at that shift.

    Raises:
        SolverError: the count finds more or fewer than the space.
    """
    theta, Y, residual = lanczos.ritz()
    values, wanted, room = 1.0 / theta, shifted.below, TOL.space_doublings
    # Those that have converged to round-off at shift zero stay as they are: soft ones are known best there.
    locked = int(
        np.argmin(np.append((residual <= TOL.settled_residual * np.abs(theta)) & (values < shifted.sigma), False))
    )
    if locked < wanted:
        first = values[:locked]
        lanczos.turn(shifted.apply, shifted.sigma, locked)
        done = False
        while not done:
            if lanczos.full():
                room -= 1
                if room < 0:
                    break
                lanczos.enlarge(2 * lanczos.capacity)
            lanczos.expand()
            theta, Y, residual = lanczos.ritz()
            values = shifted.sigma + 1.0 / theta
            # The more, the nearer to zero a mode is.
            bound = (
                TOL.shifted_residual_part * TOL.ritz_residual * np.abs(theta) * np.minimum(1.0, np.abs(values * theta))
            )
            # Orthonormal vectors with small residuals belong to as many modes, so that the count says when all are
            # there. Other negative values are round-off: rigid motions, whose flexibility is zero, never converge.
            good = (theta < 0) & (residual <= bound)
            progress.update(f"{locked + int(good.sum())} of {wanted} {what} converged")
            done = locked + int(good.sum()) >= wanted or not lanczos.pending.shape[1]
        values, Y = values[good], Y[:, good]
        Y = np.hstack([np.eye(lanczos.size, locked), Y])
        values = np.concatenate([first, values])
    else:
        values, Y = values[:locked], Y[:, :locked]
    if len(values) != wanted:
        raise SolverError(
            f"the Sturm count finds {wanted} {what} below {eigenvalue_in_hz(shifted.sigma):.6g} Hz, the eigensolver "
            f"{len(values)}; ask for a few modes more or less, so that the limit does not cut a cluster"
        )
    order = np.argsort(values, kind="stable")
    return values[order], lanczos.vectors(Y[:, order])
