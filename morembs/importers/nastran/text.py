"""Text of Nastran bulk data: where they begin and end, files that they include, pieces of whole cards."""

from __future__ import annotations

import gzip
import re
import zlib
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from morembs.base.errors import InputError
from morembs.importers.decks.includes import Includes, cut_line, ends_within_number, open_line, open_text
from morembs.importers.nastran.replication import BLOCK, replicate
from morembs.importers.tolerances import TOL

_BEGIN = re.compile(rb"^[ \t]*BEGIN[ \t,]+(BULK|SUPER)[^\n]*\n?", re.MULTILINE | re.IGNORECASE)
_END = re.compile(rb"^[ \t]*ENDDATA.*", re.MULTILINE | re.IGNORECASE | re.DOTALL)
_INCLUDE = re.compile(
    rb"^[ \t]*INCLUDE[ \t=]+(?:'([^']*)'|\"([^\"]*)\"|([^\s$]+))[^\n]*\n", re.MULTILINE | re.IGNORECASE
)
# How an included file begins: a card whose first field is a number, one of a few others, or a continuation.
_FIRST = re.compile(
    rb"(PARAM|INCLUDE|ENDDATA|BEGIN|GRDSET|DMIG)\b|[A-Z]\w{0,7} *\*? *[ ,\t][ ,\t]*[-+.0-9]|[+*,]", re.IGNORECASE
)


class Columns:
    """Columns of a line of fixed fields, from 0 (MSC Nastran Quick Reference Guide, format of bulk data entries).

    A mark at its end stands at the begin of the line that continues it.
    """

    MARK = slice(1, 8)
    FIELDS = slice(8, 72)
    MARK_BELOW = slice(73, 80)
    ALL = 80


@dataclass(frozen=True)
class Piece:
    """Lines of whole cards of one file, without comments, below ``above`` lines."""

    text: bytes
    file: str
    above: int


class BulkText:
    """The text of a file of bulk data, which may be packed (gzip), and of its included files.

    ``head`` is what stands above BEGIN BULK, empty without it.

    Raises:
        InputError: the file cannot be opened.
    """

    def __init__(self, path: Path, *, outside: bool = False) -> None:
        self.path, self.file = path, path.name
        head, self._start = _head_of(path)
        self.head = re.sub(rb"\$.*", b"", head.replace(b"\r", b"")).decode("latin-1")
        self._includes = Includes(path, outside)
        self._ended = True
        self._said: list[str] = []
        self._first: dict[str, str] = {}
        self._count: dict[str, int] = {}

    def unread(self, file: str, line: int, text: str) -> None:
        """Note ``text`` of the ``line`` of a file, counted from 1, that lies beyond the fields of its card."""
        max_length = TOL.shown_unread
        short = text if len(text) <= max_length else f"{text[:max_length]}..."
        self._first.setdefault(file, f"line {line}: the text {short!r}")
        self._count[file] = self._count.get(file, 0) + 1

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the text, a sentence each, once its pieces were read."""
        cut = f"{self.file} has BEGIN BULK and no ENDDATA at its end; cards may be missing there"
        return (
            (() if self._ended else (cut,))
            + tuple(self._said)
            + tuple(
                f"{file}, {first} beyond column {Columns.ALL}, where the fields of a card end, was not read"
                + (f", nor that of {count - 1} further lines" if (count := self._count[file]) > 1 else "")
                + "; check the columns of these cards"
                for file, first in self._first.items()
            )
        )

    def __iter__(self) -> Iterator[Piece]:
        """Pieces in the order of the cards, INCLUDE followed.

        Raises:
            InputError: a file is missing, binary, or includes a forbidden file.
        """
        yield from self._pieces(self.path, (), self._start)

    def _pieces(self, path: Path, outer: tuple[Path, ...], start: int = 0) -> Iterator[Piece]:
        outer, above = (*outer, path.resolve()), _lines_above(path, start)
        ended, card = not start, b""
        for text, last in _cards(path, start, self._said):
            at = 0
            for match in _INCLUDE.finditer(text) if _has_word(text, b"INCLUDE") else ():
                part = text[at : match.start()]
                card = yield from _write_out(part, path.name, above + text.count(b"\n", 0, at), card)
                at = match.end()
                name = next(group for group in match.groups() if group is not None).decode("latin-1").strip()
                where, folders = f"{path.name}: INCLUDE", (path.parent, self._includes.path.parent)
                yield from self._pieces(self._includes.take(name, where, folders, outer, _FIRST), outer)
            card = yield from _write_out(text[at:], path.name, above + text.count(b"\n", 0, at), card)
            above += text.count(b"\n")
            ended = ended or last
        self._ended = self._ended and ended


def _write_out(text: bytes, file: str, above: int, card: bytes) -> Generator[Piece, None, bytes]:
    """The text, below the line ``card``, as pieces in which replicated cards are written out; its last line."""
    at = 0
    for match in BLOCK.finditer(text) if b"=" in text else ():
        before = text[at : match.start()]
        yield Piece(before, file, above + text.count(b"\n", 0, at))
        card = before.rstrip().rpartition(b"\n")[2] or card
        line = above + 1 + text.count(b"\n", 0, match.start())
        cards = replicate(card, match.group(), f"{file}, line {line}")
        yield Piece(cards, file, line - 1)
        card, at = cards.rstrip().rpartition(b"\n")[2], match.end()
    yield Piece(text[at:], file, above + text.count(b"\n", 0, at))
    return text[at:].rstrip().rpartition(b"\n")[2] or card


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    try:
        with path.open("rb") as file:
            packed = file.read(2) == b"\x1f\x8b"
        with gzip.open(path) if packed else open_text(path) as text:
            yield text  # type: ignore[misc]
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise InputError(
            f"{path.name} cannot be read: it is cut off or not a gzip file ({error}); pack it again",
            kind="file",
            keyword=path.name,
        ) from error
    except OSError as error:
        raise InputError(
            f"{path.name} cannot be opened: {error.strerror}; check the path", kind="file", keyword=path.name
        ) from error


def _head_of(path: Path) -> tuple[bytes, int]:
    """What stands above BEGIN BULK (empty without it), and where bulk data begin."""
    text, at = b"", 0
    with _opened(path) as file:
        while chunk := file.read(TOL.piece_bytes):
            text += chunk
            # A search for a plain word takes a tenth of the time.
            if _has_word(text, b"BEGIN") and (match := _BEGIN.search(text)):
                return text[: match.start()], at + match.end()
            # Case control is short; what does not fit here is bulk data.
            keep = min(len(text), 1 << 12)
            if at == 0 and len(text) <= TOL.piece_bytes:
                continue
            at, text = at + len(text) - keep, text[-keep:]
    return b"", 0


def _has_word(text: bytes, word: bytes) -> bool:
    """True if a word in capitals is in a text in any case; letters are looked for first, as copies take ten times as
    long."""
    return word in text or (any(bytes([letter]) in text for letter in {*word.lower()}) and word in text.upper())


def _lines_above(path: Path, start: int) -> int:
    with _opened(path) as file:
        return len(re.findall(rb"\r\n?|\n", file.read(start)))


def _cards(path: Path, start: int, warnings: list[str]) -> Iterator[tuple[bytes, bool]]:
    """Text of whole cards without comments, up to ENDDATA; whether that was met. ``warnings`` are warnings."""
    rest, above = b"", list[bytes]()
    with _opened(path) as file:
        file.seek(start, 1)
        while True:
            chunk = file.read(TOL.piece_bytes)
            if b"\0" in chunk:
                raise InputError(
                    f"{path.name} holds binary data; expected bulk data, which are text", kind="file", keyword=path.name
                )
            text = rest + chunk
            cut = _last_card(text, len(rest)) if chunk else len(text)
            if chunk and not cut and len(text) > TOL.longest_card_bytes:
                raise InputError(
                    f"{path.name} has a card of {len(text) / 1e6:.0f} MB, or no ends of lines; expected bulk data, "
                    "which are text",
                    kind="file",
                    keyword=path.name,
                )
            rest = text[cut:]
            clean = _clean(text[:cut])
            end = _END.search(clean) if _has_word(clean, b"ENDDATA") else None
            if not chunk and not end and text.strip() and text[-1:] not in (b"\n", b"\r"):
                warnings += _last_line(above, text[text.rfind(b"\n") + 1 :], path.name)
            above = clean.rstrip(b"\n").rsplit(b"\n", TOL.layout_lines)[-TOL.layout_lines :]
            yield (clean[: end.start()] if end else clean), end is not None
            if end or not chunk:
                return


def _last_line(above: list[bytes], line: bytes, file: str) -> list[str]:
    """What to say of a last line without an end and without ENDDATA below ``above``; its card may be whole.

    Raises:
        InputError: the line has fewer fields than the one above, which has the same name, or a shorter number than
            lines above of the same layout; it goes on, or is of a matrix.
    """
    line = line.partition(b"$")[0]
    if not line.strip():
        return []
    own, other = (
        row.split(b",") if b"," in row else [row[at : at + 8] for at in range(0, len(row) or 1, 8)]
        for row in (line, above[-1] if above else b"")
    )
    name = own[0].strip(b" *").upper()
    alike = [row for row in above if row[: len(name)].upper() == name]
    is_short = name == other[0].strip(b" *").upper() and len(own) < len(other)
    goes_on = line.rstrip().endswith((b",", b"+", b"*"))
    # Columns of a matrix have any number of entries.
    is_short |= ends_within_number(line, alike)
    if is_short or goes_on or name == b"DMIG" or b"ENDDATA".startswith(line.strip().upper()):
        raise cut_line(file, line)
    return [open_line(file, line)]


def _last_card(text: bytes, known: int) -> int:
    """Where the last card begins, which may go on in the next piece; in the ``known`` first bytes only one does."""
    at = len(text)
    while (at := text.rfind(b"\n", max(known - 1, 0), at)) >= 0:
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
