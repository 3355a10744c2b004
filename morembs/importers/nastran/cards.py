"""Cards of Nastran bulk data in small, large and free fields; many cards of one name at once.

A file is read in pieces of whole cards. Each line becomes eight fields (four where a field has 16 columns), and
cards of one name with lines of the same kind become one table of fields.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.matrices.text import integers, numbers
from morembs.importers.nastran.text import BulkText, Columns, Piece
from morembs.importers.tolerances import TOL

Bytes = NDArray[np.uint8]
_REAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([ED]?[+-]?\d+)?", re.IGNORECASE)


class Form(IntEnum):
    """Forms of a line: fields of 8 or 16 columns, or between commas, eight or four of them."""

    SMALL = 1
    LARGE = 2
    FREE = 3
    FREE_LARGE = 4


@dataclass(frozen=True, eq=False)
class Table:
    """Cards of one name: ``fields`` (cards, fields, 24) characters from the field behind the name on, and the ``lines``
    (cards,) of the file that they begin on."""

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

    def given(self, first: int, last: int) -> NDArray[np.bool_]:
        """Which of the fields ``first`` to ``last`` (exclusive) are not blank (cards, last - first)."""
        return np.asarray((self._part(first, last) != 32).any(axis=2))

    def reals(self, first: int, last: int) -> Floats:
        """Numbers (cards, last - first) of fields; a blank one is 0."""
        part = self._part(first, last)
        used = np.flatnonzero((part != 32).any(axis=(0, 1)))
        width = int(used[-1]) + 1 if len(used) else 1
        text = np.full((*part.shape[:2], width + 1), 10, dtype=np.uint8)
        text[:, :, :width] = part[:, :, :width]
        text[:, :, 0][(part == 32).all(axis=2)] = ord("0")
        try:
            values = numbers(text.tobytes(), self.file)
        except InputError as error:
            raise InputError(f"{self.file}: a {self.name} card: {error}") from error
        if len(values) != part.shape[0] * part.shape[1]:
            raise InputError(f"{self.file}: a {self.name} card has a field that is not one number")
        return values.reshape(part.shape[:2])

    def integers(self, first: int, last: int) -> Ints:
        """Integers (cards, last - first) of fields; a blank one is 0."""
        values = integers(self.reals(first, last).ravel(), f"an integer of a {self.name} card", self.file)
        return values.reshape(len(self), last - first)

    def rows(self) -> list[list[str]]:
        """The fields of each card as text, without blank ones at the end."""
        width = TOL.field_characters
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
            more = np.full((len(part), last - first - part.shape[1], TOL.field_characters), 32, dtype=np.uint8)
            part = np.concatenate([part, more], axis=1)
        return part


def real(text: str, what: str) -> float:
    """A number as Nastran writes it ("1.0-3", "7.+5", "1.D3"); blank is 0."""
    if not text:
        return 0.0
    match = _REAL.fullmatch(text)
    if match:
        base, power = match.group(1), (match.group(2) or "0").upper().lstrip("ED")
        value = float(f"{'-' if text[0] == '-' else ''}{base}e{power}")
        if abs(value) < TOL.largest_number:
            return value
    raise InputError(f"{what}: {text[:24]!r} cannot be read as a number; expected a finite one")


def integer(text: str, what: str) -> int:
    """An integer; blank is 0."""
    if not text:
        return 0
    if re.fullmatch(r"[+-]?\d{1,15}", text):
        return int(text)
    raise InputError(f"{what}: {text[:24]!r} was given; expected an integer")


class Cards:
    """Cards of a piece of text.

    ``names`` (k,) in capitals, ``heads`` (k,) their first lines, ``size`` (k,) how many they have; ``form`` (n,) of
    each line, ``owner`` (n,) its card. ``codes`` are all characters, ``starts`` and ``lengths`` (n,) place lines there.

    Raises:
        InputError: a line is no card and continues none.
    """

    def __init__(self, piece: Piece, text: BulkText) -> None:
        self.file = piece.file
        codes = self.codes = np.frombuffer(piece.text + b" " * (Columns.ALL + TOL.field_characters), dtype=np.uint8)
        ends = np.flatnonzero(codes == 10)
        starts = np.concatenate([[0], ends[:-1] + 1]) if len(ends) else np.empty(0, dtype=np.int64)
        lengths = ends - starts
        lines = np.lib.stride_tricks.sliding_window_view(codes, Columns.ALL)[starts].copy()
        lines[np.arange(Columns.ALL) >= lengths[:, None]] = 32
        full = (lines != 32).any(axis=1)
        for i in np.flatnonzero(lengths > Columns.ALL).tolist():
            line = bytes(codes[starts[i] : ends[i]])
            if line[Columns.ALL :].strip() and not (full[i] and b"," in line):
                text.unread(piece.file, piece.above + i + 1, line[Columns.ALL :].decode("latin-1").strip())
        lines, self.starts, self.lengths = lines[full], starts[full], lengths[full]
        self.number = piece.above + 1 + np.flatnonzero(full)
        self.lines = lines
        first = lines[:, 0]
        begins = _letters(first)
        # A name may stand behind blanks within its eight columns, where it is not the mark of the line above.
        inner = np.flatnonzero(first == 32)
        inner = inner[(lines[inner, Columns.MARK] != 32).any(axis=1)]
        named = _letters(lines[inner, (lines[inner, :8] != 32).argmax(axis=1)])
        begins[inner] = named & (lines[inner - 1, Columns.MARK_BELOW] != lines[inner, Columns.MARK]).any(axis=1)
        odd = np.flatnonzero(~begins & ~np.isin(first, np.frombuffer(b"+* ,", dtype=np.uint8)))
        if len(odd) or (len(lines) and not begins[0]):
            words = bytes(lines[odd[0] if len(odd) else 0]).decode("latin-1").strip()
            raise InputError(f"{self.file}: the line {words[:60]!r} is neither a card nor the continuation of one")
        commas = codes == 44
        self.commas = np.flatnonzero(commas)
        self.commas_before = np.concatenate([[0], np.cumsum(commas)])
        free = self.commas_before[self.starts + self.lengths] > self.commas_before[self.starts]
        self.form = np.where((lines[:, :8] == ord("*")).any(axis=1), Form.LARGE, Form.SMALL)
        self.form[free] = np.where(_star_in_first(lines[free]), Form.FREE_LARGE, Form.FREE)
        _check_marks(lines, begins, self.form, self.file)
        self.owner, self.heads = np.cumsum(begins) - 1, np.flatnonzero(begins)
        self.names = _names(lines[self.heads])
        self.size = np.diff(np.append(self.heads, len(lines)))

    def tables(self) -> Iterator[Table]:
        """The cards in the order of the file, as far as a name and the kind of its lines change."""
        unique, kind = np.unique(self.names, return_inverse=True)
        below = np.minimum(np.arange(len(self.lines)) - self.heads[self.owner], 20).astype(np.int64)
        layout = np.bincount(self.owner, weights=(self.form * 5**below).astype(np.float64)).astype(np.int64)
        layout[self.size > 20] = -self.heads[self.size > 20] - 1
        key = np.unique(np.stack([kind, layout, self.size]), axis=1, return_inverse=True)[1].ravel()
        order = np.argsort(key, kind="stable")
        for cards in np.split(order, np.flatnonzero(np.diff(key[order])) + 1):
            if len(cards):
                parts = [self._fields(self.heads[cards] + k) for k in range(int(self.size[cards[0]]))]
                name = unique[kind[cards[0]]].decode("latin-1")
                yield Table(name, np.concatenate(parts, axis=1), self.file, self.number[self.heads[cards]])

    def fours(self, name: bytes) -> tuple[Table, Ints]:
        """Fields of all cards of a name, in the order of the file and in groups of four, and the card of each group."""
        lines = np.flatnonzero((self.names == name)[self.owner])
        count = np.where(np.isin(self.form[lines], (Form.SMALL, Form.FREE)), 2, 1)
        first, fields = np.cumsum(count) - count, np.empty((int(count.sum()), 4, TOL.field_characters), dtype=np.uint8)
        for form in np.unique(self.form[lines]).tolist():
            chosen = self.form[lines] == form
            groups = self._fields(lines[chosen]).reshape(int(chosen.sum()), -1, 4, TOL.field_characters)
            for k in range(groups.shape[1]):
                fields[first[chosen] + k] = groups[:, k]
        return Table(name.decode(), fields, self.file), np.repeat(self.owner[lines], count)

    def _fields(self, rows: Ints) -> Bytes:
        """Data fields (rows, 8 or 4, 24) of lines of one form.

        Raises:
            InputError: more fields than a line has, or longer ones.
        """
        lines, form = self.lines[rows], int(self.form[rows[0]])
        if form in (Form.SMALL, Form.LARGE):
            width = 8 if form == Form.SMALL else 16
            fixed = np.full((len(lines), 64 // width, TOL.field_characters), 32, dtype=np.uint8)
            fixed[:, :, :width] = lines[:, Columns.FIELDS].reshape(len(lines), -1, width)
            return fixed
        codes, total, starts = self.codes, self.commas_before, self.starts[rows]
        stops = starts + self.lengths[rows]
        count = 8 if form == Form.FREE else 4
        first, count_of = total[starts], total[stops] - total[starts]
        padded = np.append(self.commas, np.full(count + 2, len(codes)))
        at = padded[first[:, None] + np.arange(count + 2)]
        at = np.where(np.arange(count + 2) < count_of[:, None], at, stops[:, None])
        begin, end = np.minimum(at[:, :count] + 1, at[:, 1 : count + 1]), at[:, 1 : count + 1]
        # Blanks before a field do not count.
        for _ in range(Columns.ALL):
            move = (begin < end) & (codes[begin] == 32)
            if not move.any():
                break
            begin = begin + move
        most = TOL.field_characters
        index = begin[:, :, None] + np.arange(most)
        text = np.where(index < end[:, :, None], codes[np.minimum(index, len(codes) - 1)], 32).astype(np.uint8)
        beyond = np.flatnonzero(count_of > count + 1)
        tail = [i for i in beyond.tolist() if bytes(codes[at[i, count + 1] : stops[i]]).strip(b", ")]
        long = ((end - begin > most) & (codes[np.minimum(begin + most, len(codes) - 1)] != 32)).any(axis=1)
        for i in [*tail, *np.flatnonzero(long).tolist()][:1]:
            line = bytes(codes[starts[i] : stops[i]]).decode("latin-1")
            raise InputError(
                f"{self.file}: the line {line[:60]!r} has too many or too long fields; expected {count} of them"
            )
        return text


def _letters(codes: Bytes) -> NDArray[np.bool_]:
    # Without the bit of small letters.
    return np.asarray(((codes & 0xDF) >= ord("A")) & ((codes & 0xDF) <= ord("Z")))


def tables(text: BulkText) -> Iterator[Table]:
    """The cards of bulk data.

    Raises:
        InputError: what ``BulkText`` and ``Cards`` refuse.
    """
    for piece in text:
        yield from Cards(piece, text).tables()


def _star_in_first(lines: Bytes) -> NDArray[np.bool_]:
    """Whether there is a star before the first comma of the line."""
    star, comma = lines == ord("*"), lines == 44
    return np.asarray(
        star.any(axis=1) & (star.argmax(axis=1) < np.where(comma.any(axis=1), comma.argmax(axis=1), Columns.ALL))
    )


def _names(lines: Bytes) -> NDArray[np.bytes_]:
    """Names (k,) of cards in capitals, without star and blanks in front."""
    heads = lines[:, :8].copy()
    for i in np.flatnonzero(heads[:, 0] == 32).tolist():
        heads[i] = np.frombuffer(bytes(heads[i]).lstrip().ljust(8), dtype=np.uint8)
    stop = np.cumsum((heads == 44) | (heads == ord("*")) | (heads == 32), axis=1) > 0
    heads[stop] = 0
    small = (heads >= ord("a")) & (heads <= ord("z"))
    heads[small] -= 32
    return np.asarray(np.ascontiguousarray(heads).view("S8").ravel())


def _check_marks(lines: Bytes, begins: NDArray[np.bool_], form: Ints, file: str) -> None:
    """Refuse continuations that do not follow the line whose mark they carry."""
    pair = np.flatnonzero(~begins[1:] & (form[1:] < Form.FREE) & (form[:-1] < Form.FREE))
    before, after = lines[pair, Columns.MARK_BELOW], lines[pair + 1, Columns.MARK]
    wrong = (before != after).any(axis=1) & (before != 32).any(axis=1) & (after != 32).any(axis=1)
    if wrong.any():
        line = bytes(lines[pair[wrong][0] + 1]).decode("latin-1").strip()
        raise InputError(
            f"{file}: the continuation {line[:60]!r} does not carry the mark of the line above it; sort the cards so "
            "that each is followed by its continuations"
        )
