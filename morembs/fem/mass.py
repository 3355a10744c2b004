"""Mass, centre of mass and inertia of a model from its consistent mass matrix."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from morembs.base.types import Floats
from morembs.linalg.dense import symmetric

if TYPE_CHECKING:
    import scipy.sparse as sp


def mass_properties(M: sp.csr_array, R: Floats, pole: Floats) -> tuple[float, Floats, Floats]:
    """Mass, centre of mass (3,) and inertia (3, 3) about it.

    From the consistent mass ``M`` (N, N) and rigid-body modes ``R`` (N, 6) with rotations about ``pole`` (3,).
    """
    G = R.T @ (M @ R)
    mass = float(np.trace(G[:3, :3]) / 3)
    coupling = G[:3, 3:]  # -m c~
    arm = np.array([coupling[1, 2], coupling[2, 0], coupling[0, 1]]) / (mass or 1.0)
    shift = mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    inertia = G[3:, 3:] - shift
    return mass, pole + arm, symmetric(inertia)
