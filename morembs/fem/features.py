"""Where other bodies may touch a part whose surfaces have no names: plane faces and round holes, found in its skin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from morembs.base.types import Floats, Ints
from morembs.fem.mesh import Mesh
from morembs.fem.surface import seen_faces
from morembs.fem.tolerances import TOL


@dataclass(frozen=True, eq=False)
class PlaneFace:
    """A plane face: rows (n,) of its nodes, its outward normal (3,) and its area."""

    nodes: Ints
    normal: Floats
    area: float


@dataclass(frozen=True, eq=False)
class Hole:
    """A round hole: rows (n,) of the nodes of its wall, where its axis starts (3,), its unit direction (3,), its length
    and radius."""

    nodes: Ints
    start: Floats
    axis: Floats
    length: float
    radius: float


@dataclass(frozen=True, eq=False)
class Skin:
    """Outer faces of a mesh: rows (f, 9) of their nodes, the four corners first, where a node may stand more than once;
    unit normals (f, 3), areas (f,) and centers (f, 3) of the polygons of corners, and pairs (p, 2) of faces that share
    an edge. All is in the unit of ``xyz`` (n, 3)."""

    xyz: Floats
    nodes: Ints
    normals: Floats
    areas: Floats
    centers: Floats
    pairs: Ints

    @classmethod
    def of(cls, mesh: Mesh) -> Skin:
        """The skin of ``mesh``. Peak memory: some 100 numbers a face."""
        nodes = np.concatenate([_pad(faces) for faces in seen_faces(mesh).values()])
        corners = nodes[:, :4]
        at = mesh.nodes.xyz[corners]
        # Diagonals span twice the area; the fourth corner of a triangle is its first, and the same holds.
        vectors = np.cross(at[:, 2] - at[:, 0], at[:, 3] - at[:, 1]) / 2
        areas = np.linalg.norm(vectors, axis=1)
        edges = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
        owners = np.repeat(np.arange(len(corners)), 4)
        real = edges[:, 0] != edges[:, 1]
        edges, owners = edges[real], owners[real]
        order = np.lexsort((owners, edges[:, 1], edges[:, 0]))
        same = (np.diff(edges[order], axis=0) == 0).all(axis=1)
        pairs = np.column_stack([owners[order[:-1]][same], owners[order[1:]][same]])
        normals = vectors / np.maximum(areas, np.finfo(float).tiny)[:, None]
        return cls(mesh.nodes.xyz, nodes, normals, areas, at.mean(axis=1), pairs)

    def shortest_edge(self) -> float:
        """Length of the shortest edge, collapsed ones left out."""
        at = self.xyz[self.nodes[:, :4]]
        lengths = np.linalg.norm(at - np.roll(at, -1, axis=1), axis=2)
        return float(lengths[lengths > 0].min())

    def groups(self, linked: NDArray[np.bool_]) -> Ints:
        """The number (f,) of the group of each face: pairs that are ``linked`` (p,) are of one group."""
        one, two = self.pairs[linked].T
        graph = sp.csr_array((np.ones(len(one), dtype=bool), (one, two)), shape=(len(self.areas),) * 2)
        return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _pad(faces: Ints) -> Ints:
    """Nodes (f, 9): corners of triangles are four with the first again, as it is again at the end."""
    corners = 3 if faces.shape[1] in (3, 6) else 4
    first = faces[:, [0, 1, 2, 0 if corners == 3 else 3]]
    rest = faces[:, corners:]
    return np.hstack([first, rest, np.repeat(faces[:, :1], 5 - rest.shape[1], axis=1)])


def plane_faces(skin: Skin) -> list[PlaneFace]:
    """Plane faces that are a fair part of the skin, the largest first."""
    turn = np.einsum("pi,pi->p", *skin.normals[skin.pairs.T])
    group = skin.groups(turn > np.cos(TOL.plane_angle))
    areas = np.bincount(group, weights=skin.areas)
    found = []
    for number in np.flatnonzero(areas > TOL.least_face_part * areas.sum()):
        faces = np.flatnonzero(group == number)
        normal = skin.areas[faces] @ skin.normals[faces]
        normal /= np.linalg.norm(normal)
        nodes = np.unique(skin.nodes[faces])
        if np.ptp(skin.xyz[nodes] @ normal) <= TOL.plane_error * np.sqrt(areas[number]):
            found.append(PlaneFace(nodes, normal, float(areas[number])))
    return sorted(found, key=lambda face: (-significant(face.area), face.nodes[0]))


def round_holes(skin: Skin) -> list[Hole]:
    """Round holes, the widest first: walls on a circular cylinder, all around it.

    A wall ends at sharp edges. Where its rim is rounded it ends at convex ones; a wall of irregular triangles has such
    edges too, and is looked for first.
    """
    one, two = skin.pairs.T
    smooth = np.einsum("pi,pi->p", skin.normals[one], skin.normals[two]) > np.cos(TOL.wall_angle)
    step = skin.centers[two] - skin.centers[one]
    rise = np.einsum("pi,pi->p", step, skin.normals[one] - skin.normals[two])
    concave = rise >= -TOL.flat_rise * np.linalg.norm(step, axis=1)
    found: list[Hole] = []
    free = np.ones(len(skin.areas), dtype=bool)
    for linked in (smooth, smooth & concave):
        group = skin.groups(linked)
        for number in np.flatnonzero(np.bincount(group) >= TOL.least_wall_faces):
            faces = np.flatnonzero(group == number)
            hole = _hole(skin, faces) if free[faces].all() else None
            if hole is not None:
                found.append(hole)
                free[faces] = False
    return sorted(found, key=lambda hole: (-significant(hole.radius), hole.nodes[0]))


def significant(value: float) -> float:
    """``value`` to six digits, so that round-off sorts nothing."""
    return float(f"{value:.6g}")


def _hole(skin: Skin, faces: Ints) -> Hole | None:
    """The hole that ``faces`` are the wall of; None where they are not on a cylinder, or do not go around it."""
    normals = skin.normals[faces]
    parts, axes = np.linalg.eigh((normals.T * skin.areas[faces]) @ normals)
    points = skin.xyz[np.unique(skin.nodes[faces, :4])]
    if parts[1] <= TOL.plane_angle**2 * parts[2]:
        return None  # they are plane
    axis, center, radius, error = _cylinder(points, axes[:, 0])
    out = skin.centers[faces] - center
    inwards = np.einsum("fi,fi->f", out - np.outer(out @ axis, axis), normals) < 0
    if error > TOL.wall_error * radius or not inwards.all():
        return None
    across, other = _basis(axis)
    angles = np.sort(np.arctan2((points - center) @ other, (points - center) @ across))
    if np.diff(angles, append=angles[0] + 2 * np.pi).max() > TOL.wall_gap:
        return None
    along = (points - center) @ axis
    return Hole(np.unique(skin.nodes[faces]), center + along.min() * axis + 0.0, axis, float(np.ptp(along)), radius)


def _cylinder(points: Floats, axis: Floats) -> tuple[Floats, Floats, float, float]:
    """The cylinder of least squared distance from ``points`` (n, 3): its axis (3,), a point on it (3,), its radius, and
    the largest distance.

    Gauss and Newton's method from the circle of least algebraic distance (Kasa 1976) across the first ``axis``, the
    direction that normals have least of (Chaperon and Goulette 2001).
    """
    middle = points.mean(axis=0)
    away = points - middle
    across, other = _basis(axis)
    flat = away @ np.column_stack([across, other])
    shift = np.linalg.lstsq(np.column_stack([2 * flat, np.ones(len(flat))]), (flat**2).sum(axis=1), rcond=None)[0]
    center = shift[0] * across + shift[1] * other
    for _ in range(TOL.cylinder_steps):
        across, other = _basis(axis)
        out = away - center
        along = out @ axis
        radial = out - np.outer(along, axis)
        distance = np.linalg.norm(radial, axis=1)
        unit = radial / np.maximum(distance, np.finfo(float).tiny)[:, None]
        a, b = unit @ across, unit @ other
        radius = float(distance.mean())
        slopes = np.column_stack([a, b, along * a, along * b, np.ones(len(a))])
        du, dv, tu, tv, _ = np.linalg.lstsq(slopes, distance - radius, rcond=None)[0]
        center = center + du * across + dv * other
        axis = axis + tu * across + tv * other
        axis /= np.linalg.norm(axis)
    out = away - center
    distance = np.linalg.norm(out - np.outer(out @ axis, axis), axis=1)
    radius = float(distance.mean())
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))]) + 0.0
    return axis, middle + center, radius, float(np.abs(distance - radius).max())


def _basis(axis: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors across ``axis``."""
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    return across, np.cross(axis, across)
