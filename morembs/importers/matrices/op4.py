"""Nastran OUTPUT4 files: matrices by name, text or binary, dense or sparse, either byte order, 32 or 64 bits.

Layout: MSC Nastran DMAP Programmer's Guide, module OUTPUT4. A binary file is a sequence of Fortran records
(length, bytes, length): a header per matrix, a record per column that is not zero, and one for column n + 1.
"""

from __future__ import annotations

import mmap
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError, nearest
from morembs.base.types import Ints
from morembs.importers.matrices.op4_columns import Collector, Header, OP4Matrix, Packed, header
from morembs.importers.matrices.op4_text import read_op4_text
from morembs.importers.matrices.text import open_lines
from morembs.importers.tolerances import TOL

__all__ = ["OP4Matrix", "read_op4"]


@dataclass(frozen=True, kw_only=True)
class _RecordFormat:
    """Bytes of a record mark (4 or 8) and of an integer (4 or 8), and the byte order "<" or ">"."""

    order: str
    mark: int
    word: int

    @property
    def struct_mark(self) -> Struct:
        return Struct(self.order + ("i" if self.mark == 4 else "q"))

    def ints(self, count: int) -> Struct:
        return Struct(f"{self.order}{count}{'i' if self.word == 4 else 'q'}")


def read_op4(path: str | Path, names: Collection[str] | None = None) -> dict[str, OP4Matrix]:
    """Matrices of an OP4 file by their names in capitals, in the order of the file; ``names`` picks some.

    Peak memory of a symmetric matrix is its CSR form and blocks of about 30 MB; a matrix that is not symmetric
    needs twice its CSR form, as the file is ordered by columns.

    Raises:
        InputError: the file is missing, truncated, not an OP4 file, contradicts itself, or lacks a name.
    """
    path = Path(path)
    wanted = None if names is None else {name.upper() for name in names}
    found: list[str] = []
    with open_lines(path) as file:
        # The first record with its marks, at most.
        layout = _layout(file.read(8 + 48 + 8))
        if layout is None:
            matrices = read_op4_text(path, wanted, found)
        elif path.stat().st_size % 4:
            raise InputError(
                f"{path.name} is a binary OP4 file cut off within a number; write it again",
                kind="file",
                keyword=path.name,
            )
        else:
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                matrices = _Binary(path.name, data, layout).read(wanted, found)
    for name in sorted(wanted or ()):
        if name not in matrices:
            raise InputError(f"{path.name} has no matrix {name!r}; {nearest(name, found)}", kind="unknown")
    return matrices


def take(matrices: dict[str, OP4Matrix], name: str, matrix: OP4Matrix, file: str) -> None:
    """Add a matrix.

    Raises:
        InputError: there is one of this name.
    """
    if name in matrices:
        raise InputError(
            f"{file} holds two matrices named {name!r}; name the others you need, or write one file each",
            kind="conflict",
        )
    matrices[name] = matrix


def _layout(start: bytes) -> _RecordFormat | None:
    """How a binary file is laid out, from the marks around its first record; None where it is text."""
    for order in "<>":
        for mark in (4, 8):
            for word, length in ((4, 24), (8, 48)):
                layout = _RecordFormat(order=order, mark=mark, word=word)
                end = mark + length
                if len(start) < end + mark or layout.struct_mark.unpack_from(start, 0)[0] != length:
                    continue
                if layout.struct_mark.unpack_from(start, end)[0] == length:
                    return layout
    return None


class _Binary:
    """Reader of one open binary file."""

    def __init__(self, file: str, data: mmap.mmap, layout: _RecordFormat) -> None:
        self.file, self.data, self.layout = file, data, layout
        self.words4 = np.frombuffer(data, dtype=np.uint32)
        self.at = 0

    def read(self, wanted: set[str] | None, found: list[str]) -> dict[str, OP4Matrix]:
        matrices: dict[str, OP4Matrix] = {}
        try:
            while self.at < len(self.data):
                head = self._header()
                found.append(head.name)
                columns = self._columns(head)
                if wanted is None or head.name in wanted:
                    take(matrices, head.name, self._matrix(head, *columns), self.file)
        finally:
            del self.words4  # the map cannot be closed while somebody looks at it
        return matrices

    def _record(self) -> tuple[int, int]:
        """First and last byte of the next record."""
        mark = self.layout.mark
        if self.at + mark <= len(self.data):
            (length,) = self.layout.struct_mark.unpack_from(self.data, self.at)
            first, end = self.at + mark, self.at + mark + length
            if length >= 0 and end + mark <= len(self.data):
                if self.layout.struct_mark.unpack_from(self.data, end)[0] != length:
                    raise InputError(
                        f"{self.file} has a record at byte {self.at} whose two length marks differ; it is damaged",
                        kind="file",
                        keyword=self.file,
                    )
                self.at = end + mark
                return first, end
        raise InputError(
            f"{self.file} ends within a record (byte {self.at}): it is cut off or damaged; write it again",
            kind="file",
            keyword=self.file,
        )

    def _header(self) -> Header:
        first, end = self._record()
        word = self.layout.word
        if end - first != 6 * word:
            raise InputError(
                f"{self.file} has a record of {end - first} bytes at byte {first} where the header of a matrix "
                f"({6 * word} bytes) was expected; it is damaged",
                kind="file",
                keyword=self.file,
            )
        columns, rows, form, kind = self.layout.ints(4).unpack_from(self.data, first)
        name = self.data[first + 4 * word : end].decode("latin-1").replace("\0", "").replace(" ", "").upper()
        return header(self.file, columns, rows, form, kind, name)

    def _columns(self, head: Header) -> tuple[Ints, Ints, Ints, Ints]:
        """For each column record: the column, the first row (0 where it holds strings), place and count of words."""
        triple, word = self.layout.ints(3), self.layout.word
        columns: list[tuple[int, int, int, int]] = []
        last = 0
        while True:
            first, end = self._record()
            if end - first < 3 * word:
                raise InputError(
                    f"{self.file}: a column record of {head.name!r} has {end - first} bytes; too few",
                    kind="unsupported",
                )
            column, row, words = triple.unpack_from(self.data, first)
            if column == head.columns + 1:
                break
            if not last < column <= head.columns or row < 0 or words < 1 or end - first != (3 + words) * word:
                raise InputError(
                    f"{self.file}: a record of the matrix {head.name!r} says column {column} (after {last} of "
                    f"{head.columns}), row {row}, {words} words in {end - first} bytes; the file is damaged",
                    kind="file",
                    keyword=self.file,
                )
            columns.append((column - 1, row, (first + 3 * word) // 4, words))
            last = column
        table = np.array(columns, dtype=np.int64).reshape(-1, 4)
        return table[:, 0], table[:, 1], table[:, 2], table[:, 3]

    def _matrix(self, head: Header, column: Ints, row: Ints, place: Ints, words: Ints) -> OP4Matrix:
        strings = bool(len(row)) and bool((row == 0).all())
        if not strings and (row == 0).any():
            raise InputError(
                f"{self.file}: the matrix {head.name!r} mixes dense and sparse columns; it is damaged",
                kind="file",
                keyword=self.file,
            )
        storage = ("bigmat" if head.bigmat else "nonbigmat") if strings else "dense"
        size = self._value(head).itemsize // self.layout.word
        collector = Collector(self.file, head, int(words.sum()) // size, storage)
        block = TOL.op4_block_words
        cuts = np.searchsorted(np.cumsum(words), np.arange(block, int(words.sum()) + block, block))
        begin = 0
        for cut in np.unique(np.append(cuts, len(words))):
            part = slice(begin, cut + 1)
            begin = cut + 1
            if not len(column[part]):
                continue
            if strings:
                pieces = self._strings(head, column[part], place[part], words[part])
            else:
                pieces = column[part], row[part] - 1, place[part], words[part]
            self._add(collector, head, size, *pieces)
        return collector.matrix()

    def _strings(self, head: Header, column: Ints, place: Ints, words: Ints) -> tuple[Ints, Ints, Ints, Ints]:
        """Column, row, place and words of each string; the strings of all columns are followed at the same time."""
        unit = self.layout.word // 4
        marks = 2 if head.bigmat else 1
        index, at, end = np.arange(len(column)), place.copy(), place + words * unit
        strings: list[tuple[Ints, Ints, Ints, Ints]] = []
        while len(index):
            if (at + marks * unit > end).any():
                self._refuse_strings(head)
            if head.bigmat:
                length, row = self._integers(at) - 1, self._integers(at + unit)
            else:
                packed = self._integers(at)
                length, row = (packed >> Packed.LENGTH_BITS) - 1, packed & Packed.ROW_MASK
            at = at + marks * unit
            if (length < 1).any() or (at + length * unit > end).any():
                self._refuse_strings(head)
            strings.append((index, row - 1, at, length))
            at = at + length * unit
            left = at < end
            index, at, end = index[left], at[left], end[left]
        owner = np.concatenate([f[0] for f in strings])
        order = np.argsort(owner, kind="stable")
        row, start, length = (np.concatenate([f[i] for f in strings])[order] for i in (1, 2, 3))
        return column[owner[order]], row, start, length

    def _refuse_strings(self, head: Header) -> None:
        raise InputError(
            f"{self.file}: a string of the matrix {head.name!r} does not fit into its column; the file is damaged",
            kind="file",
            keyword=self.file,
        )

    def _add(
        self, collector: Collector, head: Header, size: int, column: Ints, row: Ints, place: Ints, words: Ints
    ) -> None:
        if (words % size).any():
            self._refuse_strings(head)
        unit, length = self.layout.word // 4 * size, words // size
        first = np.cumsum(length) - length
        at = np.repeat(place - first * unit, length) + np.arange(int(length.sum())) * unit
        values = self._gather(at, unit).view(self._value(head)).ravel()
        # What is no number in single precision is none in double, and is refused with the whole matrix.
        with np.errstate(invalid="ignore"):
            collector.add(column, row, length, values.astype(collector.dtype))

    def _gather(self, at: Ints, count: int) -> NDArray[np.uint32]:
        """``count`` 4-byte words from each place (k,) on: (k, count), in the byte order of the file."""
        result = np.empty((len(at), count), dtype=np.uint32)
        for i in range(count):
            result[:, i] = self.words4[at + i]
        return result

    def _integers(self, at: Ints) -> Ints:
        unit = self.layout.word // 4
        kind = f"{self.layout.order}i{self.layout.word}"
        return self._gather(at, unit).view(kind).ravel().astype(np.int64)

    def _value(self, head: Header) -> np.dtype[Any]:
        """Type of an entry; files with 8-byte integers hold double precision whatever the type says."""
        double = self.layout.word == 8 or head.type in (2, 4)
        return np.dtype(f"{self.layout.order}{'c' if head.complex else 'f'}{(8 if double else 4) << int(head.complex)}")
