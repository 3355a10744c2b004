"""Writers of decks; the table is the contents page.

A writer takes a deck and gives the lines of its text, and sentences on what differs in it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from morembs.base.arguments import check_value
from morembs.base.errors import InputError, OverwriteError, nearest
from morembs.importers.decks.labels import in_ranges
from morembs.importers.decks.materials import complete
from morembs.importers.decks.problems import Problems
from morembs.importers.decks.tables import NOT_WRITTEN, DeckTables
from morembs.importers.decks.writers.calculix import calculix_lines
from morembs.importers.decks.writers.nastran import nastran_lines
from morembs.storage.contents import same_place
from morembs.storage.safefile import replacing

WRITERS: dict[str, Callable[[DeckTables], tuple[Iterator[str], list[str]]]] = {
    "calculix": calculix_lines,
    "abaqus": partial(calculix_lines, dialect="abaqus"),
    "nastran": nastran_lines,
}
# Kinds of elements without cards of their own: what single nodes carry is among masses and springs.
_NOT_WRITTEN = ("point", "none")

# Values of single elements, by their kind, that are written.
_WRITTEN_VALUES = {
    *(("beam", name) for name in ("offset", "direction", "released")),
    *(("shell", name) for name in ("thickness", "offset", "direction", "angle")),
}
# Those that CalculiX and Abaqus have cards for.
_NOT_OF_NASTRAN = {("beam", "normal"), ("shell", "normal"), ("membrane", "normal")}


def write_deck(deck: DeckTables, path: str | Path, format: str) -> tuple[str, ...]:
    """Write a deck as one flat file of a format; sentences on what differs in it.

    Raises:
        DeckError: what keeps the deck from becoming a model, which the written deck would not show.
        InputError: an unknown format, or what the format cannot say.
        OverwriteError: ``path`` is a file that the deck was read from.
        OutputError: the file cannot be written; an old one is kept.
    """
    check_value("path", path, str | Path)
    if format not in WRITERS:
        raise InputError(
            f"the format {format!r} of a deck was given; {nearest(format, WRITERS)}", kind="unknown", keyword="format"
        )
    if any(same_place(path, file) for file in deck.files):
        raise OverwriteError(
            f"{path} would overwrite a file that the deck was read from; give the result another name", keyword="out"
        )
    _refuse_problems(deck)
    first_new = len(deck.warnings)
    deck = complete(deck)
    refuse_values(deck, format)
    lines, warnings = WRITERS[format](deck)
    if deck.left_out:
        listed = ", ".join(f"{name} ({own.count})" for name, own in deck.left_out.items())
        warnings.append(f"{deck.name} has more that is not written: {listed} {NOT_WRITTEN}")
    with replacing(Path(path)) as file:
        for line in lines:
            file.write(line.encode() if line.endswith("\n") else f"{line}\n".encode())
    return tuple(dict.fromkeys([*deck.warnings[first_new:], *without_section(deck), *warnings]))


def _refuse_problems(deck: DeckTables) -> None:
    """Refuse what keeps a deck from becoming a model, but for elements that own assembly lacks and writers have.

    Raises:
        DeckError: there is any.
    """
    problems = Problems(deck.name, deck.options.flags)
    unwritten = [part.problem for part in deck.elements if part.problem and part.kind in _NOT_WRITTEN]
    of_elements = [part.problem for part in deck.elements if part.problem]
    problems.entries += [*unwritten, *(problem for problem in deck.problems if problem not in of_elements)]
    problems.refuse()


def without_section(deck: DeckTables) -> list[str]:
    """A sentence on elements that have no material, as they are in no section."""
    bare = 0
    for part in deck.elements:
        own = [deck.ranges(section.set) for section in deck.sections if section.kind == part.kind]
        if part.kind not in _NOT_WRITTEN:
            bare += int(np.sum(~in_ranges(part.ids, np.concatenate([np.empty((0, 2), dtype=np.int64), *own]))))
    return [f"{bare} elements are in no section, so have no material"] if bare else []


def refuse_values(deck: DeckTables, format: str) -> None:
    """Refuse values of single elements that a format does not have here.

    Raises:
        InputError: there are any.
    """
    written = _WRITTEN_VALUES if format == "nastran" else _WRITTEN_VALUES | _NOT_OF_NASTRAN
    for part in deck.elements:
        for name, values in part.values.items():
            if (part.kind, name) not in written and np.isfinite(values).any():
                raise InputError(
                    f"{deck.name}: {part.code} elements have {name} of their own, which {format!r} decks written here "
                    "lack; give it to their section",
                    kind="unsupported",
                )
    for section in deck.sections:
        if "NODAL THICKNESS" in section.code:
            raise InputError(
                f"{deck.name}: {section.code} of the set {section.set} takes the thickness from nodes, which is not "
                "read; give it to the section",
                kind="unsupported",
                keyword="thickness",
            )
