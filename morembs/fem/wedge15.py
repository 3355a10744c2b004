"""Shape functions of the 15-node wedge, as an element of scikit-fem."""

from __future__ import annotations

import numpy as np
import skfem
from skfem.refdom import RefWedge

from morembs.base.types import Floats
from morembs.fem.elements import WEDGE15, WEDGE_EDGES


class ElementWedgeS2(skfem.ElementH1):  # type: ignore[misc]
    """15-node serendipity wedge, which scikit-fem lacks (Zienkiewicz and Taylor 2000, ch. 8.12)."""

    maxdeg = 3
    refdom = RefWedge
    doflocs = WEDGE15

    def lbasis(self, X: Floats, i: int) -> tuple[Floats, Floats]:
        """Value (nq,) and gradient (3, nq) of function ``i`` at the points X (3, nq)."""
        r, s, t = X
        zero, ones = np.zeros_like(r), np.ones_like(r)
        L = (1 - r - s, r, s)
        dL = (np.array([-ones, -ones, zero]), np.array([ones, zero, zero]), np.array([zero, ones, zero]))
        dz = np.array([zero, zero, 2 * ones])
        if i < 6:
            a, side = i % 3, -1.0 if i < 3 else 1.0
            z = side * (2 * t - 1)
            value = 0.5 * L[a] * (1 + z) * (2 * L[a] - 2 + z)
            by_area = 0.5 * (1 + z) * (4 * L[a] - 2 + z)
            by_height = 0.5 * L[a] * (2 * L[a] - 1 + 2 * z) * side
            return value, by_area * dL[a] + by_height * dz
        z = 2 * t - 1
        if i < 12:
            a, b = (corner % 3 for corner in WEDGE_EDGES[i - 6])
            side = -1.0 if i < 9 else 1.0
            height = 1 + side * z
            return (2 * L[a] * L[b] * height, 2 * height * (L[a] * dL[b] + L[b] * dL[a]) + 2 * L[a] * L[b] * side * dz)
        a = i - 12
        return L[a] * (1 - z**2), (1 - z**2) * dL[a] - 2 * z * L[a] * dz
