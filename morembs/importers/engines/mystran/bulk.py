"""Decks of other programs as bulk data that MYSTRAN is given."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from morembs.base.options import known
from morembs.base.scratch import ScratchFolder
from morembs.importers.abaqus.importer import read_abaqus_deck
from morembs.importers.decks.model import Deck
from morembs.importers.decks.problems import DeckError
from morembs.importers.decks.tables import NOT_WRITTEN
from morembs.importers.engines.mystran.structures import with_structures
from morembs.importers.imported import Imported


@dataclass(frozen=True, kw_only=True, eq=False)
class Source:
    """Where the bulk data lie; the ``deck`` that they were written of, None where they are the file itself, and what
    is to be said of the writing."""

    bulk: Path
    deck: Deck | None = None
    warnings: tuple[str, ...] = ()

    def density(self, given: float | Mapping[str, float] | None) -> float | dict[str, float] | None:
        """Densities for properties of the bulk data: those of sets of another deck are in these already."""
        if self.deck is None or not isinstance(given, Mapping):
            return dict(given) if isinstance(given, Mapping) else given
        return {"all": given["all"]} if "all" in given else None

    def whole(self, imported: Imported) -> Imported:
        """The model with the name and the sets of the deck that the bulk data were written of."""
        deck = self.deck
        if deck is None or imported.nodes is None:
            return imported
        sets = {name: rows for name, rows in imported.nodes.sets.items() if not name.startswith("SET1")}
        row = {label: i for i, label in enumerate(imported.nodes.ids.tolist())}
        for name, ranges in deck.node_sets.items():
            labels = (label for a, b in ranges.tolist() for label in range(a, b + 1))
            rows = sorted(row[label] for label in labels if label in row)
            if rows:
                sets[name] = np.array(rows)
        return replace(
            imported,
            source=deck.name,
            nodes=replace(imported.nodes, sets=sets),
            notes=(*imported.notes, *deck.notes, *deck.remarks),
            warnings=tuple(dict.fromkeys((*deck.warnings, *self.warnings, *imported.warnings))),
        )


@contextmanager
def as_bulk(path: Path, format: str, options: Mapping[str, Any]) -> Iterator[Source]:
    """The bulk data of a deck of a format, in a folder of their own where they have to be written.

    Raises:
        DeckError: what keeps the deck from becoming a model, whoever assembles it.
        InputError: what bulk data cannot say.
    """
    if format == "nastran":
        yield Source(bulk=path)
        return
    deck = read_abaqus_deck(path, **{key: value for key, value in options.items() if key in known(read_abaqus_deck)})
    deck = with_structures(deck, path, deck.options, outside=options.get("allow_includes_outside", False))
    problems = [*deck.problems, *(part.problem for part in deck.elements if part.problem)]
    if problems:
        raise DeckError(deck.name, problems, deck.options.flags)
    with closing(ScratchFolder(None)) as scratch:
        bulk = scratch.path / f"{path.stem}.bdf"
        said = (sentence for sentence in deck.write(bulk, "nastran") if NOT_WRITTEN not in sentence)
        yield Source(bulk=bulk, deck=deck, warnings=tuple(said))
