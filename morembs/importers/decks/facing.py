"""Which face of a tied surface CalculiX gives a node to, and which nodes it leaves free.

The faces of all masters become triangles. From the triangle whose centre is nearest to a node CalculiX walks over the
edges that the node is beyond. Where the walk ends at a triangle that the node is over, the node is tied if it is near
enough to its plane; where it comes to the border of the surface, or turns in a circle, the node stays free. An edge is
crossed, and a border reached, by a fortieth of the mean distance of centres from first edges, whatever POSITION
TOLERANCE says (CalculiX 2.20, seen by experiment and in its published source).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from morembs.base.types import Floats, Ints
from morembs.importers.decks.projection import Projection, on_face
from morembs.importers.tolerances import TOL

# Triangles of a face by its corners and middles; edge i of a triangle is that without its corner i.
_TRIANGLES = {
    "tri3": ((0, 1, 2),),
    "quad4": ((0, 1, 3), (1, 2, 3)),
    "tri6": ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),
    "quad8": ((0, 4, 7), (4, 1, 5), (6, 5, 2), (7, 6, 3), (7, 4, 6), (4, 5, 6)),
}
_TRIANGLES["quad9"] = _TRIANGLES["quad8"]
Faces = Sequence[tuple[str, Ints]]


class Facing:
    """The triangles of the faces of all ``masters``, each a sequence of type and nodes (nf, k), rows of ``xyz``."""

    def __init__(self, xyz: Floats, masters: Sequence[Faces]) -> None:
        self.faces = [part for faces in masters for part in faces]
        corners, parts, rows, self._starts = [np.empty((0, 3), dtype=np.int64)], [], [], [0]
        for part, (kind, nodes) in enumerate(self.faces):
            local = np.array(_TRIANGLES[kind])
            corners.append(nodes[:, local].reshape(-1, 3))
            parts.append(np.full(len(corners[-1]), part))
            rows.append(np.repeat(np.arange(len(nodes)), len(local)))
        count = 0
        for faces in masters:
            count += sum(len(nodes) * len(_TRIANGLES[kind]) for kind, nodes in faces)
            self._starts.append(count)
        self._corners = np.concatenate(corners)
        self._part, self._row = (np.concatenate([np.empty(0, dtype=np.int64), *a]) for a in (parts, rows))
        x = xyz[self._corners]
        self._center = x.mean(axis=1)
        self._normal = _unit(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]))
        # Outward directions, in the plane of the triangle, of the edges opposite to each corner, and a point on each.
        self._base = np.roll(x, -1, axis=1)
        along = np.roll(x, -2, axis=1) - self._base
        self._out = _unit(np.cross(along, self._normal[:, None]))
        first = np.einsum("tx,tx->t", self._out[:, 0], self._center - self._base[:, 0])
        self.tolerance = TOL.crossed_part * float(np.abs(first).mean()) if len(first) else 0.0
        self._beyond = _neighbours(self._corners)

    def on(self, points: Floats, xyz: Floats, master: int, tolerance: float) -> tuple[Projection, NDArray[np.bool_]]:
        """The points (n, 3) on the faces of the ``master`` (its number) that they face, and which of them are tied.

        Those within ``tolerance`` of the plane of their triangle are; of others the projection says nothing.
        """
        at = self._find_faced(points, *self._starts[master : master + 2])
        height = np.einsum("nx,nx->n", self._normal[at], points - self._base[at, 0])
        tied = (at >= 0) & (np.abs(height) <= tolerance)
        width = max(nodes.shape[1] for _, nodes in self.faces)
        projection = Projection(
            np.abs(height),
            points.copy(),
            np.zeros((len(points), width), dtype=np.int64),
            np.zeros((len(points), width)),
        )
        for part, (kind, nodes) in enumerate(self.faces):
            own = np.flatnonzero(tied & (self._part[at] == part))
            faces = nodes[self._row[at[own]]]
            projection.nodes[own] = faces[:, :1]
            projection.nodes[own, : nodes.shape[1]] = faces
            projection.weights[own, : nodes.shape[1]], projection.foot[own] = on_face(kind, points[own], xyz[faces])
        return projection, tied

    def _find_faced(self, points: Floats, start: int, end: int) -> Ints:
        """The triangle that each point (n, 3) faces, -1 for none."""
        # Not at the top: few decks have ties.
        from scipy.spatial import cKDTree

        at = start + cKDTree(self._center[start:end]).query(points)[1]
        result, before = np.full(len(points), -1), np.full(len(points), -1)
        visited = np.full((len(points), TOL.walked_triangles), -1)
        walking = np.arange(len(points))
        for step in range(TOL.walked_triangles + 1):
            here = at[walking]
            gap = points[walking, None] - self._base[here]
            outside = np.einsum("nex,nex->ne", self._out[here], gap) > self.tolerance
            to = np.where(outside.any(axis=1), self._beyond[here, outside.argmax(axis=1)], -2)
            arrived = (to == -2) | ((to >= 0) & (to == before[walking]))
            result[walking[arrived]] = here[arrived]
            on = ~arrived & (to >= 0) & ~(visited[walking] == to[:, None]).any(axis=1)
            walking, here, to = walking[on], here[on], to[on]
            if not len(walking) or step == TOL.walked_triangles:
                break
            visited[walking, step], before[walking], at[walking] = to, here, to
        return result


def _neighbours(corners: Ints) -> Ints:
    """Triangle (t, 3) beyond the edge opposite to each corner, -1 for none.

    Where more than two share an edge the first has the last as its neighbour and all others the first, as in CalculiX:
    so nodes beyond a border are tied where two ties name the same master.
    """
    count = len(corners)
    edges = np.sort(np.stack([np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1)], axis=2), axis=2)
    _, group = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
    # CalculiX goes by triangles; within one the order of its edges does not matter.
    order = np.argsort(group.ravel(), kind="stable")
    group, triangle = group.ravel()[order], order // 3
    first = np.flatnonzero(np.diff(group, prepend=-1))
    last = np.append(first[1:], len(group)) - 1
    beyond = np.repeat(triangle[first], last - first + 1)
    beyond[first] = np.where(last > first, triangle[last], -1)
    result = np.empty(3 * count, dtype=np.int64)
    result[order] = beyond
    return result.reshape(count, 3)


def _unit(vectors: Floats) -> Floats:
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0))
