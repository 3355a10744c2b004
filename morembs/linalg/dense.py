"""Small dense matrices; nothing here needs SciPy, which readers of body files do without."""

from __future__ import annotations

import numpy as np

from morembs.base.types import Floats


def symmetric(A: Floats) -> Floats:
    """The symmetric part of ``A`` (n, n)."""
    return np.asarray(0.5 * (A + A.T))
