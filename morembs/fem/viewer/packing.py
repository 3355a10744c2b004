"""Numbers as a page holds them: whole, as differences to what earlier ones let expect, in planes of bytes, compressed,
in base 64.

Differences are small, so that their high bytes are zero, and planes of like bytes compress to less than half of what
the numbers themselves do.
"""

from __future__ import annotations

import base64
import gzip
from collections.abc import Sequence
from typing import Any

import numpy as np

from morembs.base.types import Floats, Ints
from morembs.fem.viewer.prediction import Prediction


def pack_whole(values: Any, prediction: Prediction | None = None) -> dict[str, Any]:
    """Whole numbers (n, w) or (n,) of 32 bits, row by row; ``reading.js`` reads them back.

    Args:
        prediction: from neighbours on a surface, by default from the row before.
    """
    table = np.asarray(values, dtype=np.int64)
    table = table.reshape(len(table), -1) if table.size else table.reshape(0, max(1, table.shape[-1]))
    return _pack(np.diff(table, axis=0, prepend=0) if prediction is None else prediction.subtract(table))


def _pack(steps: Ints) -> dict[str, Any]:
    # Zigzag: 0, -1, 1, -2, ... are 0, 1, 2, 3, ...
    folded = np.where(steps < 0, -2 * steps - 1, 2 * steps).astype(np.uint64)
    width = max(1, (int(folded.max(initial=0)).bit_length() + 7) // 8)
    planes = [(folded[:, c] >> np.uint64(8 * b)).astype(np.uint8) for c in range(steps.shape[1]) for b in range(width)]
    raw = np.concatenate([np.empty(0, np.uint8), *planes]).tobytes()
    text = base64.b64encode(gzip.compress(raw, 9, mtime=0)).decode()
    return {"rows": len(steps), "columns": steps.shape[1], "bytes": width, "data": text}


def whole_steps(values: Floats, steps: int) -> tuple[Ints, float]:
    """Numbers (n, w) as whole multiples of a scale, of which the largest is ``steps``, and that scale; the least stands
    for NaN and infinity."""
    known = np.isfinite(values)
    drawn = np.where(known, values, 0.0)
    largest = float(np.abs(drawn).max(initial=0.0)) or 1.0
    whole = np.where(known, np.round(drawn / largest * steps), -steps - 1)
    return whole.astype(np.int64), largest / steps


def pack_shape(values: Ints, prediction: Prediction, earlier: Sequence[Ints] = ()) -> dict[str, Any]:
    """Whole numbers (n, w) at the points of a surface: by prediction, or as the difference to one of the ``earlier``
    shapes on it, where that is shorter; modes of two bodies of a part are often the same."""
    packed = pack_whole(values, prediction)
    products = [float(np.vdot(values, shape)) for shape in earlier]
    if not products:
        return packed
    # Scales are those of the largest entry, so that the same shapes have the same numbers, or the opposite ones.
    sizes = [max(1.0, float(np.linalg.norm(shape))) for shape in earlier]
    like = int(np.argmax(np.abs(products) / np.array(sizes)))
    sign = 1 if products[like] >= 0 else -1
    short = _pack(values - sign * earlier[like]) | {"like": like, "sign": sign}
    return min(packed, short, key=lambda each: len(each["data"]))


def drawn_order(points: Floats) -> Ints:
    """Rows of ``points`` (n, 3) along the longest direction of their box, and within a slice along the others: the
    corners across most edges then come one behind the other."""
    if not len(points):
        return np.empty(0, dtype=np.int64)
    low, extent = points.min(axis=0), np.ptp(points, axis=0)
    # Some 1,000 slices: points of one slice are at one place.
    cell = np.floor((points - low) / (float(extent.max()) or 1.0) * 1024 + 0.5).astype(np.int64)
    return np.lexsort(cell[:, np.argsort(extent, kind="stable")].T)
