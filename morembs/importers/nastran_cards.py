"""Cards of Nastran bulk data in small, large and free fields; many cards of one name at once.

A file is read in pieces of whole cards. Each line becomes eight fields (four where a field has 16 columns), and
cards of one name with lines of the same kind become one table of fields.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.importers.includes import Includes, open_text
from morembs.importers.text_matrices import integers, numbers

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bytes = NDArray[np.uint8]
PIECE = 1 << 22
_LONGEST_CARD = 1 << 26
_TAIL = 1 << 16
_LARGEST = 1e100
_WIDTH = 24
_LINE = 80
_SHOWN = 24
_SMALL, _LARGE, _FREE, _FREE_LARGE = 1, 2, 3, 4
_BEGIN = re.compile(rb"^[ \t]*BEGIN[ \t,]+(BULK|SUPER)[^\n]*\n?", re.MULTILINE | re.IGNORECASE)
_END = re.compile(rb"^[ \t]*ENDDATA.*", re.MULTILINE | re.IGNORECASE | re.DOTALL)
_INCLUDE = re.compile(
    rb"^[ \t]*INCLUDE[ \t=]+(?:'([^']*)'|\"([^\"]*)\"|([^\s$]+))[^\n]*\n", re.MULTILINE | re.IGNORECASE
)
# How an included file begins: a card whose first field is a number, one of a few others, or a continuation.
_FIRST = re.compile(
    rb"(PARAM|INCLUDE|ENDDATA|BEGIN|GRDSET)\b|[A-Z]\w{0,7} *\*? *[ ,\t][ ,\t]*[-+.0-9]|[+*,]", re.IGNORECASE
)
_REAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([ED]?[+-]?\d+)?", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Table:
    """Cards of one name: ``fields`` (cards, fields, 24) characters from the field behind the name on."""

    name: str
    fields: Bytes
    file: str

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

    def whole(self, first: int, last: int) -> Ints:
        """Integers (cards, last - first) of fields; a blank one is 0."""
        values = integers(self.reals(first, last).ravel(), f"an integer of a {self.name} card", self.file)
        return values.reshape(len(self), last - first)

    def rows(self) -> list[list[str]]:
        """The fields of each card as text, without blank ones at the end."""
        flat = np.ascontiguousarray(self.fields).reshape(-1, _WIDTH).view(f"S{_WIDTH}").ravel()
        texts = np.char.strip(flat).reshape(self.fields.shape[:2])
        rows = [[text.decode("latin-1") for text in row] for row in texts.tolist()]
        for row in rows:
            while row and not row[-1]:
                row.pop()
        return rows

    def _part(self, first: int, last: int) -> Bytes:
        part = self.fields[:, first:last]
        if part.shape[1] < last - first:
            more = np.full((len(part), last - first - part.shape[1], _WIDTH), 32, dtype=np.uint8)
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
        if abs(value) < _LARGEST:
            return value
    raise InputError(f"{what}: {text[:24]!r} cannot be read as a number; expected a finite one")


def whole(text: str, what: str) -> int:
    """An integer; blank is 0."""
    if not text:
        return 0
    if re.fullmatch(r"[+-]?\d{1,15}", text):
        return int(text)
    raise InputError(f"{what}: {text[:24]!r} was given; expected an integer")


def head_of(path: Path) -> tuple[bytes, int]:
    """What stands above BEGIN BULK (empty without one), and where bulk data begin."""
    text, at = b"", 0
    try:
        with open_text(path) as file:
            while chunk := file.read(PIECE):
                text += chunk
                if match := _BEGIN.search(text):
                    return text[: match.start()], at + match.end()
                # Case control is short; what does not fit here is bulk data.
                keep = min(len(text), 1 << 12)
                if at == 0 and len(text) <= PIECE:
                    continue
                at, text = at + len(text) - keep, text[-keep:]
    except OSError as error:
        raise InputError(f"{path.name} cannot be opened: {error.strerror}; check the path") from error
    return b"", 0


def ends(path: Path) -> bool:
    """Whether ENDDATA stands near the end of a file."""
    with open_text(path) as file:
        size = file.seek(0, 2)
        file.seek(max(size - _TAIL, 0))
        return _END.search(file.read()) is not None


class Unread:
    """Lines of files with text beyond the last column of fixed fields, which belongs to no field."""

    def __init__(self) -> None:
        self._first: dict[str, str] = {}
        self._count: dict[str, int] = {}

    def add(self, file: str, line: int, text: str) -> None:
        """Such a ``text`` of the ``line`` of a file, counted from 1."""
        short = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
        self._first.setdefault(file, f"line {line}: the text {short!r}")
        self._count[file] = self._count.get(file, 0) + 1

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for each file."""
        return tuple(
            f"{file}, {first} beyond column {_LINE}, where the fields of a card end, was not read"
            + (f", nor that of {count - 1} further lines" if (count := self._count[file]) > 1 else "")
            + "; check the columns of these cards"
            for file, first in self._first.items()
        )


def tables(
    path: Path, start: int, includes: Includes, unread: Unread, above: tuple[Path, ...] = ()
) -> Iterator[Table]:  # fmt: skip
    """The cards of bulk data from the byte ``start`` on, INCLUDE followed.

    Raises:
        InputError: a file is missing, binary, includes what it must not, or has a line that is no card.
    """
    above = (*above, path.resolve())
    lines = _lines_above(path, start)
    for piece in _pieces(path, start):
        at = 0
        for match in _INCLUDE.finditer(piece):
            part = piece[at : match.start()]
            yield from _tables(part, path.name, lines, unread)
            lines += part.count(b"\n") + match.group().count(b"\n")
            at = match.end()
            name = next(group for group in match.groups() if group is not None).decode("latin-1").strip()
            folders = (path.parent, includes.path.parent)
            file = includes.take(name, f"{path.name}: INCLUDE", folders, above, _FIRST)
            yield from tables(file, 0, includes, unread, above)
        yield from _tables(piece[at:], path.name, lines, unread)
        lines += piece[at:].count(b"\n")


def _lines_above(path: Path, start: int) -> int:
    """Ends of lines before the byte ``start`` of the text, where bulk data begin."""
    try:
        with open_text(path) as file:
            return len(re.findall(rb"\r\n?|\n", file.read(start)))
    except OSError as error:
        raise InputError(f"{path.name} cannot be opened: {error.strerror}; check the path") from error


def _pieces(path: Path, start: int) -> Iterator[bytes]:
    """Pieces of whole cards without comments, up to ENDDATA."""
    rest = b""
    try:
        with open_text(path) as file:
            file.seek(start, 1)
            while True:
                chunk = file.read(PIECE)
                if b"\0" in chunk:
                    raise InputError(f"{path.name} holds binary data; expected bulk data, which are text")
                text = rest + chunk
                cut = _last_card(text) if chunk else len(text)
                if chunk and not cut and len(text) > _LONGEST_CARD:
                    raise InputError(f"{path.name} has no ends of lines; expected bulk data, which are text")
                rest = text[cut:]
                clean = _clean(text[:cut])
                end = _END.search(clean)
                if not chunk and not end and text.strip() and text[-1:] not in (b"\n", b"\r"):
                    line = text[text.rfind(b"\n") + 1 :].decode("latin-1")
                    raise InputError(
                        f"{path.name} ends within the line {line[:40]!r} and without ENDDATA, so it may be cut off; "
                        "write it again, or end the last line if the file is complete"
                    )
                yield clean[: end.start()] if end else clean
                if end or not chunk:
                    return
    except OSError as error:
        raise InputError(f"{path.name} cannot be opened: {error.strerror}; check the path") from error


def _last_card(text: bytes) -> int:
    """Where the last card begins; it may go on in the next piece."""
    at = len(text)
    while (at := text.rfind(b"\n", 0, at)) >= 0:
        if text[at + 1 : at + 2].isalpha():
            return at + 1
    return 0


def _clean(text: bytes) -> bytes:
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"$" in text:
        text = re.sub(rb"\$.*", b"", text)
    if b"\t" in text:
        text = b"\n".join(line.expandtabs(8) for line in text.split(b"\n"))
    return text if not text or text.endswith(b"\n") else text + b"\n"


def _tables(piece: bytes, file: str, above: int, unread: Unread) -> Iterator[Table]:
    """Tables of the cards of a piece, ``above`` which lines lie: one for each name and kind of lines."""
    codes = np.frombuffer(piece + b" " * (_LINE + _WIDTH), dtype=np.uint8)
    ends = np.flatnonzero(codes == 10)
    starts = np.concatenate([[0], ends[:-1] + 1]) if len(ends) else np.empty(0, dtype=np.int64)
    lengths = ends - starts
    lines = np.lib.stride_tricks.sliding_window_view(codes, _LINE)[starts].copy()
    lines[np.arange(_LINE) >= lengths[:, None]] = 32
    full = (lines != 32).any(axis=1)
    for i in np.flatnonzero(lengths > _LINE).tolist():
        text = bytes(codes[starts[i] : ends[i]])
        if text[_LINE:].strip() and not (full[i] and b"," in text):
            unread.add(file, above + i + 1, text[_LINE:].decode("latin-1").strip())
    lines, starts, lengths = lines[full], starts[full], lengths[full]
    if not len(lines):
        return
    first = lines[:, 0]
    begins = ((first & 0xDF) >= ord("A")) & ((first & 0xDF) <= ord("Z"))
    odd = np.flatnonzero(~begins & ~np.isin(first, np.frombuffer(b"+* ,", dtype=np.uint8)))
    if len(odd) or not begins[0]:
        line = bytes(lines[odd[0] if len(odd) else 0]).decode("latin-1").strip()
        raise InputError(f"{file}: the line {line[:60]!r} is neither a card nor the continuation of one")
    commas = codes == 44
    total = np.concatenate([[0], np.cumsum(commas)])
    count = total[starts + lengths] - total[starts]
    star = (lines[:, :8] == ord("*")).any(axis=1)
    star_first = _star_in_first(lines)
    form = np.where(count > 0, np.where(star_first, _FREE_LARGE, _FREE), np.where(star, _LARGE, _SMALL))
    _check_marks(lines, begins, form, file)
    owner = np.cumsum(begins) - 1
    heads = np.flatnonzero(begins)
    titles = _names(lines[heads])
    size = np.diff(np.append(heads, len(lines)))
    unique, kind = np.unique(titles, return_inverse=True)
    digits = form * 5 ** np.minimum(np.arange(len(lines)) - heads[owner], 20).astype(np.int64)
    layout = np.bincount(owner, weights=digits.astype(np.float64)).astype(np.int64)
    layout[size > 20] = -heads[size > 20] - 1
    position = np.flatnonzero(commas)
    # In the order of the file, as far as a name and the kind of its lines change.
    key = np.unique(np.stack([kind, layout, size]), axis=1, return_inverse=True)[1].ravel()
    order = np.argsort(key, kind="stable")
    for cards in np.split(order, np.flatnonzero(np.diff(key[order])) + 1):
        name = unique[kind[cards[0]]].decode("latin-1")
        parts = []
        for k in range(int(size[cards[0]])):
            at = heads[cards] + k
            parts.append(_fields(lines[at], int(form[at[0]]), codes, starts[at], lengths[at], position, total, file))
        yield Table(name, np.concatenate(parts, axis=1), file)


def _star_in_first(lines: Bytes) -> NDArray[np.bool_]:
    """Whether there is a star before the first comma of the line."""
    star, comma = lines == ord("*"), lines == 44
    return np.asarray(
        star.any(axis=1) & (star.argmax(axis=1) < np.where(comma.any(axis=1), comma.argmax(axis=1), _LINE))
    )


def _names(lines: Bytes) -> NDArray[np.bytes_]:
    """Names (k,) of cards in capitals, without star."""
    heads = lines[:, :8].copy()
    stop = np.cumsum((heads == 44) | (heads == ord("*")) | (heads == 32), axis=1) > 0
    heads[stop] = 0
    small = (heads >= ord("a")) & (heads <= ord("z"))
    heads[small] -= 32
    return np.asarray(np.ascontiguousarray(heads).view("S8").ravel())


def _check_marks(lines: Bytes, begins: NDArray[np.bool_], form: Ints, file: str) -> None:
    """Refuse continuations that are not behind the line whose mark they bear."""
    pair = np.flatnonzero(~begins[1:] & (form[1:] < _FREE) & (form[:-1] < _FREE))
    before, after = lines[pair, 73:80], lines[pair + 1, 1:8]
    wrong = (before != after).any(axis=1) & (before != 32).any(axis=1) & (after != 32).any(axis=1)
    if wrong.any():
        line = bytes(lines[pair[wrong][0] + 1]).decode("latin-1").strip()
        raise InputError(
            f"{file}: the continuation {line[:60]!r} does not bear the mark of the line above it; sort the cards so "
            "that each is followed by its continuations"
        )


def _fields(
    lines: Bytes, form: int, codes: Bytes, starts: Ints, lengths: Ints, position: Ints, total: Ints, file: str
) -> Bytes:
    """Data fields (lines, 8 or 4, 24) of lines of one form."""
    blank = np.full((len(lines), 8 if form in (_SMALL, _FREE) else 4, _WIDTH), 32, dtype=np.uint8)
    if form == _SMALL:
        blank[:, :, :8] = lines[:, 8:72].reshape(-1, 8, 8)
        return blank
    if form == _LARGE:
        blank[:, :, :16] = lines[:, 8:72].reshape(-1, 4, 16)
        return blank
    count = blank.shape[1]
    first, found = total[starts], total[starts + lengths] - total[starts]
    padded = np.append(position, np.full(count + 2, len(codes)))
    at = padded[first[:, None] + np.arange(count + 2)]
    at = np.where(np.arange(count + 2) < found[:, None], at, (starts + lengths)[:, None])
    begin, end = np.minimum(at[:, :count] + 1, at[:, 1 : count + 1]), at[:, 1 : count + 1]
    # Blanks before a field do not count.
    for _ in range(_LINE):
        move = (begin < end) & (codes[begin] == 32)
        if not move.any():
            break
        begin = begin + move
    index = begin[:, :, None] + np.arange(_WIDTH)
    text = np.where(index < end[:, :, None], codes[np.minimum(index, len(codes) - 1)], 32).astype(np.uint8)
    beyond = np.flatnonzero(found > count + 1)
    tail = [i for i in beyond.tolist() if bytes(codes[at[i, count + 1] : starts[i] + lengths[i]]).strip(b", ")]
    long = ((end - begin > _WIDTH) & (codes[np.minimum(begin + _WIDTH, len(codes) - 1)] != 32)).any(axis=1)
    for i in [*tail, *np.flatnonzero(long).tolist()][:1]:
        line = bytes(codes[starts[i] : starts[i] + lengths[i]]).decode("latin-1")
        raise InputError(f"{file}: the line {line[:60]!r} has too many or too long fields; expected {count} of them")
    return text
