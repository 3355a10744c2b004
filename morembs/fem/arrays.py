"""Read-only arrays for the fields of frozen types."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def freeze(array: NDArray[Any]) -> NDArray[Any]:
    """A read-only view of ``array``."""
    view = array.view()
    view.flags.writeable = False
    return view


def frozen_numbers(value: ArrayLike) -> NDArray[Any]:
    """A read-only array of double precision; what carries a complex step stays complex."""
    array = np.asarray(value)
    return freeze(array.astype(np.result_type(array, np.float64), copy=False))
