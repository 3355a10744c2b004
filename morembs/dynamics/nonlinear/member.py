"""Members of a planar mechanism: full nonlinear components, and what reduced ones must give."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.sparse as sp

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.dynamics.nonlinear.component import NonlinearComponent, StrainStiffness
from morembs.dynamics.nonlinear.tolerances import TOL


@dataclass(frozen=True, kw_only=True, eq=False, slots=True)
class MemberState:
    """A member at one configuration q (k,).

    ``x`` (N,) coordinates of the motion, those of the nodes or fewer, ``J`` (N, k) dx/dq or None for x = q, strain
    energy ``V``, ``force`` (k,) dV/dq, ``stiffness`` gives d2V/dq2 (k, k) (a part of it is enough for Newton's method),
    ``strains`` the part (k, k) of it by which strains resist: no negative eigenvalues, free of rigid motion; None
    where that is not known.
    """

    x: Floats
    J: Floats | None
    V: float
    force: Floats
    stiffness: Callable[[], Floats | sp.spmatrix]
    strains: Callable[[], Floats | sp.spmatrix] | None = None


class Member(Protocol):
    """A planar component between two frames; q = (frame at the start, frame at the end, inner coordinates)."""

    @property
    def size(self) -> int:
        """Length of q, 6 for the frames included."""

    @property
    def length(self) -> float:
        """Distance of the frames without load, m."""

    @property
    def M(self) -> sp.spmatrix:
        """Mass matrix (N, N) of the coordinates of the motion."""

    @property
    def rigid(self) -> Floats:
        """(N, 3): coordinates of the motion for unit translations along x and y and a unit turn of all rotations."""

    def nodes(self, x: Floats) -> Floats:
        """Coordinates (N, ...) of the component in its own order, from those of the motion."""

    def start(self, frames: Floats) -> Floats:
        """Configuration at rest without strain; ``frames`` (6,) must be at the distance ``length`` and aligned."""

    def at(self, q: Floats) -> MemberState:
        """Everything at a configuration; raises nothing for any finite q."""

    def outside(self, q: Floats) -> tuple[str, float, float] | None:
        """A coordinate that left the tabulated range, its value and limit; None within."""

    def estimate_neglected(self, q: Floats, state: MemberState, load: Floats) -> float:
        """Static answer, per length, of the first modes left out to ``load`` (N,), the force less inertia."""


@checked
class FullMember:
    """A nonlinear component with all its coordinates; its frames are named ``start`` and ``end``.

    Raises:
        InputError: a component without these frames, or whose reference does not run along x from the origin.
    """

    def __init__(self, component: NonlinearComponent) -> None:
        self.component = component
        self.length, self._order = ends(component)
        self.M = sp.csr_matrix(component.M[self._order][:, self._order])
        self._back = np.argsort(self._order)
        self.rigid = np.zeros((component.size, 3))
        self.rigid[:, 2] = 1
        self.rigid[self._back[component.translations]] = np.eye(2, 3)

    @property
    def size(self) -> int:
        return self.component.size

    def start(self, frames: Floats) -> Floats:
        placed, at = self.component.reference + frames[2], self.component.translations
        c, s = math.cos(frames[2]), math.sin(frames[2])
        placed[at] = self.component.reference[at] @ np.array([[c, s], [-s, c]]) + frames[:2]
        return np.asarray(placed[self._order])

    def at(self, q: Floats) -> MemberState:
        x = q[self._back]
        part = self.component
        return MemberState(
            x=q,
            J=None,
            V=part.energy(x),
            force=part.force(x)[self._order],
            stiffness=lambda: self._reorder(part.tangent(x)),
            strains=(lambda: self._reorder(part.strain_stiffness(x))) if isinstance(part, StrainStiffness) else None,
        )

    def _reorder(self, matrix: sp.spmatrix) -> sp.spmatrix:
        K = sp.coo_matrix(matrix)
        return sp.coo_matrix((K.data, (self._back[K.row], self._back[K.col])), shape=K.shape)

    def nodes(self, x: Floats) -> Floats:
        return np.asarray(x[self._back])

    def outside(self, q: Floats) -> tuple[str, float, float] | None:
        return None

    def estimate_neglected(self, q: Floats, state: MemberState, load: Floats) -> float:
        return 0.0


def ends(component: NonlinearComponent) -> tuple[float, Ints]:
    """Distance of the frames ``start`` and ``end``, and the coordinates with those of the frames first.

    Raises:
        InputError: frames that are missing, or a reference that does not run along x from the origin.
    """
    missing = [name for name in ("start", "end") if name not in component.frames]
    if missing:
        raise InputError(
            f"the component has the frames {', '.join(component.frames) or 'none'}; expected 'start' and 'end'"
        )
    first, second = component.frames["start"], component.frames["end"]
    a, b = component.reference[first], component.reference[second]
    length = float(b[0])
    if length <= 0 or np.abs(np.concatenate((a, b[1:]))).max() > TOL.off_axis * length:
        raise InputError(
            f"the reference of the component runs from {a} to {b}; expected frames without rotation at the origin and "
            "on the x axis. Turn and shift it",
            keyword="frames",
        )
    others = np.setdiff1d(np.arange(component.size), np.concatenate((first, second)))
    return length, np.concatenate((first, second, others))
