"""Input decks for CalculiX to assemble: the tables of the own reader, and all else as it stands."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.importers.abaqus_deck import POINTS, SOLIDS, Deck, DeckReader, Members, Rows, Scope, join
from morembs.importers.abaqus_keywords import Card, cards, element_numbers, fields
from morembs.importers.abaqus_words import MATERIAL
from morembs.importers.problems import Problems

Ints = NDArray[np.int64]
# Elements of CalculiX beside solids, and how many nodes they have.
WIDTHS = {
    "S3": 3, "S4": 4, "S4R": 4, "S6": 6, "S8": 8, "S8R": 8, "M3D3": 3, "M3D4": 4, "M3D4R": 4, "M3D6": 6, "M3D8": 8,
    "M3D8R": 8, "B31": 2, "B31R": 2, "B32": 3, "B32R": 3, "T3D2": 2, "T3D3": 3, "SPRINGA": 2, "SPRING1": 1,
    "SPRING2": 2, "GAPUNI": 2, "DCOUP3D": 1,
}  # fmt: skip
# Types of Abaqus that CalculiX has under another name, in a plain form.
_PLAIN = {
    "S3R": "S3", "S3RS": "S3", "STRI3": "S3", "STRI65": "S6", "S4RS": "S4R", "S4R5": "S4R", "S8R5": "S8R", "B31H": "B31",
    "B31OS": "B31", "B32H": "B32", "B32OS": "B32", "B33": "B31", "PIPE31": "B31", "PIPE32": "B32", "T3D2H": "T3D2",
    "T3D3H": "T3D3", "C3D20RI": "C3D20R",
}  # fmt: skip
# Elements without stiffness and mass.
_EMPTY = ("SFM3D", "DASHPOT", "ROTARYI")
_PLANE = ("CPE", "CPS", "CAX", "SAX", "MAX", "B21", "B22", "T2D", "CGAX", "PIPE21", "PIPE22")
_HEAT = ("DC3D", "DC2D", "DCC", "D", "F3D", "DS", "AC3D")


@dataclass
class EngineDeck(Deck):
    """A deck with all ``cards`` outside of steps that the own reader has no table for, and those of each step.

    ``replaced`` counts element types that were taken for others (as it is written -> as it was taken).
    """

    cards: list[tuple[Scope, Card, Rows]] = field(default_factory=list)
    steps: list[list[tuple[Card, Rows]]] = field(default_factory=list)
    replaced: dict[tuple[str, str], int] = field(default_factory=dict)


def read_for_engine(path: Path, *, outside: bool = False) -> EngineDeck:
    """The deck of a file as CalculiX means it.

    Raises:
        InputError: the text is no deck, or holds elements that are no part of a structure in space.
    """
    deck = EngineDeck(path.name, dialect="calculix", problems=Problems(path.name))
    reader = _Keeping(deck)
    for card, pieces in cards(path, outside=outside):
        reader.take(card, pieces)
    if reader.open and reader.open != ["STEP"]:
        raise InputError(f"{path.name} ends inside *{reader.open[-1]}; the file may be cut off")
    wrong = {code: count for code, count in deck.counts.items() if not _known(code)}
    if wrong:
        listed = ", ".join(f"{count} of the type {code!r}" for code, count in wrong.items())
        why = "they are plane or axisymmetric, no body in space" if all(map(_plane, wrong)) else "they are not structural"
        known = all(_plane(code) or code.startswith(_HEAT) for code in wrong)
        raise InputError(
            f"{path.name} has elements that do not become a model: {listed}"
            f"{f'; {why}' if known else f'; expected solids, {chr(44).join(WIDTHS)}'}; take them out of the deck"
        )
    deck.problems.refuse()
    return deck


def _known(code: str) -> bool:
    plain = _PLAIN.get(code, code)
    return plain in SOLIDS or plain in WIDTHS or plain in POINTS or code.startswith(_EMPTY)


def _plane(code: str) -> bool:
    return code.startswith(_PLANE)


class _Keeping(DeckReader):
    """Keeps every card with its data that is not mesh, set, material or structure."""

    deck: EngineDeck

    def take(self, card: Card, pieces: Iterator[bytes]) -> None:
        word, deck = card.keyword, self.deck
        if word == "END STEP":
            # Steps are history; CalculiX, too, takes one that is not ended at the end of a deck.
            self.open = [scope for scope in self.open if scope != "STEP"]
        elif self.open and self.open[-1] == "STEP":
            if word == "STEP":
                deck.steps.append([(card, [])])
            else:
                deck.steps[-1].append((card, fields(b"".join(pieces))))
        elif word == "STEP":
            self.open.append(word)
            deck.steps.append([(card, [])])
        elif word in _TABLES or word.startswith("END ") or (self.material is not None and word in MATERIAL):
            super().take(card, pieces)
        elif word == "ELEMENT":
            self._elements(card, pieces)
        else:
            deck.cards.append((self.scope, card, [row for row in fields(b"".join(pieces)) if row]))

    def _elements(self, card: Card, pieces: Iterator[bytes]) -> None:
        code = card.options.get("TYPE", "").upper()
        plain = _PLAIN.get(code, code)
        if plain != code:
            card = Card(card.keyword, {**card.options, "TYPE": plain}, card.file)
        if plain not in WIDTHS:
            before = self.deck.counts.get(plain, 0)
            if code.startswith(_EMPTY):
                for _ in pieces:
                    pass
                self.deck.noted[f"ELEMENT, TYPE={code}"] = 1
                return
            super()._elements(card, pieces)
            count = self.deck.counts.get(plain, 0) - before
        else:
            rows = _records(card, pieces, plain)
            count = len(rows)
            self.deck.counts[plain] = self.deck.counts.get(plain, 0) + count
            self.scope.others.append((plain, rows))
            name = card.options.get("ELSET", "")
            join(self.scope.element_sets, name, Members(rows[:, 0].copy(), [], [], ""))
        if plain != code:
            self.deck.replaced[code, plain] = self.deck.replaced.get((code, plain), 0) + count


_TABLES = ("PART", "ASSEMBLY", "INSTANCE", "NODE", "NSET", "ELSET", "MATERIAL", "SURFACE", "COUPLING", "KINEMATIC",
           "DISTRIBUTING", "HEADING")  # fmt: skip


def _records(card: Card, pieces: Iterator[bytes], code: str) -> Ints:
    """Label and nodes (k, 1 + width) of elements; data may go on in further lines."""
    width = 1 + WIDTHS[code]
    parts = [element_numbers(piece, card)[0] for piece in pieces if piece]
    values = np.concatenate([np.empty(0, dtype=np.int64), *parts])
    if len(values) % width:
        raise InputError(
            f"{card}, TYPE={code}: the block does not hold a multiple of {width} numbers (label and {width - 1} nodes "
            "for each element); the file may be cut off"
        )
    return values.reshape(-1, width)
