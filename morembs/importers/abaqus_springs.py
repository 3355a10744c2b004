"""*SPRING and *DASHPOT of an input deck as entries of K and D."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.importers.abaqus_assembly import Assembly, Discrete
from morembs.importers.abaqus_deck import Rows, values
from morembs.importers.abaqus_equations import Axes
from morembs.importers.abaqus_keywords import Card
from morembs.importers.discrete import spring
from morembs.importers.imported import DiscreteElement

Floats = NDArray[np.float64]
_MATRIX = {"SPRING": "K", "DASHPOT": "D"}


def spring_of(
    assembly: Assembly, axes: Axes, element: Discrete, card: Card, rows: Rows, warnings: list[str]
) -> DiscreteElement:
    """A spring or dashpot with the lines of its property.

    SPRING1 is between a node and the ground, SPRING2 between two nodes, each along given directions; SPRINGA acts along
    the line through its nodes.

    Raises:
        InputError: lines that do not fit, directions along an *ORIENTATION, or two ends at one place.
    """
    if card.options.get("ORIENTATION"):
        raise InputError(f"{card} acts along an *ORIENTATION, which is not supported; give it in global directions")
    along_line = element.code.endswith("A")
    lines = [values(row, card) for row in rows if row]
    if not lines or (not along_line and len(lines) < 2):
        raise InputError(f"{card} has {len(lines)} lines; expected its directions and its constant below them")
    value = _constant(card, lines if along_line else lines[1:], warnings)
    name = f"{card.options['ELSET']}:{element.label}"
    if along_line:
        a, b = (assembly.xyz[node] for node in element.nodes)
        length = np.linalg.norm(b - a)
        if not length > 0:
            raise InputError(f"{card}: the ends of the element {element.label} are at one place; expected a line")
        part = np.concatenate([(b - a) / length, np.zeros(3)])
        return spring(name, _MATRIX[card.keyword], [(element.nodes[0], -part), (element.nodes[1], part)], value)
    directions = [int(d) - 1 for d in lines[0] if d]
    if len(directions) == 1 and len(element.nodes) == 2:
        directions *= 2
    if len(directions) != len(element.nodes) or not all(0 <= d < 6 for d in directions):
        raise InputError(f"{card} gives the directions {lines[0]}; expected one of 1 to 6 for each node of an element")
    signs = (1.0, -1.0)
    ends = [
        (node, sign * axes.part(node, d))
        for node, d, sign in zip(element.nodes, directions, signs[: len(directions)], strict=True)
    ]
    return spring(name, _MATRIX[card.keyword], ends, value)


def _constant(card: Card, lines: list[list[float]], warnings: list[str]) -> float:
    """The constant; the slope at zero of a table of forces."""
    if "NONLINEAR" not in card.options:
        if len(lines) > 1:
            warnings.append(
                f"{card} of {card.options['ELSET']} depends on temperature or frequency; its first line was taken "
                "[temperature-first-row]"
            )
        return lines[0][0]
    table = np.array([[*row, 0.0][:2] for row in lines])
    force, motion = table[np.argsort(table[:, 1], kind="stable")].T
    if len(table) < 2 or not (np.diff(motion) > 0).all():
        raise InputError(f"{card} is nonlinear and gives no table of forces over growing motions; expected one")
    warnings.append(f"{card} of {card.options['ELSET']} is nonlinear; its slope at zero was taken [spring-slope]")
    i = int(np.clip(np.searchsorted(motion, 0.0, side="right") - 1, 0, len(motion) - 2))
    return float((force[i + 1] - force[i]) / (motion[i + 1] - motion[i]))
