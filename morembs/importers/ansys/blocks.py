"""Blocks of fixed-width numbers in ANSYS archives (CDWRITE): NBLOCK, EBLOCK, CMBLOCK, RLBLOCK, ETBLOCK.

A block is a command, a Fortran format such as (3i9,6e21.13e3), and lines in which numbers may touch each other and
trailing zeros are left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.decks.includes import open_text
from morembs.importers.tolerances import TOL

_FORMAT = re.compile(r"(\d*)([IEFGD])(\d+)(?:\.\d+(?:E\d+)?)?")


class Lines:
    """Lines of an archive without their ends, with one line of looking ahead; ``number`` of the last from 1."""

    def __init__(self, path: Path) -> None:
        self.name, self.number = path.name, 0
        self._lines = self._read(path)
        self._next: bytes | None = next(self._lines, None)

    def _read(self, path: Path) -> Iterator[bytes]:
        if not path.is_file():
            what = "is not a file" if path.exists() else "does not exist"
            raise InputError(f"archive {str(path)!r} {what}; check the path")
        try:
            with open_text(path) as file:
                # Limited, so that a file without lines is not taken in whole.
                while line := file.readline(1 << 16):
                    if b"\0" in line or (len(line) == 1 << 16 and not line.endswith(b"\n")):
                        raise InputError(f"{path.name} is not a text of lines; expected an archive (CDWRITE)")
                    if not line.endswith((b"\n", b"\r")) and line.strip().upper() not in (b"", b"FINISH"):
                        raise InputError(
                            f"{path.name} ends within a line, so it may be cut off; write it again, or end the last "
                            "line if the file is complete"
                        )
                    yield line.rstrip(b"\r\n")
        except OSError as error:
            raise InputError(f"archive {str(path)!r} cannot be read: {error.strerror}") from error

    def __iter__(self) -> Iterator[bytes]:
        while self._next is not None:
            yield self.take("")

    def take(self, within: str) -> bytes:
        """The next line; ``within`` is the block that the file must not end in."""
        line = self._next
        if line is None:
            raise InputError(f"{self.name} ends within {within}; it is cut off, write it again")
        self._next = next(self._lines, None)
        self.number += 1
        return line


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Widths of the columns of a line: ``whole`` integer ones, then ``real`` ones."""

    whole: int
    width: int
    real: int = 0
    real_width: int = 0

    @property
    def length(self) -> int:
        """Characters of a full line."""
        return self.whole * self.width + self.real * self.real_width


def layout(line: bytes, block: str, name: str) -> Layout:
    """Layout of a format line such as (19i10) or (3i9,6e21.13e3).

    Raises:
        InputError: another format.
    """
    text = line.decode("latin-1").upper().replace("1P", "").split("!")[0].strip()
    parts = _FORMAT.findall(text) if text.startswith("(") else []
    counts = [(kind == "I", int(count or 1), int(width)) for count, kind, width in parts if len(count + width) < 6]
    shape = [whole for whole, _, _ in counts]
    if shape not in ([True], [True, False], [False]) or any(
        not (0 < n <= TOL.block_numbers and 0 < w <= TOL.block_number_characters) for _, n, w in counts
    ):
        raise InputError(f"{name}: {block} has the format {text[:40]!r}; expected one such as (3i9,6e21.13e3)")
    whole = counts[0] if shape[0] else (True, 0, 1)
    real = counts[-1] if not shape[-1] else (False, 0, 0)
    return Layout(whole=whole[1], width=whole[2], real=real[1], real_width=real[2])


def columns(lines: list[bytes], form: Layout, block: str, name: str) -> tuple[Ints, Floats]:
    """Integers (k, whole) and reals (k, real) of ``lines``; what a line leaves out is zero.

    Raises:
        InputError: a line that is too long, or something that is not a finite number.
    """
    if not lines:
        return np.zeros((0, form.whole), dtype=np.int64), np.zeros((0, form.real))
    longest = max(map(len, lines))
    if longest > form.length and max(len(line.rstrip()) for line in lines) > form.length:
        bad = _shown(next(line for line in lines if len(line.rstrip()) > form.length))
        raise InputError(f"{name}: a line of {block} is longer than its format: {bad!r}")
    text = np.array([line[: form.length].ljust(form.length) for line in lines], dtype=f"S{form.length}")
    table = text.view("S1").reshape(len(lines), form.length)
    cut = form.whole * form.width
    whole = _numbers(table[:, :cut], form.width, np.int64, lines, block, name)
    real = _numbers(table[:, cut:], form.real_width, np.float64, lines, block, name)
    if not np.isfinite(real).all():
        bad = _shown(lines[int(np.flatnonzero(~np.isfinite(real).all(axis=1))[0])])
        raise InputError(f"{name}: {block} holds a number that is not finite: {bad!r}")
    if len(whole) and whole.size and np.abs(whole).max() >= 2**31:
        raise InputError(f"{name}: {block} holds an integer of more than 31 bits; it is damaged")
    return whole, real


def _shown(line: bytes) -> str:
    """Its begin, as messages quote it."""
    return line.decode("latin-1")[: TOL.shown_line]


def _numbers(table: NDArray[np.bytes_], width: int, kind: type, lines: list[bytes], block: str, name: str) -> NDArray:  # type: ignore[type-arg]
    if not table.shape[1]:
        return np.zeros((len(table), 0), dtype=kind)
    words = np.ascontiguousarray(table).view(f"S{width}")
    blank = (np.ascontiguousarray(table) == b" ").reshape(len(table), -1, width).all(axis=2)
    words = np.where(blank, b"0", words)
    try:
        return words.astype(kind)
    except (ValueError, OverflowError):
        words = words.reshape(len(lines), -1)  # refused below, by the line at fault
    for line, row in zip(lines, words, strict=True):
        try:
            row.astype(kind)
        except (ValueError, OverflowError) as error:
            raise InputError(f"{name}: a line of {block} is not as its format says: {_shown(line)!r}") from error
    raise InputError(f"{name}: {block} cannot be read")


def _chunks(lines: Lines, block: str, ends: tuple[bytes, ...]) -> Iterator[list[bytes]]:
    """Lines up to one that starts with one of ``ends`` (blanks left out), which is taken too."""
    chunk: list[bytes] = []
    while not (line := lines.take(block)).lstrip().upper().startswith(ends):
        chunk.append(line)
        if len(chunk) == TOL.lines_at_once:
            yield chunk
            chunk = []
    yield chunk


def node_block(lines: Lines, fields: list[str]) -> tuple[Ints, Floats, Floats]:
    """Labels (k,), coordinates (k, 3) and angles of nodal axes (k, 3) of an NBLOCK.

    Raises:
        InputError: not as its format says, cut off, or another count than announced.
    """
    form = layout(lines.take("NBLOCK"), "NBLOCK", lines.name)
    if form.whole < 1 or form.real < 3:
        raise InputError(f"{lines.name}: NBLOCK has a format without label and x, y, z")
    parts = [columns(c, form, "NBLOCK", lines.name) for c in _chunks(lines, "NBLOCK", (b"N,", b"-1", b"NBLOCK"))]
    label = np.concatenate([whole[:, 0] for whole, _ in parts])
    real = np.concatenate([values for _, values in parts])
    count = announced(fields, 4)
    if len(label) and label.min() < 1:
        raise InputError(f"{lines.name}: NBLOCK has the node label {label.min()}; expected labels from 1")
    if count and len(label) != count:
        raise InputError(f"{lines.name}: NBLOCK holds {len(label)} nodes where it announces {count}; it is cut off")
    angles = np.zeros((len(label), 3))
    angles[:, : min(3, form.real - 3)] = real[:, 3:6]
    return label, real[:, :3], angles


def element_block(lines: Lines, fields: list[str]) -> tuple[bool, Ints]:
    """Whether it is of the SOLID form, and the lines (k, columns) of an EBLOCK as they are."""
    form = layout(lines.take("EBLOCK"), "EBLOCK", lines.name)
    if form.real:
        raise InputError(f"{lines.name}: EBLOCK has a format with reals; expected one such as (19i8)")
    parts = [columns(c, form, "EBLOCK", lines.name)[0] for c in _chunks(lines, "EBLOCK", (b"-1",))]
    key = fields[2].upper() if len(fields) > 2 else ""
    if key == "COMPACT":
        raise InputError(f"{lines.name} has an EBLOCK in the compact form; write it again (CDWRITE,DB,model,cdb)")
    solid = key == "SOLID"
    least = 12 if solid else 6
    if form.whole < least:
        raise InputError(f"{lines.name}: EBLOCK has {form.whole} columns; expected {least} or more")
    return solid, np.concatenate(parts).astype(np.int32)


def component_block(lines: Lines, fields: list[str]) -> Ints:
    """Ranges (k, 2) of labels of a CMBLOCK, first and last, single labels too.

    Raises:
        InputError: a range without a start or that runs backwards, or a count that cannot be right.
    """
    name = fields[1] if len(fields) > 1 else "?"
    block = f"CMBLOCK {name}"
    form = layout(lines.take(block), block, lines.name)
    count = announced(fields, 3)
    if form.real or not form.whole:
        raise InputError(f"{lines.name}: {block} has a format with reals; expected one such as (8i10)")
    rows = [lines.take(block) for _ in range(-(-count // form.whole))]
    given = columns(rows, form, block, lines.name)[0].ravel()
    given, rest = given[:count], given[count:]
    if rest.any() or (given == 0).any():
        raise InputError(f"{lines.name}: {block} does not hold the {count} numbers that it announces; it is damaged")
    last = np.flatnonzero(given < 0)
    start = given[last - 1]
    if len(last) and (last[0] == 0 or (start <= 0).any() or (-given[last] < start).any()):
        raise InputError(f"{lines.name}: {block} has a range that does not run from a label to a larger one")
    ends = np.where(np.append(given[1:], 0) < 0, -np.append(given[1:], 0), given)
    return np.column_stack([given, ends])[given > 0]


def real_constants(lines: Lines, fields: list[str]) -> dict[int, list[float]]:
    """Sets of real constants of an RLBLOCK by number."""
    first = layout(lines.take("RLBLOCK"), "RLBLOCK", lines.name)
    more = layout(lines.take("RLBLOCK"), "RLBLOCK", lines.name)
    if first.whole != 2 or not first.real or not more.real or more.whole:
        raise InputError(f"{lines.name}: RLBLOCK has formats other than (2i8,6g16.9) and (7g16.9)")
    result: dict[int, list[float]] = {}
    for _ in range(announced(fields, 1)):
        head, values = columns([lines.take("RLBLOCK")], first, "RLBLOCK", lines.name)
        number, count = (int(i) for i in head[0])
        row = values[0].tolist()
        while len(row) < count:
            row.extend(columns([lines.take("RLBLOCK")], more, "RLBLOCK", lines.name)[1][0].tolist())
        result[number] = row[:count]
    return result


def element_types(lines: Lines) -> list[list[int]]:
    """Rows (type, number of the element, key options from 1) of an ETBLOCK."""
    lines.take("ETBLOCK")
    rows = []
    for chunk in _chunks(lines, "ETBLOCK", (b"-1",)):
        for line in chunk:
            words = line.split()
            if len(words) < 2 or not all(word.lstrip(b"-").isdigit() and len(word) < 10 for word in words):
                raise InputError(f"{lines.name}: a line of ETBLOCK is not a list of integers: {_shown(line)!r}")
            rows.append([int(word) for word in words])
    return rows


def announced(fields: list[str], place: int) -> int:
    word = fields[place] if place < len(fields) else ""
    return int(word) if word.isdigit() and len(word) < 12 else 0
