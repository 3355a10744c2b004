"""Points on the nearest faces of a surface, with the shape functions there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from morembs.base.types import Floats, Ints
from morembs.fem.elements import FACES
from morembs.importers.tolerances import TOL


@dataclass(frozen=True, eq=False)
class Projection:
    """Of each point its ``distance`` (n,) to the surface and the ``foot`` (n, 3) there; ``nodes`` (n, w) and
    ``weights`` (n, w) of the face, padded by zero weights on its first node."""

    distance: Floats
    foot: Floats
    nodes: Ints
    weights: Floats


def face_size(xyz: Floats, faces: Sequence[tuple[str, Ints]]) -> float:
    """Root of the mean area of plane faces through the corners."""
    areas = []
    for kind, nodes in faces:
        corners = xyz[nodes[:, : 3 if kind.startswith("tri") else 4]]
        legs = (corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        if corners.shape[1] == 4:
            legs = (corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
        areas.append(0.5 * np.linalg.norm(np.cross(*legs), axis=1))
    return float(np.sqrt(np.concatenate(areas).mean()))


def project(points: Floats, xyz: Floats, faces: Sequence[tuple[str, Ints]]) -> Projection:
    """The points (n, 3) on the nearest of ``faces`` (type, rows (nf, k) of ``xyz``).

    Feet are found by Gauss-Newton steps in the coordinates of each face, which are kept within it, and of its edges.
    """
    # Not at the top, where it would cost every command its memory.
    from scipy.spatial import cKDTree

    width = max(nodes.shape[1] for _, nodes in faces)
    best = Projection(
        np.full(len(points), np.inf),
        np.zeros((len(points), 3)),
        np.zeros((len(points), width), dtype=np.int64),
        np.zeros((len(points), width)),
    )
    for kind, nodes in faces:
        tree = cKDTree(xyz[nodes].mean(axis=1))
        tried = min(TOL.tried_faces, len(nodes))
        near = tree.query(points, k=tried)[1].reshape(len(points), tried)
        for candidate in near.T:
            corners = xyz[nodes[candidate]]
            N, foot = on_face(kind, points, corners)
            distance = np.linalg.norm(points - foot, axis=1)
            closer = distance < best.distance
            best.distance[closer], best.foot[closer] = distance[closer], foot[closer]
            best.nodes[closer] = nodes[candidate[closer], :1]
            best.nodes[closer, : nodes.shape[1]] = nodes[candidate[closer]]
            best.weights[closer] = 0.0
            best.weights[closer, : nodes.shape[1]] = N[closer]
    return best


def on_face(kind: str, points: Floats, corners: Floats) -> tuple[Floats, Floats]:
    """Shape functions (n, k) and places (n, 3) of the feet of points on faces with nodes at ``corners`` (n, k, 3)."""
    triangle = kind.startswith("tri")
    s = _descend(kind, points, corners, np.zeros(2), np.eye(2))
    foot = _place(kind, s, corners)
    far = s.sum(axis=1) if triangle else s.max(axis=1)
    border = np.flatnonzero((s.min(axis=1) < TOL.no_shape) | (far > 1 - TOL.no_shape))
    ends = np.array([[0.0, 0], [1, 0], [0, 1]] if triangle else [[0.0, 0], [1, 0], [1, 1], [0, 1]])
    for begin, end in zip(ends, np.roll(ends, -1, axis=0), strict=True):
        # Steps that are cut off at the border end beside the nearest point of it.
        t = _descend(kind, points[border], corners[border], begin, (end - begin)[None])
        place = _place(kind, t, corners[border])
        nearer = _square(points[border] - place) < _square(points[border] - foot[border])
        s[border[nearer]], foot[border[nearer]] = t[nearer], place[nearer]
    N, _ = FACES[kind].shape(s)
    N[np.abs(N) < TOL.no_shape] = 0.0
    N /= N.sum(axis=1, keepdims=True)
    return N, foot


def _descend(kind: str, points: Floats, corners: Floats, origin: Floats, along: Floats) -> Floats:
    """Coordinates (n, 2) of a face, ``origin`` + t ``along`` (m, 2), that are nearest to the points, or at a border.

    On a face m is 2, on one of its edges 1.
    """
    face, triangle = FACES[kind], kind.startswith("tri") and len(along) == 2
    t = np.full((len(points), len(along)), 1 / 3 if triangle else 0.5)
    for _ in range(TOL.foot_steps):
        N, dN = face.shape(origin + t @ along)
        J = np.einsum("nki,nkx,mi->nxm", dN, corners, along)
        gap = points - np.einsum("nk,nkx->nx", N, corners)
        normal = np.einsum("nxi,nxj->nij", J, J)
        size = np.trace(normal, axis1=1, axis2=2)
        normal += TOL.foot_shift * np.maximum(size, np.finfo(float).tiny)[:, None, None] * np.eye(len(along))
        moved = _inside(t + np.linalg.solve(normal, np.einsum("nxi,nx->ni", J, gap)[..., None])[..., 0], triangle)
        done = np.abs(moved - t).max(initial=0.0) < TOL.settled_foot
        t = moved
        if done:
            break
    return np.asarray(origin + t @ along)


def _place(kind: str, s: Floats, corners: Floats) -> Floats:
    return np.asarray(np.einsum("nk,nkx->nx", FACES[kind].shape(s)[0], corners))


def _square(vectors: Floats) -> Floats:
    return np.asarray(np.einsum("nx,nx->n", vectors, vectors))


def _inside(s: Floats, triangle: bool) -> Floats:
    """The nearest coordinates that belong to the face."""
    s = np.clip(s, 0.0, 1.0)
    if triangle:
        over = np.maximum(s.sum(axis=1) - 1.0, 0.0)[:, None]
        s = np.clip(s - 0.5 * over, 0.0, 1.0)
        s /= np.maximum(s.sum(axis=1, keepdims=True), 1.0)
    return s
