"""Meshes as input decks of Abaqus, Nastran and ANSYS have them: nodes and elements, without materials."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from morembs.fem import Mesh

Element = tuple[int, int, int, int, Sequence[int]]

ABAQUS_CODES = {
    "tet4": "C3D4",
    "tet10": "C3D10",
    "hex8": "C3D8",
    "hex20": "C3D20",
    "hex27": "C3D27",
    "wedge6": "C3D6",
    "wedge15": "C3D15",
}
_NASTRAN_CARDS = {"tet": "CTETRA", "hex": "CHEXA", "wed": "CPENTA"}
# Where the cards put what VTK puts at each place (Quick Reference Guide: bottom edges, upright edges, top edges).
_NASTRAN_ORDER = {"hex20": [*range(12), 16, 17, 18, 19, 12, 13, 14, 15], "wedge15": [*range(9), 12, 13, 14, 9, 10, 11]}


def abaqus_mesh(mesh: Mesh, shift: int = 0, order: Sequence[int] | None = None, per_line: int = 7) -> str:
    """*NODE and *ELEMENT of a mesh; ``order`` of the nodes of its elements."""
    block = mesh.blocks[0]
    nodes = mesh.nodes.ids[block.nodes][:, order if order is not None else slice(None)] + shift
    text = ["*NODE"] + [
        f"{i + shift}, {x!r}, {y!r}, {z!r}"
        for i, (x, y, z) in zip(mesh.nodes.ids.tolist(), mesh.nodes.xyz.tolist(), strict=True)
    ]
    text.append(f"*ELEMENT, TYPE={ABAQUS_CODES[block.type]}, ELSET=Body")
    for i, row in zip(block.ids.tolist(), nodes.tolist(), strict=True):
        fields = [str(v) for v in [i + shift, *row]]
        text.append(",\n".join(", ".join(fields[k : k + per_line]) for k in range(0, len(fields), per_line)))
    return "\n".join(text) + "\n"


def _short(x: float) -> str:
    """A number in eight columns as Nastran allows it: no E, no zero before the point."""
    best = next(text for d in range(12, -1, -1) if len(text := _squeezed(x, d)) <= 8)
    return best.rjust(8)


def _squeezed(x: float, digits: int) -> str:
    mantissa, power = f"{x:.{digits}e}".split("e")
    return f"{mantissa if '.' in mantissa else mantissa + '.'}{int(power):+d}" if x else "0."


def nastran_card(name: str, fields: Sequence[str], form: str) -> str:
    """One card in small, large or free fields."""
    count = {"small": 8, "large": 4, "free": 8}[form]
    rows = [fields[i : i + count] for i in range(0, len(fields), count)]
    text = ""
    for k, row in enumerate(rows):
        if form == "free":
            text += ",".join([name if k == 0 else "", *row]) + "\n"
        elif form == "small":
            text += (name if k == 0 else "+").ljust(8) + "".join(f.rjust(8) for f in row) + "\n"
        else:
            text += (name + "*" if k == 0 else "*").ljust(8) + "".join(f.rjust(16) for f in row) + "\n"
    return text


def nastran_mesh(mesh: Mesh, form: str) -> str:
    """Grids and elements of a mesh, in small, large or free fields."""
    block = mesh.blocks[0]
    number = _short if form == "small" else (lambda x: f"{x:.9E}" if form == "large" else repr(x))
    text = ""
    for i, p in zip(mesh.nodes.ids.tolist(), mesh.nodes.xyz.tolist(), strict=True):
        text += nastran_card("GRID", [str(i), "", *(number(x) for x in p)], form)
    order = _NASTRAN_ORDER.get(block.type, list(range(block.nodes.shape[1])))
    for i, row in zip(block.ids.tolist(), mesh.nodes.ids[block.nodes].tolist(), strict=True):
        text += nastran_card(_NASTRAN_CARDS[block.type[:3]], [str(i), "1", *(str(row[k]) for k in order)], form)
    return text


def e21(value: float) -> str:
    """A number as Fortran's e21.13e3 prints it."""
    mantissa, exponent = f"{value:.13E}".split("E")
    return f"{mantissa}E{int(exponent):+04d}".rjust(21)


# Label and coordinates of a node as they are written, and the command, by the format of the block.
ARCHIVE_FORMS: dict[str, tuple[Callable[[int], str], Callable[[float], str], str]] = {
    "(3i9,6e21.13e3)": (lambda i: f"{i:9d}{0:9d}{0:9d}", e21, "NBLOCK,6,SOLID"),
    "(3i8,6e20.13)": (lambda i: f"{i:8d}{0:8d}{0:8d}", lambda v: f"{v:20.13E}", "NBLOCK,6,SOLID"),
    "(1i9,3e22.14e3)": (lambda i: f"{i:9d}", lambda v: e21(v).rjust(22), "nblock,3"),
}


def _ansys_element(kind: str, nodes: np.ndarray, quadratic_tets: int = 187) -> tuple[int, list[int]]:
    """Routine and nodes of an element as ANSYS numbers them; wedges and tetrahedra as degenerate bricks."""
    n = nodes.tolist()
    if kind in ("hex8", "hex20"):
        return (185 if kind == "hex8" else 186), n
    if kind == "wedge6":
        return 185, [*n[:3], n[2], *n[3:], n[5]]
    if kind == "tet4":
        return 45, [*n[:3], n[2], *[n[3]] * 4]
    if kind == "tet10" and quadratic_tets == 187:
        return 187, n
    if kind == "tet10":
        i, j, k, m, ij, jk, ki, im, jm, km = n
        return 95, [i, j, k, k, m, m, m, m, ij, jk, k, ki, m, m, m, m, im, jm, km, km]
    i, j, k, m, nn, o, ij, jk, ki, mn, no, om, im, jn, ko = n
    return 186, [i, j, k, k, m, nn, o, o, ij, jk, k, ki, mn, no, o, om, im, jn, ko, ko]


def ansys_elements(elements: Sequence[Element], plain: bool = False) -> str:
    """Lines of elements (label, type, material, real constants, nodes)."""
    lines = []
    for label, kind, material, real, nodes in elements:
        row = (
            [label, 1, real, material, 0, *nodes]
            if plain
            else [material, kind, real, 1, 0, 0, 0, 0, len(nodes), 0, label, *nodes]
        )
        cut = 15 if plain else 19
        lines += ["".join(f"{v:10d}" for v in part) + "\n" for part in (row[:cut], row[cut:]) if part]
    return "".join(lines)


def ansys_archive(
    mesh: Mesh,
    *,
    form: str = "(3i9,6e21.13e3)",
    before: str = "",
    after: str = "",
    plain: bool = False,
    tets: int = 187,
    extra: Sequence[Element] = (),
) -> str:
    """An archive of a mesh with nodes 101, 102, ..., as CDWRITE or (plain) Workbench writes it."""
    label, number, command = ARCHIVE_FORMS[form]
    nodes = [label(i) + "".join(map(number, x)).rstrip() for i, x in enumerate(mesh.nodes.xyz.tolist(), start=101)]
    block = mesh.blocks[0]
    formed = [_ansys_element(block.type, 101 + rows, tets) for rows in block.nodes]
    elements = [(i, 1, 1, 1, labels) for i, (_, labels) in enumerate(formed, start=1)] + list(extra)
    head = "EBLOCK,10,,,\n(15i10)" if plain else f"EBLOCK,19,SOLID,{len(elements)},{len(elements)}\n(19i10)"
    return "\n".join(
        [
            "/COM,ANSYS RELEASE",
            "/PREP7",
            f"ET,1,{formed[0][0]}",
            "TYPE,1",
            f"{before}{command},{len(nodes)},{len(nodes)}",
            form,
            *nodes,
            "N,R5.3,LOC,       -1,",
            head,
            f"{ansys_elements(elements, plain)}        -1",
            f"EN,R5.5,ATTR,       -1,\n{after}FINISH\n",
        ]
    )
