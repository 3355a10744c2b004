"""Blocks of solid elements and their matrices, by textbook quadrature: nothing of the package is used."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache

import numpy as np

from morembs.base.types import Floats, Ints

KINDS = ("hex8", "tet4", "wedge6", "tet10")
_CUBE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
# Faces by corners; the middles of a tet10 follow from the edges.
_FACES = {
    "hex8": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    "tet4": ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
    "wedge6": ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "tet10": ((0, 2, 1, 6, 5, 4), (0, 1, 3, 4, 8, 7), (1, 2, 3, 5, 9, 8), (0, 3, 2, 7, 9, 6)),
}


@dataclass(frozen=True, kw_only=True)
class Solid:
    """Elements ``cells`` (ne, k) of one ``kind`` on nodes ``xyz`` (n, 3), in m; nodes are labelled from 1."""

    kind: str
    xyz: Floats
    cells: Ints
    young: float
    poisson: float
    density: float

    def matrices(self, young: Floats | None = None, density: Floats | None = None) -> tuple[Floats, Floats]:
        """K and M (N, N); moduli and densities (ne,) of the elements in place of the material's."""
        K, M = np.zeros((2, self.xyz.size, self.xyz.size))
        stiffness, mass = _elements(self.kind, self.xyz[self.cells], self.poisson)
        for e, cell in enumerate(self.cells):
            at = (3 * cell[:, None] + np.arange(3)).ravel()
            K[np.ix_(at, at)] += (self.young if young is None else young[e]) * stiffness[e]
            M[np.ix_(at, at)] += (self.density if density is None else density[e]) * mass[e]
        return K, M

    def weights(self, rows: Ints) -> Floats:
        """int N dA (ns,) over the whole outer faces between the nodes ``rows``; ones where there are none."""
        faces = [cell[list(face)] for cell in self.cells for face in _FACES[self.kind]]
        keys = [tuple(sorted(face.tolist())) for face in faces]
        areas = np.zeros(len(self.xyz))
        for face, key in zip(faces, keys, strict=True):
            if keys.count(key) == 1 and np.isin(face, rows).all():
                areas[face] += _face_areas(self.xyz[face])
        return areas[rows] if areas[rows].sum() > 0 else np.ones(len(rows))


def block(kind: str, cells: tuple[int, int, int], size: Floats, taper: float = 0.0) -> tuple[Floats, Ints]:
    """Nodes (n, 3) in m and elements of a block of ``cells``; ``taper``: by how much the far end is smaller."""
    pieces = []
    for corner in np.ndindex(*cells):
        cube = _CUBE + np.array(corner)
        if kind == "hex8":
            pieces.append(cube.astype(float))
        elif kind == "wedge6":
            pieces += [cube[[0, 1, 2, 4, 5, 6]].astype(float), cube[[0, 2, 3, 4, 6, 7]].astype(float)]
        else:
            pieces += [_tetrahedron(kind, np.array(corner), order) for order in itertools.permutations(range(3))]
    points = np.array(pieces)
    flat, inverse = np.unique(np.round(2 * points.reshape(-1, 3)).astype(int), axis=0, return_inverse=True)
    xyz = flat / (2 * np.array(cells))
    xyz[:, 1:] = (xyz[:, 1:] - 0.5) * (1 - taper * xyz[:, :1])
    elements = np.asarray(inverse, dtype=np.int64).reshape(points.shape[:2])
    # Of files in mm, and of those in m: no more digits than text has, and edges that stay straight.
    xyz = np.round(xyz * size * 1e3, 5)
    for k, (a, b) in enumerate(_EDGES if kind == "tet10" else ()):
        xyz[elements[:, 4 + k]] = (xyz[elements[:, a]] + xyz[elements[:, b]]) / 2
    return xyz * 1e-3, elements


def _tetrahedron(kind: str, corner: Ints, order: tuple[int, ...]) -> Floats:
    x = corner + np.vstack([np.zeros(3), np.cumsum(np.eye(3)[list(order)], axis=0)])
    if np.linalg.det(x[1:] - x[0]) < 0:
        x = x[[0, 2, 1, 3]]
    return np.vstack([x, [(x[a] + x[b]) / 2 for a, b in _EDGES]]) if kind == "tet10" else x


def _elements(kind: str, x: Floats, poisson: float) -> tuple[Floats, Floats]:
    """K and M (ne, 3 k, 3 k) of elements with nodes ``x`` (ne, k, 3) for unit modulus and density."""
    C = np.diag([1 - 2 * poisson] * 3 + [(1 - 2 * poisson) / 2] * 3)
    C[:3, :3] += poisson
    C /= (1 + poisson) * (1 - 2 * poisson)
    least, matrices = 1 if kind == "tet4" else 2, []
    for points, is_mass in ((least, False), (least + 1, True)):
        weights, N, dN = _shapes(kind, points)
        J = np.einsum("qki,ekj->eqij", dN, x)
        size = weights * np.linalg.det(J)
        if is_mass:
            pairs = np.einsum("eq,qi,qj->eij", size, N, N)
            A = np.einsum("eij,ab->eiajb", pairs, np.eye(3)).reshape(len(x), 3 * x.shape[1], -1)
        else:
            B = _strain(np.einsum("qki,eqji->eqkj", dN, np.linalg.inv(J)))
            A = np.einsum("eq,eqai,ab,eqbj->eij", size, B, C, B, optimize=True)
        matrices.append((A + A.transpose(0, 2, 1)) / 2)
    return matrices[0], matrices[1]


@cache
def _shapes(kind: str, n: int) -> tuple[Floats, Floats, Floats]:
    """Weights (q,), shape functions (q, k) and their derivatives (q, k, 3) of a rule."""
    points, weights = _rule(kind, n)
    each = [_shape(kind, point) for point in points]
    return weights, np.array([N for N, _ in each]), np.array([dN for _, dN in each])


def _strain(g: Floats) -> Floats:
    """(..., 6, 3 k) of the gradients (..., k, 3)."""
    B = np.zeros((*g.shape[:-2], 6, 3 * g.shape[-2]))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        B[..., i, i::3] = g[..., i]
        B[..., 3 + i, j::3], B[..., 3 + i, k::3] = g[..., k], g[..., j]
    return B


def _rule(kind: str, n: int) -> tuple[Floats, Floats]:
    """Points (q, 3) and weights (q,): Gauss, on simplices collapsed with a point more."""
    x, w = np.polynomial.legendre.leggauss(n)
    if kind == "hex8":
        grid = np.array(list(itertools.product(x, x, x)))
        return grid, np.array([a * b * c for a, b, c in itertools.product(w, w, w)])
    # Collapsed squares and cubes lose a degree for each collapse.
    u, v = np.polynomial.legendre.leggauss(n + 1)
    u, v = (u + 1) / 2, v / 2
    if kind == "wedge6":
        triangle = [
            (a, b * (1 - a), p * q * (1 - a)) for (a, p), (b, q) in itertools.product(zip(u, v, strict=True), repeat=2)
        ]
        points = [(r, s, t) for (r, s, _), t in itertools.product(triangle, x)]
        return np.array(points), np.array([p * q for (_, _, p), q in itertools.product(triangle, w)])
    points, weights = [], []
    for (a, p), (b, q), (c, r) in itertools.product(zip(u, v, strict=True), repeat=3):
        points.append((a, b * (1 - a), c * (1 - a) * (1 - b)))
        weights.append(p * q * r * (1 - a) ** 2 * (1 - b))
    return np.array(points), np.array(weights)


def _shape(kind: str, p: Floats) -> tuple[Floats, Floats]:
    """Shape functions (k,) and their derivatives (k, 3) at ``p``."""
    if kind == "hex8":
        signs = 2.0 * _CUBE - 1
        f = 1 + signs * p
        return f.prod(axis=1) / 8, np.stack(
            [signs[:, i] * f[:, (i + 1) % 3] * f[:, (i + 2) % 3] for i in range(3)], 1
        ) / 8
    r, s, t = p
    if kind == "wedge6":
        L, dL = np.array([1 - r - s, r, s]), np.array([[-1.0, -1], [1, 0], [0, 1]])
        h, dh = np.array([(1 - t) / 2, (1 + t) / 2]), np.array([-0.5, 0.5])
        N = np.outer(h, L).ravel()
        return N, np.hstack([np.vstack([h[0] * dL, h[1] * dL]), np.outer(dh, L).ravel()[:, None]])
    L, dL = np.array([1 - r - s - t, r, s, t]), np.vstack([-np.ones(3), np.eye(3)])
    if kind == "tet4":
        return L, dL
    N = np.concatenate([L * (2 * L - 1), [4 * L[a] * L[b] for a, b in _EDGES]])
    return N, np.vstack([(4 * L - 1)[:, None] * dL, [4 * (L[a] * dL[b] + L[b] * dL[a]) for a, b in _EDGES]])


def _face_areas(x: Floats) -> Floats:
    """int N dA (k,) of a plane face of 3, 4 or 6 nodes."""
    if len(x) == 4:
        u, v = np.polynomial.legendre.leggauss(2)
        total = np.zeros(4)
        signs = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
        for (a, p), (b, q) in itertools.product(zip(u, v, strict=True), repeat=2):
            f = 1 + signs * (a, b)
            dN = np.stack([signs[:, 0] * f[:, 1], signs[:, 1] * f[:, 0]], 1) / 4
            total += p * q * f.prod(axis=1) / 4 * np.linalg.norm(np.cross(*(dN.T @ x)))
        return total
    area = np.linalg.norm(np.cross(x[1] - x[0], x[2] - x[0])) / 2
    # Of quadratic triangles the corners carry nothing.
    return area / 3 * (np.ones(3) if len(x) == 3 else np.array([0, 0, 0, 1, 1, 1.0]))
