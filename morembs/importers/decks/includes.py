"""Text of decks, and the files that decks include: where these may lie, how deep, how many and how large.

A deck may come from a stranger, so its included files lie in its folder, and no message quotes an included file before
that file has shown itself to be a deck.
"""

from __future__ import annotations

import codecs
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from morembs.base.errors import InputError
from morembs.importers.tolerances import TOL

_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
ALLOW = "--allow-includes-outside"


def open_text(path: Path) -> BinaryIO:
    """The bytes of a text, those of UTF-16 as UTF-8 (all in memory), without a byte order mark.

    Raises:
        OSError: the file cannot be opened.
        InputError: it says that it is UTF-16, and is not.
    """
    file = path.open("rb")
    start = file.read(3)
    if start[:2] in _UTF16:
        with file:
            file.seek(0)
            try:
                return io.BytesIO(file.read().decode("utf-16").encode("utf-8"))
            except UnicodeDecodeError as error:
                raise InputError(
                    f"{path.name} is not the UTF-16 text that its mark says; write it as UTF-8",
                    kind="file",
                    keyword=path.name,
                ) from error
    file.seek(len(codecs.BOM_UTF8) if start == codecs.BOM_UTF8 else 0)
    return file


def open_line(file: str, line: bytes) -> str:
    """The warning of a last line without an end that may be whole, by its card."""
    return (
        f"{file} has no end of line behind its last line {line.strip()[-40:].decode('latin-1')!r}, which was read as "
        "it stands; check that it is not cut off [last-line-open]"
    )


def ends_within_number(line: bytes, above: Sequence[bytes]) -> bool:
    """True if the last field of a line lacks characters, as far as the lines ``above`` have fields of one width.

    Numbers between commas that are written in one format have one width; columns that are filled from the right end
    at a multiple of eight.
    """
    rows = [row for row in above if row.count(b",") == line.count(b",")][-TOL.layout_lines :]
    if b"," in line:
        own, *widths = (len(row.rstrip().rpartition(b",")[2]) for row in (line, *rows))
    else:
        own, *widths = (len(row.rstrip()) for row in (line, *rows))
    is_layout = len(widths) == TOL.layout_lines and len(set(widths)) == 1 and widths[0] >= TOL.layout_characters
    return is_layout and own < widths[0] and (b"," in line or widths[0] % TOL.layout_characters == 0)


def cut_line(file: str, line: bytes) -> InputError:
    """The refusal of a last line without an end that is not whole."""
    return InputError(
        f"{file} ends within the line {line.strip()[-40:].decode('latin-1')!r}, so it may be cut off; write it again, "
        "or end the last line if the file is complete",
        kind="file",
    )


@dataclass
class Includes:
    """What the deck at ``path`` has included so far; ``outside`` allows files beyond its folder; ``warnings`` are about
    the texts."""

    path: Path
    outside: bool = False
    warnings: list[str] = field(default_factory=list)
    count: int = 0
    total: int = 0
    folder: Path = field(init=False)

    def __post_init__(self) -> None:
        self.folder = self.path.parent.resolve()

    def take(
        self, name: str, where: str, beside: tuple[Path, ...], above: tuple[Path, ...], begin: re.Pattern[bytes]
    ) -> Path:
        """The file ``name`` that ``where`` includes.

        Args:
            beside: folders to look into.
            above: the files, resolved, that led here.
            begin: what the first line that is no comment must match.

        Raises:
            InputError: no such file, outside of the folder, in a circle, too deep, too many, too large, or no deck.
        """
        try:
            path = next((folder / name for folder in beside if name and (folder / name).is_file()), None)
            resolved = None if path is None else path.resolve()
        except (OSError, ValueError, RuntimeError):
            path = resolved = None
        if not self.outside and not self._inside(resolved, name, beside):
            raise InputError(
                f"{where} names the file {name!r}, which is not in the folder of the deck (nor below it); put it "
                f"there, or give {ALLOW} if the deck may read other files",
                kind="unsupported",
            )
        if path is None or resolved is None:
            raise InputError(
                f"{where} names the file {name!r}, which does not exist beside the deck; check the path",
                kind="file",
                keyword="INCLUDE",
            )
        if resolved in above:
            chain = " -> ".join(path.name for path in (*above, resolved))
            raise InputError(
                f"{path.name} includes itself ({chain}); remove the include that closes the circle",
                kind="conflict",
                keyword="INCLUDE",
            )
        if len(above) > TOL.max_include_depth:
            raise InputError(
                f"{self.path.name} includes files {len(above)} deep; at most {TOL.max_include_depth} are followed; "
                "join them",
                kind="unsupported",
            )
        self.count += 1
        try:
            self.total += resolved.stat().st_size
            self._refuse_other(path, where, begin)
        except OSError as error:
            raise InputError(
                f"{path.name}, which {where} names, cannot be opened: {error.strerror}", kind="file", keyword=path.name
            ) from error
        if self.count > TOL.max_includes or self.total > TOL.max_include_bytes:
            raise InputError(
                f"{self.path.name} includes {self.count} files of {self.total / 1e6:.0f} MB together (files that are "
                f"included again count again); at most {TOL.max_includes} files and "
                f"{TOL.max_include_bytes / 1e6:.0f} MB are read; join them",
                kind="unsupported",
            )
        return path

    def _inside(self, resolved: Path | None, name: str, beside: tuple[Path, ...]) -> bool:
        """True if a file, there or not, lies in the folder: messages do not show whether a file outside exists."""
        try:
            place = resolved if resolved is not None else (beside[0] / name).resolve()
        except (OSError, ValueError, RuntimeError):
            return True
        return place.is_relative_to(self.folder)

    def _refuse_other(self, path: Path, where: str, begin: re.Pattern[bytes]) -> None:
        with open_text(path) as file:
            text = file.read(TOL.head_bytes)
        lines = (line.strip() for line in text.replace(b"\r", b"\n").split(b"\n"))
        first = next((line for line in lines if line and not line.startswith((b"**", b"$"))), b"")
        if first and not begin.match(first):
            raise InputError(
                f"{path.name}, which {where} names, does not begin as a deck does (a keyword or card, or data of "
                "numbers); its lines are not shown; check the path",
                kind="unsupported",
            )
