"""Matrices from entries that come block by block: kept on the disk, numbered, and put into rows."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from morembs.base.closing import Closing
from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.tolerances import TOL

Triplets = tuple[Ints, Ints, Floats]
# Words for a row and a column counted from 0.
Place = Callable[[int, int], str]


class TripletStore(Closing):
    """Triplets (row, column, value) in a temporary file, so that text is read once and memory holds a block.

    It takes 24 bytes per entry on the disk where temporary files go.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._file = tempfile.TemporaryFile()  # noqa: SIM115
        self._lengths: list[int] = []

    @property
    def count(self) -> int:
        """Number of triplets."""
        return sum(self._lengths)

    def add(self, rows: Ints, columns: Ints, values: Floats) -> None:
        """Append triplets; zeros are left out."""
        kept = np.flatnonzero(values)
        self._lengths.append(len(kept))
        for part in (rows[kept], columns[kept], values[kept]):
            self._file.write(np.ascontiguousarray(part).tobytes())

    def __iter__(self) -> Iterator[Triplets]:
        self._file.seek(0)
        for length in self._lengths:
            rows, columns = (np.frombuffer(self._file.read(8 * length), dtype=np.int64) for _ in range(2))
            yield rows, columns, np.frombuffer(self._file.read(8 * length))

    def close(self) -> None:
        """Remove the file."""
        self._file.close()


def row_and_column(row: int, column: int) -> str:
    """Words for a place in a matrix, counted from 1 as files do."""
    return f"row {row + 1}, column {column + 1}"


def assemble(
    triplets: Iterable[Triplets], shape: tuple[int, int], *, mirror: bool, name: str, place: Place = row_and_column
) -> sp.csr_array:
    """Matrix of triplets counted from 0, each place given once.

    Holds nothing but the result and a block, for which ``triplets`` is read twice: to count and to fill. With
    ``mirror`` each entry off the diagonal stands for two. ``place`` are words for a row and a column of the file.

    Raises:
        InputError: an index lies outside, or a place is given twice.
    """
    size = shape[0]
    counts = np.zeros(size + 1, dtype=np.int64)
    for rows, _, _ in _both(triplets, shape, mirror, name):
        counts[1:] += np.bincount(rows, minlength=size)
    indptr = np.cumsum(counts)
    total = int(indptr[-1])
    small = max(total, *shape) < 2**31
    indices, data = np.empty(total, dtype=np.int32 if small else np.int64), np.empty(total)
    free = indptr[:-1].copy()
    for rows, columns, values in _both(triplets, shape, mirror, name):
        order = np.argsort(rows, kind="stable")
        ascending = rows[order]
        first = np.flatnonzero(np.diff(ascending, prepend=-1))
        length = np.diff(first, append=len(rows))
        at = free[ascending] + np.arange(len(rows)) - np.repeat(first, length)
        indices[at], data[at] = columns[order], values[order]
        free[ascending[first]] += length
    matrix = sp.csr_array((data, indices, indptr.astype(indices.dtype)), shape=shape)
    refuse_twice(matrix, name, place, mirror)
    return matrix


def refuse_twice(matrix: sp.csr_array, name: str, place: Place = row_and_column, mirrored: bool = False) -> None:
    """Sort the entries of a matrix of a file, each of which a program writes once.

    The sum of a file that was appended to itself is twice the matrix, which no later check can tell from a stiffer
    one. ``mirrored`` says that one of each pair of entries was filled in, which does not count.

    Raises:
        InputError: entries at one place; their number, the first place and its values are in the message.
    """
    matrix.sort_indices()
    if matrix.has_canonical_format:
        return
    count, first, equal = 0, None, True
    for begin in range(0, matrix.shape[0], TOL.rows_at_once):
        low, high = matrix.indptr[begin], matrix.indptr[min(begin + TOL.rows_at_once, matrix.shape[0])]
        row = np.repeat(
            np.arange(begin, begin + TOL.rows_at_once)[: matrix.shape[0] - begin],
            np.diff(matrix.indptr[begin : begin + TOL.rows_at_once + 1]),
        )
        column, value = matrix.indices[low:high], matrix.data[low:high]
        twice = np.flatnonzero((np.diff(row) == 0) & (np.diff(column) == 0) & ~(mirrored & (column < row)[1:]))
        count += len(twice)
        equal = equal and bool((value[twice] == value[twice + 1]).all())
        if first is None and len(twice):
            k = int(twice[0])
            first = f"{place(int(row[k]), int(column[k]))} ({value[k]:.6g} and {value[k + 1]:.6g})"
    entries = "entry" if count == 1 else "entries"
    raise InputError(
        f"{name} gives {count} {entries} twice{', with the same value' if equal else ''}: the first in {first}; "
        "expected each once, as their sum would be another matrix; two files may stand in one, or one twice: write it "
        "again",
        kind="file",
    )


def refuse_outside(rows: Ints, columns: Ints, shape: tuple[int, int], name: str) -> None:
    """Refuse entries in rows or columns that a matrix of this shape does not have.

    Raises:
        InputError: in these cases.
    """
    for places, size in zip((rows, columns), shape, strict=True):
        outside = places[(places < 0) | (places >= size)]
        if len(outside):
            raise InputError(
                f"{name} has an entry in row or column {outside[0] + 1}; expected 1 to {size}",
                kind="file",
                keyword=name,
            )


def _both(triplets: Iterable[Triplets], shape: tuple[int, int], mirror: bool, name: str) -> Iterator[Triplets]:
    """The triplets, with their mirror images where only half was given."""
    for rows, columns, values in triplets:
        refuse_outside(rows, columns, shape, name)
        yield rows, columns, values
        if mirror:
            off = rows != columns
            yield columns[off], rows[off], values[off]


def unique(triplets: Iterable[Triplets]) -> Ints:
    """All codes of rows and columns, ascending; ``triplets`` is read twice."""
    ends = [(int(part.min()), int(part.max())) for block in triplets for part in block[:2] if len(part)]
    if not ends:
        return np.empty(0, dtype=np.int64)
    low, high = min(a for a, _ in ends), max(b for _, b in ends)
    if high - low < TOL.largest_table:
        there = np.zeros(high - low + 1, dtype=bool)
        for rows, columns, _ in triplets:
            there[rows - low], there[columns - low] = True, True
        return np.flatnonzero(there) + low
    return _sort_once([_sort_once([rows, columns]) for rows, columns, _ in triplets])


def _sort_once(parts: list[Ints]) -> Ints:
    """As np.unique, which for codes takes several times as long."""
    codes = np.sort(np.concatenate(parts))
    return codes[np.diff(codes, prepend=codes[:1] - 1) > 0]


class Numbering:
    """Place of each code; ``order`` (n,) says which of the ascending ``codes`` (n,) comes first, second, ..."""

    def __init__(self, codes: Ints, order: Ints | None = None) -> None:
        self.codes, self.places = codes, np.arange(len(codes))
        if order is not None:
            self.places[order] = np.arange(len(codes))
        span = int(codes[-1] - codes[0]) + 1 if len(codes) else 0
        self._table = np.zeros(span, dtype=np.int64) if span <= TOL.largest_table else None
        if self._table is not None and span:
            self._table[codes - codes[0]] = self.places

    def __len__(self) -> int:
        return len(self.codes)

    def __call__(self, codes: Ints) -> Ints:
        """Places of ``codes``, all of them known."""
        if self._table is None:
            return np.asarray(self.places[np.searchsorted(self.codes, codes)])
        return np.asarray(self._table[codes - self.codes[0]] if len(codes) else codes)


@dataclass(frozen=True, kw_only=True, eq=False)
class Renumbered:
    """Triplets with places instead of codes."""

    triplets: Iterable[Triplets]
    rows: Numbering
    columns: Numbering

    def __iter__(self) -> Iterator[Triplets]:
        for rows, columns, values in self.triplets:
            yield self.rows(rows), self.columns(columns), values


def complete(
    triplets: Iterable[Triplets], size: int, name: str, place: Place = row_and_column
) -> tuple[bool, sp.csr_array]:
    """True if the file holds one entry of each pair only, and the whole matrix.

    Raises:
        InputError: as ``assemble``.
    """
    above = below = False
    for rows, columns, _ in triplets:
        above, below = above or bool((rows < columns).any()), below or bool((rows > columns).any())
    if above != below:
        return True, assemble(triplets, (size, size), mirror=True, name=name, place=place)
    matrix = assemble(triplets, (size, size), mirror=False, name=name, place=place)
    if asymmetry(matrix) > TOL.asymmetry:
        # Entries of a half may lie in both triangles, as the order of the equations is not that of the labels.
        pattern = sp.csr_array((np.ones(matrix.nnz, dtype=np.int8), matrix.indices, matrix.indptr), matrix.shape)
        if (pattern * pattern.T).nnz <= np.count_nonzero(matrix.diagonal()):
            return True, sp.csr_array(matrix + matrix.T - sp.diags_array(matrix.diagonal()))
    return False, matrix


def asymmetry(A: sp.csr_array) -> float:
    """|A z - A' z| over |A| |z| (largest components) for a fixed random vector z: zero if A = A'.

    Needs vectors only (a copy where products would overflow). Rows are compared in units of their own size.
    """
    if float(np.abs(A.data).max(initial=0.0)) > TOL.largest_entry:
        A = A / np.abs(A.data).max()
    z = np.random.default_rng(60).standard_normal(A.shape[0])
    forward, backward = A @ z, A.T @ z
    largest = np.zeros(A.shape[0])
    for at in range(0, A.shape[0], TOL.rows_at_once):
        part = abs(A[at : at + TOL.rows_at_once])
        largest[at : at + TOL.rows_at_once] = np.asarray(part.sum(axis=1)).ravel()
    scale = float(largest.max(initial=0.0))
    return float(np.abs(forward - backward).max(initial=0.0)) / scale if scale else 0.0
