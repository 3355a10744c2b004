"""Input decks for CalculiX to assemble: the tables of the own reader, and all else as it stands."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from morembs.base.errors import InputError
from morembs.importers.abaqus.blocks import line_records
from morembs.importers.abaqus.data import fields
from morembs.importers.abaqus.deck import (
    DISCRETE,
    NODES,
    PLAIN,
    SOLIDS,
    STRUCTURES,
    Contents,
    Members,
    Rows,
    Scope,
    join,
    width_of,
)
from morembs.importers.abaqus.generate import GENERATING
from morembs.importers.abaqus.keywords import Card, cards
from morembs.importers.abaqus.reader import DeckReader
from morembs.importers.abaqus.words import CONTACT, MATERIAL, STRUCTURAL
from morembs.importers.decks.formulations import dialects_of_comments
from morembs.importers.decks.includes import open_text
from morembs.importers.decks.options import DeckOptions
from morembs.importers.decks.problems import Problem, Problems
from morembs.importers.tolerances import TOL

# Elements without stiffness and mass.
_EMPTY = ("SFM3D",)
_PLANE = ("CPE", "CPS", "CAX", "SAX", "MAX", "B21", "B22", "T2D", "CGAX", "PIPE21", "PIPE22")
_FLOW = ("DC3D", "DC2D", "DCC", "F3D", "DS", "AC3D")


@dataclass
class EngineDeck(Contents):
    """A deck with all ``cards`` outside of steps that the own reader has no table for, and those of each step.

    ``replaced`` counts element types that were taken for others (as it is written, as it was taken).
    """

    cards: list[tuple[Scope, Card, Rows]] = field(default_factory=list)
    steps: list[list[tuple[Card, Rows]]] = field(default_factory=list)
    replaced: dict[tuple[str, str], int] = field(default_factory=dict)


def read_for_engine(path: Path, options: DeckOptions, *, outside: bool = False) -> EngineDeck:
    """The deck of a file as CalculiX means it; elements that it has not are problems of the deck.

    Raises:
        InputError: the text is no deck.
    """
    deck = EngineDeck(path.name, options, Problems(path.name, options.flags), dialect="calculix")
    with deck.problems.ending():
        reader = _Keeping(deck)
        for card, pieces in cards(path, outside=outside, warnings=deck.warnings):
            reader.take(card, pieces)
        if reader.open and reader.open != ["STEP"]:
            raise InputError(f"{path.name} ends inside *{reader.open[-1]}; the file may be cut off")
    _refuse_others(deck)
    with open_text(path) as file:
        deck.dialects |= dialects_of_comments(file.read(TOL.head_bytes)) | ({"abaqus"} if deck.parts else set())
    return deck


def _refuse_others(deck: EngineDeck) -> None:
    wrong = {code: count for code, count in deck.counts.items() if not _known(code) and count}
    for code in list(wrong):
        if deck.options.skips(code):
            deck.skipped[f"elements {code}"] = wrong.pop(code)
    if not wrong:
        return
    listed = ", ".join(f"{count} of the type {code!r}" for code, count in wrong.items())
    why = f"expected solids, {', '.join(STRUCTURES)}"
    if all(code.startswith(_PLANE) for code in wrong):
        why = "they are plane or axisymmetric, no body in space"
    elif all(code.startswith(_FLOW) or code == "D" for code in wrong):
        why = "they carry heat or a fluid and no forces"
    deck.problems.add(
        Problem(
            what=f"{deck.name} has elements that CalculiX does not make a body of: {listed}; {why}; leave "
            f"them out with --skip {','.join(wrong)} if the model is right without them",
            file=deck.name,
            keyword="ELEMENT",
            flags=tuple(f"--skip {code}" for code in wrong),
        )
    )


def _known(code: str) -> bool:
    return code in SOLIDS or code in STRUCTURES or code in DISCRETE or code.startswith(_EMPTY)


_TABLES = (*GENERATING, "NODE", "NSET", "ELSET", "MATERIAL", "SURFACE", "COUPLING", "KINEMATIC", "DISTRIBUTING")


class _Keeping(DeckReader):
    """Keeps every card with its data that is not mesh, set, material or structure."""

    deck: EngineDeck
    glues = False

    def take(self, card: Card, pieces: Iterator[bytes]) -> None:
        """One card with its data."""
        word, deck = card.keyword, self.deck
        if word == "END STEP":
            # Steps are history; CalculiX, too, takes one that is not ended at the end of a deck.
            self.open = [scope for scope in self.open if scope != "STEP"]
        elif word == "STEP":
            self.open = [*(scope for scope in self.open if scope != "STEP"), word]
            deck.steps.append([(card, [])])
        elif self.open and self.open[-1] == "STEP":
            deck.steps[-1].append((card, fields(b"".join(pieces))))
        elif self._is_own(word):
            super().take(card, pieces)
        elif word == "ELEMENT":
            self._elements(card, pieces)
        else:
            deck.cards.append((self.scope, card, [row for row in fields(b"".join(pieces)) if row]))

    def _is_own(self, word: str) -> bool:
        """Whether the own reader has a table for a keyword, or the words to refuse it."""
        glued = word == "CONTACT PAIR" and self.deck.options.contact == "tie"
        of_material = self.material is not None and word in MATERIAL
        return word in _TABLES or word in STRUCTURAL or of_material or (word in CONTACT and not glued)

    def _elements(self, card: Card, pieces: Iterator[bytes]) -> None:
        code = card.options.get("TYPE", "").upper()
        plain = PLAIN.get(code, code)
        width = NODES[SOLIDS[plain]] if plain in SOLIDS else width_of(plain)
        if not width:
            super()._elements(card, pieces)
            return
        rows = line_records(card, pieces, plain, width)
        self.deck.counts[plain] = self.deck.counts.get(plain, 0) + len(rows)
        if plain in SOLIDS:
            self.scope.elements.setdefault(plain, []).append(rows)
        else:
            self.scope.others.append((plain, rows))
        join(self.scope.element_sets, card.options.get("ELSET", ""), Members(rows[:, 0].copy(), [], [], ""))
        if plain != code:
            self.deck.replaced[code, plain] = self.deck.replaced.get((code, plain), 0) + len(rows)
