"""Whole numbers at the points of a surface from those at earlier points: only the difference is written to a page.

Across an edge of two triangles a smooth field goes on nearly as it began: the fourth corner follows from the other
three. ``reading.js`` does the same sums, so they have no rounding: weights are multiples of a power of two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morembs.base.types import Floats, Ints
from morembs.fem.tolerances import TOL


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """``corners`` (k, 4): both ends of an edge, the corner before it and the one behind, which is predicted from these;
    ``weights`` (k, 2) of the second and the third."""

    corners: Ints
    weights: Floats

    @classmethod
    def across_edges(cls, triangles: Ints) -> Prediction:
        """By parallelograms on ``triangles`` (nt, 3)."""
        edges = np.stack([triangles, np.roll(triangles, -1, axis=1), np.roll(triangles, -2, axis=1)], axis=2)
        edges = edges.reshape(-1, 3)
        low, high = edges[:, :2].min(axis=1), edges[:, :2].max(axis=1)
        order = np.lexsort((high, low))
        shared = np.flatnonzero((np.diff(low[order]) == 0) & (np.diff(high[order]) == 0))
        ends, corners = order[shared], np.stack([edges[order[shared], 2], edges[order[shared + 1], 2]])
        before, behind = corners.min(axis=0), corners.max(axis=0)
        a, b = low[ends], high[ends]
        # Of three corners that were written before.
        later = (behind > b) & (behind > before)
        found = np.stack([a, b, before, behind], axis=1)[later]
        return cls(corners=found, weights=np.tile([1.0, -1.0], (len(found), 1)))

    def of_plane(self, places: Ints) -> Prediction:
        """By the plane through three corners at whole ``places`` (n, 3): exact for linear fields on flat surfaces."""
        a, b, c, d = (places[column].astype(float) for column in self.corners.T)
        u, v, w = b - a, c - a, d - a
        uu, uv, vv, uw, vw = ((p * q).sum(axis=1) for p, q in ((u, u), (u, v), (v, v), (u, w), (v, w)))
        area = uu * vv - uv * uv
        flat = area > TOL.thin_triangle * (uu * vv)
        weights = np.stack([uw * vv - vw * uv, vw * uu - uw * uv], axis=1) / np.where(flat, area, 1.0)[:, None]
        known = flat & (np.abs(weights) <= TOL.max_prediction_weight).all(axis=1)
        rounded = np.floor(weights * TOL.prediction_steps + 0.5) / TOL.prediction_steps
        return Prediction(corners=self.corners, weights=np.where(known[:, None], rounded, self.weights))

    def subtract(self, values: Ints) -> Ints:
        """Differences of whole ``values`` (n, w) to the mean of the predictions of each point, or to the
        point before."""
        a, b, c, d = self.corners.T
        count = np.bincount(d, minlength=len(values))
        differences = np.diff(values, axis=0, prepend=0)
        at = np.flatnonzero(count)
        for column, field in enumerate(values.T):
            predicted = (
                field[a] + self.weights[:, 0] * (field[b] - field[a]) + self.weights[:, 1] * (field[c] - field[a])
            )
            total = np.bincount(d, weights=predicted, minlength=len(values))
            differences[at, column] = field[at] - np.floor(total[at] / count[at] + 0.5).astype(np.int64)
        return differences
