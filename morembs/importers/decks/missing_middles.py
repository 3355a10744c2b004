"""Middle nodes that some edges of quadratic elements do not have.

A middle node that moves as the mean of its two corners makes its edge linear, which is the serendipity element with
fewer nodes (Bathe 2014, section 5.3.2): so such an edge is given a node that depends on its corners.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from morembs.base.types import Ints
from morembs.fem.constraints import Equations
from morembs.fem.elements import TYPES
from morembs.importers.decks.labels import Labels
from morembs.importers.decks.tables import DeckTables

Tables = TypeVar("Tables", bound=DeckTables)
LINEAR_EDGES = "edges without middle nodes"


def with_middles(deck: Tables) -> Tables:
    """The deck with all middle nodes of its solids: new ones behind its nodes, and equations by which they move.

    Elements with the same corners share a node.

    Raises:
        InputError: corners that are not defined, or nodes that are there twice.
    """
    gaps = {i: np.nonzero(part.nodes == 0) for i, part in enumerate(deck.elements) if part.kind == "solid"}
    gaps = {i: places for i, places in gaps.items() if len(places[0])}
    if not gaps:
        return deck
    ends = [
        np.sort(deck.elements[i].nodes[element[:, None], _corners_of_middles(deck.elements[i].shape)[middle]], axis=1)
        for i, (element, middle) in gaps.items()
    ]
    pairs, which = np.unique(np.concatenate(ends), axis=0, return_inverse=True)
    first, elements, at = int(deck.ids.max(initial=0)) + 1, list(deck.elements), 0
    for i, places in gaps.items():
        nodes = elements[i].nodes.copy()
        nodes[places] = first + which.ravel()[at : at + len(places[0])]
        at += len(places[0])
        elements[i] = replace(elements[i], nodes=nodes)
    corners = Labels(deck.ids, deck.name, deck.node).rows(pairs, "elements name")
    note = (
        f"{len(pairs)} edges of quadratic elements have no middle node; nodes with labels from {first} were added, "
        "which move as the means of their corners."
    )
    return replace(
        deck,
        ids=np.concatenate([deck.ids, first + np.arange(len(pairs))]),
        xyz=np.concatenate([deck.xyz, deck.xyz[corners].mean(axis=1)]),
        elements=tuple(elements),
        equations=(*deck.equations, _equations(pairs, first)),
        notes=(*deck.notes, note),
    )


def _equations(pairs: Ints, first: int) -> Equations:
    """Displacements of the nodes from ``first`` on as means of those of the corners in ``pairs`` (m, 2)."""
    count = 3 * len(pairs)
    nodes = np.repeat(first + np.arange(len(pairs)), 3)
    components = np.tile(np.arange(3), len(pairs))
    return Equations(
        name=LINEAR_EDGES,
        nodes=nodes,
        components=components,
        offsets=2 * np.arange(count + 1),
        term_nodes=np.repeat(pairs, 3, axis=0).ravel(),
        term_components=np.repeat(components, 2),
        coefficients=np.full(2 * count, 0.5),
    )


def _corners_of_middles(kind: str) -> Ints:
    """Corners (n, 2) whose mean is each node; those of corners themselves are no edge."""
    reference = TYPES[kind].reference
    pairs = np.stack(np.triu_indices(len(reference), 1), axis=1)
    means = reference[pairs].mean(axis=1)
    return np.asarray(pairs[np.linalg.norm(means - reference[:, None], axis=2).argmin(axis=1)])
