"""Modes of a wide band, slice by slice: shift-invert Lanczos at shifts that walk up the spectrum.

One Krylov space for hundreds of modes spends its time in orthogonalisation. Here every slice has a shift sigma of
its own (Grimes, Lewis and Simon 1994): the factor of K - sigma M finds the modes on both sides of sigma and its
inertia counts those below, so that the modes between two shifts are proven complete when the next one is done.
Modes that are known are locked out of the next space.
"""

from __future__ import annotations

import logging
from functools import partial

import numpy as np
import scipy.sparse as sp

from morembs.base import progress
from morembs.base.errors import SolverError
from morembs.base.types import Floats, Ints
from morembs.base.units import eigenvalue_in_hz
from morembs.linalg.columns import m_norms
from morembs.linalg.eigen_cost import block_width
from morembs.linalg.lanczos import BlockLanczos
from morembs.linalg.second_shift import has_converged
from morembs.linalg.space import Space
from morembs.linalg.statics import ConstrainedStatics
from morembs.linalg.sturm import ShiftedInverse, off_eigenvalues
from morembs.linalg.tolerances import TOL

log = logging.getLogger(__name__)


def sliced_modes(
    body: ConstrainedStatics,
    M: sp.csr_array,
    values: Floats,
    vectors: Floats,
    *,
    count: int,
    below: float | None = None,
    per_slice: int = TOL.slice_modes,
) -> tuple[Floats, Floats, float]:
    """The lowest ``count`` modes: values ascending (count,), vectors (N, count), and where the proof ends (rad/s)2.

    ``values`` (m,), ``vectors`` (N, m) are the lowest modes, to begin with, which the count of the first slice proves.
    With ``below`` in (rad/s)2 the ``count`` has been counted there. Peak memory: the vectors, where the budget wants
    them, the Krylov space of a slice, and as many columns for the modes that it locks.

    Raises:
        SolverError: a slice does not converge, or a mode is missing.
    """
    # The last slice finds modes beyond those that are wanted, unless the limit is known.
    room = count + (0 if below is not None else TOL.space_of_slice * per_slice)
    locked = body.statics.budget.empty((M.shape[0], min(room, M.shape[0] - body.count)), order="F")
    size, proven, sigma = min(len(values), count), 0.0, 0.0
    locked[:, :size], lam = vectors[:, :size], np.array(values[:size])
    while size < count or (below is None and int((lam < proven).sum()) < count):
        # Down, as the last shift is the limit.
        sigma = _next_shift(lam, proven, count, below, per_slice)
        words = "; move the limit by a percent"
        with off_eigenvalues(sigma, partial(ShiftedInverse, body), side=-1, words=words) as shifted:
            missing = shifted.below - int((lam < shifted.sigma).sum())
            near = np.sort(np.argsort(np.abs(lam - shifted.sigma))[: int(TOL.locked_slices * per_slice)])
            limit = min(below or np.inf, 2 * shifted.sigma - lam.max())
            new, V = _slice(shifted, M, locked[:, :size], near, missing, limit, TOL.space_of_slice * per_slice)
        found = int((new < shifted.sigma).sum())
        if found != missing or (below is not None and size + len(new) > count):
            raise SolverError(
                f"{missing} more modes lie below {eigenvalue_in_hz(shifted.sigma):.6g} Hz, the eigensolver found "
                f"{found}; move the limit by a percent"
            )
        if not len(new) and below is not None and sigma >= below:
            raise SolverError(
                f"{count} modes lie below {eigenvalue_in_hz(below):.6g} Hz, {size} were found; move the "
                "limit by a percent",
                keyword="below",
            )
        proven = shifted.sigma
        if size + len(new) > locked.shape[1]:
            nearest = np.argsort(new)[: locked.shape[1] - size]
            new, V = new[nearest], V[:, nearest]
        locked[:, size : size + len(new)] = V
        lam, size = np.append(lam, new), size + len(new)
        log.info("slice at %.6g Hz: %d of %d modes", eigenvalue_in_hz(shifted.sigma), size, count)
        progress.update(f"{min(size, count)} of {count} modes in slices")
    order = np.argsort(lam, kind="stable")
    behind = lam[order[count]] if len(lam) > count else np.inf
    return lam[order[:count]], body.statics.space.reorder(locked, order)[:, :count], min(proven, behind)


def gap_after(values: Floats, count: int) -> float | None:
    """A shift in the first gap behind mode ``count``; None if all further values cluster with it."""
    for k in range(count, len(values)):
        if values[k] - values[k - 1] > TOL.eigenvalue_gap * values[k]:
            return float(0.5 * (values[k] + values[k - 1]))
    return None


def _next_shift(lam: Floats, proven: float, count: int, below: float | None, per_slice: int) -> float:
    """Where the next shift lies: so far above the modes that are known that a slice of modes is new on both sides."""
    known, left = np.sort(lam), count - len(lam)
    # Where all are known that are wanted, they are counted behind the last of them.
    if below is None and left <= 0 and (cut := gap_after(known, count)) is not None and cut > proven:
        return cut
    recent = known[-per_slice:]
    gap = (recent[-1] - recent[0]) / max(len(recent) - 1, 1)
    new = TOL.slice_part_below * per_slice
    if below is None and left < TOL.last_slice * new:
        new = max(left, 0) * TOL.beyond_last + TOL.beyond_columns
    # Behind an empty slice the spectrum has a gap of unknown width.
    step = 2 * (proven - recent[-1]) if proven > recent[-1] else new * gap
    return float(min(recent[-1] + step, np.inf if below is None else below))


def _slice(
    shifted: ShiftedInverse, M: sp.csr_array, vectors: Floats, near: Ints, missing: int, limit: float, capacity: int
) -> tuple[Floats, Floats]:
    """Converged modes up to ``limit``, at least the ``missing`` ones below the shift, without the ``vectors`` ones.

    Those ``near`` the shift are taken out of the space; others seldom converge in it, and are left out then.
    """
    if not missing:
        return np.zeros(0), np.zeros((M.shape[0], 0))
    space, locked = Space(M, budget=shifted.body.statics.budget), vectors[:, near]

    def flexibility(F: Floats) -> Floats:
        # Once: F has no part along what is locked, so that only the error of these is left of it.
        U = shifted.apply(F)
        space.orthogonalize_once([locked], U, M @ U)
        return U

    stats = shifted.body.statics.factor.stats
    block = block_width(stats, 2 * missing)
    start = flexibility(M @ np.random.default_rng(6).standard_normal((M.shape[0], block)))
    space.orthogonalize_in_place(locked, start)
    room = M.shape[0] - shifted.body.count - locked.shape[1]
    lanczos = BlockLanczos(flexibility, space, start, capacity=min(capacity + 4 * block, room), seed=8)
    looked = 0
    for _ in range(TOL.lanczos_steps):
        if lanczos.full():
            _make_room(lanczos, missing, room)
            looked = 0
        lanczos.expand()
        ended = not lanczos.pending.shape[1]
        if not ended and (lanczos.size < missing or not lanczos.grew_since(looked)):
            continue
        looked = lanczos.size
        theta, Y, residual = lanczos.ritz()
        values = shifted.sigma + 1.0 / theta
        good = has_converged(values, theta, residual)
        left = int((good & (theta < 0)).sum())
        progress.update(
            f"slice at {eigenvalue_in_hz(shifted.sigma):.6g} Hz: {left} of {missing} modes below it converged"
        )
        if left >= missing or ended:
            # A mode counts only with all that lie nearer to the shift: gaps there would be misses.
            right = good & (theta > 0) & (values <= limit)
            right &= np.abs(theta) > np.abs(theta[~good]).max(initial=0.0)
            chosen = (good & (theta < 0)) | right
            new, V = values[chosen], lanczos.vectors(Y[:, chosen])
            known = space.dot(vectors, M @ V)
            fresh = (known**2).sum(axis=0) < 0.5
            if int((new[fresh] < shifted.sigma).sum()) >= missing or ended:
                new, V = new[fresh], V[:, fresh]
                # Modes of other shifts are exact to their residuals alone.
                space.subtract(vectors, known[:, fresh], V)
                V /= m_norms(V, M @ V)
                return new, V
    raise SolverError(
        f"the slice at {eigenvalue_in_hz(shifted.sigma):.6g} Hz did not converge in {TOL.lanczos_steps} steps"
    )


def _make_room(lanczos: BlockLanczos, missing: int, room: int) -> None:
    """Restart with all that is needed below the shift, however many lie nearer above it; enlarge if that is most."""
    theta, _, _ = lanczos.ritz()
    below = np.flatnonzero(theta < 0)
    # A space that has fewer values below the shift than modes are missing cannot hold them.
    lacks_modes = len(below) < missing
    needed = lanczos.size if lacks_modes else int(below[missing - 1]) + 1 if missing else lanczos.size // 2
    keep = needed + lanczos.block
    if keep > TOL.needed_part * lanczos.capacity and lanczos.capacity < room:
        lanczos.enlarge(min(2 * lanczos.capacity, room))
    else:
        lanczos.restart(min(keep, lanczos.size - lanczos.block))
