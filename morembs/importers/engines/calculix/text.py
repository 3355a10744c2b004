"""Nodes, elements and sets as CalculiX reads them."""

from __future__ import annotations

import numpy as np

from morembs.base.types import Floats, Ints
from morembs.fem import ElementBlock
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.tolerances import TOL


class Line:
    """What CalculiX takes of a line (CalculiX CrunchiX User's Manual): characters of a number, entries of sets and
    elements."""

    NUMBER_CHARACTERS = 20
    SET_ENTRIES = 16
    ELEMENT_ENTRIES = 10


# Types by shape and formulation, as ``formulations`` has them for CalculiX.
_CODES = {
    ("tet4", "full"): "C3D4",
    ("tet10", "full"): "C3D10",
    ("wedge6", "reduced"): "C3D6",
    ("wedge15", "full"): "C3D15",
    ("hex8", "full"): "C3D8",
    ("hex8", "mean-strain"): "C3D8R",
    ("hex8", "incompatible"): "C3D8I",
    ("hex20", "full"): "C3D20",
    ("hex20", "reduced"): "C3D20R",
}
# Elements on single nodes that CalculiX has; most masses and distributing couplings are added to its matrices.
_DISCRETE = ("SPRING1", "SPRING2", "SPRINGA")


def numeral(value: float) -> str:
    """A number in the characters that CalculiX reads."""
    text = repr(float(value))
    return text if len(text) <= Line.NUMBER_CHARACTERS else f"{value:.12e}"


def elastic_lines(C: Floats) -> list[str]:
    """*ELASTIC of the stiffness C (6, 6) along the global axes; by two constants where these say it all."""
    lam, mu = C[0, 1], C[3, 3]
    plain = np.diag([2 * mu] * 3 + [mu] * 3)
    plain[:3, :3] += lam
    if np.abs(C - plain).max() <= TOL.isotropic_error * np.abs(C).max():
        return ["*ELASTIC", f"{numeral(mu * (3 * lam + 2 * mu) / (lam + mu))}, {numeral(lam / (2 * (lam + mu)))}"]
    # Columns of the upper triangle, shear in the order 12, 13, 23.
    order = [0, 1, 2, 5, 4, 3]
    constants = [numeral(C[order[i], order[j]]) for j in range(6) for i in range(j + 1)]
    return ["*ELASTIC, TYPE=ANISO", *(", ".join(constants[i : i + 8]) for i in (0, 8, 16))]


def sixteen(labels: Ints) -> list[str]:
    """Data lines of a set."""
    entries = list(map(str, labels.tolist()))
    return [", ".join(entries[i : i + Line.SET_ENTRIES]) + "," for i in range(0, len(entries), Line.SET_ENTRIES)]


def node_lines(assembly: Assembly) -> list[str]:
    """All nodes with labels from 1."""
    rows = zip(range(1, len(assembly.ids) + 1), assembly.xyz.tolist(), strict=True)
    return ["*NODE", *(f"{i}, {', '.join(map(numeral, x))}" for i, x in rows)]


def element_lines(assembly: Assembly, blocks: tuple[ElementBlock, ...], masses: set[int]) -> list[str]:
    """All elements in the order of their numbers, of point masses some."""
    lines, number, most = [], 1, Line.ELEMENT_ENTRIES

    def block(code: str, nodes: Ints) -> None:
        nonlocal number
        lines.append(f"*ELEMENT, TYPE={code}")
        for row in (nodes + 1).tolist():
            entries = [str(number), *map(str, row)]
            lines.extend(
                ", ".join(entries[i : i + most]) + ("," if i + most < len(entries) else "")
                for i in range(0, len(entries), most)
            )
            number += 1

    for part in blocks:
        block(_CODES[part.type, part.formulation], part.nodes)
    for element in assembly.discrete:
        if element.code in _DISCRETE or element.number in masses:
            number = element.number + 1
            block(element.code, np.array([element.nodes]))
    number = 1 + assembly.solids + len(assembly.discrete)
    for code, _, nodes in assembly.others:
        if nodes.shape[1]:
            block(code, nodes)
        else:
            number += len(nodes)
    return lines
