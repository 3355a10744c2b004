"""Lower triangle of a sparse matrix: what factorisations read. One that is not symmetric has a skew part beside it."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base.budget import current_budget
from morembs.base.errors import InputError, SingularMatrixError
from morembs.base.types import Values
from morembs.linalg.sparse.tolerances import TOL


@dataclass(frozen=True, eq=False)
class Lower:
    """Lower triangle of a symmetric (n, n) matrix by columns, row numbers ascending, no duplicates.

    Read by rows the same arrays are the upper triangle. Real or complex symmetric (not Hermitian).
    """

    indptr: Values
    indices: Values
    data: Values

    @property
    def n(self) -> int:
        """Number of rows."""
        return len(self.indptr) - 1

    @property
    def nnz(self) -> int:
        """Number of stored entries."""
        return len(self.indices)

    @cached_property
    def pattern(self) -> int:
        """A checksum of the pattern, equal for matrices that can share a symbolic analysis."""
        buffers: list[Any] = [self.indptr.view(np.uint8), self.indices.view(np.uint8)]
        return zlib.crc32(buffers[1], zlib.crc32(buffers[0]))

    @classmethod
    def of(cls, A: sp.sparray | Lower, what: str = "the matrix", *, regular: bool = True) -> Lower:
        """Lower triangle of ``A``, which is checked; ``regular`` False lets it have rows of nothing but zero.

        Peak memory: the triangle itself, where the budget wants it, and a piece of it.

        Raises:
            InputError: not square, empty, not symmetric, or values that are not finite.
            SingularMatrixError: a row or column without any value but zero.
        """
        if isinstance(A, General):
            raise InputError(
                f"{what} is not symmetric; its structure is unsymmetric", kind="model", keyword="structure"
            )
        if isinstance(A, Lower):
            return A
        if A.ndim != 2 or A.shape[0] != A.shape[1]:
            raise InputError(f"{what} has the shape {A.shape}; a square one is needed")
        if A.shape[0] == 0:
            raise InputError(f"{what} has no rows; nothing can be solved with it")
        kind = np.complex128 if np.iscomplexobj(A.data) else np.float64
        if A.dtype != kind:
            A = A.astype(kind)
        if not isinstance(A, sp.csr_array) or not A.has_canonical_format:
            A = sp.csr_array(A.T if isinstance(A, sp.csc_array) else A, copy=True)
            A.sum_duplicates()
        _check_values(A, what, regular)
        budget, counts = current_budget(), np.zeros(A.shape[0] + 1, dtype=np.int64)
        for first, row, keep in _upper(A):
            local = np.bincount(row[keep] - first)
            counts[first + 1 : first + 1 + len(local)] = local
            budget.release_if_tight()
        # The same types for the same pattern, regardless of what SciPy chose for the whole matrix.
        small = np.iinfo(np.int32).max
        indptr = np.cumsum(counts)
        indptr = indptr.astype(np.int32 if indptr[-1] <= small else np.int64)
        indices = budget.empty(int(indptr[-1]), np.int32 if A.shape[0] <= small else np.int64)
        data = budget.empty(int(indptr[-1]), A.dtype)
        used = 0
        for first, row, keep in _upper(A):
            begin = int(A.indptr[first])
            end, count = begin + len(row), int(keep.sum())
            indices[used : used + count], data[used : used + count] = (
                A.indices[begin:end][keep],
                A.data[begin:end][keep],
            )
            used += count
            budget.release_if_tight()
        return cls(indptr, indices, data)

    def columns(self) -> Values:
        """Column number (nnz,) of each entry."""
        return np.repeat(np.arange(self.n, dtype=self.indices.dtype), np.diff(self.indptr))

    def triangles(self, part: slice = slice(None)) -> tuple[Values, Values]:
        """Values a_ij of the lower triangle and a_ji of the upper one, in the order of ``data``, a ``part`` of them."""
        return self.data[part], self.data[part]

    def transpose(self) -> Self:
        """The transpose."""
        return self

    def _magnitudes(self, part: slice) -> NDArray[np.float64]:
        """Magnitudes of the entries in ``part`` of the data, no less than those of their mirror images."""
        return np.asarray(np.abs(self.data[part]))

    def _halves(self) -> tuple[sp.csc_array, sp.csc_array]:
        """Lower triangle, and the transpose of the upper one."""
        shape = self.n, self.n
        lower, upper = self.triangles()
        half = sp.csc_array((lower, self.indices, self.indptr), shape=shape)
        return half, half if upper is lower else sp.csc_array((upper, self.indices, self.indptr), shape=shape)

    def full(self) -> sp.csc_array:
        """Both triangles, for algorithms that need them."""
        half, other = self._halves()
        strict = sp.csc_array(other.T)
        strict.setdiag(0.0)
        matrix = sp.csc_array(half + strict)
        matrix.sort_indices()
        return matrix

    def diagonal(self) -> Values:
        """Diagonal (n,)."""
        result = np.zeros(self.n, dtype=self.data.dtype)
        begin = self.indptr[:-1]
        filled = np.flatnonzero(np.diff(self.indptr) > 0)
        first = begin[filled]
        on = self.indices[first] == filled
        result[filled[on]] = self.data[first[on]]
        return result

    def __matmul__(self, X: Values) -> Values:
        """A X for (n,) or (n, k)."""
        half, other = self._halves()
        result = half @ X
        result += other.T @ X
        d = self.diagonal()
        result -= (d if X.ndim == 1 else d[:, None]) * X
        return np.asarray(result)

    def largest_in_rows(self) -> NDArray[np.float64]:
        """Largest magnitude (n,) of each row of the whole matrix."""
        size = np.zeros(self.n)
        for first in range(0, self.n, TOL.matrix_rows):
            last = min(first + TOL.matrix_rows, self.n)
            begin, end = self.indptr[first], self.indptr[last]
            values = self._magnitudes(slice(begin, end))
            column = np.repeat(np.arange(first, last), np.diff(self.indptr[first : last + 1]))
            np.maximum.at(size, column, values)
            np.maximum.at(size, self.indices[begin:end], values)
        return size

    def scaled_norm(self, d: NDArray[np.float64]) -> float:
        """Largest row sum of the magnitudes of D A D, with ``d`` (n,) the diagonal of D."""
        total = np.zeros(self.n)
        for first in range(0, self.n, TOL.matrix_rows):
            last = min(first + TOL.matrix_rows, self.n)
            begin, end = self.indptr[first], self.indptr[last]
            column = np.repeat(np.arange(first, last), np.diff(self.indptr[first : last + 1]))
            row = self.indices[begin:end]
            values = self._magnitudes(slice(begin, end)) * d[row] * d[column]
            total[first:last] += np.bincount(column - first, values, last - first)
            off_diagonal = row != column
            total += np.bincount(row[off_diagonal], values[off_diagonal], self.n)
        return float(total.max(initial=0.0))


@dataclass(frozen=True, eq=False)
class General(Lower):
    """A matrix that is not symmetric, on a symmetric pattern: ``data`` is the lower triangle of its symmetric part and
    ``skew`` that of its skew part, so that a_ij = data + skew below the diagonal and a_ji = data - skew above."""

    skew: Values

    @classmethod
    def of(cls, A: sp.sparray | Lower, what: str = "the matrix", *, regular: bool = True) -> General:
        """Both parts of ``A`` (n, n). Peak memory: some three times that of ``A``.

        Raises:
            InputError: not square, empty, or values that are not finite.
            SingularMatrixError: a row without any value but zero.
        """
        if isinstance(A, General):
            return A
        if isinstance(A, Lower):
            return cls(A.indptr, A.indices, A.data, np.zeros_like(A.data))
        entries = sp.coo_array(A)
        if entries.shape[0] != entries.shape[1] or not entries.shape[0]:
            raise InputError(f"{what} has the shape {entries.shape}; a square one is needed")
        row, column = entries.coords
        values = entries.data.astype(np.complex128 if np.iscomplexobj(entries.data) else np.float64)
        if not np.isfinite(values).all():
            raise InputError(f"{what} has values that are not finite; check the input matrices", keyword="matrix")
        empty = np.flatnonzero(np.bincount(row, minlength=entries.shape[0]) == 0)
        if regular and len(empty):
            raise SingularMatrixError(
                f"{what} has {len(empty)} rows that are zero (the first is row {empty[0]}); remove these dofs"
            )
        ends = np.maximum(row, column), np.minimum(row, column)
        # Sums of duplicates keep zeros, so that both parts have one pattern.
        half, skew = (
            sp.csc_array(sp.coo_array((values * weight, ends), shape=entries.shape))
            for weight in (0.5 + 0.5 * (row == column), 0.5 * np.sign(row - column))
        )
        kind = np.int32 if half.nnz <= np.iinfo(np.int32).max else np.int64
        return cls(half.indptr.astype(kind), half.indices.astype(np.int32), half.data, skew.data)

    def triangles(self, part: slice = slice(None)) -> tuple[Values, Values]:
        return self.data[part] + self.skew[part], self.data[part] - self.skew[part]

    def transpose(self) -> General:
        return replace(self, skew=-self.skew)

    def _magnitudes(self, part: slice) -> NDArray[np.float64]:
        return np.asarray(np.abs(self.data[part]) + np.abs(self.skew[part]))


def _upper(A: sp.csr_array) -> Iterator[tuple[int, Values, NDArray[np.bool_]]]:
    """Pieces of ``A``: their first row, the row of each entry, and whether it lies on or right of the diagonal."""
    for first in range(0, A.shape[0], TOL.matrix_rows):
        last = min(first + TOL.matrix_rows, A.shape[0])
        row = np.repeat(np.arange(first, last, dtype=A.indices.dtype), np.diff(A.indptr[first : last + 1]))
        yield first, row, A.indices[A.indptr[first] : A.indptr[last]] >= row


def _check_values(A: sp.csr_array, what: str, regular: bool) -> None:
    if not np.isfinite(A.data).all():
        raise InputError(f"{what} has values that are not finite; check the input matrices", keyword="matrix")
    x = np.random.default_rng(11).standard_normal(A.shape[0])
    size = np.asarray(np.sqrt(abs(A.diagonal())))
    x = np.divide(x, size, out=x, where=size > 0)
    Ax, ATx = A @ x, A.T @ x
    if np.linalg.norm(Ax - ATx) > TOL.asymmetry * (np.linalg.norm(Ax) + np.linalg.norm(ATx)):
        raise InputError(
            f"{what} is not symmetric; the methods here need symmetric mass, stiffness and damping",
            kind="model",
            keyword="matrix",
        )
    if not regular:
        return
    if not A.nnz:
        raise SingularMatrixError(f"{what} is zero")
    empty = np.flatnonzero(np.diff(A.indptr) == 0)
    if len(empty):
        raise SingularMatrixError(
            f"{what} has {len(empty)} rows that are zero (the first is row {empty[0]}); remove these dofs"
        )
