"""Loads in orthonormal coordinates of an energy norm: differences of large residuals keep their digits."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg as sl

from morembs.base.types import Floats
from morembs.linalg.columns import m_norms, orthonormal
from morembs.linalg.dense import symmetric
from morembs.linalg.space import Space
from morembs.parametric.tolerances import TOL


class LoadCoordinates:
    """Coordinates of loads in the norm f' G f, with the flexibility G = ``flexibility`` of K (Nc, Nc) on a subspace
    where K, the inner product of ``space``, is positive definite: an orthonormal basis of the motions G f grows with
    the loads.

    Peak memory: the basis, where its budget wants it, and a block of loads (Casenave, Ern and Lelievre 2014).
    """

    def __init__(
        self, flexibility: Callable[[Floats], Floats], space: Space, cut: float = TOL.dependent_column
    ) -> None:
        self.flexibility, self.space, self.K, self.cut = flexibility, space, space.M, cut
        self.basis: list[Floats] = []

    @property
    def size(self) -> int:
        """Number of coordinates so far."""
        return sum(block.shape[1] for block in self.basis)

    def of(self, loads: Floats, scale: Floats) -> tuple[Floats, Floats]:
        """Coordinates (q, k) of ``loads`` (Nc, k), which join the basis, and norms (k,) of what is left out: below
        ``cut`` times ``scale`` (k,)."""
        Z = np.asfortranarray(self.flexibility(loads))
        inside = self.space.orthogonalize_in_place(self.basis, Z)
        G = symmetric(Z.T @ (self.K @ Z))
        values, U = sl.eigh(G / np.outer(scale, scale))
        good = values > self.cut**2
        new = np.zeros((0, Z.shape[1]))
        if good.any():
            Q = (Z / scale) @ (U[:, good] / np.sqrt(values[good]))
            self.space.orthogonalize_in_place(self.basis, Q)
            Q = orthonormal(Q, self.K)
            self.basis.append(self.space.budget.store(np.asfortranarray(Q)))
            new = self.space.dot(Q, self.K @ Z)
            self.space.subtract(Q, new, Z)
        return np.vstack([inside, new]), m_norms(Z, self.K @ Z)


def stack_padded(parts: list[Floats], size: int) -> Floats:
    """``parts`` (q_i, k_i) side by side as (``size``, k): what came later has coordinates that they lack."""
    return np.hstack([np.vstack([part, np.zeros((size - len(part), part.shape[1]))]) for part in parts])
