"""Parts of 20-node hexahedra that are mapped from grids: a connecting rod, a bracket, a bar. Lengths in mm."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from morembs.base.types import Floats, Ints
from morembs.fem.elements import TYPES

Place = Callable[[Floats, Floats, Floats], Sequence[Floats]]


@dataclass(frozen=True)
class Shape:
    """Points (n, 3), cells (m, 20) in VTK order, rows of points by name, rows of cells by name (each cell in one)."""

    points: Floats
    cells: Ints
    node_sets: Mapping[str, Ints]
    element_sets: Mapping[str, Ints]


@dataclass(frozen=True)
class _Block:
    """One mapped grid: the element set of its cells, their number each way, and its map from the unit cube."""

    name: str
    counts: tuple[int, int, int]
    place: Place

    def mesh(self) -> tuple[Floats, Ints]:
        """Points of the grid with twice as many steps, and those of each cell."""
        steps = 2 * np.array(self.counts) + 1
        grid = np.stack(np.meshgrid(*(np.linspace(0, 1, n) for n in steps), indexing="ij"))
        points = np.stack(np.broadcast_arrays(*self.place(*grid)), axis=-1).reshape(-1, 3)
        corner = 2 * np.stack(np.meshgrid(*map(np.arange, self.counts), indexing="ij"), axis=-1).reshape(-1, 1, 3)
        at = corner + np.rint(2 * TYPES["hex20"].reference).astype(int)
        return points, np.ravel_multi_index(tuple(np.moveaxis(at, -1, 0)), tuple(steps))


def rod_shape() -> Shape:
    """A rod between two pins, 120 mm apart: thick eyes with bushes, a thinner shank."""
    # Distance of the pins; radii of bores, bushes and eyes of both ends; elements around them.
    length, bores, inner, outer, turned = 120.0, (10.0, 6.0), (12.5, 8.0), (17.0, 11.5), (24, 20)
    layers = np.array([-8.0, -5.0, 5.0, 8.0])
    shank = 4  # sectors of each eye from which the shank goes out
    blocks = []
    for center, bore, bush, edge, count in zip((0.0, length), bores, inner, outer, turned, strict=True):
        for name, low, high in (("BUSHES", bore, bush), ("BODY", bush, edge)):
            blocks.append(_Block(name, (1, count, 3), _ring(center, low, high, layers)))
    half = [np.pi * shank / count for count in turned]

    def between(u: Floats, v: Floats, w: Floats) -> Sequence[Floats]:
        ends = []
        for center, edge, turn, side in zip((0.0, length), outer, half, (1, -1), strict=True):
            angle = (2 * v - 1) * turn
            ends.append((center + side * edge * np.cos(angle), edge * np.sin(angle)))
        return *((1 - u) * a + u * b for a, b in zip(*ends, strict=True)), np.interp(w, [0, 1], layers[1:3])

    blocks.append(_Block("BODY", (9, shank, 1), between))
    shape = _join(blocks)
    away = [np.hypot(shape.points[:, 0] - center, shape.points[:, 1]) for center in (0.0, length)]
    return _with_sets(shape, BIGEND=_is(away[0], bores[0]), SMALLEND=_is(away[1], bores[1]))


def bracket_shape() -> Shape:
    """An L: a foot of 80 x 40 mm with two bolt holes, and a lug with a hole for a pin; 8 mm thick."""
    # Thickness, half the side of the squares about the holes, radii of the holes.
    thick, half, bolt, pin = 8.0, 20.0, 5.5, 8.0
    blocks = []
    for side in range(4):
        hole, lug = _tile(side, bolt, half), _tile(side, pin, half)
        blocks += [_Block("FOOT", (2, 4, 1), _move(hole, (half, y, 0), thick)) for y in (half, 3 * half)]
        # The lug stands: x, y and z of its tile become y, z and x.
        blocks.append(_Block("LUG", (2, 4, 1), _turn(_move(lug, (2 * half, thick + half, -thick), thick))))
    blocks.append(_Block("FOOT", (1, 8, 1), lambda u, v, w: (thick * (u - 1), 4 * half * v, thick * w)))
    shape = _join(blocks)
    x, y, z = shape.points.T
    bolts = [_is(np.hypot(x - half, y - center), bolt) for center in (half, 3 * half)]
    hole = _is(np.hypot(y - 2 * half, z - thick - half), pin) & (x <= 0)
    return _with_sets(shape, BOLTS=bolts[0] | bolts[1], PIN=hole)


def bar_shape() -> Shape:
    """A bar of 200 x 20 x 10 mm."""
    length = 200.0  # twenty times the height
    shape = _join([_Block("BAR", (10, 1, 1), lambda u, v, w: (length * u, 20 * v, 10 * w))])
    return _with_sets(shape, LEFT=shape.points[:, 0] == 0, RIGHT=shape.points[:, 0] == length)


def faces_of(shape: Shape, rows: Ints) -> Ints:
    """The faces (nf, 8) of cells all of whose nodes are among ``rows``."""
    inside = np.zeros(len(shape.points), dtype=bool)
    inside[rows] = True
    faces: Ints = np.concatenate([shape.cells[:, local] for _, local in TYPES["hex20"].face_nodes])
    return faces[inside[faces].all(axis=1)]


def _ring(center: float, low: float, high: float, layers: Floats) -> Place:
    """A ring about (center, 0) between two radii, with layers along z."""

    def place(u: Floats, v: Floats, w: Floats) -> Sequence[Floats]:
        radius, angle = low + u * (high - low), 2 * np.pi * v
        z = np.interp(w, np.linspace(0, 1, len(layers)), layers)
        return center + radius * np.cos(angle), radius * np.sin(angle), z

    return place


def _tile(side: int, radius: float, half: float) -> Place:
    """The quarter of a square about a round hole that ends at one of its sides, from the hole outwards; 1 thick."""

    def place(u: Floats, v: Floats, w: Floats) -> Sequence[Floats]:
        angle = np.pi / 4 * (2 * v - 1)
        x = (1 - u) * radius * np.cos(angle) + u * half
        y = (1 - u) * radius * np.sin(angle) + u * half * (2 * v - 1)
        for _ in range(side):
            x, y = -y, x
        return x, y, w

    return place


def _move(inner: Place, by: tuple[float, float, float], thick: float) -> Place:
    """A place that is ``thick`` times as thick, and moved."""

    def place(u: Floats, v: Floats, w: Floats) -> Sequence[Floats]:
        x, y, z = inner(u, v, w)
        return x + by[0], y + by[1], thick * z + by[2]

    return place


def _turn(inner: Place) -> Place:
    """A place whose x, y and z become y, z and x."""

    def place(u: Floats, v: Floats, w: Floats) -> Sequence[Floats]:
        x, y, z = inner(u, v, w)
        return z, x, y

    return place


def _is(distance: Floats, radius: float) -> NDArray[np.bool_]:
    return np.abs(distance - radius) < 1e-6  # a nanometre: places are rounded to it


def _join(blocks: Sequence[_Block]) -> Shape:
    """One shape of blocks that meet: points at one place are one, and points of no cell go."""
    meshes = [block.mesh() for block in blocks]
    starts = np.cumsum([0, *(len(points) for points, _ in meshes)])
    # A nanometre is far above round-off and far below a step; adding zero takes the sign of -0.
    places = np.concatenate([points for points, _ in meshes]).round(6) + 0.0
    cells = np.concatenate([cells + start for (_, cells), start in zip(meshes, starts, strict=False)])
    used, cells = np.unique(cells, return_inverse=True)
    points, place = np.unique(places[used], axis=0, return_inverse=True)
    owners = np.repeat([block.name for block in blocks], [len(cells) for _, cells in meshes])
    sets = {name: np.flatnonzero(owners == name) for name in dict.fromkeys(block.name for block in blocks)}
    return Shape(points, place.ravel()[cells].reshape(-1, 20), {}, sets)


def _with_sets(shape: Shape, **chosen: NDArray[np.bool_]) -> Shape:
    rows = {name: np.flatnonzero(inside) for name, inside in chosen.items()}
    return Shape(shape.points, shape.cells, rows, shape.element_sets)
