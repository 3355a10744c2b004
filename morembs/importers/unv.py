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
from morembs.base.types import Ints
from morembs.importers.decks.labels import Labels, distinct, ranges_of
from morembs.importers.decks.model import Deck
from morembs.importers.decks.tables import Elements, LeftOut

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


_LEFT_OUT = "left out: only solids are assembled"


@dataclass
class _Contents:
    """What a file holds, by labels: ``solids`` and ``flat`` elements by descriptor, each a label and its nodes."""

    ids: list[int] = field(default_factory=list)
    xyz: list[list[float]] = field(default_factory=list)
    solids: dict[int, list[list[int]]] = field(default_factory=dict)
    flat: dict[int, list[int]] = field(default_factory=dict)
    groups: dict[str, list[tuple[int, int]]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def read_unv(path: str | Path) -> Deck:
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
            raise InputError(
                f"{path.name}: the dataset {number} cannot be read ({error}); write it again",
                kind="file",
                keyword=path.name,
            ) from error
    return _deck(contents, path.name)


def _datasets(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Number and lines of each dataset."""
    try:
        text = path.read_bytes().decode("latin-1")
    except OSError as error:
        raise InputError(
            f"{path.name} cannot be opened: {error.strerror}; check the path", kind="file", keyword=path.name
        ) from error
    inside, lines = False, list[str]()
    for line in text.splitlines():
        if line.strip() != "-1":
            if inside:
                lines.append(line)
            continue
        if inside:
            if not lines or not lines[0].strip().isdigit():
                raise InputError(
                    f"{path.name} has a dataset without a number; expected a universal file",
                    kind="file",
                    keyword=path.name,
                )
            yield int(lines[0]), lines[1:]
        inside, lines = not inside, []
    if inside:
        raise InputError(
            f"{path.name} ends within a dataset; it is cut off, write it again", kind="file", keyword=path.name
        )


def _take(number: int, lines: list[str], contents: _Contents, name: str) -> None:
    if number == Dataset.UNITS:
        units = lines[0][10:30].strip() or lines[0].split()[0]
        contents.notes.append(f"{name} says that its units are {units} (dataset 164)")
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
            contents.solids.setdefault(kind, []).append([label, *nodes])
        elif kind in _FLAT:
            contents.flat.setdefault(kind, []).append(label)
        else:
            raise InputError(
                f"{name}: element {label} is of the kind {kind}, which is not supported; expected solids "
                f"({', '.join(map(str, SOLIDS))})",
                kind="unsupported",
                keyword="elements",
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


def _deck(contents: _Contents, name: str) -> Deck:
    if not contents.ids:
        raise InputError(
            f"{name} has no nodes (datasets 15, 781 or 2411); write it again", kind="missing", keyword="nodes"
        )
    parts = []
    for kind, rows in contents.solids.items():
        table, (shape, vtk) = np.array(rows, dtype=np.int64), SOLIDS[kind]
        ids, nodes = table[:, 0], table[:, 1:][:, vtk]
        parts.append(Elements(code=f"descriptor {kind}", kind="solid", shape=shape, ids=ids, nodes=nodes))
    for kind, labels in contents.flat.items():
        none = np.empty((len(labels), 0), dtype=np.int64)
        parts.append(
            Elements(code=f"descriptor {kind}", kind="none", shape="", ids=np.array(labels, dtype=np.int64), nodes=none)
        )
    if flat := sum(map(len, contents.flat.values())):
        contents.notes.append(f"{flat} elements that are no solids were left out")
    ids = np.array(contents.ids, dtype=np.int64)
    elements = distinct(np.concatenate([np.empty(0, dtype=np.int64), *(part.ids for part in parts)]))
    return Deck(
        name=name,
        program="UNV",
        ids=ids,
        xyz=np.array(contents.xyz),
        elements=tuple(parts),
        node_sets=_sets(contents, Entity.NODE, Labels(ids, name)),
        element_sets=_sets(contents, Entity.ELEMENT, Labels(elements, name, "element")),
        left_out={f"descriptor {kind}": LeftOut(len(own), _LEFT_OUT) for kind, own in contents.flat.items()},
        notes=tuple(contents.notes),
    )


def _sets(contents: _Contents, entity: Entity, known: Labels) -> dict[str, Ints]:
    """Ranges of the members of each group that are of an entity, and in the file."""
    sets = {}
    for title, members in contents.groups.items():
        labels = np.array([label for kind, label in members if kind == entity], dtype=np.int64)
        if len(labels := labels[known.has(labels)]):
            sets[title] = ranges_of(labels)
    return sets
