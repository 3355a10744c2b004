"""Kinds of arrays, by their numbers; shapes stand where they are used."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
# In single precision where memory counts more.
Reals = NDArray[np.float64] | NDArray[np.float32]
# Real or complex.
Values = NDArray[Any]
