"""Nodes, elements and sets as CalculiX reads them."""

from __future__ import annotations

import numpy as np

from morembs.base.types import Bools, Ints
from morembs.fem import ElementBlock
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.decks.writers.calculix_mesh import entry_lines, numeral, solid_code

# Elements on single nodes that CalculiX has; most masses and distributing couplings are added to its matrices.
_DISCRETE = ("SPRING1", "SPRING2", "SPRINGA")


def node_lines(assembly: Assembly) -> list[str]:
    """All nodes with labels from 1."""
    rows = zip(range(1, len(assembly.ids) + 1), assembly.xyz.tolist(), strict=True)
    return ["*NODE", *(f"{i}, {', '.join(map(numeral, x))}" for i, x in rows)]


def element_lines(assembly: Assembly, blocks: tuple[ElementBlock, ...], masses: set[int], reduced: Bools) -> list[str]:
    """All elements with their numbers from 1, of point masses some; ``reduced`` (elements,) ones by the type with R."""
    lines = list[str]()

    def block(code: str, numbers: Ints, nodes: Ints) -> None:
        if len(nodes):
            lines.extend([f"*ELEMENT, TYPE={code}", *entry_lines(np.column_stack([numbers + 1, nodes + 1]))])

    number = 0
    for part in blocks:
        block(solid_code(part.type, part.formulation), number + np.arange(len(part.nodes)), part.nodes)
        number += len(part.nodes)
    for element in assembly.discrete:
        if element.code in _DISCRETE or element.number in masses:
            block(element.code, np.array([element.number]), np.array([element.nodes]))
    number = assembly.solids + len(assembly.discrete)
    for code, _, nodes in assembly.others:
        numbers = number + np.arange(len(nodes))
        number += len(nodes)
        if nodes.shape[1]:
            is_reduced = reduced[numbers]
            block(code, numbers[~is_reduced], nodes[~is_reduced])
            block(f"{code}R", numbers[is_reduced], nodes[is_reduced])
    return lines
