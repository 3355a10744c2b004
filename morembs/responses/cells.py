"""Branch and bound over the cells of a band."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from morembs.base.types import Bools, Floats
from morembs.responses.tolerances import TOL


@dataclass(frozen=True, kw_only=True, eq=False)
class Bounds:
    """Of some cells: ``upper`` (nc, t) limits of t quantities on all of a cell, ``lower`` (nc, t) values that are
    reached in it, at ``at`` (nc, t) rad/s; ``final`` (nc, t) tells where smaller cells would give nothing."""

    upper: Floats
    lower: Floats
    at: Floats
    final: Bools

    @classmethod
    def join(cls, parts: list[Bounds]) -> Bounds:
        """Those of all ``parts``."""
        return cls(
            **{
                name: np.concatenate([getattr(part, name) for part in parts])
                for name in ("upper", "lower", "at", "final")
            }
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class BandCells:
    """Cells that cover a band: ``edges`` (nc, 2) in rad/s, ``upper`` (nc, t); of the whole band ``lower`` (t,) values
    that are reached at ``at`` (t,) rad/s. ``within_allowed`` is False where a lower value exceeded what was allowed,
    ``converged`` where cells were not halved any more because there were too many."""

    edges: Floats
    upper: Floats
    lower: Floats
    at: Floats
    within_allowed: bool = True
    converged: bool = True


def branch_and_bound(
    bounds: Callable[[Floats, Floats], Bounds],
    resolved: Callable[[Floats, Floats], Bools],
    edges: Floats,
    done: Callable[[Bounds, Floats], Bools],
    quantities: int,
    allowed: Floats | None = None,
    entries_per_cell: int = 1,
    max_cells: int = TOL.max_cells,
) -> BandCells:
    """Halve cells until all are done.

    ``bounds(low, high)`` of cells, ``resolved(low, high)`` where they mean anything; ``edges`` (n + 1,) to begin with;
    ``done`` (nc, t) by the bounds of cells and the largest lower values (t,). It ends early where a lower value exceeds
    what is ``allowed`` (t,). ``entries_per_cell`` numbers are kept for each cell, and at most ``max_cells`` are made.
    """
    low, high = edges[:-1], edges[1:]
    kept: list[tuple[Floats, Floats, Floats]] = []
    best, at = np.full(quantities, -np.inf), np.zeros(quantities)
    count, within_allowed, converged, step = 0, True, True, max(1, TOL.entries_at_once // entries_per_cell)
    max_cells = min(max_cells, max(TOL.least_max_cells, min(TOL.max_cells, TOL.max_cell_entries // entries_per_cell)))
    while len(low) and within_allowed:
        narrow = high - low <= TOL.least_cell_width * edges[-1]
        ready = resolved(low, high) | narrow
        unready = np.stack([low[~ready], high[~ready]])
        low, high, narrow = low[ready], high[ready], narrow[ready]
        if len(low):
            parts = [bounds(low[i : i + step], high[i : i + step]) for i in range(0, len(low), step)]
            bounds_here = Bounds.join(parts)
            here = bounds_here.lower.argmax(axis=0)
            reached = bounds_here.lower.max(axis=0)
            at = np.where(reached > best, np.take_along_axis(bounds_here.at, here[None], axis=0)[0], at)
            best = np.maximum(best, reached)
            closed = (bounds_here.final | done(bounds_here, best)).all(axis=1) | narrow
            within_allowed = allowed is None or not bool((best > allowed).any())
            if not within_allowed or count + 2 * len(low) + unready.shape[1] > max_cells:
                converged = converged and (not within_allowed or bool(closed.all()))
                closed[:] = True
            count += int(closed.sum())
            kept.append((low[closed], high[closed], bounds_here.upper[closed]))
            low, high = low[~closed], high[~closed]
        low, high = np.concatenate([low, unready[0]]), np.concatenate([high, unready[1]])
        middle = 0.5 * (low + high)
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
    cells = np.concatenate([np.stack([part[0], part[1]], axis=1) for part in kept])
    order = np.argsort(cells[:, 0], kind="stable")
    upper = np.concatenate([part[2] for part in kept])
    return BandCells(
        edges=cells[order], upper=upper[order], lower=best, at=at, within_allowed=within_allowed, converged=converged
    )


def initial_partition(low: float, high: float, inside: Floats) -> Floats:
    """Edges (n + 1,) of the first cells of a band in rad/s, with those of ``inside`` it as ends."""
    least = TOL.least_cell_width * high
    inside = inside[(inside > low + least) & (inside < high - least)]
    edges = np.unique(np.concatenate([np.linspace(low, high, TOL.first_cells + 1), inside]))
    # Ends that are nearly equal are one.
    return np.asarray(edges[np.concatenate([[True], np.diff(edges) > least])])
