"""Lines of ANSYS archives: one by one, and many of a block at once."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.importers.decks.includes import cut_line, open_line, open_text
from morembs.importers.decks.numerals import Eight
from morembs.importers.tolerances import TOL

# Commands without fields, which an archive may end with.
_ALONE = (b"FINISH", b"FINI", b"/EOF", b"/SOLU", b"SOLVE", b"/GO", b"/PREP7", b"ALLSEL", b"SAVE")
_BEFORE_NEWLINE = re.compile(rb"\r+\n")


class Lines:
    """Lines of an archive without their ends; ``number`` of the last from 1."""

    def __init__(self, path: Path) -> None:
        self.name, self.number = path.name, 0
        self.warnings: list[str] = []
        self._pieces = self._read(path)
        self._text, self._at = next(self._pieces, b""), 0

    def _read(self, path: Path) -> Iterator[bytes]:
        """Pieces of whole lines."""
        if not path.is_file():
            what = "is not a file" if path.exists() else "does not exist"
            raise InputError(f"archive {str(path)!r} {what}; check the path", kind="unsupported")
        rest = b""
        try:
            with open_text(path) as file:
                while chunk := file.read(TOL.piece_bytes):
                    text = rest + chunk
                    cut = text.rfind(b"\n") + 1
                    rest = text[cut:]
                    if b"\0" in chunk or len(rest) > TOL.longest_line_bytes:
                        raise InputError(
                            f"{path.name} is not a text of lines; expected an archive (CDWRITE)",
                            kind="file",
                            keyword=path.name,
                        )
                    piece = text[:cut]
                    if piece:
                        yield _BEFORE_NEWLINE.sub(b"\n", piece) if b"\r" in piece else piece
        except OSError as error:
            raise InputError(f"archive {str(path)!r} cannot be read: {error.strerror}", kind="file") from error
        if rest.strip():
            yield rest.rstrip(b"\r") + (b"\n" if rest.endswith(b"\r") else b"")

    def __iter__(self) -> Iterator[bytes]:
        while self._is_more():
            yield self.take("")

    def _is_more(self) -> bool:
        if self._at == len(self._text):
            self._text, self._at = next(self._pieces, b""), 0
        return self._at < len(self._text)

    def take(self, within: str) -> bytes:
        """The next line; ``within`` is the block that the file must not end in."""
        if not self._is_more():
            raise InputError(f"{self.name} ends within {within}; it is cut off, write it again", kind="file")
        end = self._text.find(b"\n", self._at)
        if end < 0:
            self._text += b"\n"
            return self._last_line(self.take(within), within)
        line = self._text[self._at : end]
        self._at, self.number = end + 1, self.number + 1
        return line

    def _last_line(self, line: bytes, within: str) -> bytes:
        """The last line, which has no end: that of a command may be whole.

        Raises:
            InputError: the line is one of a block, or of a command that is not.
        """
        word = line.split(b",")[0].strip().upper()
        if within or line.rstrip().endswith(b",") or (b"," not in line and word not in _ALONE):
            raise cut_line(self.name, line)
        self.warnings += [] if word in _ALONE else [open_line(self.name, line)]
        return line

    def rows(self, within: str, count: int) -> BlockText:
        """The next ``count`` lines."""
        return BlockText(b"".join(self.take(within) + b"\n" for _ in range(count)))

    def block(self, within: str, ends: tuple[bytes, ...]) -> Iterator[BlockText]:
        """Lines up to one that starts with one of ``ends`` (blanks left out), which is taken too."""
        last = None
        while last is None:
            if not self._is_more() or self._text.find(b"\n", self._at) < 0:
                if self._text[self._at :].lstrip().upper().startswith(ends):
                    self._text = b""
                    self._at = 0
                    return
                self.take(within)
            stop = self._text.rfind(b"\n", self._at, self._at + TOL.block_bytes) + 1
            rows = BlockText(self._text[self._at : stop])
            last = rows.first(ends)
            rows = rows if last is None else rows.before(last)
            self._at, self.number = self._at + len(rows.text), self.number + len(rows)
            if last is None and not self._is_more():
                self.take(within)
            yield rows
        self.take(within)


class BlockText:
    """Lines (n,) of a ``text``, which begin at ``starts`` (n,) and have ``lengths`` (n,) characters."""

    def __init__(self, text: bytes) -> None:
        self.text = text
        ends = np.flatnonzero(np.frombuffer(text, dtype=np.uint8) == ord("\n"))
        self.starts = np.concatenate([[0], ends[:-1] + 1])[: len(ends)]
        self.lengths = ends - self.starts

    def __len__(self) -> int:
        return len(self.starts)

    def __getitem__(self, row: int) -> bytes:
        start = int(self.starts[row])
        return self.text[start : start + int(self.lengths[row])]

    def before(self, row: int) -> BlockText:
        """The lines before a row."""
        return BlockText(self.text[: int(self.starts[row])])

    def first(self, ends: tuple[bytes, ...]) -> int | None:
        """The first line that starts with one of ``ends``, blanks left out."""
        begin = self.characters(16).view("<u8")
        # A minus has the bit 8 and not 16; digits from 8 on have both.
        minus = (begin << np.uint64(1)) & ~begin & np.uint64(Eight.OF_DIGITS)
        has_command = (begin & np.uint64(Eight.OF_LETTERS)) | minus
        blank = begin == np.uint64(Eight.BLANKS)
        for row in np.flatnonzero((has_command[:, 0] | has_command[:, 1] != 0) | (blank[:, 0] & blank[:, 1])).tolist():
            if self[row].lstrip().upper().startswith(ends):
                return int(row)
        return None

    def characters(self, width: int) -> NDArray[np.uint8]:
        """The first characters (n, ``width``) of each line, with blanks behind short ones."""
        text = self.text + b" " * width
        places = np.ndarray(len(text) - width + 1, f"V{width}", text, 0, (1,))
        table: NDArray[np.uint8] = places[self.starts].view(np.uint8).reshape(-1, width)
        short = np.minimum(self.lengths, width).astype(np.uint16)
        if short.min(initial=width) < width:
            table[np.arange(width, dtype=np.uint16) >= short[:, None]] = ord(" ")
        return table
