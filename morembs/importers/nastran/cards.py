"""Cards of Nastran bulk data in small, large and free fields; many cards of one name at once.

A file is read in pieces of whole cards. Each line becomes eight fields (four where a field has 16 columns), and
cards of one name with lines of the same kind become one table of fields.
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterator
from enum import IntEnum
from functools import partial

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.importers.decks.numerals import Eight, Words, words_of
from morembs.importers.nastran.names import FREE_TEXT
from morembs.importers.nastran.tables import REAL, Bytes, FreeTable, Table, widen
from morembs.importers.nastran.text import BulkText, Columns, Piece
from morembs.importers.tolerances import TOL

_COMMA, _NEWLINE = b",\n"
# How a line begins that continues the one above.
_CONTINUES = np.isin(np.arange(256), list(b"+* ,"))


class Form(IntEnum):
    """Forms of a line: fields of 8 or 16 columns, or between commas, eight or four of them."""

    SMALL = 1
    LARGE = 2
    FREE = 3
    FREE_LARGE = 4


def real(text: str, what: str) -> float:
    """A number as Nastran writes it ("1.0-3", "7.+5", "1.D3"); blank is 0."""
    if not text:
        return 0.0
    match = REAL.fullmatch(text)
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

    ``names`` in capitals that there are and ``kind`` (k,) that of each card, ``heads`` (k,) their first lines, ``size``
    (k,) how many they have; ``form`` (n,) of each line, ``owner`` (n,) its card. ``codes`` are all characters,
    ``starts`` and ``lengths`` (n,) place lines there.

    Raises:
        InputError: a line is no card and continues none.
    """

    def __init__(self, piece: Piece, text: BulkText) -> None:
        self.file = piece.file
        self._text = piece.text + b" " * (Columns.ALL + TOL.field_characters)
        codes = self.codes = np.frombuffer(self._text, dtype=np.uint8)
        ends = np.flatnonzero(codes == _NEWLINE)
        starts = np.concatenate([[0], ends[:-1] + 1]) if len(ends) else np.empty(0, dtype=np.int64)
        lengths = ends - starts
        lines = self._characters(starts, lengths, Columns.ALL)
        full = (lines.view("<u8") != np.uint64(Eight.BLANKS)).any(axis=1)
        for i in np.flatnonzero(lengths > Columns.ALL).tolist():
            line = bytes(codes[starts[i] : ends[i]])
            if line[Columns.ALL :].strip() and not (full[i] and b"," in line):
                text.unread(piece.file, piece.above + i + 1, line[Columns.ALL :].decode("latin-1").strip())
        self.commas = np.flatnonzero(codes == _COMMA)
        has_comma = np.diff(self._commas_before(ends), prepend=0) > 0
        self.number = piece.above + 1 + np.arange(len(lines))
        if not full.all():
            lines, starts, lengths, has_comma, self.number = (
                part[full] for part in (lines, starts, lengths, has_comma, self.number)
            )
        self.lines, self.starts, self.lengths = lines, starts, lengths
        heads = lines.view("<u8")[:, 0]
        first = lines[:, 0]
        begins = _letters(first)
        # A name may stand behind blanks within its eight columns, where it is not the mark of the line above.
        inner = np.flatnonzero((first == 32) & (heads != np.uint64(Eight.BLANKS)))
        named = _letters(lines[inner, (lines[inner, :8] != 32).argmax(axis=1)])
        begins[inner] = named & (lines[inner - 1, Columns.MARK_BELOW] != lines[inner, Columns.MARK]).any(axis=1)
        odd = np.flatnonzero(~begins & ~_CONTINUES[first])
        if len(odd) or (len(lines) and not begins[0]):
            words = bytes(lines[odd[0] if len(odd) else 0]).decode("latin-1").strip()
            raise InputError(
                f"{self.file}: the line {words[:60]!r} is neither a card nor the continuation of one",
                kind="unsupported",
            )
        self.owner, self.heads = np.cumsum(begins) - 1, np.flatnonzero(begins)
        self.form = self._forms(has_comma)
        self.names, self.kind = _names(lines[self.heads, :8])
        free_text = np.array([name.decode("latin-1") in FREE_TEXT for name in self.names.tolist()], dtype=bool)
        _check_marks(lines, begins | free_text[self.kind][self.owner], self.form, self.file)
        self.size = np.diff(np.append(self.heads, len(lines)))

    def _characters(self, begin: Ints, length: Ints, width: int) -> Bytes:
        """The first ``length`` (any shape) of ``width`` characters at places, with blanks behind them."""
        from_place = np.ndarray(len(self._text) - width + 1, f"V{width}", self._text, 0, (1,))
        text = from_place[begin].view(np.uint8).reshape(*begin.shape, width)
        if length.min(initial=width) < width:
            text[np.arange(width, dtype=np.uint8) >= np.minimum(length, width).astype(np.uint8)[..., None]] = 32
        return text

    def _commas_before(self, places: Ints) -> Ints:
        """How many commas stand before places of the text."""
        return np.searchsorted(self.commas, places)

    def _forms(self, has_comma: NDArray[np.bool_]) -> Ints:
        """The form of each line."""
        stars = np.zeros(len(self.lines), dtype=bool)
        if b"*" in self._text:
            stars = (self.lines[:, :8] == ord("*")).any(axis=1)
        form = np.where(stars, Form.LARGE, Form.SMALL)
        form[has_comma] = Form.FREE
        if b"*" in self._text:
            form[has_comma] = np.where(_star_in_first(self.lines[has_comma]), Form.FREE_LARGE, Form.FREE)
        return form

    def tables(self, read: Container[str] | None = None) -> Iterator[Table]:
        """The cards in the order of the file, as far as a name and the kind of its lines change; fields only of cards
        that are ``read`` (None: of all)."""
        below = np.minimum(np.arange(len(self.lines)) - self.heads[self.owner], 20)
        # A digit for each line: its form.
        places = float(len(Form) + 1) ** np.arange(21)
        layout = np.bincount(self.owner, weights=self.form * places[below]).astype(np.int64)
        layout[self.size > 20] = -self.heads[self.size > 20] - 1
        layouts, layout = np.unique(layout, return_inverse=True)
        key = self.kind * len(layouts) + layout.ravel()
        order = np.argsort(key, kind="stable")
        for cards in np.split(order, np.flatnonzero(np.diff(key[order])) + 1):
            if len(cards):
                name = self.names[self.kind[cards[0]]].decode("latin-1")
                lines = self.number[self.heads[cards]]
                if read is not None and name not in read:
                    yield Table(name, np.empty((len(cards), 0, 8), dtype=np.uint8), self.file, lines)
                    continue
                rows = self.heads[cards][:, None] + np.arange(int(self.size[cards[0]]))
                free = self._free_words(rows) if (self.form[rows[0]] == Form.FREE).all() else None
                if free is None:
                    yield Table(name, self._all_fields(rows), self.file, lines)
                else:
                    yield FreeTable(name, self.file, lines, *free, partial(self._all_fields, rows))

    def _all_fields(self, rows: Ints) -> Bytes:
        """Fields (cards, fields, 8 to 24) of cards whose lines are ``rows`` (cards, lines)."""
        parts = [self._fields(rows[:, k]) for k in range(rows.shape[1])]
        width = max(part.shape[2] for part in parts)
        return np.concatenate([widen(part, width) for part in parts], axis=1)

    def _free_words(self, rows: Ints) -> tuple[Words, Ints] | None:
        """Words of the lines (cards, lines) of cards, behind them an empty one, and the word of each field; None where
        a line has more or longer fields than it may, or a blank stands within one."""
        lines, count = rows.ravel(), 8
        begin, end = self.starts[lines], self.starts[lines] + self.lengths[lines]
        if (begin[1:] == end[:-1] + 1).all():
            text = self._text[int(begin[0]) : int(end[-1])]
        else:
            text = b"\n".join(self._text[a:b] for a, b in zip(begin.tolist(), end.tolist(), strict=True))
        words = words_of(text + b"\n,\n")
        if words is None:
            return None
        last = np.flatnonzero(words.ends_line)[:-1]
        first = np.concatenate([[-1], last[:-1]]) + 1
        if len(last) != len(lines) or (last - first).max() > count + 1:
            return None
        at = first[:, None] + 1 + np.arange(count)
        index = np.where(at <= last[:, None], at, len(words) - 1)
        if (words.end - words.begin).max() > TOL.field_characters:
            return None
        return words, index.reshape(len(rows), -1)

    def fours(self, name: bytes) -> tuple[Table, Ints]:
        """Fields of all cards of a name, in the order of the file and in groups of four, and the card of each group."""
        lines = np.flatnonzero((self.names == name)[self.kind][self.owner])
        count = np.where(np.isin(self.form[lines], (Form.SMALL, Form.FREE)), 2, 1)
        first, fields = np.cumsum(count) - count, np.empty((int(count.sum()), 4, TOL.field_characters), dtype=np.uint8)
        for form in np.unique(self.form[lines]).tolist():
            chosen = self.form[lines] == form
            wide = widen(self._fields(lines[chosen]), TOL.field_characters)
            groups = wide.reshape(int(chosen.sum()), -1, 4, TOL.field_characters)
            for k in range(groups.shape[1]):
                fields[first[chosen] + k] = groups[:, k]
        return Table(name.decode(), fields, self.file), np.repeat(self.owner[lines], count)

    def _fields(self, rows: Ints) -> Bytes:
        """Data fields (rows, 8 or 4, 8 to 24) of lines of one form.

        Raises:
            InputError: more fields than a line has, or longer ones.
        """
        form = int(self.form[rows[0]])
        if form in (Form.SMALL, Form.LARGE):
            width = 8 if form == Form.SMALL else 16
            return self.lines[rows, Columns.FIELDS].reshape(len(rows), -1, width)
        codes, starts = self.codes, self.starts[rows]
        stops = starts + self.lengths[rows]
        count = 8 if form == Form.FREE else 4
        first = self._commas_before(starts)
        count_of = self._commas_before(stops) - first
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
        max_width = TOL.field_characters
        beyond = np.flatnonzero(count_of > count + 1)
        tail = [i for i in beyond.tolist() if bytes(codes[at[i, count + 1] : stops[i]]).strip(b", ")]
        long = ((end - begin > max_width) & (codes[np.minimum(begin + max_width, len(codes) - 1)] != 32)).any(axis=1)
        for i in [*tail, *np.flatnonzero(long).tolist()][:1]:
            line = bytes(codes[starts[i] : stops[i]]).decode("latin-1")
            raise InputError(
                f"{self.file}: the line {line[:60]!r} has too many or too long fields; expected {count} of them"
            )
        width = min(-(-int((end - begin).max(initial=1)) // 8) * 8, max_width)
        return self._characters(begin, end - begin, width)


def _letters(codes: Bytes) -> NDArray[np.bool_]:
    # Without the bit of small letters.
    return np.asarray(((codes & 0xDF) >= ord("A")) & ((codes & 0xDF) <= ord("Z")))


def tables(text: BulkText, read: Container[str] | None = None) -> Iterator[Table]:
    """The cards of bulk data, with fields of cards that are ``read`` (None: of all).

    Raises:
        InputError: a file or card that ``BulkText`` or ``Cards`` refuses.
    """
    for piece in text:
        yield from Cards(piece, text).tables(read)


def _star_in_first(lines: Bytes) -> NDArray[np.bool_]:
    """True if there is a star before the first comma of the line."""
    star, comma = lines == ord("*"), lines == 44
    return np.asarray(
        star.any(axis=1) & (star.argmax(axis=1) < np.where(comma.any(axis=1), comma.argmax(axis=1), Columns.ALL))
    )


def _names(heads: Bytes) -> tuple[NDArray[np.bytes_], Ints]:
    """The names of cards in capitals, without star and blanks in front, and which of them each card (k,) has."""
    heads = heads.copy()
    for i in np.flatnonzero(heads[:, 0] == 32).tolist():
        heads[i] = np.frombuffer(bytes(heads[i]).lstrip().ljust(8), dtype=np.uint8)
    eights = heads.view("<u8")[:, 0]
    # Blank, comma and star have the bit 32 without 16 and 64, which digits and letters have; a name ends at the first.
    ends = (eights >> np.uint64(5)) & ~(eights >> np.uint64(4)) & ~(eights >> np.uint64(6)) & np.uint64(Eight.EACH)
    unique, card = np.unique(eights & ((ends & (~ends + np.uint64(1))) - np.uint64(1)), return_inverse=True)
    letters = unique.view(np.uint8).reshape(-1, 8)
    letters[(letters >= ord("a")) & (letters <= ord("z"))] -= 32
    names, name = np.unique(np.ascontiguousarray(letters).view("S8").ravel(), return_inverse=True)
    return names, name.ravel()[card.ravel()]


def _check_marks(lines: Bytes, begins: NDArray[np.bool_], form: Ints, file: str) -> None:
    """Refuse continuations that do not follow the line whose mark they carry."""
    pair = np.flatnonzero(~begins[1:] & (form[1:] < Form.FREE) & (form[:-1] < Form.FREE))
    eights = lines.view("<u8")
    # Without the first of eight characters, which says that a line goes on.
    before, after = (eights[rows, k] >> np.uint64(8) for rows, k in ((pair, 9), (pair + 1, 0)))
    blank = np.uint64(Eight.BLANKS >> 8)
    wrong = (before != after) & (before != blank) & (after != blank)
    if wrong.any():
        line = bytes(lines[pair[wrong][0] + 1]).decode("latin-1").strip()
        raise InputError(
            f"{file}: the continuation {line[:60]!r} does not carry the mark of the line above it; sort the cards so "
            "that each is followed by its continuations",
            kind="unsupported",
        )
