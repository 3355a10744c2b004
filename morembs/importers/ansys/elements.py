"""Elements of ANSYS archives: lines of an EBLOCK, and which solid the (repeated) nodes of an element make.

Node order as in the Element Reference: SOLID185 is I J K L M N O P; SOLID186 adds the middles of IJ JK KL LI, MN NO
OP PM, IM JN KO LP; SOLID187 is I J K L and the middles of IJ JK KI IL JL KL. A wedge has K = L and O = P, a tetrahedron
M = N = O = P too, and a pyramid M = N = O = P only.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.importers.ansys.names import SOLIDS, element_name


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """Elements (k,) of one type of the archive: labels, ``nodes`` (k, 20) labels with 0 for none, and attributes."""

    ids: Ints
    nodes: Ints
    material: Ints
    real: Ints
    system: Ints
    section: Ints


# Which of eight corners are the first of their label -> shape, the nodes in VTK order that it keeps of twenty, and how
# many of these are corners.
_SHAPES: dict[tuple[int, ...], tuple[str, tuple[int, ...], int]] = {
    (0, 1, 2, 3, 4, 5, 6, 7): ("hex", tuple(range(20)), 8),
    (0, 1, 2, 2, 4, 5, 6, 6): ("wedge", (0, 1, 2, 4, 5, 6, 8, 9, 11, 12, 13, 15, 16, 17, 18), 6),
    (0, 1, 2, 2, 4, 4, 4, 4): ("tet", (0, 1, 2, 4, 8, 9, 11, 16, 17, 18), 4),
}
_PYRAMID = (0, 1, 2, 3, 4, 4, 4, 4)
_TET = ("tet", tuple(range(10)), 4)
_TYPES = {"hex": ("hex8", "hex20"), "wedge": ("wedge6", "wedge15"), "tet": ("tet4", "tet10")}


def from_solid_form(table: Ints, name: str) -> list[tuple[int, Rows]]:
    """(type, elements) of the lines (k, >= 12) of an EBLOCK of the SOLID form.

    Raises:
        InputError: a count of nodes that cannot be, or a second line that is missing.
    """
    first = _heads(table, name)
    head, count_of = table[first], table[first, 8]
    nodes = np.zeros((len(first), 20), dtype=np.int64)
    nodes[:, : min(8, table.shape[1] - 11)] = head[:, 11:19]
    more = count_of > 8
    width = min(12, table.shape[1])
    nodes[more, 8 : 8 + width] = table[first[more] + 1, :width]
    nodes[np.arange(20) >= count_of[:, None]] = 0
    return [
        (int(kind), _pick(head[:, 1] == kind, head[:, 10], nodes, head[:, 0], head[:, 2], head[:, 4], head[:, 3]))
        for kind in np.unique(head[:, 1])
    ]


def _heads(table: Ints, name: str) -> Ints:
    """The first line of each element: those of more than eight nodes have two."""
    for step, least, largest in ((1, 1, 8), (2, 9, 20)):
        count = table[::step, 8]
        if len(table) % step == 0 and ((count >= least) & (count <= largest)).all():
            return np.arange(0, len(table), step)
    heads, at = [], 0
    given = table[:, 8].tolist()
    while at < len(given):
        if not 0 < given[at] <= 20:
            raise InputError(f"{name}: EBLOCK gives the element {table[at, 10]} {given[at]} nodes; expected 1 to 20")
        heads.append(at)
        at += 1 + (given[at] > 8)
    if at != len(given):
        raise InputError(f"{name}: EBLOCK ends within the element {table[heads[-1], 10]}; it is cut off", kind="file")
    return np.array(heads, dtype=np.int64)


def from_plain_form(table: Ints, routine: int, name: str) -> Rows:
    """Elements of one type of an EBLOCK without SOLID: label, section, real, material, system, up to ten nodes."""
    two = SOLIDS.get(routine, 0) > table.shape[1] - 5
    if two and len(table) % 2:
        raise InputError(f"{name}: EBLOCK of {element_name(routine)} has {len(table)} lines; expected two per element")
    head = table[:: 2 if two else 1]
    nodes = np.zeros((len(head), 20), dtype=np.int64)
    width = min(20, table.shape[1] - 5)
    nodes[:, :width] = head[:, 5 : 5 + width]
    if two:
        rest = min(20 - width, table.shape[1])
        nodes[:, width : width + rest] = table[1::2, :rest]
    return _pick(np.ones(len(head), dtype=bool), head[:, 0], nodes, head[:, 3], head[:, 2], head[:, 4], head[:, 1])


def _pick(
    chosen: NDArray[np.bool_], ids: Ints, nodes: Ints, material: Ints, real: Ints, system: Ints, section: Ints
) -> Rows:
    return Rows(
        ids=ids[chosen].astype(np.int64),
        nodes=nodes[chosen],
        material=material[chosen].astype(np.int64),
        real=real[chosen].astype(np.int64),
        system=system[chosen].astype(np.int64),
        section=section[chosen].astype(np.int64),
    )


def solids(routine: int, elements: Rows, name: str) -> Iterator[tuple[str, Ints, Ints]]:
    """Shape, rows of ``elements``, and their node labels (k, n) in VTK order, 0 for a middle node left out.

    Raises:
        InputError: pyramids, or other repeated nodes.
    """
    nodes, full, who = elements.nodes, SOLIDS[routine], element_name(routine)
    corners = 8 if full in (8, 20) else 4
    short = (nodes[:, full:] != 0).any(axis=1) | (nodes[:, :corners] <= 0).any(axis=1) | (nodes < 0).any(axis=1)
    if short.any():
        bad = elements.ids[short][0]
        raise InputError(f"{name}: element {bad} does not have the nodes of {who}; it is damaged", kind="file")
    for pattern, rows in _patterns(nodes[:, :corners]):
        if pattern == _PYRAMID:
            raise InputError(
                f"{name} has {len(rows)} pyramids ({who} with five corners; first: element {elements.ids[rows[0]]}), "
                "which are not supported; mesh with tetrahedra, wedges or hexahedra only",
                kind="unsupported",
            )
        shape, picked, own = _TET if pattern == (0, 1, 2, 3) else _SHAPES.get(pattern, ("", (), 0))
        chosen = nodes[rows][:, list(picked)]
        ordered = np.sort(chosen, axis=1)
        wrong = ((np.diff(ordered, axis=1) == 0) & (ordered[:, 1:] > 0)).any(axis=1) | (not shape)
        if corners == 8 and shape != "hex":
            # On the collapsed edge K = L, the middles of KO and LP are one node.
            wrong |= (nodes[rows, 18] != nodes[rows, 19]) & (nodes[rows, 19] != 0)
        if wrong.any():
            raise InputError(
                f"{name}: element {elements.ids[rows[wrong]][0]} ({who}) repeats nodes in a way that makes no "
                "hexahedron, wedge (K = L, O = P) or tetrahedron (K = L, M = N = O = P); check the mesh",
                kind="unsupported",
            )
        bare = (chosen[:, own:] == 0).all(axis=1)
        for quadratic, these, width in ((0, bare, own), (1, ~bare, len(picked))):
            if these.any():
                yield _TYPES[shape][quadratic], rows[these], chosen[these][:, :width]


def _patterns(corners: Ints) -> Iterator[tuple[tuple[int, ...], Ints]]:
    """For each pattern of repeated corners, as the first place (c,) of each label, the rows that have it."""
    first = np.zeros(corners.shape, dtype=np.int64)
    for i in range(corners.shape[1] - 1, -1, -1):
        first[corners == corners[:, [i]]] = i
    key = first @ 8 ** np.arange(corners.shape[1])
    # Hexahedra first, whose key is the largest.
    for number in np.unique(key)[::-1].tolist():
        rows = np.flatnonzero(key == number)
        yield tuple(first[rows[0]].tolist()), rows
