"""A surface of triangles with a continuous normal: a quartic patch of Gregory's kind on each (Walton and Meek 1996).

Edges are cubic curves from the points and normals at their ends. On each edge both patches have the tangent plane
spanned by the edge and a common field of cross directions, so the normal does not jump.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.dynamics.multibody.contact.curves import checked_points
from morembs.dynamics.multibody.contact.surfaces import ClosestPoint, NodalSurface, foot_at
from morembs.dynamics.multibody.contact.tolerances import TOL
from morembs.dynamics.multibody.rotations import cross

# Exponents of the Bernstein polynomials of degree four that are on the border, and those inside.
_BORDER = tuple((i, j, 4 - i - j) for i in range(5) for j in range(5 - i) if not (i and j and 4 - i - j))
_INNER = tuple((i, j, 4 - i - j) for i in (2, 1) for j in range(3 - i, 0, -1))
_COUNT = {(4, 0): 1.0, (3, 1): 4.0, (2, 2): 6.0, (2, 1): 12.0}


def _bernstein(power: tuple[int, int, int], b: Floats) -> tuple[float, Floats]:
    """A Bernstein polynomial of degree four at barycentric b (3,), and its derivatives (3,)."""
    high = sorted(power, reverse=True)
    count = _COUNT[high[0], high[1]]
    parts = [float(x) ** p for x, p in zip(b, power, strict=True)]
    slopes = [p * float(x) ** (p - 1) if p else 0.0 for x, p in zip(b, power, strict=True)]
    x, y, z = parts
    return count * x * y * z, count * np.array([slopes[0] * y * z, x * slopes[1] * z, x * y * slopes[2]])


def _edge(a: Floats, b: Floats, normal_a: Floats, normal_b: Floats) -> Floats:
    """Cubic control points (4, 3): tangents at right angles to the normals, as long as those of an arc."""
    d = b - a
    length = float(np.linalg.norm(d))
    inner = []
    for normal in (normal_a, normal_b):
        t = d - (d @ normal) * normal
        size = float(np.linalg.norm(t))
        inner.append(t / size * (2 / 3) * length / (1 + size / length))
    return np.array([a, a + inner[0], b - inner[1], b])


def _elevate_degree(V: Floats) -> Floats:
    """The same cubic as five control points of degree four."""
    return np.array([V[0], (V[0] + 3 * V[1]) / 4, (V[1] + V[2]) / 2, (3 * V[2] + V[3]) / 4, V[3]])


def _inside(V: Floats, normal_a: Floats, normal_b: Floats, first: Floats, last: Floats) -> tuple[Floats, Floats]:
    """The two control points next to an edge, from those (first, last) next to its ends on the other edges."""
    W, E = np.diff(V, axis=0), _elevate_degree(V)
    A0 = cross(normal_a, W[0]) / np.linalg.norm(W[0])
    A2 = cross(normal_b, W[2]) / np.linalg.norm(W[2])
    A1 = (A0 + A2) / np.linalg.norm(A0 + A2)
    C0, C3 = first - E[0], last - E[3]
    k0, k1 = C0 @ W[0] / (W[0] @ W[0]), C3 @ W[2] / (W[2] @ W[2])
    m0, m1 = C0 @ A0, C3 @ A2
    C1 = (2 * k0 * W[1] + k1 * W[0] + 2 * m0 * A1 + m1 * A0) / 3
    C2 = (k0 * W[2] + 2 * k1 * W[1] + m0 * A2 + 2 * m1 * A1) / 3
    return E[1] + C1, E[2] + C2


@dataclass(frozen=True, eq=False)
class _Patch:
    """Control points of one triangle: ``border`` (12, 3) and two choices for each inner one, ``inner`` (3, 3, 3)."""

    border: Floats
    # inner[k, e]: near corner k, for the edge opposite to corner e.
    inner: Floats

    def at(self, b: Floats) -> tuple[Floats, Floats]:
        """Point (3,) and derivatives (3, 3) by the barycentric coordinates b (3,)."""
        point, slope = np.zeros(3), np.zeros((3, 3))
        for power, control in zip(_BORDER, self.border, strict=True):
            value, rates = _bernstein(power, b)
            point += value * control
            slope += np.outer(rates, control)
        for k, power in enumerate(_INNER):
            i, j = (k + 1) % 3, (k + 2) % 3
            # On the edge where b[j] = 0 the choice for that edge counts alone.
            total = b[i] + b[j]
            if abs(total) < TOL.at_corner:
                continue
            control = (b[i] * self.inner[k, j] + b[j] * self.inner[k, i]) / total
            value, rates = _bernstein(power, b)
            point += value * control
            slope += np.outer(rates, control)
            slope[i] += value * (self.inner[k, j] - control) / total
            slope[j] += value * (self.inner[k, i] - control) / total
        return point, slope


def _patch(points: Floats, normals: Floats) -> _Patch:
    """The patch of one triangle from its corners (3, 3) and their normals (3, 3)."""
    edges = {(a, b): _edge(points[a], points[b], normals[a], normals[b]) for a in range(3) for b in range(3) if a != b}
    quartic = {key: _elevate_degree(V) for key, V in edges.items()}
    border = []
    for power in _BORDER:
        corners = [k for k in range(3) if power[k]]
        a, b = (corners[0], corners[-1]) if len(corners) > 1 else (corners[0], (corners[0] + 1) % 3)
        border.append(quartic[a, b][power[b]])
    inner = np.zeros((3, 3, 3))
    for c in range(3):
        a, b = (c + 1) % 3, (c + 2) % 3
        near_a, near_b = _inside(edges[a, b], normals[a], normals[b], quartic[a, c][1], quartic[b, c][1])
        inner[a, c], inner[b, c] = near_a, near_b
    return _Patch(np.array(border), inner)


@checked
@dataclass(frozen=True, eq=False)
class TriangleSurface(NodalSurface):
    """Surface of ``triangles`` (t, 3) on ``vertices`` (n, 3), counterclockwise seen from outside.

    ``normals`` (n, 3) at vertices, the mean of the triangles weighted by their angles unless given. Displacements
    of vertices are interpolated linearly on each triangle: under them the normal jumps at edges by the change of
    slope between triangles, which is small where displacements are; a GridSurface keeps it continuous.

    Raises:
        InputError: triangles without area, with unknown vertices, turned against their neighbours, edges with more
            than two triangles, normals that point away from their triangles.
    """

    vertices: ArrayLike
    triangles: ArrayLike
    normals: ArrayLike | None = None
    _: KW_ONLY
    name: str = "surface"
    shift: Floats | None = field(default=None, repr=False)
    neighbours: Ints = field(init=False, repr=False)

    def __post_init__(self) -> None:
        points = checked_points(f"surface {self.name!r}", self.vertices, 2)
        triangles = np.array(self.triangles)
        if triangles.ndim != 2 or triangles.shape[1] != 3 or not np.issubdtype(triangles.dtype, np.integer):
            raise InputError(
                f"surface {self.name!r}: triangles of shape {triangles.shape} were given; expected (t, 3)",
                keyword="triangles",
            )
        if triangles.min(initial=0) < 0 or triangles.max(initial=-1) >= len(points):
            raise InputError(
                f"surface {self.name!r}: triangles name vertices that are not among the {len(points)}",
                kind="unknown",
                keyword="triangles",
            )
        across = self._check(points, triangles)
        neighbours = self._neighbours(triangles)
        normals = _mean_normals(points, triangles, across) if self.normals is None else np.array(self.normals, float)
        normals = self._check_normals(points, normals, triangles, across)
        patches = [_patch(points[t], normals[t]) for t in triangles]
        tree = cKDTree(points[triangles].mean(axis=1))
        values = {
            "points": points,
            "vertices": points,
            "triangles": triangles,
            "normals": normals,
            "_patches": patches,
            "neighbours": neighbours,
            "_tree": tree,
        }
        for key, value in values.items():
            object.__setattr__(self, key, value)

    def _check(self, points: Floats, triangles: Ints) -> Floats:
        """Directions (t, 3) at right angles to the triangles."""
        a, b, c = (points[triangles[:, k]] for k in range(3))
        across = np.cross(b - a, c - a)
        area = np.linalg.norm(across, axis=1)
        sides = np.max([np.linalg.norm(s, axis=1) for s in (b - a, c - b, a - c)], axis=0)
        bad = np.flatnonzero(area <= TOL.flat_triangle * sides**2)
        if len(bad):
            k = int(bad[0])
            raise InputError(
                f"surface {self.name!r}: {len(bad)} degenerate triangles, the first is number {k} with vertices "
                f"{triangles[k].tolist()} at {np.array2string(a[k], precision=6)} m; expected three points that are "
                "not on one line. Merge its points, or leave the triangle out",
                kind="model",
                keyword="triangles",
            )
        return np.asarray(across / area[:, None])

    def _neighbours(self, triangles: Ints) -> Ints:
        """(t, 3): the triangle over the edge opposite to each corner, -1 at a border."""
        of_edge: dict[tuple[int, int], tuple[int, int]] = {}
        for t, corners in enumerate(triangles.tolist()):
            for k in range(3):
                edge = corners[(k + 1) % 3], corners[(k + 2) % 3]
                if edge in of_edge:
                    raise InputError(
                        f"surface {self.name!r}: triangles {of_edge[edge][0]} and {t} run along the edge {edge} in the "
                        "same sense; expected all triangles turned alike, and two at an edge at most",
                        kind="model",
                        keyword="triangles",
                    )
                of_edge[edge] = t, k
        result = np.full((len(triangles), 3), -1)
        for (a, b), (t, k) in of_edge.items():
            result[t, k] = of_edge.get((b, a), (-1, 0))[0]
        return result

    def _check_normals(self, points: Floats, normals: Floats, triangles: Ints, across: Floats) -> Floats:
        if normals.shape != points.shape or not np.isfinite(normals).all():
            raise InputError(f"surface {self.name!r}: normals {normals.shape} were given; expected {points.shape}")
        used = np.unique(triangles)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        if (length[used] == 0).any():
            raise InputError(f"surface {self.name!r}: some normals have no length; expected a direction per vertex")
        normals = normals / np.where(length > 0, length, 1.0)
        turned = np.argwhere(np.einsum("tkx,tx->tk", normals[triangles], across) <= TOL.same_side)
        if len(turned):
            t, k = turned[0].tolist()
            raise InputError(
                f"surface {self.name!r}: the normal at vertex {triangles[t, k]} is along triangle {t} or away from it; "
                "expected a smooth surface. Split it at sharp edges, or refine it"
            )
        return normals

    def at(self, triangle: int, b: Floats) -> tuple[Floats, Floats]:
        """Point (3,) and derivatives (3, 3) by the barycentric coordinates b (3,) of a triangle."""
        point, slope = self._patches[triangle].at(b)  # type: ignore[attr-defined]
        if self.shift is not None:
            moved = self.shift[np.asarray(self.triangles)[triangle]]
            point, slope = point + b @ moved, slope + moved
        return point, slope

    def normal(self, triangle: int, b: Floats) -> Floats:
        """Unit normal (3,)."""
        _, slope = self.at(triangle, b)
        across = cross(slope[1] - slope[0], slope[2] - slope[0])
        return np.asarray(across / np.linalg.norm(across))

    def nearest(self, point: Floats) -> ClosestPoint:
        visited: set[int] = set()
        triangle = int(self._tree.query(point)[1])  # type: ignore[attr-defined]
        best: tuple[float, int, Floats] | None = None
        for _ in range(TOL.patches_visited):
            visited.add(triangle)
            b, distance = self._foot(triangle, point)
            if best is None or distance < best[0]:
                best = distance, triangle, b
            around = self.neighbours[triangle]
            over = [
                int(around[k])
                for k in range(3)
                if b[k] <= TOL.on_edge and around[k] >= 0 and int(around[k]) not in visited
            ]
            if not over:
                break
            triangle = over[0]
        if best is None:
            raise InputError(f"surface {self.name!r} has no triangles")
        _, triangle, b = best
        corners = np.asarray(self.triangles)[triangle]
        return foot_at(point, self.at(triangle, b)[0], self.normal(triangle, b), corners, b)

    def _foot(self, triangle: int, target: Floats) -> tuple[Floats, float]:
        """Barycentric coordinates of the nearest point of one patch, and its distance."""
        b, last = np.full(3, 1 / 3), np.inf
        for _ in range(TOL.foot_iterations):
            point, slope = self.at(triangle, b)
            miss = target - point
            distance = float(np.linalg.norm(miss))
            J = slope[:2] - slope[2]
            step = np.linalg.solve(J @ J.T, J @ miss)
            moved = _in_triangle(b + np.array([step[0], step[1], -step[0] - step[1]]), J)
            change = float(np.abs(moved - b).max())
            if change < TOL.foot_change or distance > last * (1 + TOL.patch_distance_growth):
                break
            b, last = moved, distance
        return b, float(np.linalg.norm(target - self.at(triangle, b)[0]))

    def displace(self, displacements: Floats) -> TriangleSurface:
        moved = object.__new__(TriangleSurface)
        moved.__dict__.update(self.__dict__)
        moved.__dict__["shift"] = displacements
        return moved


def _in_triangle(b: Floats, J: Floats) -> Floats:
    """The nearest barycentric coordinates in the triangle, in the metric of its tangents J (2, 3)."""
    if b.min() >= 0:
        return b
    corners = np.vstack((J, np.zeros(3)))
    target, best, nearest = b @ corners, np.inf, b
    for i, k in ((0, 1), (1, 2), (2, 0)):
        d = corners[k] - corners[i]
        s = min(max(float((target - corners[i]) @ d / (d @ d)), 0.0), 1.0)
        away = float(np.linalg.norm(corners[i] + s * d - target))
        if away < best:
            best, nearest = away, np.zeros(3)
            nearest[i], nearest[k] = 1 - s, s
    return nearest


def _mean_normals(points: Floats, triangles: Ints, across: Floats) -> Floats:
    normals = np.zeros_like(points)
    for k in range(3):
        a, b, c = (points[triangles[:, (k + j) % 3]] for j in range(3))
        u, v = b - a, c - a
        cosine = np.einsum("tx,tx->t", u, v) / (np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1))
        np.add.at(normals, triangles[:, k], np.arccos(np.clip(cosine, -1, 1))[:, None] * across)
    return normals
