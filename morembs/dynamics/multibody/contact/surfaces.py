"""Surfaces that points touch: planes, spheres, grids of Overhauser curves, with continuous normals."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import KW_ONLY, dataclass

import numpy as np
from numpy.typing import ArrayLike

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.limits import Positive
from morembs.base.types import Floats, Ints
from morembs.dynamics.multibody.component import direction, vector
from morembs.dynamics.multibody.contact.curves import checked_points, descend, overhauser
from morembs.dynamics.multibody.contact.tolerances import TOL
from morembs.dynamics.multibody.rotations import cross


@dataclass(frozen=True, kw_only=True, eq=False, slots=True)
class ClosestPoint:
    """The nearest point of a surface: ``gap`` m (negative inside), ``point`` (3,), unit ``normal`` (3,) outwards.

    ``vertices`` (v,) and ``weights`` (v,), of sum one: how the displacements of vertices move the point.
    """

    gap: float
    point: Floats
    normal: Floats
    vertices: Ints
    weights: Floats


_NO_VERTICES, _NO_WEIGHTS = np.zeros(0, dtype=int), np.zeros(0)


class Surface(ABC):
    """A surface in the axes of the marker that carries it."""

    name: str

    @abstractmethod
    def nearest(self, point: Floats) -> ClosestPoint:
        """The foot of ``point`` (3,)."""


class NodalSurface(Surface):
    """A surface through ``points`` (n, 3), which may move."""

    points: Floats

    @abstractmethod
    def displace(self, displacements: Floats) -> NodalSurface:
        """The same surface with its points displaced by (n, 3)."""


@checked
@dataclass(frozen=True, eq=False)
class Plane(Surface):
    """All that is below ``point`` (3,) m against ``normal`` (3,), which points outside.

    Raises:
        InputError: wrong shapes, or a normal that is no direction.
    """

    point: ArrayLike = (0.0, 0.0, 0.0)
    normal: ArrayLike = (0.0, 0.0, 1.0)
    _: KW_ONLY
    name: str = "plane"

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", vector(f"point of {self.name!r}", self.point))
        object.__setattr__(self, "normal", direction(f"normal of {self.name!r}", self.normal))

    def nearest(self, point: Floats) -> ClosestPoint:
        normal = np.asarray(self.normal, dtype=float)
        gap = float(normal @ (point - np.asarray(self.point, dtype=float)))
        return ClosestPoint(
            gap=gap, point=point - gap * normal, normal=normal, vertices=_NO_VERTICES, weights=_NO_WEIGHTS
        )


@checked
@dataclass(frozen=True, eq=False)
class Sphere(Surface):
    """A ball of ``radius`` m about ``center`` (3,) m, or where ``hollow`` all that is outside.

    Raises:
        InputError: a radius that is not positive, a centre of another shape.
    """

    center: ArrayLike
    radius: Positive
    _: KW_ONLY
    hollow: bool = False
    name: str = "sphere"

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", vector(f"center of {self.name!r}", self.center))

    def nearest(self, point: Floats) -> ClosestPoint:
        center = np.asarray(self.center, dtype=float)
        arm = point - center
        distance = float(np.linalg.norm(arm))
        # From the centre all directions are as near.
        out = arm / distance if distance > 0 else np.array([0.0, 0.0, 1.0])
        sign = -1.0 if self.hollow else 1.0
        return ClosestPoint(
            gap=sign * (distance - self.radius),
            point=center + self.radius * out,
            normal=sign * out,
            vertices=_NO_VERTICES,
            weights=_NO_WEIGHTS,
        )


@checked
@dataclass(frozen=True, eq=False)
class GridSurface(NodalSurface):
    """Surface through a grid of ``points`` (n, m, 3), Overhauser curves in both directions; its normal is continuous.

    The normal is along (first direction) x (second direction), or against it where ``flip``. ``closed`` joins the
    last row of points to the first. Weights of the points do not depend on their place: a moved grid is as smooth.

    Raises:
        InputError: fewer than two points along a direction, points that coincide, folded cells.
    """

    grid: ArrayLike
    _: KW_ONLY
    closed: bool = False
    flip: bool = False
    name: str = "grid"

    def __post_init__(self) -> None:
        grid = checked_points(f"surface {self.name!r}", self.grid, 3)
        if grid.shape[0] < (3 if self.closed else 2) or grid.shape[1] < 2:
            raise InputError(
                f"surface {self.name!r}: a grid {grid.shape[:2]} was given; expected two points each way",
                keyword="grid",
            )
        object.__setattr__(self, "grid", grid)
        self._check(grid)
        object.__setattr__(self, "points", grid.reshape(-1, 3))

    def _check(self, grid: Floats) -> None:
        rows = np.concatenate((grid, grid[:1])) if self.closed else grid
        a, b = rows[1:, 1:] - rows[:-1, :-1], rows[:-1, 1:] - rows[1:, :-1]
        area = np.linalg.norm(np.cross(a, b), axis=-1)
        bad = np.argwhere(area <= TOL.flat_cell * (np.linalg.norm(a, axis=-1) ** 2 + np.linalg.norm(b, axis=-1) ** 2))
        if len(bad):
            i, j = bad[0].tolist()
            raise InputError(
                f"surface {self.name!r}: {len(bad)} cells have no area, the first at ({i}, {j}) near "
                f"{np.array2string(grid[i, j], precision=6)} m; expected cells with four points apart",
                kind="model",
                keyword="grid",
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Points along both directions."""
        n, m, _ = np.shape(self.grid)
        return n, m

    def at(self, u: Floats) -> tuple[Floats, Floats, Floats]:
        """Point (3,) and both derivatives at the parameters u (2,)."""
        grid, (n, m) = np.asarray(self.grid), self.shape
        rows, a, da = overhauser(n, float(u[0]), self.closed)
        columns, b, db = overhauser(m, float(u[1]))
        near = grid[np.ix_(rows, columns)]
        along = np.tensordot(b, near, (0, 1))
        return a @ along, da @ along, a @ np.tensordot(db, near, (0, 1))

    def normal(self, u: Floats) -> Floats:
        """Unit normal (3,)."""
        _, first, second = self.at(u)
        across = cross(first, second)
        return np.asarray((-1.0 if self.flip else 1.0) * across / np.linalg.norm(across))

    def _keep_inside(self, u: Floats) -> Floats:
        n, m = self.shape
        first = u[0] % n if self.closed else min(max(u[0], 0.0), n - 1.0)
        return np.array([first, min(max(u[1], 0.0), m - 1.0)])

    def nearest(self, point: Floats) -> ClosestPoint:
        n, m = self.shape
        start = np.array(np.unravel_index(int(np.argmin(np.sum((self.points - point) ** 2, axis=1))), (n, m)), float)
        u = descend(self.at, start, point, self._keep_inside)
        rows, a, _ = overhauser(n, float(u[0]), self.closed)
        columns, b, _ = overhauser(m, float(u[1]))
        numbers, weights = np.add.outer(rows * m, columns).ravel(), np.outer(a, b).ravel()
        return foot_at(point, self.at(u)[0], self.normal(u), numbers, weights)

    def displace(self, displacements: Floats) -> GridSurface:
        moved = object.__new__(GridSurface)
        grid = np.asarray(self.grid) + displacements.reshape(np.shape(self.grid))
        for key, value in (("grid", grid), ("closed", self.closed), ("flip", self.flip), ("name", self.name)):
            object.__setattr__(moved, key, value)
        object.__setattr__(moved, "points", grid.reshape(-1, 3))
        return moved


def foot_at(point: Floats, foot: Floats, normal: Floats, vertices: Ints, weights: Floats) -> ClosestPoint:
    """The foot with its gap; over an edge the gap is the distance, along the line to the point."""
    arm = point - foot
    gap, distance = float(normal @ arm), float(np.linalg.norm(arm))
    beside = float(np.linalg.norm(arm - gap * normal))
    if beside > TOL.beside_normal * max(distance, TOL.tiny) and beside > TOL.least_beside_normal:
        gap, normal = distance, arm / distance
    return ClosestPoint(gap=gap, point=foot, normal=normal, vertices=vertices, weights=weights)
