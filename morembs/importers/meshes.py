"""Every mesh format that meshio reads, with named sets kept as node sets and element sets."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError, MorembsError
from morembs.base.types import Ints
from morembs.fem import ElementBlock, Mesh, Nodes
from morembs.fem.elements import TYPES
from morembs.importers.abaqus.importer import read_abaqus
from morembs.importers.imported import Imported, picked_nodes
from morembs.importers.tolerances import TOL
from morembs.storage.hdf5 import refuse_unsafe_file

if TYPE_CHECKING:
    import meshio

SOLIDS = {
    "tetra": "tet4",
    "tetra10": "tet10",
    "hexahedron": "hex8",
    "hexahedron20": "hex20",
    "hexahedron27": "hex27",
    "wedge": "wedge6",
    "wedge15": "wedge15",
}
# How formats begin, and their last line; a text of any other format ends with an end of line.
_LAST_LINES = (
    (
        re.compile(rb"\s*\$MeshFormat"),
        re.compile(
            rb"\$End(MeshFormat|Comments|PhysicalNames|(Partitioned)?Entities|Nodes|Elements|Periodic|GhostElements|"
            rb"Parametrizations|(Node|Element|ElementNode)Data|InterpolationScheme)"
        ),
    ),
    (re.compile(rb"\s*<"), re.compile(rb".*</\w+>")),
    (re.compile(rb"\s*MeshVersionFormatted", re.IGNORECASE), re.compile(rb"End", re.IGNORECASE)),
)
_BINARY = re.compile(rb"^BINARY\s*$|[\x00-\x08\x0e-\x1f\x7f-\xff]", re.MULTILINE)
# Meshes of Salome, and results of code_aster, which hold one too.
_MED = (".med", ".rmed")
# Cells that carry a name for their nodes but neither mass nor stiffness here.
CARRIERS = {"vertex", "line", "line3", "triangle", "triangle6", "quad", "quad8", "quad9"}


def read_with_meshio(path: Path, kinds: Mapping[str, str] = SOLIDS) -> Mesh:
    """Mesh of any file that meshio reads, in the units of the file. Labels are counted from 1, since meshio drops them.

    Args:
        kinds: cells of meshio that become elements, with the type of these; solids unless given.

    Raises:
        InputError: a file that meshio cannot read or that is damaged, or elements that are no solids known here.
    """
    data = _read(path)
    _refuse_damage(path, data)
    # gmsh splits a type by entity; blocks of one type are joined, `place` remembers where each went.
    parts: dict[str, list[tuple[Ints, Ints]]] = {}
    place: dict[int, tuple[str, int]] = {}
    label = 1
    for index, cells in enumerate(data.cells):
        ids = np.arange(label, label + len(cells.data))
        label += len(cells.data)
        if cells.type in kinds:
            kind = kinds[cells.type]
            mirrored = kind in TYPES and path.suffix.lower() in _MED
            nodes = cells.data[:, _mirror(kind)] if mirrored else cells.data
            joined = parts.setdefault(kind, [])
            place[index] = kind, sum(len(i) for _, i in joined)
            joined.append((nodes, ids))
        elif cells.type not in CARRIERS:
            raise InputError(
                f"{path.name} has elements of the type {cells.type!r}, which is not supported; expected "
                f"{'solids' if kinds is SOLIDS else 'plane elements'}: {', '.join(kinds.values())}",
                kind="unsupported",
            )
    blocks = [
        ElementBlock(
            type=kind, nodes=np.concatenate([n for n, _ in joined]), ids=np.concatenate([i for _, i in joined])
        )
        for kind, joined in parts.items()
    ]
    used = _used_nodes(len(data.points), blocks)
    row = np.cumsum(used) - 1
    node_sets = _named_points(data)
    element_sets: dict[str, tuple[Ints, ...]] = {}
    for name, per_block in _named_cells(data).items():
        members = [data.cells[i].data[rows].ravel() for i, rows in per_block.items()]
        node_sets[name] = np.unique(np.concatenate([node_sets.get(name, np.empty(0, dtype=np.int64)), *members]))
        chosen: dict[str, list[Ints]] = {block.type: [np.empty(0, dtype=np.int64)] for block in blocks}
        for i, rows in per_block.items():
            if i in place:
                kind, offset = place[i]
                chosen[kind].append(rows + offset)
        picked = tuple(np.concatenate(chosen[block.type]) for block in blocks)
        if any(len(rows) for rows in picked):
            element_sets[name] = picked
    points = Nodes(ids=np.arange(1, len(used) + 1), xyz=data.points, sets=node_sets)
    nodes = picked_nodes(points, np.flatnonzero(used))
    renumbered = tuple(ElementBlock(type=b.type, nodes=row[b.nodes], ids=b.ids) for b in blocks)
    return Mesh(nodes=nodes, blocks=renumbered, element_sets=element_sets, source=path.name)


def _read(path: Path) -> meshio.Mesh:
    """meshio's mesh; it prints and ends the process on files that it cannot read, which is caught here."""
    import meshio
    from meshio._mesh import topological_dimension

    # meshio reads 15-node wedges but forgot their dimension, without which it stops.
    topological_dimension.setdefault("wedge15", 3)
    for file in (path, *_beside(path)):
        refuse_unsafe_file(file)
    _refuse_cut(path)
    words = io.StringIO()
    try:
        with contextlib.redirect_stdout(words), contextlib.redirect_stderr(words), _bounded_tags():
            if path.suffix.lower() in _MED:
                return meshio.read(_without_results(path), file_format="med")
            return meshio.read(path)
    except MorembsError:
        raise
    except (SystemExit, Exception) as error:
        message = words.getvalue().strip() or (str(error) if not isinstance(error, SystemExit) else "")
        reason = " ".join(message.split())[: TOL.shown_mesh_reason] or type(error).__name__
        raise InputError(
            f"{path.name} cannot be read as a mesh ({reason}); expected a format that meshio reads "
            "(.msh, .vtk, .vtu, .med, .bdf, ...) or an Abaqus .inp file",
            kind="file",
            keyword=path.name,
        ) from error


def _without_results(path: Path) -> Path | io.BytesIO:
    """A MED file, or a copy of its mesh in memory where it holds fields: those of some of the elements stop meshio."""
    import h5py

    with h5py.File(path) as file:
        if "CHA" not in file:
            return path
        copy = io.BytesIO()
        with h5py.File(copy, "w") as mesh:
            for name in set(file) - {"CHA", "PROFILS"}:
                file.copy(name, mesh)
    copy.seek(0)
    return copy


@contextlib.contextmanager
def _bounded_tags() -> Iterator[None]:
    """Refuse node tags of gmsh far beyond the number of nodes: meshio makes a table as long as the largest one."""
    from meshio.gmsh import _gmsh22, _gmsh40, _gmsh41

    def bound_tags(read: Callable[..., Any]) -> Callable[..., Any]:
        def read_nodes(*arguments: Any) -> Any:
            nodes = read(*arguments)
            tags = np.asarray(nodes[1])
            largest = TOL.sparse_tags + TOL.sparse_tags_per_node * len(tags)
            if len(tags) and (tags.max() > largest or tags.min() < 0):
                raise ValueError(
                    f"{len(tags)} nodes have tags from {tags.min():.0f} to {tags.max():.0f}; renumber them in gmsh"
                )
            return nodes

        return read_nodes

    readers = {module: module._read_nodes for module in (_gmsh22, _gmsh40, _gmsh41)}
    for module, read in readers.items():
        module._read_nodes = bound_tags(read)
    try:
        yield
    finally:
        for module, read in readers.items():
            module._read_nodes = read


def _refuse_cut(path: Path) -> None:
    """Refuse a text that ends within a line, or before the mark that its format ends with: meshio reads on without."""
    try:
        with path.open("rb") as file:
            head = file.read(TOL.mesh_end_bytes)
            file.seek(-min(path.stat().st_size, TOL.mesh_end_bytes), 2)
            tail = file.read()
    except OSError as error:
        raise InputError(
            f"{path.name} cannot be opened: {error.strerror}; check the path", kind="file", keyword=path.name
        ) from error
    last = tail.rstrip().rsplit(b"\n", 1)[-1].strip()
    wanted = next((mark for begin, mark in _LAST_LINES if begin.match(head)), None)
    if wanted is not None:
        whole = bool(wanted.fullmatch(last))
    else:
        whole = b"\0" in head + tail or _BINARY.search(head) is not None or tail[-1:] in b"\r\n"
    if not whole:
        raise InputError(
            f"{path.name} cannot be read as a mesh: expected it to end as its format does, and it ends before that, so "
            "it may be cut off; write it again, or end its last line if the file is complete",
            kind="file",
            keyword=path.name,
        )


def _beside(path: Path) -> set[Path]:
    """Files that an XDMF file takes its numbers from.

    Raises:
        InputError: one of them lies elsewhere: the numbers of any file could be read in this way.
    """
    if path.suffix.lower() not in (".xdmf", ".xmf"):
        return set()
    try:
        items = list(ElementTree.parse(path).iter("DataItem"))
    except (OSError, SyntaxError, ValueError, LookupError):
        return set()  # meshio says what is wrong
    named = [(item.text or "").strip() for item in items if item.get("Format", "").upper() in ("HDF", "BINARY")]
    beside = {path.parent / name.split(":")[0] for name in named}
    for file in beside:
        if not file.resolve().is_relative_to(path.parent.resolve()):
            raise InputError(
                f"{path.name} takes numbers from {file}; expected files next to it, or in folders next to it",
                kind="unsupported",
                keyword=path.name,
            )
    return beside


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


def _refuse_damage(path: Path, data: meshio.Mesh) -> None:
    """Refuse what meshio passes on unseen: cells on points that are not there, data of another length."""
    points = data.points
    if not isinstance(points, np.ndarray) or points.ndim != 2 or points.dtype.kind not in "fiu":
        raise InputError(
            f"{path.name} has no table of points; it is damaged, write it again", kind="file", keyword=path.name
        )
    if points.shape[1] != 3:
        raise InputError(
            f"{path.name} has points with {points.shape[1]} coordinates; a mesh in space has 3", kind="unsupported"
        )
    if not np.isfinite(points).all():
        raise InputError(
            f"{path.name} has points whose coordinates are not finite; write it again", kind="file", keyword=path.name
        )
    counts = []
    for cells in data.cells:
        nodes = np.asarray(cells.data)
        counts.append(len(nodes))
        if nodes.ndim != 2 or nodes.dtype.kind not in "iu" or (cells.type in SOLIDS and nodes.shape[1] != _size(cells)):
            raise InputError(
                f"{path.name} has damaged cells of the type {cells.type!r}; write it again",
                kind="file",
                keyword=path.name,
            )
        if nodes.size and not (int(nodes.min()) >= 0 and int(nodes.max()) < len(points)):
            raise InputError(
                f"{path.name} has a {cells.type} cell on a point that is not there; write it again",
                kind="file",
                keyword=path.name,
            )
    tables = [*data.cell_data.values()]
    fits = all(len(arrays) == len(counts) for arrays in tables)
    fits = fits and all(len(np.atleast_1d(a)) == n for table in tables for a, n in zip(table, counts, strict=True))
    fits = fits and all(len(np.atleast_1d(a)) == len(points) for a in data.point_data.values())
    rows = [
        (np.asarray(r), n)
        for name, sets in data.cell_sets.items()
        if not name.startswith("gmsh:")
        for r, n in zip(sets, counts, strict=False)
        if r is not None and len(r)
    ]
    rows += [(np.asarray(r), len(points)) for r in data.point_sets.values() if len(r)]
    if not fits or not all(r.dtype.kind in "iu" and int(r.min()) >= 0 and int(r.max()) < n for r, n in rows):
        raise InputError(
            f"{path.name} has sets or data that do not fit its points and cells; write it again",
            kind="file",
            keyword=path.name,
        )


def _size(cells: meshio.CellBlock) -> int:
    return TYPES[SOLIDS[cells.type]].n_nodes


def _named_cells(data: meshio.Mesh) -> dict[str, dict[int, Ints]]:
    """Name -> {cell block: rows}, from named sets, and from integer cell data as "key:value".

    Physical groups of gmsh without names are "physical:value"; groups of MED have their names. The names of MSH 2 are
    beside the values, those of MSH 4 are named sets.
    """
    of_gmsh = data.field_data if "gmsh:physical" in data.cell_data else {}
    titles = {(int(tag), int(dim)): [name] for name, (tag, dim) in of_gmsh.items()}
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
        groups = _groups(data, "cell_tags") if key == "cell_tags" else {}
        for i, values in enumerate(np.asarray(a) for a in arrays):
            if values.ndim == 1 and np.issubdtype(values.dtype, np.integer):
                for value in np.unique(values).tolist():
                    chosen = np.flatnonzero(values == value)
                    titled = titles.get((value, data.cells[i].dim)) if key == "gmsh:physical" else None
                    for name in titled or groups.get(value, [f"{key.removeprefix('gmsh:')}:{value}"]):
                        before = named.setdefault(name, {}).get(i, chosen[:0])
                        named[name][i] = np.unique(np.concatenate([before, chosen]))
    return named


def _groups(data: meshio.Mesh, key: str) -> dict[int, list[str]]:
    """Names of the groups that a family of a MED file belongs to, by the number of the family."""
    return {int(number): [str(name) for name in names] for number, names in (getattr(data, key, None) or {}).items()}


def _named_points(data: meshio.Mesh) -> dict[str, Ints]:
    """Named rows of points: sets, and groups of a MED file."""
    named = {name: np.unique(np.asarray(members)) for name, members in data.point_sets.items()}
    family = np.asarray(data.point_data.get("point_tags", []))
    for number, names in _groups(data, "point_tags").items():
        for name in names:
            before = named.get(name, np.empty(0, dtype=np.int64))
            named[name] = np.unique(np.concatenate([before, np.flatnonzero(family == number)]))
    return named


def import_mesh(path: Path, *, allow_includes_outside: bool = False) -> Imported:
    """A solid mesh with its sets, without materials.

    Raises:
        InputError: the file cannot be read, or has no solid elements or some that are not supported.
    """
    path = Path(path)
    deck = path.suffix.lower() == ".inp"
    mesh = read_abaqus(path, allow_includes_outside=allow_includes_outside) if deck else read_with_meshio(path)
    if not mesh.blocks:
        raise InputError(
            f"{path.name} has no solid elements; a volume mesh is needed (tet, hex or wedge)", kind="missing"
        )
    return Imported(source=path.name, mesh=mesh)
