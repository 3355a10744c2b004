"""Shells and beams of a deck as solids, as CalculiX expands them: one deck becomes another, for all later steps.

``sections`` says what each element is made of, ``normals`` which elements share a fibre or cross-section at a node,
``solids`` where the nodes of these are, ``equations`` how those of one node hang together, ``names`` what sets and
couplings that name a node mean.

A node of the deck with one fibre or cross-section is at the mean of its corners, with three translations. One with
several is a knot with three rotations and its stretches, which all their nodes follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from morembs.base.types import Ints
from morembs.importers.decks.expansion.equations import knot_equations
from morembs.importers.decks.expansion.names import with_names
from morembs.importers.decks.expansion.normals import Corners, Fibres, fibres_of
from morembs.importers.decks.expansion.sections import SOLIDS, Structure, is_expanded, solid_sections, structures_of
from morembs.importers.decks.expansion.solids import FibreNodes, corners_of, solid_nodes
from morembs.importers.decks.formulations import warnings_of
from morembs.importers.decks.labels import Labels
from morembs.importers.decks.problems import Problems
from morembs.importers.decks.tables import DeckTables, Elements


def expand(deck: DeckTables, problems: Problems) -> DeckTables:
    """The deck with solids for its shells and beams; unsupported ones are added to ``problems``.

    Raises:
        InputError: elements without a size or a direction, or labels that are not there.
    """
    parts = structures_of(deck, problems)
    if not parts:
        return deck
    labels = Labels(deck.ids, deck.name, deck.node)
    corners = [corners_of(part, deck.xyz, labels.rows(part.elements.nodes, "elements name")) for part in parts]
    whole = Corners(**{name: np.concatenate([vars(own)[name] for own in corners]) for name in vars(corners[0])})
    fibres = fibres_of(whole, len(deck.ids))
    solids, nodes = _solids(deck, parts, whole, fibres)
    sets, sections = solid_sections(deck, parts)
    made = nodes.labels > 0
    equations, stretches, places = knot_equations(deck, fibres, nodes)
    return with_names(
        replace(
            deck,
            ids=np.concatenate([deck.ids, nodes.labels[made], stretches]),
            xyz=np.concatenate([deck.xyz, nodes.xyz[made], places]),
            elements=(*(part for part in deck.elements if not is_expanded(part)), *solids),
            element_sets={**deck.element_sets, **sets},
            sections=(*(own for own in deck.sections if own.kind == "solid"), *sections),
            equations=(*deck.equations, *equations),
            mesh_warnings=(*deck.mesh_warnings, *_warnings(deck, parts)),
        ),
        nodes,
        problems,
    )


def _solids(
    deck: DeckTables, parts: Sequence[Structure], corners: Corners, fibres: Fibres
) -> tuple[list[Elements], FibreNodes]:
    """A solid for each element, and the nodes of fibres."""
    numbers, shapes, start = list[Ints](), list[str](), 0
    for part in parts:
        fibre = fibres.of[start : start + part.elements.nodes.size].reshape(part.elements.nodes.shape)
        shape, own = solid_nodes(part.elements.shape, fibre)
        numbers.append(own)
        shapes.append(shape)
        start += fibre.size
    nodes = FibreNodes.of(deck, corners, fibres, np.concatenate([own.ravel() for own in numbers]))
    solids = [
        Elements(
            code=part.elements.code,
            kind="solid",
            shape=shape,
            ids=part.elements.ids,
            nodes=nodes.labels.ravel()[own],
            meaning=SOLIDS[part.elements.code],
        )
        for part, shape, own in zip(parts, shapes, numbers, strict=True)
    ]
    return solids, nodes


def _warnings(deck: DeckTables, parts: Sequence[Structure]) -> list[str]:
    """What differs from the program of the deck, a sentence for each type."""
    counts: dict[str, int] = {}
    for part in parts:
        counts[part.elements.code] = counts.get(part.elements.code, 0) + len(part.elements.ids)
    if deck.program == "CalculiX":
        return warnings_of(deck.program, ((code, n, SOLIDS[code]) for code, n in counts.items()))
    return [
        f"{count} elements {code} are expanded to solids as CalculiX does, which {deck.program} does not: its own may "
        "be softer or stiffer [formulation-differs]"
        for code, count in counts.items()
    ]
