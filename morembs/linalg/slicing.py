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
from morembs.linalg.lanczos import BlockLanczos
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
    below: float,
    per_slice: int = TOL.slice_modes,
) -> tuple[Floats, Floats]:
    """All ``count`` modes with eigenvalues up to ``below`` (rad/s)2: values ascending (count,), vectors (N, count).

    ``values`` (m,), ``vectors`` (N, m) are the lowest modes, known and proven complete, to begin with; ``count`` has
    been counted. Peak memory: the vectors, where the budget wants them, and the Krylov space of a slice.

    Raises:
        SolverError: a slice does not converge, or a mode is missing.
    """
    budget = body.statics.budget
    locked = budget.empty((M.shape[0], count), order="F")
    size, empty = min(len(values), count), 0.0
    locked[:, :size], lam = vectors[:, :size], np.array(values[:size])
    while size < count:
        recent = np.sort(lam)[-per_slice:]
        gap = (recent[-1] - recent[0]) / max(len(recent) - 1, 1)
        # Behind an empty slice the spectrum has a gap of unknown width.
        step = 2 * (empty - recent[-1]) if empty > recent[-1] else TOL.slice_part_below * per_slice * gap
        sigma = min(recent[-1] + step, below)
        # Down, as the last shift is the limit.
        words = "; move the limit by a percent"
        with off_eigenvalues(sigma, partial(ShiftedInverse, body), side=-1, words=words) as shifted:
            missing = shifted.below - int((lam < shifted.sigma).sum())
            near = np.sort(np.argsort(np.abs(lam - shifted.sigma))[: 3 * per_slice])
            limit = min(below, 2 * shifted.sigma - recent[-1])
            new, V = _slice(shifted, M, locked[:, :size], near, missing, limit, 2 * per_slice)
        if int((new < shifted.sigma).sum()) != missing or size + len(new) > count:
            raise SolverError(
                f"{missing} more modes lie below {eigenvalue_in_hz(shifted.sigma):.6g} Hz, the eigensolver found "
                f"{int((new < shifted.sigma).sum())}; move the limit by a percent"
            )
        if not len(new) and sigma >= below:
            raise SolverError(
                f"{count} modes lie below {eigenvalue_in_hz(below):.6g} Hz, {size} were found; move the "
                "limit by a percent"
            )
        empty = empty if len(new) else shifted.sigma
        locked[:, size : size + len(new)] = V
        lam, size = np.append(lam, new), size + len(new)
        log.info("slice at %.6g Hz: %d of %d modes", eigenvalue_in_hz(shifted.sigma), size, count)
        progress.update(f"{size} of {count} modes in slices")
    order = np.argsort(lam, kind="stable")
    result = budget.empty(locked.shape, order="F")
    for column, source in enumerate(order):
        result[:, column] = locked[:, source]
    return lam[order], result


def _slice(
    shifted: ShiftedInverse, M: sp.csr_array, vectors: Floats, near: Ints, missing: int, limit: float, capacity: int
) -> tuple[Floats, Floats]:
    """Converged modes up to ``limit``, at least the ``missing`` ones below the shift, without the ``vectors`` ones.

    Those ``near`` the shift are taken out of the space; others seldom converge in it, and are left out then.
    """
    space, locked = Space(M, budget=shifted.body.statics.budget), vectors[:, near]

    def flexibility(F: Floats) -> Floats:
        U = shifted.apply(F)
        space.project_out(locked, U)
        return U

    if not missing and limit <= shifted.sigma:
        return np.zeros(0), np.zeros((M.shape[0], 0))
    start = flexibility(M @ np.random.default_rng(6).standard_normal((M.shape[0], TOL.slice_block)))
    room = M.shape[0] - shifted.body.count - locked.shape[1]
    lanczos = BlockLanczos(flexibility, space, start, capacity=min(capacity + 4 * TOL.slice_block, room), seed=8)
    for _ in range(TOL.lanczos_steps):
        if lanczos.full():
            _make_room(lanczos, missing, room)
        lanczos.expand()
        theta, Y, residual = lanczos.ritz()
        good = residual <= TOL.ritz_residual * np.abs(theta)
        values = shifted.sigma + 1.0 / theta
        left = int((good & (theta < 0)).sum())
        progress.update(
            f"slice at {eigenvalue_in_hz(shifted.sigma):.6g} Hz: {left} of {missing} modes below it converged"
        )
        if left >= missing or not lanczos.pending.shape[1]:
            # A mode counts only with all that lie nearer to the shift: gaps there would be misses.
            right = good & (theta > 0) & (values <= limit)
            right &= np.abs(theta) > np.abs(theta[~good]).max(initial=0.0)
            chosen = (good & (theta < 0)) | right
            new, V = values[chosen], lanczos.vectors(Y[:, chosen])
            fresh = (space.dot(vectors, M @ V) ** 2).sum(axis=0) < 0.5
            if int((new[fresh] < shifted.sigma).sum()) >= missing or not lanczos.pending.shape[1]:
                return new[fresh], V[:, fresh]
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
