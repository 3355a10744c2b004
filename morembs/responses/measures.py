"""How far two transfer functions are apart on every frequency of a band, in three measures.

With E = H - H_r and Frobenius norms:

- "envelope": max |E(w)| / e(w), e(w) = sum_p |b_p|^2 / |a_p(w)| the sum of the sizes of all modal contributions;
  it has the peaks of H and no zeros;
- "peak": max |E| / max |H|;
- "pointwise": max |E(w)| / |H(w)|, large at zeros of H.

The block of the motions i and loads j is measured by the envelope of its own, sum_p |b_p,i| |b_p,j| / |a_p|.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from morembs.base.limits import number, one_of
from morembs.base.types import Floats
from morembs.base.units import in_hz
from morembs.responses.cells import BandCells, Bounds, branch_and_bound, initial_partition
from morembs.responses.layout import BlockIndex
from morembs.responses.rational import GRID, POINTS, PoleResidueForm, cell_points, on_grid, squares
from morembs.responses.rounding import Response, RoundoffBound, RoundoffSums
from morembs.responses.tolerances import TOL

MEASURES = ("envelope", "peak", "pointwise")
Measure = Annotated[str, one_of(*MEASURES)]
Sharpness = Annotated[float, number("a factor from 1.01 to 2", ge=1.01, le=2)]
TINY = np.finfo(float).tiny


@dataclass(frozen=True, kw_only=True)
class Limit:
    """The largest value over a band lies between ``lower``, reached ``at_hz``, and ``upper``; infinite ``upper``
    where there is no limit.

    >>> Limit(lower=0.8, upper=1.0, at_hz=120.0).upper
    1.0
    """

    lower: float
    upper: float
    at_hz: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Verdict:
    """True if a tolerance holds; if not, frequencies ``at`` (n,) in rad/s where to look: the worst one found and the
    ends of its cell."""

    holds: bool
    at: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferenceResponse:
    """What bodies are measured against: ``H`` in the entries of ``layout``, known but for ``uncertainty(low, high)``
    (nc,) times the envelope on cells without round-off (``cell_uncertainty`` between ``edges``), the envelope's
    ``modes`` with ``residue_norms`` (k, 1 + nb), the ``rounding`` at the poles of H, at least ``floor`` times the
    envelope."""

    H: PoleResidueForm
    modes: PoleResidueForm
    residue_norms: Floats
    rounding: RoundoffBound
    layout: BlockIndex
    floor: float
    edges: Floats
    cell_uncertainty: Floats

    def uncertainty(self, low: Floats, high: Floats) -> Floats:
        """(nc,) limits of |H - H_ref| / e on cells, round-off apart."""
        last = len(self.cell_uncertainty) - 1
        first = np.clip(np.searchsorted(self.edges, low, side="right") - 1, 0, last)
        end = np.clip(np.searchsorted(self.edges, high, side="left"), first + 1, last + 1)
        # Every other result belongs to a cell; the last end may lie behind all.
        pairs = np.stack([first, end], axis=1).ravel()
        return np.asarray(np.maximum.reduceat(np.append(self.cell_uncertainty, 0.0), pairs)[::2])

    def lost_to_rounding(self, omega: Floats, inverse: Floats) -> Floats:
        """(nf,) limits of what round-off makes of H at ``omega`` (nf,), for 1 / |a_p| (nf, k) of the modes."""
        own = inverse if self.H is self.modes else self.H.moduli(omega)[0]
        return np.asarray(self.rounding.at(own).size()[:, 0])


class Comparison:
    """A body in the entries of the layout of ``standard`` against its standard, cell by cell.

    Quantities: envelope, |E|, pointwise, |H|, and the envelopes of the blocks. Of a limit interpolation between points
    may take a share of what ``sharpness`` leaves.
    """

    def __init__(self, standard: ReferenceResponse, body: Response, sharpness: float = TOL.sharpness) -> None:
        self.standard, self.body = standard, body
        self.both = standard.H, body.terms
        self.residue_norms = [standard.layout.norms(terms.N) for terms in self.both]
        self.quantities = 3 + self.residue_norms[0].shape[1]
        # Two limits make that of the peak.
        self.sharpness = np.full(self.quantities, sharpness)
        self.sharpness[[1, 3]] = np.sqrt(sharpness)
        self.poles = np.concatenate([terms.z.real.ravel() for terms in self.both])

    def are_resolved(self, low: Floats, high: Floats) -> NDArray[np.bool_]:
        """True if cells are far enough from the poles to be worth a look."""
        middle = 0.5 * (low + high)
        return np.asarray(
            0.5 * (high - low) < TOL.resolved_cell * np.minimum(*(terms.nearest(middle) for terms in self.both))
        )

    def bounds(self, low: Floats, high: Floats) -> Bounds:
        """Limits of the quantities on cells."""
        standard, layout = self.standard, self.standard.layout
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        w = cell_points(low, high, POINTS)
        grid = cell_points(low, high, np.cos(GRID))
        full, reduced = (terms.at(w) for terms in self.both)
        H, X = on_grid(full), on_grid(full - reduced)
        remainders = [
            terms.remainder(middle, half, size) for terms, size in zip(self.both, self.residue_norms, strict=True)
        ]
        rest_H, remainder = remainders[0][:, :1], (remainders[0] + remainders[1])[:, None]
        size = layout.norms(X)
        largest = np.maximum(size[:, 1:], size[:, :-1]) + TOL.bulge * _spread(X, layout)[:, None] + remainder
        e, e_least, e_most, floor, floor_most = self._envelope(grid)
        uncertainty = standard.uncertainty(low, high)[:, None]
        # The uncertainty of the whole counts for every block.
        unsure = floor + (uncertainty * e[..., 0])[..., None]
        unsure_most = floor_most + (uncertainty * e_most[..., 0])[..., None]
        size_H = np.sqrt(squares(H).sum(axis=2))
        bulge_H = TOL.bulge * _spread(H, None)[:, :1] + rest_H
        least_H = _chords(H) - bulge_H
        above_H = np.maximum(size_H[:, 1:], size_H[:, :-1]) + bulge_H
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            uncertain = largest + unsure_most
            pure, total = (
                _quotients(error, e_least, np.maximum(least_H - off_H, 0.0), above_H + off_H).max(axis=1)
                for error, off_H in ((largest, np.zeros(1)), (uncertain, unsure_most[..., 0]))
            )
            least = np.maximum(size - remainder - unsure, 0.0)
            off_H = unsure[..., 0]
            reached = _quotients(least, e, size_H + rest_H + off_H, np.maximum(size_H - rest_H - off_H, 0.0))
            at_points = _quotients(size, e, size_H, size_H).max(axis=1)
            # nan: infinite limits on both sides of a difference.
            cost = np.nan_to_num(pure - at_points, nan=np.inf, posinf=np.inf)
            final = cost <= np.maximum(TOL.interpolation_share * (self.sharpness - 1) * total, total - pure)
        # Where only what is not known makes a limit infinite, smaller cells do not help.
        final &= np.isfinite(cost)
        where = reached.argmax(axis=1)
        return Bounds(
            upper=np.nan_to_num(total, nan=np.inf, posinf=np.inf),
            lower=reached.max(axis=1),
            at=np.take_along_axis(grid, where, axis=1),
            final=final,
        )

    def _envelope(self, grid: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Envelopes on the grid and their least and largest values between its points; round-off, and its largest."""
        standard = self.standard
        half = 0.5 * np.diff(grid[:, ::-1], axis=1)[:, ::-1]
        inverse, near, far = _inverse(standard.modes, grid)
        e = inverse @ standard.residue_norms
        # On each half of a segment by the way to its end.
        grown = [((1 + half / near[:, s]) * (1 + half / far[:, s]))[..., None] for s in (slice(1, None), slice(-1))]
        least = np.minimum(e[:, 1:] / grown[0], e[:, :-1] / grown[1])
        shrunk = _shrunk(half, near, far)
        largest = np.maximum(e[:, 1:] * shrunk[0][..., None], e[:, :-1] * shrunk[1][..., None])
        if standard.H is not standard.modes:
            # Damping couples the modes: errors grow at the poles of the response.
            inverse, near, far = _inverse(standard.H, grid)
            shrunk = _shrunk(half, near, far)
        lost = standard.rounding.at(inverse)
        floor, floor_most = lost.size() + standard.floor * e, _largest_loss(lost, shrunk) + standard.floor * largest
        inverse, near, far = _inverse(self.body.terms, grid)
        lost = self.body.rounding.at(inverse)
        own, own_most = lost.size(), _largest_loss(lost, _shrunk(half, near, far))
        return e, least, largest, floor + own, floor_most + own_most


def _quotients(error: Floats, envelope: Floats, divisor: Floats, H: Floats) -> Floats:
    """(nc, n, 4 + nb) the quantities of ``Comparison``: of ``error`` and ``envelope`` (nc, n, 1 + nb), the whole before
    its blocks, and of |H| (nc, n) as ``divisor`` of pointwise errors and as it is."""
    whole, blocks = error[..., :1], error[..., 1:]
    parts = (whole / envelope[..., :1], whole, whole / divisor[..., None], H[..., None], blocks / envelope[..., 1:])
    return np.concatenate(parts, axis=2)


def _inverse(terms: PoleResidueForm, grid: Floats) -> tuple[Floats, Floats, Floats]:
    """(nc, n, P) of 1 / |a_p|, the distance (nc, n) of the nearest root, and one below that of any second one."""
    inverse, near = terms.moduli(grid)
    # Roots come in pairs of opposite real parts, and no frequency is negative.
    return inverse, near, np.maximum(near, grid)


def _largest_loss(lost: RoundoffSums, shrunk: list[Floats]) -> Floats:
    """(nc, n - 1, 1 + nb) the largest that is lost between the points of cells."""
    return np.maximum(lost.part(slice(1, None)).size(shrunk[0]), lost.part(slice(-1)).size(shrunk[1]))


def _shrunk(half: Floats, near: Floats, far: Floats) -> list[Floats]:
    """By how much 1 / |a_p| grows at most up to ``half`` a segment away from its ends."""
    with np.errstate(divide="ignore"):
        return [
            1.0 / (np.maximum(1 - half / near[:, s], 0.0) * np.maximum(1 - half / far[:, s], 0.0))
            for s in (slice(1, None), slice(-1))
        ]


def _spread(p: NDArray[np.complex128], layout: BlockIndex | None) -> Floats:
    """(nc, q) largest |p - p_mid| on the grid."""
    away = p - p[:, TOL.segments // 2, None]
    if layout is None:
        return np.asarray(np.sqrt(squares(away).sum(axis=2)).max(axis=1))[:, None]
    return np.asarray(layout.norms(away).max(axis=1))


def _chords(p: NDArray[np.complex128]) -> Floats:
    """(nc, SEGMENTS) distances of zero from the straight lines between neighbours on the grid."""
    a, way = p[:, :-1], np.diff(p, axis=1)
    along = -(way.real * a.real + way.imag * a.imag).sum(axis=2)
    t = np.clip(along / np.maximum(squares(way).sum(axis=2), TINY), 0.0, 1.0)
    return np.asarray(np.sqrt(squares(a + t[..., None] * way).sum(axis=2)))


def compare(
    standard: ReferenceResponse,
    body: Response,
    low: float,
    high: float,
    sharpness: float = TOL.sharpness,
    asked: tuple[str, float] | None = None,
    most_cells: int = TOL.max_cells,
) -> tuple[dict[str, Limit], Floats, BandCells]:
    """Limits by measure, those (ni, ni) of the blocks by their envelopes, and the cells with upper limits (nc, 3).

    ``low`` and ``high`` in rad/s; an upper limit is at most ``sharpness`` times the lower one, where neither round-off
    nor what is not known of the full model stand against it. Where a measure is ``asked`` for with a tolerance, the
    other limits are not sharp, and its own does not lie above the tolerance while its lower one lies below. They hold
    with any number of cells, of which ``most_cells`` are made.
    """
    comparison = Comparison(standard, body, sharpness)
    factor = comparison.sharpness
    other = np.arange(comparison.quantities) >= len(MEASURES)
    number = MEASURES.index(asked[0]) if asked else -1
    unasked = np.array([asked is not None and q != number and (q, number) != (3, 1) for q in range(len(factor))])

    def done(bounds: Bounds, lower: Floats) -> NDArray[np.bool_]:
        sharp = (bounds.upper <= factor * lower) & (
            (bounds.upper <= TOL.local_sharpness * bounds.lower) | other
        ) | unasked
        if asked:
            allowed = asked[1] * (lower[3] if number == 1 else 1.0)
            sharp[:, number] &= (bounds.upper[:, number] <= allowed) | (lower[number] > allowed)
        return np.asarray(sharp)

    cells = branch_and_bound(
        comparison.bounds,
        comparison.are_resolved,
        initial_partition(low, high, comparison.poles),
        done,
        quantities=comparison.quantities,
        entries_per_cell=_numbers(comparison),
        max_cells=most_cells,
    )
    upper, lower = cells.upper.max(axis=0), cells.lower
    hz = in_hz(cells.at)
    # The largest |H| is known from both sides; where its lower limit is 0, no error is known relative to it.
    in_peaks = np.inf if lower[3] == 0 else 1 / lower[3]
    with np.errstate(invalid="ignore"):
        own = cells.upper[:, :3] * np.array([1.0, in_peaks, 1.0])
    # nan: no error of a response that nothing is known of.
    own[np.isnan(own)] = np.inf
    peak, least_peak = float(own[:, 1].max()), float(lower[1] / upper[3]) if upper[3] > 0 else 0.0
    limits = {
        "envelope": Limit(lower=float(lower[0]), upper=float(upper[0]), at_hz=float(hz[0])),
        "peak": Limit(lower=least_peak, upper=peak, at_hz=float(hz[1])),
        "pointwise": Limit(lower=float(lower[2]), upper=float(upper[2]), at_hz=float(hz[2])),
    }
    return limits, _blocks(standard.layout, upper), replace(cells, upper=own)


def _blocks(layout: BlockIndex, upper: Floats) -> Floats:
    """(ni, ni) limits of the blocks, where there is but one that of the whole, of those of all quantities."""
    n = len(layout.blocks)
    blocks = np.full((n, n), upper[0])
    for (i, j), value in zip(layout.pairs, upper[4:], strict=True):
        blocks[i, j] = value
        if layout.symmetric:
            blocks[j, i] = value
    return blocks


def decide(
    standard: ReferenceResponse, body: Response, low: float, high: float, measure: str, tolerance: float
) -> Verdict:
    """True if the limit by ``measure`` is at most ``tolerance`` from ``low`` to ``high`` rad/s."""
    comparison = Comparison(standard, body)
    number = MEASURES.index(measure)
    allowed = np.full(comparison.quantities, np.inf)
    if measure == "peak":
        # Any value that is reached will do for the peak of the full response.
        size = np.abs(standard.modes.z.real.ravel())
        w = np.clip(np.append(size, [low, high]), low, high)
        allowed[number] = tolerance * float(standard.layout.norms(standard.H.at(w))[:, 0].max())
    else:
        allowed[number] = tolerance
    cells = branch_and_bound(
        comparison.bounds,
        comparison.are_resolved,
        initial_partition(low, high, comparison.poles),
        lambda bounds, _: bounds.upper <= allowed,
        quantities=comparison.quantities,
        allowed=allowed,
        entries_per_cell=_numbers(comparison),
    )
    if cells.within_allowed and (cells.upper[:, number] <= allowed[number]).all():
        return Verdict(holds=True, at=np.zeros(0))
    worst = int(cells.upper[:, number].argmax())
    at = cells.at[number] if not cells.within_allowed else cells.edges[worst].mean()
    return Verdict(holds=False, at=np.unique([at, *cells.edges[worst]]))


def _numbers(comparison: Comparison) -> int:
    """Numbers that are held for one cell at once."""
    entries, poles = len(comparison.standard.layout.i), len(comparison.poles)
    return int(TOL.segments * (6 * entries + 6 * poles) + 20 * TOL.degree * poles)
