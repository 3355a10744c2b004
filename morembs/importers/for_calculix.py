"""Decks of all families for CalculiX: the one way from a file to what its engine takes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from morembs.base.options import list_options
from morembs.importers.abaqus.cards.read import read_cards
from morembs.importers.ansys.cdb import read_ansys
from morembs.importers.decks.model import Deck
from morembs.importers.decks.options import DeckOptions
from morembs.importers.nastran.importer import read_nastran
from morembs.importers.unv import read_unv

_READERS: dict[str, Callable[..., Deck]] = {
    "abaqus": read_cards,
    "ansys": read_ansys,
    "nastran": read_nastran,
    "unv": read_unv,
}
FORMATS = tuple(_READERS)


def read_for_calculix(
    path: Path, format: str, options: DeckOptions, *, dialect: str = "auto", outside: bool = False
) -> Deck:
    """A deck of one of ``FORMATS``: with ``cards`` where its family is that of CalculiX.

    Args:
        dialect: the program that a deck with cards was written for.
        outside: includes may name files beyond the folder of the deck.

    Raises:
        DeckError: the text makes no sense.
    """
    given = {
        "density": dict(options.density) or None,
        "contact": options.contact,
        "pretension": options.pretension,
        "skip": sorted(options.skip),
        "allow_includes_outside": outside,
        "dialect": dialect,
    }
    read = _READERS[format]
    return read(path, **{name: own for name, own in given.items() if name in list_options(read)})
