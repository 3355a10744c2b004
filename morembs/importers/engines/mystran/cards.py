"""Cards of coordinate systems."""

from __future__ import annotations

import numpy as np

from morembs.importers.nastran.bulk import Bulk
from morembs.importers.nastran.text_of_cards import card


def system_card(bulk: Bulk, number: int) -> str:
    """A coordinate system by points in the basic one."""
    kind, origin, axes = bulk.systems.frame(number, bulk.grids)
    points = np.concatenate([origin, origin + axes[2], origin + axes[0]])
    return card(f"CORD2{kind}", [number, 0, *map(float, points)])
