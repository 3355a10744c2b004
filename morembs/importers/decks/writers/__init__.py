"""Writers of decks; the table is the contents page.

A writer takes a deck and gives the lines of its text, and sentences on what differs in it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from morembs.base.errors import InputError, nearest
from morembs.importers.decks.tables import DeckTables
from morembs.importers.decks.writers.calculix import calculix_lines
from morembs.importers.decks.writers.nastran import nastran_lines
from morembs.storage.safefile import replacing

WRITERS: dict[str, Callable[[DeckTables], tuple[Iterator[str], list[str]]]] = {
    "calculix": calculix_lines,
    "abaqus": partial(calculix_lines, dialect="abaqus"),
    "nastran": nastran_lines,
}


def write_deck(deck: DeckTables, path: str | Path, format: str) -> tuple[str, ...]:
    """Write a deck as one flat file of a format; sentences on what differs in it.

    Raises:
        InputError: an unknown format, or what the format cannot say.
        OutputError: the file cannot be written; an old one is kept.
    """
    if format not in WRITERS:
        raise InputError(f"the format {format!r} of a deck was given; {nearest(format, WRITERS)}")
    lines, warnings = WRITERS[format](deck)
    with replacing(Path(path)) as file:
        for line in lines:
            file.write(line.encode() if line.endswith("\n") else f"{line}\n".encode())
    return tuple(dict.fromkeys(warnings))
