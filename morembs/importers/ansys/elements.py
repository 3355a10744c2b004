"""Elements of ANSYS by number, and their degenerate forms: which solid the (repeated) nodes of an element make.

Node order as in the Element Reference: SOLID185 is I J K L M N O P; SOLID186 adds the middles of IJ JK KL LI, MN NO
OP PM, IM JN KO LP; SOLID187 is I J K L and the middles of IJ JK KI IL JL KL. A wedge has K = L and O = P, a tetrahedron
M = N = O = P too, and a pyramid M = N = O = P only.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Ints


class Routine(IntEnum):
    """Routine numbers of elements that are read (Mechanical APDL Element Reference), by the names they have there."""

    COMBIN14 = 14
    MASS21 = 21
    MPC184 = 184
    SOLID45 = 45
    SOLID92 = 92
    SOLID95 = 95
    SOLID185 = 185
    SOLID186 = 186
    SOLID187 = 187
    SOLID285 = 285


# Nodes of the full form.
SOLIDS: dict[int, int] = {
    Routine.SOLID45: 8,
    Routine.SOLID185: 8,
    Routine.SOLID95: 20,
    Routine.SOLID186: 20,
    Routine.SOLID92: 10,
    Routine.SOLID187: 10,
    Routine.SOLID285: 4,
}
# Masses, springs and rigid beams.
HANGING = (Routine.MASS21, Routine.COMBIN14, Routine.MPC184)
# They have neither stiffness nor mass of a structure: meshing facets, and surfaces that carry loads.
CARRIERS = {152: "SURF152", 153: "SURF153", 154: "SURF154", 200: "MESH200", 201: "FOLLW201"}
# Contact and its targets.
CONTACT = (169, 170, 171, 172, 173, 174, 175, 176, 177, 178)
NAMES = {
    21: "MASS21",
    63: "SHELL63",
    181: "SHELL181",
    281: "SHELL281",
    188: "BEAM188",
    189: "BEAM189",
    4: "BEAM4",
    14: "COMBIN14",
    169: "TARGE169",
    170: "TARGE170",
    171: "CONTA171",
    172: "CONTA172",
    173: "CONTA173",
    174: "CONTA174",
    175: "CONTA175",
    176: "CONTA176",
    177: "CONTA177",
    178: "CONTA178",
    184: "MPC184",
    190: "SOLSH190",
    250: "COMBI250",
    93: "SHELL93",
    43: "SHELL43",
    44: "BEAM44",
    73: "SOLID73",
    72: "SOLID72",
    179: "PRETS179",
    90: "SOLID90",
    70: "SOLID70",
    87: "SOLID87",
    8: "LINK8",
    180: "LINK180",
    182: "PLANE182",
    183: "PLANE183",
    42: "PLANE42",
    82: "PLANE82",
}
_HEX20_WEDGE = (0, 1, 2, 4, 5, 6, 8, 9, 11, 12, 13, 15, 16, 17, 18)
_HEX20_TET = (0, 1, 2, 4, 8, 9, 11, 16, 17, 18)


@dataclass(frozen=True, kw_only=True, eq=False)
class Elements:
    """Elements (k,) of one type of the archive: labels, ``nodes`` (k, 20) labels with 0 for none, and attributes."""

    ids: Ints
    nodes: Ints
    material: Ints
    real: Ints
    system: Ints


def element_name(number: int) -> str:
    """Name of an element, such as SOLID186."""
    if number in SOLIDS:
        return f"SOLID{number}"
    return NAMES.get(number, CARRIERS.get(number, f"element number {number}"))


def from_solid_form(table: Ints, name: str) -> list[tuple[int, Elements]]:
    """(type, elements) of the lines (k, >= 12) of an EBLOCK of the SOLID form.

    Raises:
        InputError: a count of nodes that cannot be, or a second line that is missing.
    """
    heads, at = [], 0
    count = table[:, 8].tolist()
    while at < len(count):
        if not 0 < count[at] <= 20:
            raise InputError(f"{name}: EBLOCK gives the element {table[at, 10]} {count[at]} nodes; expected 1 to 20")
        heads.append(at)
        at += 1 + (count[at] > 8)
    if at != len(count):
        raise InputError(f"{name}: EBLOCK ends within the element {table[heads[-1], 10]}; it is cut off")
    first = np.array(heads, dtype=np.int64)
    head, count_of = table[first], table[first, 8]
    nodes = np.zeros((len(first), 20), dtype=np.int64)
    nodes[:, : min(8, table.shape[1] - 11)] = head[:, 11:19]
    more = count_of > 8
    width = min(12, table.shape[1])
    nodes[more, 8 : 8 + width] = table[first[more] + 1, :width]
    nodes[np.arange(20) >= count_of[:, None]] = 0
    return [
        (int(kind), _picked(head[:, 1] == kind, head[:, 10], nodes, head[:, 0], head[:, 2], head[:, 4]))
        for kind in np.unique(head[:, 1])
    ]


def from_plain_form(table: Ints, routine: int, name: str) -> Elements:
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
    return _picked(np.ones(len(head), dtype=bool), head[:, 0], nodes, head[:, 3], head[:, 2], head[:, 4])


def _picked(chosen: NDArray[np.bool_], ids: Ints, nodes: Ints, material: Ints, real: Ints, system: Ints) -> Elements:
    return Elements(
        ids=ids[chosen].astype(np.int64),
        nodes=nodes[chosen],
        material=material[chosen].astype(np.int64),
        real=real[chosen].astype(np.int64),
        system=system[chosen].astype(np.int64),
    )


def solids(routine: int, elements: Elements, name: str) -> dict[str, tuple[Ints, Ints]]:
    """Type of morembs -> (rows of ``elements``, node labels (k, n) in VTK order, 0 for a middle node left out).

    Raises:
        InputError: pyramids, or other repeated nodes.
    """
    nodes, full = elements.nodes, SOLIDS[routine]
    least = 8 if full in (8, 20) else 4
    if (nodes[:, full:] != 0).any() or (nodes[:, :least] <= 0).any() or (nodes < 0).any():
        short = (nodes[:, full:] != 0).any(axis=1) | (nodes[:, :least] <= 0).any(axis=1)
        bad = elements.ids[short | (nodes < 0).any(axis=1)][0]
        raise InputError(f"{name}: element {bad} does not have the nodes of {element_name(routine)}; it is damaged")
    if least == 4:
        shapes = {"tet": np.arange(len(nodes))}
        corners: dict[str, tuple[int, ...]] = {"tet": (0, 1, 2, 3)}
        middles: dict[str, tuple[int, ...]] = {"tet": tuple(range(10))}
    else:
        shapes = _shapes(nodes, elements.ids, routine, name)
        corners = {"hex": tuple(range(8)), "wedge": (0, 1, 2, 4, 5, 6), "tet": (0, 1, 2, 4)}
        middles = {"hex": tuple(range(20)), "wedge": _HEX20_WEDGE, "tet": _HEX20_TET}
    linear, quadratic = (
        {"hex": "hex8", "wedge": "wedge6", "tet": "tet4"},
        {"hex": "hex20", "wedge": "wedge15", "tet": "tet10"},
    )
    result: dict[str, tuple[Ints, Ints]] = {}
    for shape, rows in shapes.items():
        middle = nodes[rows][:, middles[shape][len(corners[shape]) :]] if full > 8 else np.zeros((len(rows), 1))
        bare = (middle == 0).all(axis=1)
        for kind, which, picked in ((linear, bare, corners), (quadratic, ~bare, middles)):
            if which.any():
                chosen = nodes[rows[which]][:, picked[shape]]
                _refuse_repeated(chosen, elements.ids[rows[which]], routine, name)
                result[kind[shape]] = rows[which], chosen
    return result


def _shapes(nodes: Ints, ids: Ints, routine: int, name: str) -> dict[str, Ints]:
    """Rows of hexahedra, wedges and tetrahedra among elements with eight corners."""
    _i, _j, k, l, m, n, o, p = nodes[:, :8].T  # noqa: E741
    top, base = (m == n) & (n == o) & (o == p), k == l
    pyramids = top & ~base
    if pyramids.any():
        raise InputError(
            f"{name} has {int(pyramids.sum())} pyramids ({element_name(routine)} with five corners; first: element "
            f"{ids[pyramids][0]}), which are not supported; mesh with tetrahedra, wedges or hexahedra only"
        )
    tet, wedge = top & base, ~top & base & (o == p)
    shapes = {"hex": ~top & ~base & (o != p), "wedge": wedge, "tet": tet}
    other = ~(shapes["hex"] | wedge | tet)
    if other.any():
        _refuse(ids[other][0], routine, name)
    if nodes[:, 18:20].any():
        # On the collapsed edge K = L, the middles of KO and LP are one node.
        torn = (wedge | tet) & (nodes[:, 18] != nodes[:, 19]) & (nodes[:, 19] != 0)
        if torn.any():
            _refuse(ids[torn][0], routine, name)
    return {shape: np.flatnonzero(which) for shape, which in shapes.items() if which.any()}


def _refuse_repeated(nodes: Ints, ids: Ints, routine: int, name: str) -> None:
    ordered = np.sort(nodes, axis=1)
    repeated = ((np.diff(ordered, axis=1) == 0) & (ordered[:, 1:] > 0)).any(axis=1)
    if repeated.any():
        _refuse(ids[repeated][0], routine, name)


def _refuse(label: int, routine: int, name: str) -> None:
    raise InputError(
        f"{name}: element {label} ({element_name(routine)}) repeats nodes in a way that makes no hexahedron, wedge "
        "(K = L, O = P) or tetrahedron (K = L, M = N = O = P); check the mesh"
    )
