"""Structured meshes of every element type, mapped to any shape."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from morembs.fem import ElementBlock, FEModel, Mesh, Nodes
from morembs.fem.assembly import assemble, chunks
from morembs.fem.elements import TYPES
from morembs.fem.interface import Interface, make_interface
from morembs.fem.material import isotropic

STEEL = {"young": 2.1e11, "poisson": 0.3, "density": 7850.0}
_HEX = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], dtype=float)


def _pieces(kind: str) -> list[np.ndarray]:
    """Corner points of the elements that fill a unit cell."""
    if kind.startswith("hex"):
        return [_HEX]
    if kind.startswith("wedge"):
        return [_HEX[[0, 1, 2, 4, 5, 6]], _HEX[[0, 2, 3, 4, 6, 7]]]
    tets = []
    for order in itertools.permutations(range(3)):
        corners = np.vstack([np.zeros(3), np.cumsum(np.eye(3)[list(order)], axis=0)])
        flip = np.linalg.det(corners[1:] - corners[0]) < 0
        tets.append(corners[[0, 2, 1, 3]] if flip else corners)
    return tets


def points_and_cells(kind: str, cells: Sequence[Sequence[int]]) -> np.ndarray:
    """Node positions (ne, k, 3) of the elements that fill the given unit cells."""
    linear = TYPES[{"h": "hex8", "w": "wedge6", "t": "tet4"}[kind[0]]]
    N, _ = linear.shape(TYPES[kind].reference)
    shapes = [N @ corners for corners in _pieces(kind)]
    return np.array([np.asarray(cell) + shape for cell in cells for shape in shapes])


def merged(kind: str, xyz: np.ndarray, digits: int = 9) -> Mesh:
    """Mesh of elements with node positions (ne, k, 3); coincident nodes become one."""
    flat = xyz.reshape(-1, 3)
    size = np.abs(flat).max()
    _, first, inverse = np.unique(np.round(flat / size, digits) + 0.0, axis=0, return_index=True, return_inverse=True)
    block = ElementBlock(type=kind, nodes=inverse.reshape(xyz.shape[:2]), ids=np.arange(1, len(xyz) + 1))
    return Mesh(nodes=Nodes(ids=np.arange(1, len(first) + 1), xyz=flat[first]), blocks=(block,))


def box(
    kind: str, n: Sequence[int], size: Sequence[float], warp: Callable[[np.ndarray], np.ndarray] | None = None
) -> Mesh:
    """Box [0, size] of n[0] x n[1] x n[2] cells."""
    cells = list(itertools.product(*(range(k) for k in n)))
    xyz = points_and_cells(kind, cells) / np.asarray(n) * np.asarray(size)
    return merged(kind, xyz if warp is None else warp(xyz))


def heavy() -> tuple[Mesh, Mesh]:
    """A mesh of so many large elements that they are integrated in more than one piece; and again as two blocks, each
    of which is one piece."""
    mesh = box("hex27", (5, 6, 6), (0.5, 0.6, 0.6))
    assert len(list(chunks(mesh))) == 2
    (block,) = mesh.blocks
    halves = (slice(0, 90), slice(90, None))
    return mesh, replace(mesh, blocks=tuple(replace(block, ids=block.ids[k], nodes=block.nodes[k]) for k in halves))


def ball(kind: str, n: int, radius: float) -> Mesh:
    """Solid sphere: an inner cube and six blocks around it, each of n^3 cells."""
    cells = list(itertools.product(range(n), repeat=3))
    unit = points_and_cells(kind, cells) / n
    inner = 0.45
    core = (2 * unit - 1) * inner
    parts = [_bulged(core, inner)]
    for axis, side in itertools.product(range(3), (1.0, -1.0)):
        u, v, w = (2 * unit[..., 0] - 1), (2 * unit[..., 1] - 1), unit[..., 2]
        face = np.empty_like(unit)
        a, b = (axis + 1) % 3, (axis + 2) % 3
        if side < 0:
            a, b = b, a
        face[..., axis], face[..., a], face[..., b] = side, u, v
        start = _bulged(face * inner, inner)
        # Equal angles on the sphere give even elements.
        angled = face.copy()
        angled[..., a], angled[..., b] = np.tan(u * np.pi / 4), np.tan(v * np.pi / 4)
        end = angled / np.linalg.norm(angled, axis=-1, keepdims=True)
        parts.append(start * (1 - w[..., None]) + end * w[..., None])
    return merged(kind, radius * np.concatenate(parts))


def _bulged(p: np.ndarray, inner: float) -> np.ndarray:
    """The inner cube, blown up a little towards a ball."""
    r = np.linalg.norm(p, axis=-1, keepdims=True) / inner
    edge = np.abs(p).max(axis=-1, keepdims=True) / inner
    round_ = np.where(r > 0, edge / np.where(r > 0, r, 1.0), 1.0)
    return p * (0.6 + 0.4 * round_) * 1.2


def steel(mesh: Mesh, **change: float) -> FEModel:
    """The mesh made of steel (SI)."""
    return assemble(mesh, [isotropic(set="all", **{**STEEL, **change})])


def fully_integrated(mesh: Mesh) -> Mesh:
    """The mesh without the formulations that the program of its file has: full integration, consistent mass."""
    return replace(mesh, blocks=tuple(replace(block, formulation="full", mass="exact") for block in mesh.blocks))


def where(model: FEModel, axis: int, value: float) -> np.ndarray:
    """Rows of nodes on a coordinate plane."""
    span = np.ptp(model.nodes.xyz, axis=0).max()
    return np.flatnonzero(np.abs(model.nodes.xyz[:, axis] - value) < 1e-9 * span)


def beam(n: Sequence[int] = (8, 2, 2), kind: str = "hex8") -> FEModel:
    """A steel beam, 0.5 m long, 50 mm wide and 30 mm high."""
    return steel(box(kind, n, (0.5, 0.05, 0.03)))


def ends(model: FEModel, coupling: str = "average", **places: float) -> list[Interface]:
    """Interfaces on planes across x, name -> place; by default on the ends of a beam of 0.5 m."""
    places = places or {"left": 0.0, "right": 0.5}
    return [make_interface(model, name=name, nodes=where(model, 0, x), coupling=coupling) for name, x in places.items()]
