"""Which of the geometric rigid motions a stiffness leaves free: decided row by row, against round-off in that row.

Under a motion phi that strains nothing the terms of a row of K phi cancel, and what is left is round-off of these
terms: at most a few eps (|K| |phi|) in that row. A support leaves more in its own row, however stiff other rows are,
and independent of the mesh, the units and other rows. Only what cancels in the row itself is lost.

Numbers that were written with few digits, and bodies far from the origin, leave more than eps in most rows. Such
residuals do work of either sign, while a soft ground (positive semidefinite) does positive work at all its nodes. So
few digits are the reason only as far as the usual row has such residuals, and their work at the nodes is of either
sign. Where most entries are decimal numbers of 12 to 14 digits, nothing softer than half of the last digit is known.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.linalg.tolerances import TOL


def decimal_precision(values: Floats) -> float:
    """Half of the last digit, of a number at most, where ``values`` were written with 12 to 14 digits; otherwise 0."""
    x, count = np.unique(np.abs(np.real(values[:: max(len(values) // TOL.decimal_samples, 1)])), return_counts=True)
    # Far from the ends of double precision, where powers of ten and products of them are rounded.
    usable = (x > 1e-280) & (x < 1e280)
    x, count = x[usable], count[usable]
    if len(x) < TOL.least_decimals:
        return 0.0
    power = 10.0 ** np.floor(np.log10(x))
    # More digits than any number has.
    needs = np.full(len(x), 99)
    for digits in range(TOL.decimal_digits[-1], 0, -1):
        step = 10.0 ** (digits - 1)
        needs[np.abs(np.round(x / power * step) / step * power - x) <= 2 * TOL.roundoff * x] = digits
    for digits in TOL.decimal_digits:
        within, exactly = (
            float(count[has_digits].sum() / count.sum()) for has_digits in (needs <= digits, needs == digits)
        )
        if within >= TOL.decimal_share and exactly >= TOL.full_decimal_share:
            return 0.5 * 10.0 ** (1 - digits)
    return 0.0


def rigid_null_space(
    K: sp.csr_array, Phi: Floats, size: Floats, node: Ints, last: float = 0.0
) -> tuple[Floats, Floats]:
    """Bases (N, r) of the motions ``Phi`` (N, k) that ``K`` leaves free of strain, and (N, k - r) of those it holds.

    ``Phi`` are independent geometric rigid motions of comparable displacements; ``size`` (N, k) sums up the magnitudes
    that cancel in K Phi, with terms that cancelled in the assembly of K: eps of it is round-off. ``node`` (N,) says
    which rows belong together; entries are known to the part ``last`` of them.

    Raises:
        InputError: a support so soft that it cannot be distinguished from round-off.
    """
    ratio, level = _forces(K, Phi, size, node, last)
    loaded = np.abs(ratio).max(axis=1, initial=0.0) > level
    if not loaded.any():
        return Phi, Phi[:, :0]
    _, s, Vt = np.linalg.svd(ratio[loaded], full_matrices=True)
    s = np.concatenate([s, np.zeros(len(Vt) - len(s))])
    residuals = np.abs(ratio[loaded] @ Vt.T).max(axis=0)
    unclear = (residuals > level) & (residuals <= TOL.clear_support * level)
    if unclear.any():
        raise InputError(
            "the body is held so softly that its support cannot be distinguished from round-off: rigid motion leaves "
            f"forces of {residuals[unclear].max():.1e} of the terms that cancel in their rows of the stiffness matrix, "
            f"and round-off reaches {level:.0e}; leave the support out of the model (and give it to the simulation), "
            "or make the stiff entries in these rows (links, penalty springs) softer",
            kind="model",
            keyword="supports",
        )
    free = residuals <= level
    if free.any() and s[free].max() > TOL.mixed_motion * s[~free].min():
        raise InputError(
            f"the body is held in {int((~free).sum())} of {len(free)} rigid motions, so softly "
            f"({residuals[~free].min():.1e} of the terms that cancel) that round-off ({residuals[free].max():.1e}) "
            "hides which motions are free; leave the support out of the model, hold the other motions too, or make the "
            "stiff entries in its rows (links, penalty springs) softer",
            kind="model",
        )
    return Phi @ Vt[free].T, Phi @ Vt[~free].T


def free_in_groups(
    K: sp.csr_array, Phi: Floats, size: Floats, node: Ints, last: float, group: Ints, rank: Ints
) -> Ints:
    """How many motions (groups,) of each group of rows that ``K`` does not couple are free of strain.

    ``group`` (N,) is that of each row, the first ``rank`` (groups,) columns of ``Phi`` in its rows are its motions;
    other arguments as those of ``rigid_null_space``. What is unclear counts as held.
    """
    ratio, level = _forces(K, Phi, size, node, last)
    strained = np.abs(ratio).max(axis=1, initial=0.0) > level
    order, ends = np.argsort(group, kind="stable"), np.cumsum(np.bincount(group))
    free = rank.copy()
    for number in np.unique(group[strained]):
        rows = order[ends[number - 1] if number else 0 : ends[number]]
        forces = ratio[rows[strained[rows]], : rank[number]]
        _, _, Vt = np.linalg.svd(forces, full_matrices=True)
        free[number] = int((np.abs(forces @ Vt.T).max(axis=0, initial=0.0) <= level).sum())
    return free


def has_stiffness(A: sp.csr_array, Phi: Floats, size: Floats, node: Ints, last: float = 0.0) -> bool:
    """True if ``A`` (N, N) has forces beyond round-off under the motions ``Phi`` (N, k); arguments as above."""
    ratio, level = _forces(A, Phi, size, node, last)
    return bool((np.abs(ratio) > level).any())


def _forces(A: sp.csr_array, Phi: Floats, size: Floats, node: Ints, last: float) -> tuple[Floats, float]:
    """Forces (N, k) of ``A`` under ``Phi`` against the terms that cancel in them, and the level of round-off."""
    force = A @ Phi
    force[np.abs(force) <= TOL.cancelled_force * size] = 0.0
    row_magnitudes = size.max(axis=1, initial=0.0)[:, None]
    ratio = np.divide(force, row_magnitudes, out=np.zeros_like(force), where=row_magnitudes > 0)
    # What each term may be off by its last digit adds up to no more than that part of all.
    return ratio, max(_round_off(ratio, _work(force, Phi, row_magnitudes, node), node), last)


def _work(force: Floats, Phi: Floats, row_magnitudes: Floats, node: Ints) -> Floats:
    """Work (nodes, k) of the forces at each node, against that of all that cancels there."""
    count = int(node.max(initial=-1)) + 1
    gather = sp.csr_array((np.ones(len(node)), (node, np.arange(len(node)))), shape=(count, len(node)))
    done = gather @ (force * Phi)
    magnitude = (gather @ (row_magnitudes * np.abs(Phi))).max(axis=1, initial=0.0)[:, None]
    return np.asarray(np.divide(done, magnitude, out=np.zeros_like(done), where=magnitude > 0))


def _round_off(ratio: Floats, work: Floats, node: Ints) -> float:
    """The level that round-off reaches in ``ratio`` (N, k), the forces against the terms that cancel in them.

    ``work`` (nodes, k) is that of the forces at each node, ``node`` (N,) that of each row.
    """
    worst = np.abs(ratio).max(axis=1, initial=0.0)
    largest = np.zeros(len(work))
    np.maximum.at(largest, node, worst)
    # Nodes with a support that is clear say nothing of the others.
    if _coherent(work[(largest > TOL.strain_roundoff) & (largest <= TOL.few_digits)]):
        return TOL.strain_roundoff
    # Few digits leave residuals in all rows: where the usual row has none, neither do others have large ones.
    usual = float(np.median(worst))
    high = (largest > TOL.usual_residual * usual) & (largest <= TOL.largest_residual * usual)
    return max(
        TOL.strain_roundoff,
        min((TOL.usual_residual if _coherent(work[high]) else TOL.largest_residual) * usual, TOL.few_digits),
    )


def _coherent(work: Floats) -> bool:
    """True if ``work`` (nodes, k) is that of supports: positive at most nodes, however much each does."""
    return bool((np.sign(work).sum(axis=0) >= TOL.coherent_nodes * np.count_nonzero(work, axis=0)).all())
