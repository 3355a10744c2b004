"""Triangles of the faces of a skin, fewer of them where there are too many to look at."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from morembs.base.types import Floats, Ints
from morembs.fem.tolerances import TOL
from morembs.fem.viewer.packing import drawn_order
from morembs.fem.viewer.scene import Surface

# Corners of the triangles that a face is drawn with, by the number of its nodes in VTK order.
DRAWN = {
    3: ((0, 1, 2),),
    4: ((0, 1, 2), (0, 2, 3)),
    6: ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),
    8: ((0, 4, 7), (4, 1, 5), (5, 2, 6), (6, 3, 7), (4, 5, 7), (5, 6, 7)),
}
# Which of their sides are edges of the element: bit 1 from the first corner to the second, 2, 4 the others.
SIDES = {3: (7,), 4: (3, 6), 6: (5, 3, 6, 0), 8: (5, 3, 6, 3, 0, 0)}

# Triangles of an octahedron, its corners along x, y, z and against them.
OCTAHEDRON = tuple((x, y, z) if (x + y + z) % 2 else (x, z, y) for x in (0, 3) for y in (1, 4) for z in (2, 5))


def triangles_of(faces: Mapping[str, Ints], *, middles: bool = True) -> tuple[Ints, Ints]:
    """Triangles (nt, 3) of faces and their sides (nt,), through the middle nodes too unless ``middles`` is false."""
    parts, sides = [np.empty((0, 3), dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    for nodes in faces.values():
        corners = 3 if nodes.shape[1] in (3, 6) else 4
        size = min(nodes.shape[1], 8) if middles else corners
        parts += [nodes[:, chosen] for chosen in DRAWN[size]]
        sides += [np.full(len(nodes), bits, dtype=np.int64) for bits in SIDES[size]]
    return np.concatenate(parts), np.concatenate(sides)


def drawn_surface(
    points: Floats, node_ids: Ints, faces: Mapping[str, Ints], *, middles: bool = False, also: Ints | None = None
) -> tuple[Surface, Ints]:
    """The surface of ``faces``, whose nodes are rows of ``points`` (n, 3), and the row of each of its points.

    Args:
        middles: draw through middle nodes too, where that is not too much.
        also: rows of further nodes, which groups mark.
    """
    max_triangles = TOL.drawn_triangles
    triangles, sides = triangles_of(faces, middles=middles)
    if middles and len(triangles) > max_triangles:
        triangles, sides = triangles_of(faces, middles=False)
    note = ""
    if len(triangles) > max_triangles:
        whole = len(triangles)
        triangles = fewer_triangles(points, triangles, max_triangles)
        sides = np.full(len(triangles), 7)
        note = f"{whole:,} triangles are drawn as {len(triangles):,}: nodes between are left out of the picture"
    rows = np.unique(triangles)
    rows = rows[drawn_order(points[rows])]
    if also is not None:
        rows = np.concatenate([rows, np.setdiff1d(also, rows)])
    place = np.full(len(points), -1, dtype=np.int64)
    place[rows] = np.arange(len(rows))
    triangles, sides = _from_first_corner(place[triangles], sides)
    order = np.argsort(triangles[:, 0], kind="stable")
    return (
        Surface(
            points=points[rows], node_ids=node_ids[rows], triangles=triangles[order], sides=sides[order], note=note
        ),
        rows,
    )


def dotted_surface(points: Floats, node_ids: Ints) -> tuple[Surface, Ints]:
    """An octahedron around each of ``points`` (n, 3), for parts that have no faces; as ``drawn_surface``."""
    step = max(1, -(-len(points) * len(OCTAHEDRON) // TOL.drawn_triangles))
    nodes = np.arange(0, len(points), step)
    radius = TOL.dot_radius * (float(np.ptp(points, axis=0).max(initial=0.0)) or 1.0)
    corners = points[nodes, None] + radius * np.concatenate([np.eye(3), -np.eye(3)])
    rows = np.repeat(nodes, 6)
    triangles = (6 * np.arange(len(nodes))[:, None, None] + np.array(OCTAHEDRON)).reshape(-1, 3)
    triangles, sides = _from_first_corner(triangles, np.zeros(len(triangles), dtype=np.int64))
    left_out = f", every {step}th of {len(points):,}" if step > 1 else ""
    note = f"nodes alone are drawn{left_out}: no faces of elements are stored with them"
    return Surface(
        points=corners.reshape(-1, 3), node_ids=node_ids[rows], triangles=triangles, sides=sides, note=note
    ), rows


def _from_first_corner(triangles: Ints, sides: Ints) -> tuple[Ints, Ints]:
    """The same triangles, each from its first point on, as it is short to write."""
    turn = triangles.argmin(axis=1)
    turned = np.take_along_axis(triangles, (turn[:, None] + np.arange(3)) % 3, axis=1)
    return turned, sides >> turn | (sides << (3 - turn)) & 7


def fewer_triangles(points: Floats, triangles: Ints, max_triangles: int) -> Ints:
    """At most ``max_triangles`` triangles between some of the same ``points`` (n, 3).

    Points in one cell of a grid, on skins that look the same way, become one of them: the one where the skin bends
    most, so that edges and corners stay (Rossignac and Borrel 1993). ``max_triangles`` limits the grid.
    """
    rows = np.unique(triangles)
    at = points[rows]
    place = np.full(len(points), -1, dtype=np.int64)
    place[rows] = np.arange(len(rows))
    corners = place[triangles]
    way, bend = _ways(at, corners)
    size = float(np.ptp(at, axis=0).max())
    # A cell has about two triangles for each of its points: as a first guess cells of the area of two triangles.
    fine, coarse = 1, 2 ** int(np.ceil(np.log2(max(2, max_triangles))))
    best = triangles[:0]
    while coarse - fine > max(1, coarse // 50):
        cells = (fine + coarse) // 2
        fewer = rows[_merge(at, corners, way, bend, size / cells)]
        if len(fewer) <= max_triangles:
            best, fine = fewer, cells
        else:
            coarse = cells
    return best


def _ways(at: Floats, corners: Ints) -> tuple[Ints, Floats]:
    """Which of six ways (n,) the skin looks at each point, and how much it bends there (n,), from 0 to 1."""
    normal = np.cross(at[corners[:, 1]] - at[corners[:, 0]], at[corners[:, 2]] - at[corners[:, 0]])
    area = np.linalg.norm(normal, axis=1)
    mean, total = np.zeros_like(at), np.zeros(len(at))
    for column in corners.T:
        for axis in range(3):
            mean[:, axis] += np.bincount(column, weights=normal[:, axis], minlength=len(at))
        total += np.bincount(column, weights=area, minlength=len(at))
    bend = 1 - np.linalg.norm(mean, axis=1) / np.maximum(total, np.finfo(float).tiny)
    largest = np.abs(mean).argmax(axis=1)
    return 2 * largest + (np.take_along_axis(mean, largest[:, None], axis=1)[:, 0] > 0), bend


def _merge(at: Floats, corners: Ints, way: Ints, bend: Floats, cell: float) -> Ints:
    """Triangles between the points that stand for the others, rows of ``at``."""
    box = ((at - at.min(axis=0)) / cell).astype(np.int64)
    count = box.max(axis=0) + 1
    key = ((box[:, 0] * count[1] + box[:, 1]) * count[2] + box[:, 2]) * 6 + way
    order = np.lexsort((-bend, key))
    first = np.append(True, np.diff(key[order]) > 0)
    stands = np.empty(len(at), dtype=np.int64)
    stands[order] = order[first][np.cumsum(first) - 1]
    triangles = stands[corners]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    _, kept = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    return np.asarray(triangles[np.sort(kept)])
