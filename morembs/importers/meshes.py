"""Every mesh format that meshio reads, with named sets kept as node sets and element sets."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import meshio
import numpy as np
from meshio._mesh import topological_dimension
from numpy.typing import NDArray

from morembs.elements import TYPES
from morembs.errors import InputError
from morembs.imported import Imported
from morembs.importers.abaqus import read_abaqus
from morembs.model import ElementBlock, Mesh, Nodes

Ints = NDArray[np.int64]
SOLIDS = {
    "tetra": "tet4", "tetra10": "tet10", "hexahedron": "hex8", "hexahedron20": "hex20",
    "hexahedron27": "hex27", "wedge": "wedge6", "wedge15": "wedge15",
}  # fmt: skip
# meshio reads 15-node wedges but forgot their dimension, without which it stops.
topological_dimension.setdefault("wedge15", 3)
# Cells that carry a name for their nodes but neither mass nor stiffness here.
CARRIERS = {
    "vertex", "line", "line3", "triangle", "triangle6", "quad", "quad8", "quad9",
}  # fmt: skip


def read_with_meshio(path: Path) -> Mesh:
    """Mesh of any file that meshio reads. Labels are counted from 1, since meshio drops them."""
    data = _read(path)
    # gmsh splits a type by entity; blocks of one type are joined, `place` remembers where each went.
    parts: dict[str, list[tuple[Ints, Ints]]] = {}
    place: dict[int, tuple[str, int]] = {}
    label = 1
    for index, cells in enumerate(data.cells):
        ids = np.arange(label, label + len(cells.data))
        label += len(cells.data)
        if cells.type in SOLIDS:
            kind = SOLIDS[cells.type]
            nodes = cells.data[:, _mirror(kind)] if path.suffix.lower() == ".med" else cells.data
            joined = parts.setdefault(kind, [])
            place[index] = kind, sum(len(i) for _, i in joined)
            joined.append((nodes, ids))
        elif cells.type not in CARRIERS:
            raise InputError(
                f"{path.name} has elements of the type {cells.type!r}, which is not supported; expected solids: "
                f"{', '.join(SOLIDS.values())}"
            )
    blocks = [
        ElementBlock(
            type=kind, nodes=np.concatenate([n for n, _ in joined]), ids=np.concatenate([i for _, i in joined])
        )
        for kind, joined in parts.items()
    ]
    used = _used_nodes(len(data.points), blocks)
    row = np.cumsum(used) - 1
    node_sets = {name: np.unique(np.asarray(members)) for name, members in data.point_sets.items()}
    element_sets: dict[str, tuple[Ints, ...]] = {}
    for name, per_block in _named_cells(data).items():
        members = [data.cells[i].data[rows].ravel() for i, rows in per_block.items()]
        node_sets[name] = np.unique(np.concatenate(members))
        chosen: dict[str, list[Ints]] = {block.type: [np.empty(0, dtype=np.int64)] for block in blocks}
        for i, rows in per_block.items():
            if i in place:
                kind, offset = place[i]
                chosen[kind].append(rows + offset)
        picked = tuple(np.concatenate(chosen[block.type]) for block in blocks)
        if any(len(rows) for rows in picked):
            element_sets[name] = picked
    kept = {name: row[members[used[members]]] for name, members in node_sets.items()}
    nodes = Nodes(
        ids=np.flatnonzero(used) + 1,
        xyz=_three_columns(data.points)[used],
        sets={name: rows for name, rows in kept.items() if len(rows)},
    )
    renumbered = tuple(ElementBlock(type=b.type, nodes=row[b.nodes], ids=b.ids) for b in blocks)
    return Mesh(nodes=nodes, blocks=renumbered, element_sets=element_sets, source=path.name)


def _read(path: Path) -> meshio.Mesh:
    """meshio's mesh; it prints and ends the process on files that it cannot read, which is caught here."""
    words = io.StringIO()
    try:
        with contextlib.redirect_stdout(words), contextlib.redirect_stderr(words):
            return meshio.read(path)
    except (SystemExit, Exception) as error:
        said = words.getvalue().strip() or (str(error) if not isinstance(error, SystemExit) else "")
        reason = " ".join(said.split())[:300] or type(error).__name__
        raise InputError(
            f"{path.name} cannot be read as a mesh ({reason}); expected a format that meshio knows "
            "(.msh, .vtk, .vtu, .med, .bdf, ...) or an Abaqus .inp file"
        ) from error


def _mirror(kind: str) -> Ints:
    """Order of the nodes seen in a mirror: MED lists solids inside out, and meshio leaves them so."""
    reference = TYPES[kind].reference
    swapped = reference[:, [1, 0, 2]]
    return np.asarray(np.argmin(np.linalg.norm(swapped[:, None] - reference[None], axis=2), axis=1))


def _used_nodes(count: int, blocks: list[ElementBlock]) -> NDArray[np.bool_]:
    """Nodes of solid elements: points of construction and of shells drop out."""
    used = np.zeros(count, dtype=bool)
    for block in blocks:
        used[block.nodes] = True
    return used


def _three_columns(points: NDArray[np.float64]) -> NDArray[np.float64]:
    if points.shape[1] == 3:
        return points
    raise InputError(f"the mesh has points with {points.shape[1]} coordinates; a mesh in space has 3")


def _named_cells(data: meshio.Mesh) -> dict[str, dict[int, Ints]]:
    """Name -> {cell block: rows}, from named sets, and from integer cell data as "key:value".

    Physical groups of gmsh without names are "physical:value".
    """
    named: dict[str, dict[int, Ints]] = {}
    for name, per_block in data.cell_sets.items():
        if name.startswith("gmsh:"):
            continue
        rows = {i: np.asarray(r, dtype=np.int64) for i, r in enumerate(per_block) if r is not None and len(r)}
        if rows:
            named[name] = rows
    unnamed = "gmsh:physical" in data.cell_data and not named
    for key, arrays in data.cell_data.items():
        if key.startswith("gmsh:") and not (unnamed and key == "gmsh:physical"):
            continue
        for i, values in enumerate(np.asarray(a) for a in arrays):
            if values.ndim == 1 and np.issubdtype(values.dtype, np.integer):
                for value in np.unique(values):
                    named.setdefault(f"{key.removeprefix('gmsh:')}:{value}", {})[i] = np.flatnonzero(values == value)
    return named


def import_mesh(path: Path) -> Imported:
    """A solid mesh with its sets, without materials.

    Raises:
        InputError: the file cannot be read, or has no solid elements or some that are not supported.
    """
    path = Path(path)
    mesh = read_abaqus(path) if path.suffix.lower() == ".inp" else read_with_meshio(path)
    if not mesh.blocks:
        raise InputError(f"{path.name} has no solid elements; a volume mesh is needed (tet, hex or wedge)")
    return Imported(source=path.name, mesh=mesh)
