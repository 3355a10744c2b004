"""What *BOUNDARY of an input deck holds, outside of steps and in the first one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.data import fields
from morembs.importers.abaqus.deck import Contents
from morembs.importers.abaqus.equations import Axes
from morembs.importers.abaqus.keywords import Card
from morembs.importers.decks.tables import Supports

_DOFS = [str(dof) for dof in range(1, 12)]
# Conditions of Abaqus by name, as the first and the last dof that they hold.
_HOLD = {
    "ENCASTRE": ((1, 6),),
    "PINNED": ((1, 3),),
    "XSYMM": ((1, 1), (5, 6)),
    "YSYMM": ((2, 2), (4, 4), (6, 6)),
    "ZSYMM": ((3, 5),),
    "XASYMM": ((2, 4),),
    "YASYMM": ((1, 1), (3, 3), (5, 5)),
    "ZASYMM": ((1, 2), (6, 6)),
}


def supports_of(contents: Contents, assembly: Assembly, axes: Axes) -> Supports:
    """Labels and directions of what is held, each once; a motion that is given is held, too.

    Raises:
        InputError: lines that name no node, or no dofs.
    """
    first = contents.steps[0] if contents.steps else []
    kept = [] if starts_anew(first) else contents.cards
    given = [(scope, card, data) for scope, card, data in kept if card.keyword == "BOUNDARY"]
    given += [(contents.top, card, data) for card, data in first if card.keyword == "BOUNDARY"]
    nodes, directions = [np.empty(0, dtype=np.int64)], [np.empty((0, 6))]
    for scope, card, data in given:
        rows = [row for row in fields(data) if row]
        for placed in (*assembly.placed.values(), assembly.top):
            if not any(scope is own for own in placed.contents):
                continue
            for row in rows:
                own = assembly.nodes_of(placed, row[0])
                dofs = sorted({dof for a, b in spans_of(row, card) for dof in range(a, b + 1) if dof <= 6})
                nodes.append(np.repeat(own, len(dofs)))
                directions.append(_directions(own, dofs, axes))
    table = np.column_stack([np.concatenate(nodes), np.concatenate(directions)])
    table = table[np.sort(np.unique(table, axis=0, return_index=True)[1])]
    return Supports(nodes=assembly.ids[table[:, 0].astype(np.int64)], directions=table[:, 1:])


def starts_anew(step: Sequence[tuple[Card, bytes]]) -> bool:
    """True if a step lets go of what was held before: its first *BOUNDARY has OP=NEW."""
    operation = next((card.options.get("OP", "") for card, _ in step if card.keyword == "BOUNDARY"), "")
    return operation.upper() == "NEW"


def _directions(nodes: Ints, dofs: list[int], axes: Axes) -> Floats:
    """Directions (nodes x dofs, 6) of dofs from 1, along the axes of nodes that have their own."""
    plain = np.tile(np.eye(6)[np.array(dofs, dtype=np.int64) - 1], (len(nodes), 1))
    for i, node in enumerate(nodes.tolist()):
        if axes.has_own_axes(node):
            plain[i * len(dofs) : (i + 1) * len(dofs)] = [axes.part(node, dof - 1) for dof in dofs]
    return plain


def spans_of(row: list[str], card: Card) -> Iterable[tuple[int, int]]:
    """The first and the last dof of each span that a line of *BOUNDARY holds."""
    words = [text for text in row[1:3] if text]
    if words and words[0].upper() in _HOLD:
        return _HOLD[words[0].upper()]
    if not words or not all(text in _DOFS for text in words):
        raise InputError(f"{card}: {', '.join(row)[:60]!r} was given; expected a node or set and dofs")
    return [(int(words[0]), int(words[-1]))]
