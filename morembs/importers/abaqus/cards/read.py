"""Input decks for CalculiX to assemble: mesh, cards, and elements that CalculiX has not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.cards.flat import flat_deck
from morembs.importers.abaqus.deck import DISCRETE, PLAIN, SOLIDS, STRUCTURES, Contents
from morembs.importers.abaqus.reader import read_deck
from morembs.importers.abaqus.whole import mesh_deck
from morembs.importers.decks.flat import Choices, FlatDeck
from morembs.importers.decks.model import Deck
from morembs.importers.decks.options import DeckOptions, deck_options
from morembs.importers.decks.problems import Problem

# Elements without stiffness and mass.
_EMPTY = ("SFM3D",)
_PLANE = ("CPE", "CPS", "CAX", "SAX", "MAX", "B21", "B22", "T2D", "CGAX", "PIPE21", "PIPE22")
_FLOW = ("DC3D", "DC2D", "DCC", "F3D", "DS", "AC3D")


def read_cards(
    path: Path,
    *,
    dialect: str = "auto",
    density: float | dict[str, float] | None = None,
    contact: str = "refuse",
    skip: list[str] | str = "",
    pretension: str = "auto",
    allow_includes_outside: bool = False,
) -> Deck:
    """The mesh of a file with sets, as CalculiX means it, and the cards that it reads in place of other tables.

    Args:
        dialect: the program that the deck was written for; what is of Abaqus says that CalculiX differs.
        density, contact, skip, pretension, allow_includes_outside: as of ``read_abaqus_deck``.

    Raises:
        DeckError: the text makes no sense.
    """
    options = deck_options(density, contact, skip, pretension)
    contents = contents_for_calculix(path, options, outside=allow_includes_outside)
    if dialect != "auto":
        contents.dialects = {dialect}
    with contents.problems.ending():
        assembly = Assembly(contents)
    blocks = [*assembly.blocks]
    deck = mesh_deck(contents, assembly)
    assembly.blocks = blocks

    def flat(choices: Choices) -> FlatDeck:
        contents.problems.entries = [*deck.problems]
        with contents.problems.ending():
            return flat_deck(contents, deck, assembly, choices)

    return replace(deck, cards=flat)


def contents_for_calculix(path: Path, options: DeckOptions, *, outside: bool = False) -> Contents:
    """What the deck says; elements that CalculiX has not are problems of it.

    Raises:
        DeckError: the text is no deck.
    """
    deck = read_deck(path, outside=outside, dialect="calculix", options=options, is_for_calculix=True)
    _refuse_others(deck)
    deck.dialects |= {"abaqus"} if deck.parts else set()
    return deck


def _refuse_others(deck: Contents) -> None:
    large = [code for code, count in deck.counts.items() if count and SOLIDS.get(code) == "hex27"]
    if large:
        what = f"{deck.name} has elements {', '.join(large)} of 27 nodes, which CalculiX has not; own assembly has them"
        deck.problems.add(Problem(what=what, file=deck.name, keyword="ELEMENT"))
    others = {code: count for code, count in deck.counts.items() if count and not _is_own(code)}
    asked = {code: others.pop(code) for code in list(others) if deck.options.skips(code)}
    deck.skipped |= {f"elements {code}": count for code, count in asked.items()}
    wrong = {code: count for code, count in others.items() if PLAIN.get(code, code) not in STRUCTURES}
    if not wrong:
        return
    # Without them nothing would be left.
    remains = len(wrong) < len(others) or any(count and code in SOLIDS for code, count in deck.counts.items())
    cure = f"; leave them out with --skip {','.join(wrong)} if the model is right without them" if remains else ""
    listed = ", ".join(f"{count} of the type {code!r}" for code, count in wrong.items())
    why = f"expected solids, {', '.join(STRUCTURES)}"
    if all(code.startswith(_PLANE) for code in wrong):
        why = "they are plane or axisymmetric, no body in space"
    elif all(code.startswith(_FLOW) or code == "D" for code in wrong):
        why = "they carry heat or a fluid and no forces"
    deck.problems.add(
        Problem(
            what=f"{deck.name} has elements that CalculiX does not make a body of: {listed}; {why}{cure}",
            file=deck.name,
            keyword="ELEMENT",
            flags=tuple(f"--skip {code}" for code in wrong) if remains else (),
        )
    )


def _is_own(code: str) -> bool:
    return code in SOLIDS or code in DISCRETE or code.startswith(_EMPTY)
