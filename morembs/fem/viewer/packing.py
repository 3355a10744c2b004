"""Numbers as a page holds them: whole, as differences to the row before, in planes of bytes, compressed, in base 64.

Neighbours in a table are neighbours in space, so that differences are small, their high bytes are zero, and planes of
like bytes compress to less than half of what the numbers themselves do.
"""

from __future__ import annotations

import base64
import gzip
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morembs.base.types import Floats, Ints


def pack_whole(values: Any) -> dict[str, Any]:
    """Whole numbers (n, w) or (n,) of 32 bits; ``viewer.js`` reads them back column by column."""
    table = np.asarray(values, dtype=np.int64)
    table = table.reshape(len(table), -1) if table.size else table.reshape(0, max(1, table.shape[-1]))
    steps = np.diff(table, axis=0, prepend=0)
    # Zigzag: 0, -1, 1, -2, ... are 0, 1, 2, 3, ...
    folded = np.where(steps < 0, -2 * steps - 1, 2 * steps).astype(np.uint64)
    width = max(1, (int(folded.max(initial=0)).bit_length() + 7) // 8)
    planes = [(folded[:, c] >> np.uint64(8 * b)).astype(np.uint8) for c in range(table.shape[1]) for b in range(width)]
    raw = np.concatenate([np.empty(0, np.uint8), *planes]).tobytes()
    text = base64.b64encode(gzip.compress(raw, 9, mtime=0)).decode()
    return {"rows": len(table), "columns": table.shape[1], "bytes": width, "data": text}


def pack_steps(values: Floats, steps: int) -> dict[str, Any]:
    """Numbers (n, w) as whole multiples of ``scale``, of which the largest is ``steps``; the least stands for NaN and
    infinity."""
    known = np.isfinite(values)
    drawn = np.where(known, values, 0.0)
    largest = float(np.abs(drawn).max(initial=0.0)) or 1.0
    whole = np.where(known, np.round(drawn / largest * steps), -steps - 1)
    return pack_whole(whole.astype(np.int64)) | {"scale": largest / steps}


def spatial_order(points: Floats) -> Ints:
    """Rows of ``points`` (n, 3) along Morton's curve (1966), on which neighbours are near in space."""
    low = points.min(axis=0, initial=0.0) if not len(points) else points.min(axis=0)
    size = float(np.ptp(points, axis=0).max()) if len(points) else 1.0
    # Ten bits a direction: 1024 boxes along the longest side.
    cell = np.minimum((points - low) / (size or 1.0) * 1024, 1023).astype(np.uint64)
    code: NDArray[np.uint64] = np.zeros(len(points), dtype=np.uint64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cell[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(code, kind="stable")
