"""Nodes, elements and sets as CalculiX reads them."""

from __future__ import annotations

import numpy as np

from morembs.base.types import Ints
from morembs.fem import ElementBlock
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.decks.writers.calculix_mesh import Line, numeral

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
