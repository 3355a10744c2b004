"""Symmetries of a component between two frames: they turn one static equilibrium into up to three others.

With the chord along x, three motions keep it: the reflection at the chord, y -> -y, which takes the end angles t to
-t; the exchange of the ends, x -> d0 - x, which takes (t1, t2) to (-t2, -t1); and both, a half turn, which takes
(t1, t2) to (t2, t1). A component has one of them if nodes fall on nodes and if inner forces move as the nodes do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from morembs.base.types import Floats, Ints
from morembs.dynamics.gmp.tolerances import TOL

# Name, signs of x and of y, what becomes of the end angles.
_MOTIONS: tuple[tuple[str, float, float, tuple[tuple[int, int], tuple[int, int]]], ...] = (
    ("reflection", 1.0, -1.0, ((-1, 0), (0, -1))),
    ("exchange of the ends", -1.0, 1.0, ((0, -1), (-1, 0))),
    ("half turn", -1.0, -1.0, ((0, 1), (1, 0))),
)


class Shaped(Protocol):
    """What is needed of a component, planar or solid."""

    @property
    def size(self) -> int: ...

    @property
    def frames(self) -> Mapping[str, Ints]: ...

    @property
    def translations(self) -> Ints: ...

    @property
    def reference(self) -> Floats: ...

    def force(self, x: Floats) -> Floats: ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Symmetry:
    """Coordinates x (N,) become ``sign * x[order]``, and those ``along`` the chord get its length more where the
    ends are exchanged; the end angles t become ``turn @ t``. ``end`` is the coordinate of the chord's length."""

    name: str
    order: Ints
    sign: Floats
    along: Floats
    turn: NDArray[np.int64]
    end: int

    def move(self, x: Floats) -> Floats:
        """The image (N,) of a shape in the frame of its chord."""
        return np.asarray(self.sign * x[self.order] + self.along * x[self.end])

    def modes(self, modes: Floats) -> Floats:
        """dX/dt (N, 2) of the image."""
        moved = self.sign[:, None] * modes[self.order] + self.along[:, None] * modes[self.end]
        return np.ascontiguousarray(moved @ self.turn.T)


def symmetries(component: Shaped, length: float) -> tuple[Symmetry, ...]:
    """All that the component has; ``length`` of its chord without load."""
    turning = _turning(component)
    if turning is None:
        return ()
    candidates = [_match_nodes(component, turning, length, *motion) for motion in _MOTIONS]
    return tuple(symmetry for symmetry in candidates if symmetry is not None and _holds(component, symmetry, length))


def _turning(component: Shaped) -> Ints | None:
    """Rotations (n, 1 or 3) of every node, -1 where it has none; None if the nodes of some are unknown."""
    at = component.translations
    count = 1 if at.shape[1] == 2 else 3
    turning = np.full((len(at), count), -1, dtype=np.int64)
    rest = np.setdiff1d(np.arange(component.size), at.ravel())
    if count == 1 and len(rest) == len(at):
        # One rotation per node, in the order of the nodes.
        turning[np.argsort(at[:, 0]), 0] = rest
    else:
        row = {int(first): k for k, first in enumerate(at[:, 0])}
        for numbers in component.frames.values():
            if len(numbers) == at.shape[1] + count and int(numbers[0]) in row:
                turning[row[int(numbers[0])]] = numbers[at.shape[1] :]
    return turning if len(np.setdiff1d(rest, turning)) == 0 else None


def _match_nodes(
    component: Shaped,
    turning: Ints,
    length: float,
    name: str,
    x: float,
    y: float,
    turn: tuple[tuple[int, int], tuple[int, int]],
) -> Symmetry | None:
    """The motion as a map of coordinates, if it takes nodes to nodes."""
    at = component.translations
    places = component.reference[at]
    Q = np.array([x, y, 1.0])[: at.shape[1]]
    images = places * Q
    images[:, 0] += length * (x < 0)
    distance, to = KDTree(places).query(images)
    if distance.max() > TOL.image_distance * length or len(np.unique(to)) < len(to):
        return None
    order, sign, along = np.arange(component.size), np.ones(component.size), np.zeros(component.size)
    order[at[to]], sign[at[to]] = at, Q
    along[at[:, 0]] = float(x < 0)
    # Rotations are axial vectors: they turn with Q and the sign of its determinant.
    axial = x * y * (np.ones(1) if turning.shape[1] == 1 else Q)
    has = turning[:, 0] >= 0
    if not np.array_equal(has[to], has):
        return None
    order[turning[to[has]]], sign[turning[to[has]]] = turning[has], axial
    end = int(component.frames["end"][0])
    return Symmetry(name=name, order=order, sign=sign, along=along, turn=np.array(turn, dtype=np.int64), end=end)


def _holds(component: Shaped, symmetry: Symmetry, length: float) -> bool:
    """True if inner forces of a few smooth, large deflections move as the nodes do."""
    random, at = np.random.default_rng(11), component.translations
    s = component.reference[at[:, 0]] / length
    reference = component.reference
    rest = np.setdiff1d(np.arange(component.size), at.ravel())
    for _ in range(TOL.symmetry_states):
        x = reference.copy()
        for axis in range(2):
            shape = np.polynomial.polynomial.polyval(s, random.uniform(-1, 1, 4))
            x[at[:, axis]] += TOL.symmetry_deflection * length * shape
        x[rest] += random.uniform(-TOL.symmetry_turn, TOL.symmetry_turn, len(rest))
        before, after = component.force(x), component.force(symmetry.move(x))
        if np.abs(after - symmetry.sign * before[symmetry.order]).max() > TOL.image_force * np.abs(before).max():
            return False
    return True
