"""Large test models: a cube, a beam and a crankshaft of straight-sided quadratic tetrahedra, of any size.

usage: python benchmarks/models.py {cube,beam,crankshaft} DOFS FILE

Every shape is a stack of swept parts. The cross-section of a part is a triangulated plane figure; layers of
prisms over it are cut into three tetrahedra each. A prism is cut by the order of its vertices in the
section, so that neighbours agree on the diagonals, and each node has its place in a regular table of
levels. Parts that meet share the nodes of the smaller section, which is a piece of the larger one; only
there are nodes searched for, so that a mesh of millions of dofs takes seconds.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import meshio
import numpy as np
from scipy.spatial import cKDTree

from morembs.base.types import Floats, Ints

CUBE_EDGE = 0.1  # m
BEAM_LENGTH, BEAM_WIDTH = 1.0, 0.05  # m
# Points nearer than this are one point: far below any element, far above rounding.
SAME_POINT = 1e-9  # m
# The number of dofs may miss the wanted one by this part of it.
WITHIN = 0.03
# How much a stretch of the elements by a factor e counts against such a miss by 100 %.
STRETCH_COST = 0.02
# Layers of the crankshaft are at most so many times thinner or thicker than its cells are wide.
MOST_STRETCH = 4.0


@dataclass(frozen=True, eq=False)
class Section:
    """Triangulated cross-section.

    ``points`` (v, 2) in m; ``triangles`` (t, 3) rows of ``points``, ascending in each triangle;
    ``edges`` (e, 2) rows of ``points``, ascending; ``sides`` (t, 3) rows of ``edges``: 01, 12, 02.
    """

    points: Floats
    triangles: Ints
    edges: Ints
    sides: Ints

    @property
    def size(self) -> int:
        """Nodes on one level: the points and the middles of the edges."""
        return len(self.points) + len(self.edges)

    def turned(self, quarters: int) -> Section:
        """The section turned by quarters of a turn; exact, since no cosine is rounded."""
        x, y = self.points.T
        turned = [(x, y), (-y, x), (-x, -y), (y, -x)][quarters % 4]
        return replace(self, points=np.column_stack(turned))

    def level(self) -> Floats:
        """Positions (size, 2) in m of the nodes on one level."""
        return np.vstack([self.points, self.points[self.edges].mean(axis=1)])


def section(patches: Iterable[Floats]) -> Section:
    """Section of patches (a + 1, b + 1, 2) of quadrilaterals that meet node to node, each cut along its
    shorter diagonal."""
    points, triangles, count = [], [], 0
    for patch in patches:
        rows = count + np.arange(patch.shape[0] * patch.shape[1]).reshape(patch.shape[:2])
        a, b, c, d = (rows[:-1, :-1], rows[1:, :-1], rows[1:, 1:], rows[:-1, 1:])
        first = np.linalg.norm(patch[1:, 1:] - patch[:-1, :-1], axis=2)
        second = np.linalg.norm(patch[1:, :-1] - patch[:-1, 1:], axis=2)
        # The slack decides ties in the same way in patches that are turned copies of each other.
        ac = (first <= second * (1 + SAME_POINT))[..., None]
        triangles.append(np.where(ac, np.stack([a, b, c], axis=2), np.stack([a, b, d], axis=2)).reshape(-1, 3))
        triangles.append(np.where(ac, np.stack([a, c, d], axis=2), np.stack([b, c, d], axis=2)).reshape(-1, 3))
        points.append(patch.reshape(-1, 2))
        count += rows.size
    stacked = np.concatenate(points)
    kept, row = np.unique(_first_at(stacked), return_inverse=True)
    corners = np.sort(row[np.concatenate(triangles)], axis=1)
    pairs = corners[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2)
    edges, sides = np.unique(pairs, axis=0, return_inverse=True)
    return Section(stacked[kept], corners, edges, sides.reshape(-1, 3))


def _first_at(points: Floats) -> Ints:
    """For each of ``points`` (n, 2) the first row that lies at the same place."""
    first = np.arange(len(points))
    pairs = cKDTree(points).query_pairs(SAME_POINT, output_type="ndarray")
    np.minimum.at(first, pairs.max(axis=1), pairs.min(axis=1))
    return first


@cache
def _prism() -> tuple[Ints, Ints]:
    """Three tet10 in a prism over a triangle that runs clockwise [0] or counter-clockwise [1].

    Both arrays are (2, 3, 10): which node of the triangle (points 0, 1, 2 and sides 01, 12, 02 as 3, 4, 5),
    and on which of the levels 0, 1, 2. Diagonals rise from the lower to the higher point.
    """
    between = {(0, 1): 3, (1, 2): 4, (0, 2): 5}
    tets = [[(0, 0), (1, 0), (2, 0), (2, 1)], [(0, 0), (1, 0), (2, 1), (1, 1)], [(0, 0), (0, 1), (1, 1), (2, 1)]]
    place, level = np.empty((2, 3, 10), dtype=np.int64), np.empty((2, 3, 10), dtype=np.int64)
    for way, tet in itertools.product(range(2), range(3)):
        corners = [tets[tet][i] for i in ((0, 1, 2, 3) if way else (1, 0, 2, 3))]
        ends = [(c, c) for c in corners]
        ends += [(corners[i], corners[j]) for i, j in ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))]
        for number, ((p, low), (q, high)) in enumerate(ends):
            place[way, tet, number] = p if p == q else between[min(p, q), max(p, q)]
            level[way, tet, number] = low + high
    return place, level


def sweep(figure: Section, heights: Floats) -> tuple[Floats, Ints]:
    """Nodes (n, 3) in m and cells (m, 10) of a section swept through ``heights`` (layers + 1,) along z.

    The nodes lie level by level, two levels to a layer, in the order of ``Section.level``.
    """
    levels = np.interp(np.arange(2 * len(heights) - 1) / 2, np.arange(len(heights)), heights)
    flat, size = figure.level(), figure.size
    points = np.empty((len(levels), size, 3))
    points[..., :2] = flat
    points[..., 2] = levels[:, None]
    a, b, c = (figure.points[figure.triangles[:, i]] for i in range(3))
    (ux, uy), (vx, vy) = (b - a).T, (c - a).T
    way = (ux * vy - uy * vx > 0).astype(np.int64)
    place, level = _prism()
    of_triangle = np.hstack([figure.triangles, len(figure.points) + figure.sides])
    first = of_triangle[np.arange(len(way))[:, None, None], place[way]] + size * level[way]
    step = 2 * size * np.arange(len(heights) - 1)
    cells = first.reshape(1, -1, 10) + step[:, None, None]
    return points.reshape(-1, 3), cells.reshape(-1, 10)


def stack(parts: Sequence[tuple[Section, Floats]]) -> tuple[Floats, Ints]:
    """Nodes (n, 3) in m and cells (m, 10) of parts (section, heights) on top of each other along z."""
    points, cells, count = [], [], 0
    below, rows_below = np.empty((0, 2)), np.empty(0, dtype=np.int64)
    for figure, heights in parts:
        xyz, nodes = sweep(figure, heights)
        row = np.full(len(xyz), -1)
        here = figure.level()
        if len(below):
            away, match = cKDTree(below).query(here, distance_upper_bound=SAME_POINT)
            shared = np.flatnonzero(np.isfinite(away))
            row[shared] = rows_below[match[shared]]
            # Fewer would leave a crack: one of the two sections is a piece of the other.
            if len(shared) < min(len(here), len(below)):
                raise ValueError(f"sections at height {heights[0]:g} m do not fit on each other")
        new = row < 0
        row[new] = count + np.arange(int(new.sum()))
        count += int(new.sum())
        points.append(xyz[new])
        cells.append(row[nodes])
        below, rows_below = here, row[-figure.size :]
    return np.concatenate(points), np.concatenate(cells)


def grid(sides: tuple[float, float], cells: tuple[int, int]) -> Floats:
    """Patch (a + 1, b + 1, 2) of a rectangle from the origin with ``sides`` in m, cut into ``cells``."""
    axes = (np.linspace(0.0, side, count + 1) for side, count in zip(sides, cells, strict=True))
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=2)


def box(sides: Sequence[float], cells: Sequence[int]) -> tuple[Floats, Ints]:
    """Box from the origin with ``sides`` in m along x, y, z, each in so many cells; swept along x."""
    plane = section([grid((sides[1], sides[2]), (cells[1], cells[2]))])
    points, tets = stack([(plane, np.linspace(0.0, sides[0], cells[0] + 1))])
    return points[:, [2, 0, 1]], tets


def _nearest(candidates: Iterable[tuple[float, float, tuple[int, ...]]], dofs: int) -> tuple[int, ...]:
    """The best of candidates (dofs, sum of squared logarithms of stretches, choice): near to ``dofs``, then even."""

    def cost(size: float, stretch: float) -> tuple[bool, float]:
        miss = abs(size / dofs - 1)
        return miss > WITHIN, miss + STRETCH_COST * stretch

    return min((cost(size, stretch), choice) for size, stretch, choice in candidates)[1]


def cube(dofs: int) -> tuple[Floats, Ints]:
    """Cube of about ``dofs`` dofs; divisions of its edges may differ a little to come nearer."""
    n = max(1, round(((dofs / 3) ** (1 / 3) - 1) / 2))
    choices = itertools.combinations_with_replacement(range(max(1, n - 2), n + 3), 3)
    sized = ((3.0 * math.prod(2 * k + 1 for k in c), math.log(max(c) / min(c)) ** 2, c) for c in choices)
    return box([CUBE_EDGE] * 3, _nearest(sized, dofs))


def beam(dofs: int) -> tuple[Floats, Ints]:
    """Beam of about ``dofs`` dofs, 20:1:1, along x."""
    ratio = BEAM_LENGTH / BEAM_WIDTH

    def sized(n: int) -> tuple[float, float, tuple[int, ...]]:
        plane = 3 * (2 * n + 1) ** 2
        layers = max(1, round((dofs / plane - 1) / 2))
        return plane * (2.0 * layers + 1), math.log(layers / (ratio * n)) ** 2, (layers, n, n)

    most = 2 + round((dofs / (3 * ratio)) ** (1 / 3))
    return box([BEAM_LENGTH, BEAM_WIDTH, BEAM_WIDTH], _nearest(map(sized, range(1, most)), dofs))


# ---------------------------------------------------------------------------------------------------------
# Crankshaft


@dataclass(frozen=True)
class Crank:
    """Measures of a crankshaft along x in m. ``throws`` are the directions of its pins in quarter turns; 0 is
    +z. A web is an arc about the pin, two straight flanks that touch it, and an arc about the journal."""

    throws: tuple[int, ...] = (0, 1, 3, 2)
    eccentricity: float = 0.058  # of the pins
    journal_radius: float = 0.028
    pin_radius: float = 0.024
    flange_radius: float = 0.050
    web_radius: float = 0.036  # about the pin
    counterweight_radius: float = 0.082  # about the journal
    flank_degrees: float = 20.0  # between a flank and the plane of symmetry
    nose_length: float = 0.060
    journal_length: float = 0.034
    pin_length: float = 0.036
    web_length: float = 0.018
    rear_length: float = 0.040  # journal between the last web and the flange
    flange_length: float = 0.014

    @property
    def length(self) -> float:
        """Length over all in m."""
        bays = len(self.throws) * (2 * self.web_length + self.pin_length + self.journal_length)
        return self.nose_length + bays - self.journal_length + self.rear_length + self.flange_length

    @property
    def middle(self) -> float:
        """Where on x the middle of the middle journal lies, in m."""
        bays = len(self.throws) // 2 * (2 * self.web_length + self.pin_length + self.journal_length)
        return self.nose_length + bays - self.journal_length / 2

    def flank(self) -> tuple[Floats, Floats]:
        """Ends (2,) of the flank at +x in the plane of the web (m): at the arc of the pin and of the weight."""
        slope = math.radians(self.flank_degrees)
        upper = np.array([0.0, self.eccentricity]) + self.web_radius * np.array([math.cos(slope), math.sin(slope)])
        along = np.array([math.sin(slope), -math.cos(slope)])
        reach = upper @ along
        length = -reach + math.sqrt(reach**2 + self.counterweight_radius**2 - upper @ upper)
        return upper, upper + length * along


CRANK = Crank()


def _arc(radius: float, angles: Floats, height: float = 0.0) -> Floats:
    """Points (len(angles), 2) on a circle about (0, ``height``); angles in radians."""
    return np.column_stack([radius * np.cos(angles), height + radius * np.sin(angles)])


def _between(inner: Floats, outer: Floats, cells: int) -> Floats:
    """Patch (len(inner), cells + 1, 2) that joins two rows of points by straight lines."""
    t = np.linspace(0.0, 1.0, cells + 1)[:, None]
    return inner[:, None] * (1 - t) + outer[:, None] * t


def _quarters(n: int, start: int, count: int) -> Floats:
    """Angles (count n + 1,) in radians over so many quarters of a turn, from ``start`` eighths of a turn on."""
    return np.pi / 4 * (start + 2 * np.arange(count * n + 1) / n)


def disc(radius: float, n: int, height: float = 0.0) -> list[Floats]:
    """Patches of a disc about (0, ``height``): a bulged square of n x n cells and a ring around it.

    A quarter turn maps the disc onto itself, so that cranks at right angles fit on one journal; for that
    ``n`` is even.
    """
    bulge, corner = 0.52, 0.44  # of the radius: middle of the sides of the square, and its corners along x

    def inside(u: Floats, v: Floats) -> Floats:
        bent = bulge - corner
        return radius * np.stack([bulge * u - bent * u * v**2, bulge * v - bent * v * u**2], axis=-1)

    core = inside(*np.moveaxis(grid((1.0, 1.0), (n // 2, n // 2)), 2, 0))
    side = np.linspace(-1.0, 1.0, n + 1)
    ring = _between(inside(np.ones(n + 1), side), _arc(radius, _quarters(n, -1, 1)), max(1, round(0.4 * n)))
    patches = []
    centre = np.array([0.0, height])
    for _ in range(4):
        patches += [core + centre, ring + centre]
        core, ring = (np.stack([-p[..., 1], p[..., 0]], axis=-1) for p in (core, ring))
    return patches


def flange(crank: Crank, n: int) -> list[Floats]:
    """Patches of the flange: the disc of the journal in a wider ring."""
    turn = _quarters(n, 0, 4)
    ring = _between(_arc(crank.journal_radius, turn), _arc(crank.flange_radius, turn), max(1, n // 2))
    return [*disc(crank.journal_radius, n), ring]


def _outline(crank: Crank, end: Floats, cells: int, *, upper: bool) -> Floats:
    """Points (cells + 1, 2) at equal distances along the web's outline from flank to flank, over the arc about
    the pin (from +x) or about the journal (from -x); ``end`` (2,) is where it starts or stops on the flank at +x."""
    radius, height = (crank.web_radius, crank.eccentricity) if upper else (crank.counterweight_radius, 0.0)
    pole, foot = (1.0, crank.flank()[0]) if upper else (-1.0, crank.flank()[1])
    arc = radius * math.acos(pole * (foot[1] - height) / radius)
    line = float(np.linalg.norm(end - foot))
    along = -pole * np.linspace(-1.0, 1.0, cells + 1) * (arc + line)
    away = np.abs(along)
    on_arc = np.column_stack([radius * np.sin(away / radius), height + pole * radius * np.cos(away / radius)])
    on_line = foot + ((away - arc) / line)[:, None] * (end - foot)
    sides = np.column_stack([np.sign(along), np.ones(cells + 1)])
    return np.asarray(np.where((away <= arc)[:, None], on_arc, on_line) * sides)


def _on_flank(crank: Crank, height: float) -> Floats:
    """Point (2,) on the flank at +x at a height in m."""
    upper, lower = crank.flank()
    return np.asarray(lower + (height - lower[1]) / (upper[1] - lower[1]) * (upper - lower))


def web(crank: Crank, n: int) -> list[Floats]:
    """Patches of a web whose pin points to +y: the discs of journal and pin, and what lies around them.

    A ring of three quarters goes around each disc, out to the outline. Between the discs lies one patch,
    and two more between the ends of the rings, out to the flanks.
    """
    journal, pin, height = crank.journal_radius, crank.pin_radius, crank.eccentricity
    around, across = max(1, round(0.75 * n)), max(1, round(0.4 * n))
    low, high = _arc(journal, _quarters(n, -5, 3)), _arc(pin, _quarters(n, -1, 3), height)
    end_low, end_high = _on_flank(crank, low[-1, 1]), _on_flank(crank, high[0, 1])
    ring_low = _between(low, _outline(crank, end_low, 3 * n, upper=False), around)
    ring_high = _between(high, _outline(crank, end_high, 3 * n, upper=True), around)
    bridge = _between(_arc(journal, _quarters(n, 1, 1)), _arc(pin, -_quarters(n, 1, 1), height), across)
    side = _between(ring_low[-1], ring_high[0], across)
    return [*disc(journal, n), *disc(pin, n, height), ring_low, ring_high, bridge, side, side * [-1.0, 1.0]]


class Part(NamedTuple):
    """Part of a crankshaft: its section, and its length along the axis in m."""

    figure: Section
    length: float
    is_web: bool = False


def crank_parts(crank: Crank, n: int) -> list[Part]:
    """Parts of a crankshaft from nose to flange, with ``n`` cells on a quarter of a journal."""
    middle, throw = section(disc(crank.journal_radius, n)), section(web(crank, n))
    pin = section(disc(crank.pin_radius, n, crank.eccentricity))
    parts = [Part(middle, crank.nose_length)]
    for turn in crank.throws:
        cheek = Part(throw.turned(turn), crank.web_length, is_web=True)
        parts += [cheek, Part(pin.turned(turn), crank.pin_length), cheek, Part(middle, crank.journal_length)]
    parts[-1] = Part(middle, crank.rear_length)
    return [*parts, Part(section(flange(crank, n)), crank.flange_length)]


def _layerings(crank: Crank, n: int, parts: Sequence[Part]) -> Iterator[tuple[float, tuple[int, ...]]]:
    """Ways to cut ``parts`` into layers: (sum of squared logarithms of the stretches, layers of each part).

    Few numbers of layers make webs as thick as wanted, so webs and shaft have pitches of their own.
    """
    width = crank.journal_radius * math.pi / 2 / n
    for thick in range(1, 2 + round(MOST_STRETCH * crank.web_length / width)):
        stretch = crank.web_length / thick / width
        for pitch in np.geomspace(width / MOST_STRETCH, width * MOST_STRETCH, 100):
            layers = tuple(thick if part.is_web else max(1, round(part.length / pitch)) for part in parts)
            yield math.log(stretch) ** 2 + math.log(pitch / width) ** 2, layers


def crankshaft(dofs: int, crank: Crank = CRANK) -> tuple[Floats, Ints]:
    """Crankshaft of about ``dofs`` dofs, along x from its nose at 0.

    The number of cells on a quarter of a journal is even, hence the size is matched by the thickness of the layers.
    """
    choices: list[tuple[float, float, tuple[int, ...]]] = []
    for n in itertools.count(2, 2):
        parts = crank_parts(crank, n)
        sizes = np.array([part.figure.size for part in parts])
        shared = int(np.minimum(sizes[1:], sizes[:-1]).sum())
        ways = [
            (3.0 * (sizes @ (2 * np.array(layers) + 1) - shared), stretch, (n, *layers))
            for stretch, layers in _layerings(crank, n, parts)
        ]
        choices += ways
        if min(ways)[0] > dofs:
            break
    n, *layers = _nearest(choices, dofs)
    parts = crank_parts(crank, n)
    ends = np.cumsum([0.0] + [part.length for part in parts])
    heights = [np.linspace(a, b, k + 1) for k, (a, b) in zip(layers, itertools.pairwise(ends), strict=True)]
    points, cells = stack([(part.figure, z) for part, z in zip(parts, heights, strict=True)])
    return points[:, [2, 0, 1]], cells


# ---------------------------------------------------------------------------------------------------------
# Files

SHAPES: dict[str, Callable[[int], tuple[Floats, Ints]]] = {"cube": cube, "beam": beam, "crankshaft": crankshaft}


def make(shape: str, dofs: int) -> tuple[Floats, Ints]:
    """Points (n, 3) in m and cells (m, 10), rows of points in VTK order, of a shape with about ``dofs`` dofs.

    Raises:
        ValueError: no such shape, or none of that size within 3 %: a crankshaft needs about 19 thousand dofs.
    """
    if dofs < 1:
        raise ValueError(f"dofs = {dofs} was given; expected a positive number")
    if shape not in SHAPES:
        raise ValueError(f"shape = {shape!r} was given; expected one of {', '.join(SHAPES)}")
    points, cells = SHAPES[shape](dofs)
    if not abs(3 * len(points) / dofs - 1) <= WITHIN:
        raise ValueError(f"there is no {shape} of about {dofs} dofs; the nearest has {3 * len(points)}")
    return points, cells


def write(shape: str, dofs: int, path: Path) -> int:
    """Write the mesh in the format of the ending of ``path`` (.vtk is read fastest); returns the number of dofs.

    Raises:
        ValueError: as ``make``.
    """
    points, cells = make(shape, dofs)
    options: dict[str, dict[str, object]] = {".vtu": {"compression": None}, ".msh": {"file_format": "gmsh"}}
    meshio.Mesh(points, [("tetra10", cells)]).write(path, **options.get(path.suffix.lower(), {}))
    return 3 * len(points)


def interfaces(shape: str) -> dict[str, str]:
    """Three interfaces of a shape: name -> selection of nodes as in a job file, in m."""

    def region(kind: str, *numbers: float) -> str:
        return f"{kind}:" + ",".join(f"{number:.9g}" for number in numbers)

    if shape == "cube":
        a = CUBE_EDGE
        ends = {"left": region("box", 0, 0, 0, 0, a, a), "right": region("box", a, 0, 0, a, a, a)}
        return {**ends, "top": region("box", a / 4, a / 4, a, 3 * a / 4, 3 * a / 4, a)}
    if shape == "beam":
        a, w = BEAM_LENGTH, BEAM_WIDTH
        ends = {"start": region("box", 0, 0, 0, 0, w, w), "end": region("box", a, 0, 0, a, w, w)}
        return {**ends, "side": region("box", (a - w) / 2, 0, w, (a + w) / 2, w, w)}
    end, half, r = CRANK.length, CRANK.journal_length / 2, CRANK.flange_radius
    return {
        "nose": region("box", 0, -r, -r, 0, r, r),
        "bearing": region("cylinder", CRANK.middle - half / 2, 0, 0, half, 0, 0, CRANK.journal_radius),
        "flange": region("box", end, -r, -r, end, r, r),
    }


def job(
    shape: str,
    dofs: int,
    folder: Path,
    *,
    memory: str | None = None,
    scratch: Path | str | None = None,
    modes: int = 30,
    reduction: dict[str, object] | None = None,
) -> Path:
    """Write the mesh and a job (Craig-Bampton, three rigid interfaces, steel) into ``folder``; the job's path.

    Args:
        memory: budget for the factors, such as "4 GiB"; no limit without it.
        scratch: folder for factors on disk.
        modes: fixed-interface modes.
        reduction: another reduction, with its keys.

    Raises:
        ValueError: as ``make``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    name = f"{shape}_{dofs}"
    write(shape, dofs, folder / f"{name}.vtk")
    solver = {"memory": memory, "scratch": None if scratch is None else str(scratch)}
    frames: list[tuple[str, dict[str, object]]] = [
        ("[[interface]]", {"name": key, "nodes": text, "coupling": "rigid"}) for key, text in interfaces(shape).items()
    ]
    tables: list[tuple[str, dict[str, object]]] = [
        ("[model]", {"mesh": f"{name}.vtk", "units": "m-kg-s"}),
        ("[[material]]", {"set": "all", "young": 2.1e11, "poisson": 0.3, "density": 7850.0}),
        *frames,
        ("[solver]", {key: value for key, value in solver.items() if value is not None}),
        ("[[reduce]]", reduction or {"method": "craig-bampton", "modes": modes}),
        ("[output]", {"path": f"{name}.h5", "nodes": "skin"}),
    ]
    # Strings and numbers of JSON are those of TOML.
    lines = [
        [head, *(f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in table.items())]
        for head, table in tables
        if table
    ]
    path = folder / f"{name}.toml"
    path.write_text("\n\n".join("\n".join(part) for part in lines) + "\n", encoding="utf-8")
    return path


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the mesh the command line asks for. Returns the exit code."""
    parser = argparse.ArgumentParser(description="Write a large test mesh of tet10 (m).")
    parser.add_argument("shape", choices=list(SHAPES))
    parser.add_argument("dofs", type=int, help="wanted number of degrees of freedom, met within 3 %%")
    parser.add_argument("file", type=Path, help="mesh file; .vtk, .vtu, .msh or another ending that meshio knows")
    options = parser.parse_args(arguments)
    try:
        dofs = write(options.shape, options.dofs, options.file)
    except (ValueError, OSError, meshio.ReadError, meshio.WriteError) as error:
        print(error, file=sys.stderr)
        return 2
    print(f"{options.file}: {options.shape}, {dofs} dofs")
    return 0


if __name__ == "__main__":
    sys.exit(main())
