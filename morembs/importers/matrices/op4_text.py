"""OP4 files as text: numbers in columns of fixed width, which may touch each other."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.importers.matrices.op4_columns import Collector, Header, OP4Matrix, Packed, header
from morembs.importers.matrices.text import integers, numbers, text_blocks

Codes = NDArray[np.uint8]
_FORMAT = re.compile(rb"(?:1P,?)?[0-9]+[ED]([0-9]+)\.[0-9]+ *\)?$", re.IGNORECASE)
# Widths of columns, rows, form and type; the second where a size has nine digits or more.
_HEADERS = ((8, 8, 8, 8), (16, 16, 8, 8), (16, 16, 16, 16))
_DOT = ord(".")


def read_op4_text(path: Path, wanted: set[str] | None, found: list[str]) -> dict[str, OP4Matrix]:
    """Matrices of a text file; see ``op4.read_op4``. ``found`` takes the names of all."""
    matrices: dict[str, OP4Matrix] = {}
    reader = _Lines(path)
    while True:
        line = reader.line()
        if line is None:
            break
        if not line.strip():
            continue
        head, width = _header(path.name, line)
        found.append(head.name)
        kept = wanted is None or head.name in wanted
        if kept and head.name in matrices:
            raise InputError(
                f"{path.name} holds two matrices named {head.name!r}; write one file each", kind="unsupported"
            )
        matrix = _matrix(path.name, head, width, reader, path.stat().st_size, kept)
        if matrix is not None:
            matrices[head.name] = matrix
    if not matrices and wanted is None:
        raise InputError(f"{path.name} holds no matrix; expected an OP4 file")
    return matrices


class _Lines:
    """The text of a file, taken by whole lines."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.blocks = (_trim(block) for block in text_blocks(path))
        self.rest = b""

    def more(self) -> bool:
        """Append the next block; False at the end of the file."""
        block = next(self.blocks, None)
        if block is None:
            return False
        self.rest += block
        return True

    def line(self) -> bytes | None:
        """The next line, without its end."""
        while b"\n" not in self.rest:
            if not self.more():
                return None
        line, self.rest = self.rest.split(b"\n", 1)
        return line


def _trim(block: bytes) -> bytes:
    """Lines without blanks at their ends."""
    if b"\r" in block or b" \n" in block or b"\t" in block:
        block = re.sub(rb"[ \t\r]+\n", b"\n", block)
    return block


def _header(file: str, line: bytes) -> tuple[Header, int]:
    """Header, and width of a number from the format behind the name."""
    for widths in _HEADERS:
        ends = np.cumsum(widths).tolist()
        # Without a format numbers are written as Nastran does by default.
        match = _FORMAT.fullmatch(line[ends[3] + 8 :].strip() or b"5E16.9")
        try:
            columns, rows, form, kind = (int(line[end - w : end]) for w, end in zip(widths, ends, strict=True))
        except ValueError:
            continue
        if match:
            name = line[ends[3] : ends[3] + 8].decode("latin-1").replace(" ", "").upper()
            return header(file, columns, rows, form, kind, name), int(match[1])
    raise InputError(
        f"{file}: {line[:60].decode('latin-1')!r} is not the header of an OP4 matrix (columns, rows, form, type, name "
        "and format, such as 1P,3E23.16); check that this is an OP4 file",
        kind="file",
    )


def _matrix(file: str, head: Header, width: int, reader: _Lines, bytes_left: int, kept: bool) -> OP4Matrix | None:
    collector: Collector | None = None
    last = -1
    for strings in _columns(file, head, width, reader):
        column, row, length, values, storage = strings
        if len(column) and (column[0] <= last or (np.diff(column) < 0).any() or column[0] < 0):
            raise InputError(
                f"{file}: the columns of the matrix {head.name!r} do not ascend; the file is damaged", kind="file"
            )
        if not kept or not len(column):
            continue
        last = int(column[-1])
        if collector is None:
            collector = Collector(file, head, bytes_left // (width * (2 if head.complex else 1)) + 1, storage)
        if collector.storage != storage:
            raise InputError(
                f"{file}: the matrix {head.name!r} mixes dense and sparse columns; it is damaged", kind="file"
            )
        collector.add(column, row, length, values.view(complex) if head.complex else values)
    if not kept:
        return None
    return (collector or Collector(file, head, 0, "dense")).matrix()


Strings = tuple[Ints, Ints, Ints, NDArray[np.float64], str]


def _columns(file: str, head: Header, width: int, reader: _Lines) -> Iterator[Strings]:
    """Strings of whole columns, block by block, up to the record of column n + 1."""
    while True:
        text, done = _whole_columns(file, head, reader)
        if text:
            yield _strings(file, head, width, text)
        if done:
            return


def _whole_columns(file: str, head: Header, reader: _Lines) -> tuple[bytes, bool]:
    """Lines of columns that are complete, and whether the matrix ends behind them."""
    wide = 0
    while True:
        starts, ends, dotted = _lines(reader.rest)
        length = ends - starts
        whole = np.flatnonzero(~dotted & (length > 16))
        if len(whole):
            wide = int(length[whole[0]]) // 3
            column_lines = np.flatnonzero(~dotted & (length == 3 * wide))
            codes = np.frombuffer(reader.rest, dtype=np.uint8)
            column = _fields(file, codes, starts[column_lines], wide)
            final = np.flatnonzero(column == head.columns + 1)
            if len(final):
                # The last record holds one number, on the line behind it.
                line = int(column_lines[final[0]])
                while len(starts) < line + 2 and reader.more():
                    starts, ends, dotted = _lines(reader.rest)
                if len(starts) < line + 2 or not dotted[line + 1]:
                    break
                text = reader.rest[: starts[line]]
                reader.rest = reader.rest[ends[line + 1] + 1 :]
                return text, True
            if len(column_lines) > 1:
                cut = int(starts[column_lines[-1]])
                text, reader.rest = reader.rest[:cut], reader.rest[cut:]
                if not reader.more():
                    break
                return text, False
        if not reader.more():
            break
    raise InputError(
        f"{file} ends before the last record (column {head.columns + 1}) of the matrix {head.name!r}: it is cut off; "
        "write it again",
        kind="file",
    )


def _lines(text: bytes) -> tuple[Ints, Ints, NDArray[np.bool_]]:
    """Start and end of each line, and whether it has a decimal point (numbers) or not (integers)."""
    codes = np.frombuffer(text, dtype=np.uint8)
    ends = np.flatnonzero(codes == 10)
    starts = np.concatenate([np.zeros(min(1, len(ends)), dtype=np.int64), ends[:-1] + 1])
    dots = np.flatnonzero(codes == _DOT)
    dotted = np.searchsorted(dots, ends) > np.searchsorted(dots, starts)
    return starts, ends, dotted


def _fields(file: str, codes: Codes, at: Ints, width: int) -> Ints:
    """Integers of ``width`` characters that start at ``at``."""
    return integers(_numbers(file, codes, at, width), "a column, row or count", file)


def _numbers(file: str, codes: Codes, at: Ints, width: int) -> NDArray[np.float64]:
    if not len(at):
        return np.empty(0)
    windows = np.lib.stride_tricks.sliding_window_view(codes, width)[at]
    lines = np.full((len(at), width + 1), 10, dtype=np.uint8)
    lines[:, :width] = windows
    values = numbers(lines.tobytes(), file)
    if len(values) != len(at):
        raise InputError(
            f"{file} has numbers that do not keep to their columns; check that this is an OP4 file", kind="unsupported"
        )
    return values


def _strings(file: str, head: Header, width: int, text: bytes) -> Strings:
    """Column, row and length of each string of some columns, and all values in their order."""
    codes = np.frombuffer(text, dtype=np.uint8)
    starts, ends, dotted = _lines(text)
    length = ends - starts
    integer = np.flatnonzero(~dotted)
    wide = int(length[integer[0]]) // 3
    per_line = np.where(dotted, length // width, 0)
    if wide not in (8, 16) or (length[dotted] % width).any() or integer[0] != 0:
        raise InputError(
            f"{file}: lines of the matrix {head.name!r} do not have the widths that its header says; it is damaged",
            kind="file",
        )
    first = np.cumsum(per_line) - per_line
    at = np.repeat(starts - first * width, per_line) + np.arange(int(per_line.sum())) * width
    values = _numbers(file, codes, at, width)
    held = np.add.reduceat(per_line, integer)
    is_column = length[integer] == 3 * wide
    begin = starts[integer]
    column, row, words = (_fields(file, codes, begin[is_column] + i * wide, wide) for i in range(3))
    size = 2 if head.complex else 1
    if is_column.all():
        storage = "dense"
        bad = (row < 1) | ((words != held) & (words != held * head_words(head)))
        strings = column - 1, row - 1, held
    else:
        storage = "bigmat" if head.bigmat else "nonbigmat"
        own = begin[~is_column]
        owner = np.cumsum(is_column)[~is_column] - 1
        if head.bigmat:
            if (length[integer][~is_column] != 2 * wide).any():
                raise InputError(f"{file}: a string of {head.name!r} lacks its row; the file is damaged", kind="file")
            stated, string_row = (_fields(file, codes, own + i * wide, wide) for i in range(2))
            stated = stated - 1
        else:
            packed = _pack(file, text, own, length[integer][~is_column])
            stated, string_row = (packed >> Packed.LENGTH_BITS) - 1, packed & Packed.ROW_MASK
        count = held[~is_column]
        total = np.bincount(owner, weights=stated + (2 if head.bigmat else 1), minlength=len(column))
        bad_column = (row != 0) | (held[is_column] != 0) | (total != words)
        bad = np.concatenate([(stated != count) & (stated != count * head_words(head)), bad_column])
        strings = column[owner] - 1, string_row - 1, count
    if bad.any() or (strings[2] % size).any() or (column > head.columns).any():
        raise InputError(
            f"{file}: a column of the matrix {head.name!r} has other counts of numbers than its record says; "
            "the file is damaged",
            kind="file",
        )
    return strings[0], strings[1], strings[2] // size, values, storage


def head_words(head: Header) -> int:
    """Words of a number: two in double precision."""
    return 2 if head.type in (2, 4) else 1


def _pack(file: str, text: bytes, at: Ints, length: Ints) -> Ints:
    """Integers that fill a line."""
    joined = b"\n".join(text[a : a + n] for a, n in zip(at.tolist(), length.tolist(), strict=True))
    values = integers(numbers(joined, file), "a row and a count", file)
    if len(values) != len(at):
        raise InputError(f"{file} has a line without a number; the file is damaged", kind="file")
    return values
