"""Decks of other programs for CalculiX: as flat decks, with what those cannot say beside the matrices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from morembs.fem import Nodes
from morembs.fem.material import Material
from morembs.importers.decks.flat import refuse_no_elements
from morembs.importers.decks.labels import Labels
from morembs.importers.decks.materials import complete, problems_of_solids
from morembs.importers.decks.model import Deck
from morembs.importers.decks.problems import DeckError, Problem, Problems
from morembs.importers.decks.tables import NOT_WRITTEN
from morembs.importers.imported import Imported, nodes_of, on_rows


def completed(deck: Deck, materials: Sequence[Material]) -> Deck:
    """A deck all of whose solids have a material.

    Raises:
        DeckError: all that keeps it from being written for CalculiX.
    """
    problems = Problems(deck.name, deck.options.flags)
    problems.entries = [*deck.problems, *(part.problem for part in deck.elements if part.problem)]
    if all(part.kind in ("point", "none") for part in deck.elements):
        refuse_no_elements(problems)
    with problems.ending():
        deck = complete(deck, materials)
    problems.entries += problems_of_solids(deck, materials)
    problems.refuse()
    return deck


def write_other(deck: Deck, folder: Path) -> tuple[Path, tuple[str, ...]]:
    """A flat deck without masses, springs and average elements, and what differs in it.

    Raises:
        InputError: what CalculiX cannot say.
    """
    path = folder / f"{Path(deck.name).stem}.inp"
    said = replace(deck, average=(), masses=(), discrete=()).write(path, "calculix")
    return path, tuple(sentence for sentence in said if NOT_WRITTEN not in sentence)


def with_others(imported: Imported, deck: Deck, said: Sequence[str]) -> Imported:
    """What CalculiX made of the flat deck, with masses, springs and average elements of the deck on its nodes.

    Raises:
        DeckError: they name nodes that are not there.
    """
    nodes = imported.nodes
    if nodes is None:
        raise DeckError(deck.name, [Problem(what=f"{deck.name} has no nodes after CalculiX; please report it")])
    wanted = nodes_of([*deck.average, *deck.masses, *deck.discrete])
    loose = np.setdiff1d(wanted, nodes.ids)
    at = Labels(deck.ids, deck.name, deck.node).rows(loose, "couplings name")
    nodes = Nodes(ids=np.append(nodes.ids, loose), xyz=np.vstack([nodes.xyz, deck.xyz[at]]), sets=nodes.sets)
    labels = Labels(nodes.ids, deck.name, deck.node)

    def rows(given: np.ndarray) -> np.ndarray:
        return labels.rows(given, "couplings name")

    return replace(
        imported,
        source=deck.name,
        nodes=nodes,
        average=(*imported.average, *on_rows(deck.average, rows)),
        masses=(*imported.masses, *on_rows(deck.masses, rows)),
        discrete=(*imported.discrete, *on_rows(deck.discrete, rows)),
        notes=(*imported.notes, *deck.notes, *deck.remarks),
        warnings=(*deck.warnings, *deck.options.idle, *said, *imported.warnings),
    )
