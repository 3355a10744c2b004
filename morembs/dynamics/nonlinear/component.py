"""What a geometrically nonlinear component must give: a constant mass matrix, inner forces from an energy, frames.

Coordinates x (N,) hold positions (m) and rotations (rad); f(x) = dW/dx is the inner force of the strain energy W
and K(x) = df/dx its tangent. Interfaces are frames: three of the coordinates in the plane, six in space.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import scipy.sparse as sp

from morembs.base.types import Floats, Ints


@runtime_checkable
class NonlinearComponent(Protocol):
    """A component of N coordinates; all matrices are sparse and symmetric.

    ``frames`` names the interfaces: (3,) numbers of their coordinates x, y and rotation in the plane, (6,) of position
    and rotation vector in space. All other coordinates that are no ``translations`` are rotations, too.
    """

    @property
    def size(self) -> int:
        """N."""

    @property
    def frames(self) -> Mapping[str, Ints]:
        """Interfaces: numbers (3,) or (6,) of their coordinates."""

    @property
    def translations(self) -> Ints:
        """Numbers (n, 2) or (n, 3) of all coordinates that are positions: along x, along y, along z."""

    @property
    def reference(self) -> Floats:
        """Coordinates (N,) without load."""

    @property
    def M(self) -> sp.csr_matrix:
        """Mass matrix (N, N); it does not depend on x."""

    def energy(self, x: Floats) -> float:
        """Strain energy W in J."""

    def force(self, x: Floats) -> Floats:
        """Inner forces dW/dx (N,)."""

    def tangent(self, x: Floats) -> sp.csr_matrix:
        """Tangent stiffness d2W/dx2 (N, N)."""


@runtime_checkable
class StrainStiffness(Protocol):
    """A component that can be damped in proportion to its stiffness."""

    def strain_stiffness(self, x: Floats) -> sp.csr_matrix:
        """Part (N, N) of the tangent by which strains resist: no negative eigenvalues, free of rigid motion."""
