"""Input decks of Abaqus and CalculiX as keywords with their data lines, read piece by piece.

A keyword line begins with one star, a comment with two; a keyword line that ends in a comma goes on in the next.
*INCLUDE is followed, and so is INPUT= of the blocks that hold data by the line.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from pathlib import Path

from morembs.base.errors import InputError
from morembs.importers.abaqus.words import WORDS, canonical, canonical_option
from morembs.importers.decks.includes import Includes, cut_line, ends_within_number, open_line, open_text
from morembs.importers.tolerances import TOL

_COMMENT = re.compile(rb"^[ \t]*\*\*.*\n", re.MULTILINE)
_WITH_INPUT = ("NODE", "ELEMENT", "NSET", "ELSET")
# How an included file begins: a keyword, or data of numbers.
_BEGIN = re.compile(rb"\*[ \t]*[A-Za-z]|[-+.0-9][-+.0-9eEdD, \t]*$")
# Data that are an include without its star.
_NO_STAR = re.compile(rb"^[ \t]*INCLUDE[ \t]*,[ \t]*INPUT[ \t]*=", re.MULTILINE | re.IGNORECASE)
# Comments at the top of a file behind other characters, such as the mark of a quotation; ccx reads over them.
_STRAY_COMMENTS = re.compile(rb"(?:[^\w*,\n]{1,4}\*\*[^\n]*\n|[ \t]*\n)+")
# They take a title or nothing, so numbers of an included file behind them are those of a block that lost its keyword.
_WITHOUT_DATA = ("HEADING", "PREPRINT")
# Last lines that are whole without an end of line: cut off, they would be other words. *END alone is of old decks.
_LAST = re.compile(rb"\*\*|\*[ \t]*END([ \t]*(STEP|PART|ASSEMBLY|INSTANCE))?$", re.IGNORECASE)
# What bulk data of Nastran have and decks of Abaqus have not.
_NASTRAN = re.compile(rb"^[ \t]*(BEGIN[ \t]+BULK|CEND\b|GRID[ ,*\t]|ENDDATA)", re.IGNORECASE | re.MULTILINE)


@dataclass(frozen=True, eq=False)
class Card:
    """A keyword line: ``keyword`` in capitals, ``options`` with their names in capitals, its ``file`` and ``line``."""

    keyword: str
    options: dict[str, str]
    file: str
    line: int = 0

    def __str__(self) -> str:
        return f"{self.file}{f', line {self.line}' if self.line else ''}: *{self.keyword}"

    def need(self, option: str) -> str:
        """Value of an option that must be there."""
        value = self.options.get(option, "")
        if not value:
            raise InputError(f"{self} gives no {option}=; expected one", kind="missing")
        return value


def cards(
    path: Path, *, outside: bool = False, warnings: list[str] | None = None
) -> Iterator[tuple[Card, Iterator[bytes]]]:
    """Each keyword with its data in pieces of whole lines; what is not taken of the pieces is passed over.

    ``outside`` allows to include files from beyond the folder of the deck; ``warnings`` about the text are added.

    Raises:
        InputError: a file is missing, binary, includes a forbidden file, or does not begin with a keyword.
    """
    includes = Includes(path, outside, [] if warnings is None else warnings)
    for card, group in groupby(_stream(path, (), None, includes), key=itemgetter(0)):
        yield card, (piece for _, piece in group)


def _stream(
    path: Path, above: tuple[Path, ...], card: Card | None, includes: Includes
) -> Generator[tuple[Card, bytes], None, Card | None]:
    """Cards with pieces of data; begins inside ``card`` and returns the one it ends in."""
    outer, above = card, (*above, path.resolve())
    before = b""
    for text, number, open_end in _texts(path):
        at = 0
        while (star := _next_keyword(text, at)) >= 0:
            yield from _data(card, text[at:star], path, swallowed=card is outer)
            line, at = _keyword_line(text, star)
            following = _card(line, path.name, number(star))
            if following.keyword == "INCLUDE":
                card = yield from _stream(_include(path, following, above, includes), above, card, includes)
                continue
            card = following
            yield card, b""
            if card.keyword in _WITH_INPUT and card.options.get("INPUT"):
                for piece, *_ in _texts(_include(path, card, above, includes)):
                    yield card, piece
        yield from _data(card, text[at:], path, swallowed=card is outer)
        if open_end:
            includes.warnings += _last_line(card, before * (at == 0) + text[at:], open_end, path.name)
        before = b"\n".join(text.rsplit(b"\n", TOL.layout_lines + 1)[-TOL.layout_lines - 1 :])
    return card


def _last_line(card: Card | None, data: bytes, line: bytes, file: str) -> list[str]:
    """What to say of the last ``line`` of a file, which has no end, behind the ``data`` of its card. The programs read
    it (fgets of ccx); a keyword that is known is whole, and numbers may be.

    Raises:
        InputError: a keyword that is not known, or the line is cut off: it has fewer fields than the one above, a
            comma at its end, or a shorter number than lines above of the same layout.
    """
    if line.startswith(b"*"):
        if not _LAST.match(line) and (canonical(decode(line[1:]).split(",")[0]) not in WORDS or line.endswith(b",")):
            raise cut_line(file, line)
        return []
    *rows, _ = data.rstrip().split(b"\n")[-1 - TOL.layout_lines :]
    above = rows[-1:]
    is_node = card is not None and card.keyword == "NODE"
    is_short = is_node and any(line.count(b",") < row.rstrip(b", ").count(b",") for row in above)
    if line.endswith(b",") or is_short or ends_within_number(line, rows):
        raise cut_line(file, line)
    return [open_line(file, line)]


def _data(card: Card | None, piece: bytes, path: Path, *, swallowed: bool) -> Iterator[tuple[Card, bytes]]:
    """Data of a card; ``swallowed`` where the card stands in the file that includes this one."""
    if not piece.strip() or (card is None and _STRAY_COMMENTS.fullmatch(piece)):
        return
    if card is None or (swallowed and card.keyword in _WITHOUT_DATA):
        behind = "no *NODE block or the like" if card is None else f"*{card.keyword}, which takes none,"
        cure = "; it seems to be Nastran bulk data: --format nastran" if _NASTRAN.search(piece) else ""
        raise InputError(
            f"{path.name} begins with data where a keyword belongs: {behind} stands before them; expected an Abaqus or "
            f"CalculiX input deck{cure}"
        )
    if (b"I" in piece or b"i" in piece) and b"INCLUDE" in piece.upper() and _NO_STAR.search(piece):
        raise InputError(
            f"{path.name} has INCLUDE, INPUT= without a star among the data of {card}; write *INCLUDE",
            kind="unsupported",
        )
    yield card, piece


def _include(path: Path, card: Card, above: tuple[Path, ...], includes: Includes) -> Path:
    """The file that a card in the file ``path`` names."""
    return includes.take(card.need("INPUT"), str(card), (path.parent, includes.path.parent), above, _BEGIN)


def _texts(path: Path) -> Iterator[tuple[bytes, Callable[[int], int], bytes]]:
    """Pieces of whole lines without comments, what gives the line of the file at an ascending place in the piece, and
    the last line of the file where it has no end.

    A keyword line is never at the end of a piece but the last.
    """
    rest, above = b"", 0
    try:
        with open_text(path) as file:
            while chunk := file.read(TOL.piece_bytes):
                if b"\0" in chunk:
                    raise InputError(
                        f"{path.name} holds binary data; expected an input deck, which is text",
                        kind="file",
                        keyword=path.name,
                    )
                text = rest + chunk
                cut = text.rfind(b"\n") + 1
                cut = _before_last_keyword(text, cut)
                if cut == 0 and len(text) > TOL.piece_bytes + TOL.longest_line_bytes:
                    raise InputError(
                        f"{path.name} has no ends of lines; expected an input deck, which is text",
                        kind="file",
                        keyword=path.name,
                    )
                rest = text[cut:]
                if cut:
                    piece, lines = _clean(text[:cut])
                    yield piece, lines.since(above), b""
                    above += lines.count
    except OSError as error:
        raise InputError(
            f"{path.name} cannot be opened: {error.strerror}; check the path", kind="file", keyword=path.name
        ) from error
    if rest:
        piece, lines = _clean(rest + b"\n")
        yield piece, lines.since(above), rest[rest.rfind(b"\n") + 1 :].strip()


def _before_last_keyword(text: bytes, cut: int) -> int:
    """``cut``, or the begin of the keyword line that is the last before it: it may go on in the next piece."""
    at = cut
    for _ in range(TOL.continued_lines):
        at = text.rfind(b"\n", 0, max(at - 1, 0)) + 1
        begin = text[at : at + TOL.told_bytes].lstrip(b" \t")[:2]
        if begin[:1] == b"*" and begin != b"**":
            return at
        before = text[max(at - TOL.told_bytes, 0) : at].rstrip()
        if at == 0 or not before.endswith(b","):
            return cut
    return cut


class _Lines:
    """Lines of the ``text`` of a piece, from which lines at the places ``left`` were taken out."""

    def __init__(self, text: bytes, left: list[int]) -> None:
        self.text, self.left = text, left

    @property
    def count(self) -> int:
        """Lines that the piece had."""
        return self.text.count(b"\n") + len(self.left)

    def since(self, above: int) -> Callable[[int], int]:
        """The line of the file at a place, ``above`` lines being before the piece; places ascend from call to call."""
        line, counted = above + 1, 0

        def number(place: int) -> int:
            nonlocal line, counted
            line += self.text.count(b"\n", counted, place)
            counted = place
            return line + bisect_right(self.left, place)

        return number


def _clean(text: bytes) -> tuple[bytes, _Lines]:
    """The text without comments, with ends of lines of one kind, and the lines it had."""
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"**" not in text:
        return text, _Lines(text, [])
    parts, left, at, taken = [], [], 0, 0
    for comment in _COMMENT.finditer(text):
        parts.append(text[at : comment.start()])
        left.append(comment.start() - taken)
        at = comment.end()
        taken += at - comment.start()
    text = b"".join([*parts, text[at:]])
    return text, _Lines(text, left)


def _next_keyword(text: bytes, at: int) -> int:
    """Where the next line begins whose first character is a star, -1 if none does."""
    star = text.find(b"*", at)
    while star >= 0:
        begin = text.rfind(b"\n", 0, star) + 1
        if not text[begin:star].strip():
            return begin
        star = text.find(b"*", star + 1)
    return -1


def _keyword_line(text: bytes, start: int) -> tuple[bytes, int]:
    """The keyword line at ``start`` with the lines it goes on in, and where the next line begins."""
    line, at = b"", start
    while True:
        end = text.index(b"\n", at) + 1
        line, at = line + text[at:end].strip(), end
        following = text[at : at + TOL.told_bytes_below].lstrip(b" \t")[:1]
        if not line.endswith(b",") or not following.isalpha():
            return line, at


def decode(text: bytes) -> str:
    """Text in UTF-8, or Latin-1 where it is not."""
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError:
        return text.decode("latin-1")


def _card(line: bytes, file: str, number: int) -> Card:
    head, *rest = decode(line).lstrip()[1:].split(",")
    options = {}
    for part in rest:
        key, _, value = part.partition("=")
        if key.strip():
            options[canonical_option(key)] = value.strip().strip('"').strip()
    return Card(canonical(head), options, file, number)
