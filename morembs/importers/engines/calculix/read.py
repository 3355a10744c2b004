"""Input decks for CalculiX to assemble: the tables of the own reader, and elements that CalculiX has not."""

from __future__ import annotations

from pathlib import Path

from morembs.importers.abaqus.deck import DISCRETE, PLAIN, SOLIDS, STRUCTURES, Contents
from morembs.importers.abaqus.reader import read_deck
from morembs.importers.decks.options import DeckOptions
from morembs.importers.decks.problems import Problem, Problems

# Elements without stiffness and mass.
_EMPTY = ("SFM3D",)
_PLANE = ("CPE", "CPS", "CAX", "SAX", "MAX", "B21", "B22", "T2D", "CGAX", "PIPE21", "PIPE22")
_FLOW = ("DC3D", "DC2D", "DCC", "F3D", "DS", "AC3D")


def read_for_engine(path: Path, options: DeckOptions, *, outside: bool = False) -> Contents:
    """The deck of a file as CalculiX means it; elements that it has not are problems of the deck.

    Raises:
        InputError: the text is no deck.
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


def refuse_no_elements(problems: Problems) -> None:
    """Refuse a deck without elements that have stiffness and mass, with what else is wrong with it.

    Raises:
        DeckError: always.
    """
    what = f"{problems.source} has no solids, shells, membranes, beams or trusses, so CalculiX has nothing to assemble"
    problems.add(Problem(what=what, file=problems.source, keyword="ELEMENT"))
    problems.refuse()


def _is_own(code: str) -> bool:
    return code in SOLIDS or code in DISCRETE or code.startswith(_EMPTY)
