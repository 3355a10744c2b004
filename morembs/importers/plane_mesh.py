"""Meshes of plane elements with a thickness, as one layer of quadratic solids.

A layer of solids whose faces are free is in plane stress as far as it is thin; it needs no plane elements of its own.
Linear elements get nodes in the middle of their edges, since linear solids are too stiff in bending.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.base.units import Units
from morembs.fem import ElementBlock, Mesh, Nodes
from morembs.importers.meshes import read_with_meshio
from morembs.importers.tolerances import TOL

# Plane elements of meshio -> number of corners and of nodes that are taken.
_PLANE = {"tri3": (3, 3), "tri6": (3, 6), "quad4": (4, 4), "quad8": (4, 8), "quad9": (4, 8)}
_NAMES = {"triangle": "tri3", "triangle6": "tri6", "quad": "quad4", "quad8": "quad8", "quad9": "quad9"}
_SOLID = {3: "wedge15", 4: "hex20"}


def read_plane_mesh(path: str | Path, thickness: float, units: Units | None = None) -> Mesh:
    """The solids of a mesh of plane elements, with its named sets; the middle plane is z = 0.

    Args:
        thickness: m.
        units: of the file; m-kg-s unless given.

    Raises:
        InputError: the file is missing, cannot be read, has no plane elements or others, or is not plane.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"mesh file {str(path)!r} does not exist; check the path", kind="file")
    flat = read_with_meshio(path, _NAMES)
    if not flat.blocks:
        raise InputError(
            f"{path.name} has no plane elements, which a thickness belongs to; expected {', '.join(_PLANE)}, or a "
            "mesh of solids without thickness",
            kind="missing",
            keyword="elements",
        )
    xyz = flat.nodes.xyz * (units or Units()).length
    deep, wide = float(np.ptp(xyz[:, 2])), float(np.ptp(xyz, axis=0).max())
    if deep > TOL.out_of_plane * wide:
        raise InputError(
            f"{path.name} extends by {deep:.3g} m along z and {wide:.3g} m at most; expected a mesh in a plane of "
            "constant z",
            kind="unsupported",
            keyword="mesh",
        )
    places, blocks, sets = xyz[:, :2], list[tuple[Ints, ElementBlock]](), dict(flat.nodes.sets)
    if len({_PLANE[block.type][1] > 4 for block in flat.blocks}) > 1:
        raise InputError(
            f"{path.name} has linear and quadratic elements, which do not fit; write it in one order",
            kind="unsupported",
            keyword="mesh",
        )
    for block in flat.blocks:
        corners, taken = _PLANE[block.type]
        if block.nodes.shape[1] < taken:
            raise InputError(
                f"{path.name} has damaged cells of the type {block.type}; write it again",
                kind="file",
                keyword=path.name,
            )
        nodes = _counter_clockwise(block.nodes[:, :taken], corners, places)
        blocks.append((nodes, block))
    quadratic, places, sets = _with_middles(blocks, places, sets)
    # Nodes in the middle of elements with nine are left out.
    used = np.unique(np.concatenate([nodes.ravel() for nodes, _ in quadratic]))
    row = np.full(len(places), -1, dtype=np.int64)
    row[used] = np.arange(len(used))
    sets = {name: row[members][row[members] >= 0] for name, members in sets.items()}
    return _layer(flat, [(row[nodes], block) for nodes, block in quadratic], places[used], sets, thickness)


def _counter_clockwise(nodes: Ints, corners: int, places: Floats) -> Ints:
    """Elements (ne, k) whose corners turn from x to y, middle nodes behind them."""
    x = places[nodes[:, :corners]]
    ahead = np.roll(x, -1, axis=1)
    turned = (x[..., 0] * ahead[..., 1] - x[..., 1] * ahead[..., 0]).sum(axis=1) < 0
    order = np.arange(nodes.shape[1])
    order[1:corners] = order[1:corners][::-1]
    order[corners:] = order[corners:][::-1]
    return np.where(turned[:, None], nodes[:, order], nodes)


def _with_middles(
    blocks: list[tuple[Ints, ElementBlock]], places: Floats, sets: dict[str, Ints]
) -> tuple[list[tuple[Ints, ElementBlock]], Floats, dict[str, Ints]]:
    """Elements with a node on each edge; a new one is in all sets that have both of its neighbours."""
    linear = [nodes for nodes, _ in blocks if nodes.shape[1] < 6]
    if not linear:
        return blocks, places, sets
    edges = np.concatenate([np.stack([n, np.roll(n, -1, axis=1)], axis=2).reshape(-1, 2) for n in linear])
    unique, which = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    rows, used, result = len(places) + which.ravel(), 0, []
    for nodes, block in blocks:
        if nodes.shape[1] < 6:
            middles = rows[used : used + nodes.size].reshape(nodes.shape)
            used, nodes = used + nodes.size, np.hstack((nodes, middles))
        result.append((nodes, block))
    for name, members in sets.items():
        between = np.flatnonzero(np.isin(unique, members).all(axis=1))
        sets[name] = np.concatenate((members, len(places) + between))
    return result, np.vstack((places, places[unique].mean(axis=1))), sets


def _layer(
    flat: Mesh, blocks: list[tuple[Ints, ElementBlock]], places: Floats, sets: dict[str, Ints], thickness: float
) -> Mesh:
    """Nodes below, above, and of corners in the middle."""
    n = len(places)
    corner = np.unique(np.concatenate([nodes[:, : nodes.shape[1] // 2].ravel() for nodes, _ in blocks]))
    middle = np.full(n, -1, dtype=np.int64)
    middle[corner] = 2 * n + np.arange(len(corner))
    solids = []
    for nodes, block in blocks:
        below, on_edges = nodes[:, : nodes.shape[1] // 2], nodes[:, nodes.shape[1] // 2 :]
        cells = np.hstack((below, below + n, on_edges, on_edges + n, middle[below]))
        solids.append(ElementBlock(type=_SOLID[below.shape[1]], nodes=cells, ids=block.ids))
    height = np.concatenate((np.full(n, -thickness / 2), np.full(n, thickness / 2), np.zeros(len(corner))))
    xyz = np.column_stack((np.concatenate((places, places, places[corner])), height))
    layered = {}
    for name, members in sets.items():
        rows = np.concatenate((members, members + n, middle[members]))
        layered[name] = np.unique(rows[rows >= 0])
    labels = np.arange(1, len(xyz) + 1)
    return Mesh(nodes=Nodes(ids=labels, xyz=xyz, sets=layered), blocks=tuple(solids), source=flat.source)
