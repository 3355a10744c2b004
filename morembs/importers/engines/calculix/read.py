"""Input decks for CalculiX to assemble: the tables of the own reader, and all else as it stands."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.importers.abaqus.data import element_numbers, fields
from morembs.importers.abaqus.deck import DISCRETE, NODES, SOLIDS, Contents, Members, Rows, Scope, join
from morembs.importers.abaqus.generate import GENERATING
from morembs.importers.abaqus.keywords import Card, cards
from morembs.importers.abaqus.reader import DeckReader
from morembs.importers.abaqus.words import CONTACT, MATERIAL, STRUCTURAL
from morembs.importers.decks.formulations import dialects_of_comments
from morembs.importers.decks.includes import open_text
from morembs.importers.decks.options import DeckOptions
from morembs.importers.decks.problems import Problem, Problems
from morembs.importers.tolerances import TOL

# Elements of CalculiX that are expanded or stand for contact, and how many nodes they have.
WIDTHS = {
    "S3": 3,
    "S4": 4,
    "S4R": 4,
    "S6": 6,
    "S8": 8,
    "S8R": 8,
    "M3D3": 3,
    "M3D4": 4,
    "M3D4R": 4,
    "M3D6": 6,
    "M3D8": 8,
    "M3D8R": 8,
    "B31": 2,
    "B31R": 2,
    "B32": 3,
    "B32R": 3,
    "T3D2": 2,
    "T3D3": 3,
    "GAPUNI": 2,
}
# Types of Abaqus that CalculiX has under another name, in a plain form.
_PLAIN = {
    "S3R": "S3",
    "S3RS": "S3",
    "STRI3": "S3",
    "STRI65": "S6",
    "S4RS": "S4R",
    "S4R5": "S4R",
    "S8R5": "S8R",
    "B31H": "B31",
    "B31OS": "B31",
    "B32H": "B32",
    "B32OS": "B32",
    "B33": "B31",
    "PIPE31": "B31",
    "PIPE32": "B32",
    "T3D2H": "T3D2",
    "T3D3H": "T3D3",
}
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
    why = f"expected solids, {', '.join(WIDTHS)}"
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
    return code in SOLIDS or code in WIDTHS or code in DISCRETE or code.startswith(_EMPTY)


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
        plain = _PLAIN.get(code, code)
        width = WIDTHS.get(plain, NODES[SOLIDS[plain]] if plain in SOLIDS else 0)
        if not width:
            super()._elements(card, pieces)
            return
        rows = _records(card, pieces, plain, width)
        self.deck.counts[plain] = self.deck.counts.get(plain, 0) + len(rows)
        if plain in SOLIDS:
            self.scope.elements.setdefault(plain, []).append(rows)
        else:
            self.scope.others.append((plain, rows))
        join(self.scope.element_sets, card.options.get("ELSET", ""), Members(rows[:, 0].copy(), [], [], ""))
        if plain != code:
            self.deck.replaced[code, plain] = self.deck.replaced.get((code, plain), 0) + len(rows)


def _records(card: Card, pieces: Iterator[bytes], code: str, width: int) -> Ints:
    """Label and nodes (k, 1 + width) of elements; data may go on in further lines, and lines may name more nodes."""
    values, first = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=bool)]
    for piece in pieces:
        if piece:
            own, begins = element_numbers(piece, card)
            values.append(own)
            first.append(begins)
    numbers, starts = np.concatenate(values), np.flatnonzero(np.concatenate(first))
    if len(numbers) % (width + 1) == 0 and np.isin(np.arange(0, len(numbers), width + 1), starts).all():
        return numbers.reshape(-1, width + 1)
    rows, row = [], list[int]()
    for line in np.split(numbers, starts[1:]):
        row += line.tolist()
        if len(row) > width:
            # As CalculiX does: what a line has beyond the last node is passed over.
            rows.append(row[: width + 1])
            row = []
    if row:
        raise InputError(
            f"{card}, TYPE={code}: the element {row[0]} has {len(row) - 1} nodes, expected {width}; the file may be "
            "cut off"
        )
    return np.array(rows, dtype=np.int64).reshape(-1, width + 1)
