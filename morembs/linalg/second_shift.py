"""The factor of the Sturm count finds the modes that it counts: one Krylov space at two shifts.

A space at shift zero shows soon where the modes wanted end. The factor of K - sigma M in the gap there counts them, and
the same space goes on with it (Grimes, Lewis and Simon 1994; Ruhe 1998): modes near either shift converge in few steps.
"""

from __future__ import annotations

import numpy as np

from morembs.base import progress
from morembs.base.errors import SolverError
from morembs.base.memory import installed_bytes
from morembs.base.types import Bools, Floats
from morembs.base.units import eigenvalue_in_hz
from morembs.linalg.lanczos import BlockLanczos
from morembs.linalg.statics import ConstrainedStatics
from morembs.linalg.sturm import ShiftedInverse
from morembs.linalg.tolerances import TOL


def keeps_two_factors(body: ConstrainedStatics) -> bool:
    """True if there is room for the factor of the Sturm count beside that of the stiffness: not under a budget."""
    stats = body.statics.factor.stats
    unlimited = body.statics.budget.memory is None and not stats.out_of_core
    return unlimited and TOL.factor_room * stats.memory_bytes < installed_bytes()


def first_look(lanczos: BlockLanczos, count: int, *, what: str) -> float | None:
    """Grow the space until a gap behind mode ``count`` is known roughly: a shift in it, None where the space ends."""
    looked = 0
    while lanczos.pending.shape[1] and not lanczos.full():
        lanczos.expand()
        if lanczos.size <= count or not lanczos.grew_since(looked):
            continue
        looked = lanczos.size
        theta, _, residual = lanczos.ritz()
        accurate = int(np.argmin(np.append(residual <= TOL.rough_residual * np.abs(theta), False)))
        progress.update(f"{min(accurate, count)} of {count} {what} known roughly")
        if accurate > count:
            values = 1.0 / theta[count - 1 : min(accurate, count + max(2, count // 10))]
            k = int(np.argmax(values[1:] / values[:-1]))
            return float(0.5 * (values[k] + values[k + 1]))
    return None


def has_converged(values: Floats, theta: Floats, residual: Floats) -> Bools:
    """Which Ritz values ``theta`` (k,) of a shift of eigenvalues ``values`` are modes, by ``residual`` norms."""
    # An error weighs more than at shift zero, and the more, the nearer to zero a mode is.
    allowed = TOL.shifted_residual_part * TOL.ritz_residual * np.minimum(1.0, np.abs(values * theta))
    return np.asarray(residual <= allowed * np.abs(theta))


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
        done, looked = False, lanczos.size
        while not done:
            if lanczos.full():
                room -= 1
                if room < 0:
                    break
                lanczos.enlarge(2 * lanczos.capacity)
            lanczos.expand()
            if not lanczos.grew_since(looked):
                continue
            looked = lanczos.size
            theta, Y, residual = lanczos.ritz()
            values = shifted.sigma + 1.0 / theta
            # Orthonormal vectors with small residuals belong to as many modes, so that the count says when all are
            # there. Other negative values are no modes and never converge: rigid motions, which enter the space by
            # round-off that normalisation scales up. Their flexibility is zero, so that their Ritz values are round-off
            # of either sign, 1e-11 of the least of a mode. (In 1,356 columns of a cube of 6,591 dofs with 600 modes
            # three of them were negative; columns are orthonormal to 5e-13, and copies of locked modes there are none.)
            good = (theta < 0) & has_converged(values, theta, residual)
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
            f"{len(values)}; ask for a few modes more or less, so that the limit does not cut a cluster",
            keyword="count",
        )
    order = np.argsort(values, kind="stable")
    return values[order], lanczos.vectors(Y[:, order])
