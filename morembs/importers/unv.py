"""Universal files (.unv) of I-deas and Salome: nodes (15, 781, 2411), solids (780, 2412), groups, units (164).

Each dataset stands between lines of -1 and begins with its number. Groups are 2435, 2452, 2467 and 2477; all other
datasets are passed over. Numbers may have exponents D.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path

import numpy as np

from morembs.base.errors import InputError
from morembs.fem import ElementBlock, Mesh, Nodes
from morembs.importers.imported import Imported

# FE descriptor -> type and the nodes of the file in VTK order. Quadratic solids list each middle between its corners,
# bottom, upright edges, top.
_HEX20 = (0, 2, 4, 6, 12, 14, 16, 18, 1, 3, 5, 7, 13, 15, 17, 19, 8, 9, 10, 11)
_WEDGE15 = (0, 2, 4, 9, 11, 13, 1, 3, 5, 10, 12, 14, 6, 7, 8)
_TET10 = (0, 2, 4, 9, 1, 3, 5, 6, 7, 8)
SOLIDS: dict[int, tuple[str, tuple[int, ...]]] = {
    111: ("tet4", tuple(range(4))),
    112: ("wedge6", tuple(range(6))),
    115: ("hex8", tuple(range(8))),
    118: ("tet10", _TET10),
    113: ("wedge15", _WEDGE15),
    116: ("hex20", _HEX20),
}


class Descriptor(IntEnum):
    """Descriptors of elements of one dimension (I-DEAS, Universal File Datasets, number 2412)."""

    ROD = 11
    LINEAR_BEAM = 21
    TAPERED_BEAM = 22
    CURVED_BEAM = 23
    PARABOLIC_BEAM = 24


class Dataset(IntEnum):
    """Numbers of datasets (the same manual); former programs write others of nodes and elements."""

    SINGLE_PRECISION_NODES = 15
    UNITS = 164
    FORMER_ELEMENTS = 780
    FORMER_NODES = 781
    NODES = 2411
    ELEMENTS = 2412


class Entity(IntEnum):
    """Kinds of members of groups (the same manual, number 2467)."""

    NODE = 7
    ELEMENT = 8


_BEAMS = (Descriptor.LINEAR_BEAM, Descriptor.TAPERED_BEAM, Descriptor.CURVED_BEAM, Descriptor.PARABOLIC_BEAM)
# Elements that may carry groups and have no mass or stiffness here.
_FLAT = (
    *range(11, 14),
    *_BEAMS,
    *range(31, 33),
    *range(41, 47),
    *range(51, 57),
    *range(61, 67),
    *range(71, 77),
    *range(81, 87),
    *range(91, 97),
    121,
    122,
    136,
    137,
    138,
    139,
    141,
    142,
    151,
    152,
    161,
    171,
)
# Lines of a node.
_NODES = {Dataset.SINGLE_PRECISION_NODES: 1, Dataset.FORMER_NODES: 2, Dataset.NODES: 2}
_ELEMENTS = (Dataset.FORMER_ELEMENTS, Dataset.ELEMENTS)
# Each member has four numbers, of which the first two are its kind and label.
_GROUPS = (2435, 2452, 2467, 2477)


@dataclass
class _Contents:
    """What a file holds, by labels."""

    ids: list[int] = field(default_factory=list)
    xyz: list[list[float]] = field(default_factory=list)
    elements: dict[int, list[list[int]]] = field(default_factory=dict)
    flat: int = 0
    groups: dict[str, list[tuple[int, int]]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def import_unv(path: str | Path) -> Imported:
    """Mesh and groups of a universal file, in its units; groups of nodes are node sets, of solids element sets.

    Raises:
        InputError: not a universal file, cut off, or with elements that are not supported.
    """
    path, contents = Path(path), _Contents()
    for number, lines in _datasets(path):
        try:
            _take(number, lines, contents, path.name)
        except (ValueError, IndexError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path.name}: the dataset {number} cannot be read ({error}); write it again") from error
    mesh = _mesh(contents, path.name)
    return Imported(source=path.name, nodes=mesh.nodes, mesh=mesh, notes=tuple(contents.notes))


def read_unv(path: Path, *, allow_includes_outside: bool = False) -> Mesh:
    """Mesh of a universal file, which includes no others.

    Raises:
        InputError: as ``import_unv``.
    """
    mesh = import_unv(path).mesh
    if mesh is None:
        raise InputError(f"{path.name} has no mesh")
    return mesh


def _datasets(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Number and lines of each dataset."""
    try:
        text = path.read_bytes().decode("latin-1")
    except OSError as error:
        raise InputError(f"{path.name} cannot be opened: {error.strerror}; check the path") from error
    inside, lines = False, list[str]()
    for line in text.splitlines():
        if line.strip() != "-1":
            if inside:
                lines.append(line)
            continue
        if inside:
            if not lines or not lines[0].strip().isdigit():
                raise InputError(f"{path.name} has a dataset without a number; expected a universal file")
            yield int(lines[0]), lines[1:]
        inside, lines = not inside, []
    if inside:
        raise InputError(f"{path.name} ends within a dataset; it is cut off, write it again")


def _take(number: int, lines: list[str], contents: _Contents, name: str) -> None:
    if number == Dataset.UNITS:
        said = lines[0][10:30].strip() or lines[0].split()[0]
        contents.notes.append(f"{name} says that its units are {said} (dataset 164)")
    elif number in _NODES:
        step = _NODES[Dataset(number)]
        for at in range(0, len(lines) - step + 1, step):
            words = " ".join(lines[at : at + step]).replace("D", "E").replace("d", "e").split()
            if len(words) != 7:
                raise ValueError(f"{lines[at]!r} is no node")
            label, *_ = (int(word) for word in words[:4])
            contents.ids.append(label)
            contents.xyz.append([float(word) for word in words[4:]])
    elif number in _ELEMENTS:
        _take_elements(lines, contents, name)
    elif number in _GROUPS:
        _take_groups(lines, contents)


def _take_elements(lines: list[str], contents: _Contents, name: str) -> None:
    at = 0
    while at < len(lines):
        words = [int(word) for word in lines[at].split()]
        label, kind, count = words[0], words[1], words[-1]
        # Beams have a line of their own in front of their nodes; some programs write it for rods as well.
        at += 2 if kind in _BEAMS or (kind == Descriptor.ROD and len(lines[at + 1].split()) > count) else 1
        nodes: list[int] = []
        while len(nodes) < count:
            nodes += [int(word) for word in lines[at].split()]
            at += 1
        if kind in SOLIDS:
            if len(nodes) != len(SOLIDS[kind][1]):
                raise ValueError(f"element {label} has {len(nodes)} nodes")
            contents.elements.setdefault(kind, []).append([label, *nodes])
        elif kind in _FLAT:
            contents.flat += 1
        else:
            raise InputError(
                f"{name}: element {label} is of the kind {kind}, which is not supported; expected solids "
                f"({', '.join(map(str, SOLIDS))})"
            )


def _take_groups(lines: list[str], contents: _Contents) -> None:
    at = 0
    while at + 1 < len(lines):
        count, title = int(lines[at].split()[-1]), lines[at + 1].strip()
        at += 2
        words: list[int] = []
        while len(words) < 4 * count:
            words += [int(word) for word in lines[at].split()]
            at += 1
        members = contents.groups.setdefault(title, [])
        members += [(words[i], words[i + 1]) for i in range(0, 4 * count, 4)]


def _mesh(contents: _Contents, name: str) -> Mesh:
    if not contents.elements:
        raise InputError(f"{name} has no solid elements (datasets 780 or 2412); expected a mesh of solids")
    if not contents.ids:
        raise InputError(f"{name} has no nodes (datasets 15, 781 or 2411); write it again")
    order = np.argsort(contents.ids, kind="stable")
    ids, xyz = np.array(contents.ids, dtype=np.int64)[order], np.array(contents.xyz)[order]
    twice = ids[1:][np.diff(ids) == 0]
    if len(twice):
        raise InputError(f"{name} defines the node {twice[0]} twice; expected each node once")
    blocks = []
    for kind, rows in contents.elements.items():
        table = np.array(rows, dtype=np.int64)
        at = np.minimum(np.searchsorted(ids, table[:, 1:]), max(len(ids) - 1, 0))
        wrong = table[:, 1:][ids[at] != table[:, 1:]]
        if len(wrong):
            some = ", ".join(map(str, np.unique(wrong)[:10]))
            raise InputError(f"{name}: elements name nodes that are not defined: {some}")
        shape, vtk = SOLIDS[kind]
        blocks.append(ElementBlock(type=shape, nodes=at[:, vtk], ids=table[:, 0]))
    if contents.flat:
        contents.notes.append(f"{contents.flat} elements that are no solids were left out")
    node_sets, element_sets = {}, {}
    for title, members in contents.groups.items():
        of_nodes = np.array([label for kind, label in members if kind == Entity.NODE], dtype=np.int64)
        of_elements = np.array([label for kind, label in members if kind == Entity.ELEMENT], dtype=np.int64)
        chosen = np.flatnonzero(np.isin(ids, of_nodes))
        if len(chosen):
            node_sets[title] = chosen
        picked = tuple(np.flatnonzero(np.isin(block.ids, of_elements)) for block in blocks)
        if any(map(len, picked)):
            element_sets[title] = picked
    nodes = Nodes(ids=ids, xyz=xyz, sets=node_sets)
    return Mesh(nodes=nodes, blocks=tuple(blocks), element_sets=element_sets, source=name)
