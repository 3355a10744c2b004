"""Tables of Nastran cards of one name: their fields as characters, or as words of free fields."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.decks.numerals import Eight, Words, fixed_integers, words_of
from morembs.importers.matrices.text import integers, numbers

Bytes = NDArray[np.uint8]
# A number as Nastran writes it.
REAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([ED]?[+-]?\d+)?", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Table:
    """Cards of one name: ``fields`` (cards, fields, 8 to 24) characters from the field behind the name on, none where
    nobody reads them, and the ``lines`` (cards,) of the file that they begin on."""

    name: str
    fields: Bytes
    file: str
    lines: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    def __len__(self) -> int:
        return len(self.fields)

    @property
    def width(self) -> int:
        """Fields of a card."""
        return int(self.fields.shape[1])

    def are_given(self, first: int, last: int) -> NDArray[np.bool_]:
        """Which of the fields ``first`` to ``last`` (exclusive) are not blank (cards, last - first)."""
        return _is_given(self._part(first, last))

    def reals(self, first: int, last: int) -> Floats:
        """Numbers (cards, last - first) of fields; a blank one is 0."""
        part = self._part(first, last)
        words = _words(part)
        plain = None if words is None else words.reals()
        return self._odd_reals(part, first) if plain is None else plain.reshape(part.shape[:2])

    def _odd_reals(self, part: Bytes, first: int) -> Floats:
        """Numbers that are written in another way than most, or are none."""
        used = np.flatnonzero((part != 32).any(axis=(0, 1)))
        width = int(used[-1]) + 1 if len(used) else 1
        text = np.full((*part.shape[:2], width + 1), 10, dtype=np.uint8)
        text[:, :, :width] = part[:, :, :width]
        text[:, :, 0][(part == 32).all(axis=2)] = ord("0")
        try:
            values = numbers(text.tobytes(), self.file)
        except InputError:
            values = np.empty(0)
        if len(values) != part.shape[0] * part.shape[1]:
            raise InputError(self._odd_field(part, first))
        return values.reshape(part.shape[:2])

    def _odd_field(self, part: Bytes, first: int) -> str:
        """A sentence on the first of the fields ``part``, from the field ``first`` on, that is no number."""
        for card, fields in enumerate(part):
            for k, characters in enumerate(fields, start=first + 2):
                text = bytes(characters).decode("latin-1").strip()
                if text and not REAL.fullmatch(text):
                    line = f", line {self.lines[card]}" if len(self.lines) else ""
                    return (
                        f"{self.file}{line}: {self.name} has {text!r} in field {k}; expected a number such as 1.5, "
                        "1.5E-3 or 1.5-3"
                    )
        return f"{self.file}: a {self.name} card has a number that is not finite"

    def integers(self, first: int, last: int) -> Ints:
        """Integers (cards, last - first) of fields; a blank one is 0."""
        part = self._part(first, last)
        if not _is_given(part).any():
            return np.zeros(part.shape[:2], dtype=np.int64)
        values = fixed_integers(part)
        if values is None:
            words = _words(part)
            values = None if words is None else words.integers()
        if values is None:
            values = integers(self.reals(first, last).ravel(), f"an integer of a {self.name} card", self.file)
        return values.reshape(part.shape[:2])

    def components(self, at: int) -> Ints:
        """Digits (cards,) of a field of components, 0 where it is blank.

        The manuals allow no blanks between them; the programs read over them, and decks have them ("12 4 6").

        Raises:
            InputError: something that is no digits.
        """
        given = np.flatnonzero(self.are_given(at, at + 1))
        digits = np.zeros(len(self), dtype=np.int64)
        if len(given):
            texts = [bytes(text).replace(b" ", b"") for text in self._part(at, at + 1)[given, 0]]
            odd = next((text for text in texts if not text.isdigit()), None)
            if odd is not None:
                raise InputError(
                    f"{self.file}: a {self.name} card has the components {odd.decode('latin-1')!r}", kind="unsupported"
                )
            digits[given] = [int(text) for text in texts]
        return digits

    def rows(self) -> list[list[str]]:
        """The fields of each card as text, without blank ones at the end."""
        width = self.fields.shape[2]
        flat = np.ascontiguousarray(self.fields).reshape(-1, width).view(f"S{width}").ravel()
        texts = np.char.strip(flat).reshape(self.fields.shape[:2])
        rows = [[text.decode("latin-1") for text in row] for row in texts.tolist()]
        for row in rows:
            while row and not row[-1]:
                row.pop()
        return rows

    def _part(self, first: int, last: int) -> Bytes:
        part = self.fields[:, first:last]
        if part.shape[1] < last - first:
            more = np.full((len(part), last - first - part.shape[1], part.shape[2]), 32, dtype=np.uint8)
            part = np.concatenate([part, more], axis=1)
        return part


class FreeTable(Table):
    """Cards of free fields, whose numbers come from the ``words`` of their lines: that of each field (cards, fields).

    The last word is empty. ``characters`` makes the fields, where they are wanted as text.
    """

    def __init__(
        self, name: str, file: str, lines: Ints, words: Words, index: Ints, characters: Callable[[], Bytes]
    ) -> None:
        for key, value in (("name", name), ("file", file), ("lines", lines)):
            object.__setattr__(self, key, value)
        self.__dict__ |= {"words": words, "index": index, "characters": characters}

    words: Words
    index: Ints
    characters: Callable[[], Bytes]

    @cached_property
    def fields(self) -> Bytes:
        """The fields as characters."""
        return self.characters()

    def __len__(self) -> int:
        return len(self.index)

    @property
    def width(self) -> int:
        """Fields of a card."""
        return int(self.index.shape[1])

    def are_given(self, first: int, last: int) -> NDArray[np.bool_]:
        """As of ``Table``."""
        return ~self.words.is_empty[self._choose(first, last)]

    def reals(self, first: int, last: int) -> Floats:
        """As of ``Table``."""
        values = self.words.reals(self._choose(first, last).ravel())
        return super().reals(first, last) if values is None else values.reshape(len(self), last - first)

    def integers(self, first: int, last: int) -> Ints:
        """As of ``Table``."""
        if not self.are_given(first, last).any():
            return np.zeros((len(self), last - first), dtype=np.int64)
        values = self.words.integers(self._choose(first, last).ravel())
        return super().integers(first, last) if values is None else values.reshape(len(self), last - first)

    def _choose(self, first: int, last: int) -> Ints:
        part = self.index[:, first:last]
        if part.shape[1] == last - first:
            return part
        more = np.full((len(part), last - first - part.shape[1]), len(self.words) - 1)
        return np.concatenate([part, more], axis=1)


def _is_given(part: Bytes) -> NDArray[np.bool_]:
    """Which fields (n, k, 8 to 24) are not blank (n, k)."""
    eights = part.view("<u8") != np.uint64(Eight.BLANKS)
    given: NDArray[np.bool_] = eights[:, :, 0]
    for k in range(1, eights.shape[2]):
        given = given | eights[:, :, k]
    return given


def _words(part: Bytes) -> Words | None:
    """Fields (n, k, 8 to 24) as words, None where a blank stands within one."""
    cards, count, width = part.shape
    if not cards or not count:
        return None
    text = np.full((cards, count, width + 1), ord(","), dtype=np.uint8)
    text[:, :, :width] = part
    text[-1, -1, -1] = ord("\n")
    words = words_of(text.tobytes())
    return words if words is not None and len(words) == cards * count else None


def widen(fields: Bytes, width: int) -> Bytes:
    """Fields (n, k, 8 to 24) with blanks behind them."""
    if fields.shape[2] == width:
        return fields
    wide = np.full((*fields.shape[:2], width), 32, dtype=np.uint8)
    wide[:, :, : fields.shape[2]] = fields
    return wide
