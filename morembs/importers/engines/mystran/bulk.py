"""Decks of other programs as bulk data that MYSTRAN is given."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from morembs.base.options import known
from morembs.base.scratch import ScratchFolder
from morembs.fem.material import Material
from morembs.importers.abaqus.importer import read_abaqus_deck
from morembs.importers.decks.materials import complete, lacking_of, problems_of_solids
from morembs.importers.decks.model import Deck
from morembs.importers.decks.options import lacking_problems
from morembs.importers.decks.problems import Problems
from morembs.importers.decks.tables import NOT_WRITTEN
from morembs.importers.engines.mystran.structures import with_structures
from morembs.importers.imported import Imported
from morembs.importers.nastran.importer import HEAD_NOTE


@dataclass(frozen=True, kw_only=True, eq=False)
class Source:
    """Where the bulk data lie; the ``deck`` that they were written of, None where they are the file itself, what is
    to be said of the writing, and the ``materials`` that are given for sets of the bulk data."""

    bulk: Path
    deck: Deck | None = None
    warnings: tuple[str, ...] = ()
    materials: tuple[Material, ...] = ()

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
        # What lacks a density is told by the names of the deck.
        warnings = [said for said in imported.warnings if not said.endswith("[no-density]")]
        return replace(
            imported,
            source=deck.name,
            nodes=replace(imported.nodes, sets=sets),
            notes=(*(note for note in imported.notes if note != HEAD_NOTE), *deck.notes, *deck.remarks),
            warnings=tuple(dict.fromkeys((*deck.warnings, *self.warnings, *warnings))),
        )


@contextmanager
def as_bulk(path: Path, format: str, options: Mapping[str, Any], materials: Sequence[Material]) -> Iterator[Source]:
    """The bulk data of a deck of a format, in a folder of their own where they have to be written.

    Args:
        materials: given ones of sets of the deck, which bulk data that are written have as their own.

    Raises:
        DeckError: what keeps the deck from becoming a model, whoever assembles it.
        InputError: what bulk data cannot say.
    """
    if format == "nastran":
        yield Source(bulk=path, materials=tuple(materials))
        return
    deck = read_abaqus_deck(path, **{key: value for key, value in options.items() if key in known(read_abaqus_deck)})
    deck = with_structures(deck, path, deck.options, outside=options.get("allow_includes_outside", False))
    problems = Problems(deck.name, deck.options.flags)
    problems.entries = [*deck.problems, *(part.problem for part in deck.elements if part.problem)]
    problems.refuse()
    with problems.ending():
        deck = complete(deck, materials)
    problems.entries += problems_of_solids(deck, materials)
    said = _without_mass(deck, problems)
    problems.refuse()
    with closing(ScratchFolder(None)) as scratch:
        # Messages name the deck of the user.
        bulk = scratch.path / path.name
        said += [sentence for sentence in deck.write(bulk, "nastran") if NOT_WRITTEN not in sentence]
        yield Source(bulk=bulk, deck=deck, warnings=tuple(said))


def _without_mass(deck: Deck, problems: Problems) -> list[str]:
    """Sections of shells, beams and trusses without any mass: problems where nothing else has one, else warnings."""
    solid = {own.set for own in deck.sections if own.kind == "solid"}
    lacking = {name: lack for name, lack in lacking_of(deck).items() if name not in solid}
    heavy = len(lacking) < len(deck.sections) or deck.masses or any(own.matrix == "M" for own in deck.discrete)
    if heavy:
        return [f"{own.sentence} and gives no mass; --density fills it in [no-density]" for own in lacking.values()]
    problems.entries += lacking_problems(deck.name, lacking)
    return []
