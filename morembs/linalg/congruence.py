"""Products of large sparse matrices, piece by piece."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base.budget import current_budget
from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.linalg.tolerances import TOL


def congruence(T: sp.csr_array, A: sp.csr_array, *, skew: bool = False) -> sp.csr_array:
    """T' A T (m, m) of a symmetric, or ``skew``, ``A`` (n, n), where T = [I 0; 0 R] but for the order of its rows.

    Rows of A that T keeps are copied, with the zeros they store: the unknowns of a node keep equal patterns.
    Peak memory: the result, where the budget wants it, and pieces of some 50 MB.

    Raises:
        InputError: ``T`` has another form.
    """
    budget = current_budget()
    kept, slaves, R = _split(T)
    f, m = len(kept), R.shape[1]
    # Coupling of the kept rows with the masters, and of the masters with each other.
    side, dropped = _coupling(A, kept, slaves, R)
    middle = sp.csr_array(R.T @ A[slaves][:, slaves] @ R)
    sign = -1.0 if skew else 1.0
    below = sp.csr_array(sp.hstack([sign * side.T, 0.5 * (middle + sign * middle.T)]))
    nnz = int(np.diff(A.indptr).astype(np.int64)[kept].sum()) - dropped + side.nnz + below.nnz
    index = np.int32 if max(nnz, f + m) < np.iinfo(np.int32).max else np.int64
    data, indices = budget.empty(nnz, A.dtype), budget.empty(nnz, index)
    indptr, used, row = np.zeros(f + m + 1, dtype=index), 0, 0
    place = np.full(A.shape[0], -1, dtype=index)
    place[kept] = np.arange(f, dtype=index)
    for rows in _pieces(A, kept):
        part = _take_rows(A, kept[rows])
        counts = _merge_rows(part, place, side[rows], f, data[used:], indices[used:])
        indptr[row + 1 : row + 1 + len(counts)] = used + np.cumsum(counts, dtype=index)
        used, row = int(indptr[row + len(counts)]), row + len(counts)
        budget.release_if_tight()
    below.sort_indices()
    data[used:], indices[used:] = below.data, below.indices
    indptr[row + 1 :] = used + below.indptr[1:].astype(index)
    result = sp.csr_array((data, indices, indptr), shape=(f + m, f + m))
    result.has_canonical_format = True
    return result


def magnitudes(A: sp.csr_array, X: NDArray[np.float64]) -> NDArray[np.float64]:
    """|A| |X| (n, k): what round-off in A X is measured by. |A| is made piece by piece."""
    X, result = np.abs(X), np.empty((A.shape[0], X.shape[1]))
    for part in _pieces(A, np.arange(A.shape[0])):
        result[part] = abs(A[part]) @ X
    return result


def abs_products(A: sp.csr_array, X: NDArray[np.float64], scalar: NDArray[np.bool_]) -> NDArray[np.float64]:
    """What cancels in A X (n, k) of motions ``X``, which leave the ``scalar`` (n,) dofs at zero.

    Modes of held nodes couple to other dofs by round-off alone, which is no measure of itself: a coupling that counts
    is near sqrt(A_ii A_jj).
    """
    terms = magnitudes(A, X)
    if scalar.any():
        size = np.sqrt(np.abs(A.diagonal()))
        terms[scalar] = np.maximum(terms[scalar], np.outer(size[scalar], (size[:, None] * np.abs(X)).max(axis=0)))
    return terms


def extended_product(A: sp.csr_array, X: NDArray[Any]) -> NDArray[np.longdouble]:
    """A X (n, k) in extended precision, where the processor has one. A is copied piece by piece."""
    result = np.empty((A.shape[0], X.shape[1]), dtype=np.longdouble)
    for part in _pieces(A, np.arange(A.shape[0])):
        result[part] = A[part].astype(np.longdouble) @ X
    return result


def scaled_row_sums(A: sp.csr_array) -> NDArray[np.float64]:
    """Weights w (n,) with |x|' |A| |x| <= w' x^2 independent of the units: the row sums of the equilibrated ``A``."""
    return weighted_row_sums(A, np.ones(A.shape[0]))


def weighted_row_sums(A: sp.csr_array, weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """As ``scaled_row_sums`` of the entries (c_i + c_j) / 2 |A_ij| for the ``weight`` c (n,) of rows."""
    d = np.sqrt(np.abs(A.diagonal()))
    d[d == 0] = 1.0
    plain, across = magnitudes(A, np.column_stack([1.0 / d, weight / d])).T
    return np.asarray(d * 0.5 * (weight * plain + across))


def _split(T: sp.csr_array) -> tuple[Ints, Ints, sp.csr_array]:
    """Rows of ``T`` that are the identity on its first columns, in the order of these; the others; and R."""
    single = np.flatnonzero(np.diff(T.indptr) == 1)
    column = T.indices[T.indptr[single]]
    unit = T.data[T.indptr[single]] == 1.0
    count = np.bincount(column[unit], minlength=T.shape[1])
    slaves_of = np.bincount(T.indices, minlength=T.shape[1])
    # Columns that one row alone reaches, and reaches with one: the first ones of them are kept.
    own = (count == 1) & (slaves_of == 1)
    f = int(np.argmin(own)) if not own.all() else T.shape[1]
    chosen = unit & (column < f)
    kept = np.empty(f, dtype=np.int64)
    kept[column[chosen]] = single[chosen]
    others = np.ones(T.shape[0], dtype=bool)
    others[kept] = False
    slaves = np.flatnonzero(others)
    terms = sp.csr_array(T[slaves])
    if terms.nnz and terms.indices.min() < f:
        raise InputError("a transformation must either keep an unknown or express it by others, not both")
    return kept, slaves, sp.csr_array(terms[:, f:])


def _coupling(A: sp.csr_array, kept: Ints, slaves: Ints, R: sp.csr_array) -> tuple[sp.csr_array, int]:
    """A[kept][:, slaves] R, and the number of stored entries of A[kept][:, slaves], of which most rows have none."""
    inside, touched = np.zeros(A.shape[0], dtype=bool), np.zeros(A.shape[0], dtype=bool)
    inside[slaves] = True
    for first in range(0, A.nnz, TOL.entries_at_once):
        hits = (first + np.flatnonzero(inside[A.indices[first : first + TOL.entries_at_once]])).astype(A.indptr.dtype)
        touched[np.searchsorted(A.indptr, hits, side="right") - 1] = True
    near = np.flatnonzero(touched[kept])
    counts, parts, dropped = np.zeros(len(kept), dtype=np.int64), [sp.csr_array((0, R.shape[1]))], 0
    for rows in _pieces(A, kept[near]):
        beside = A[kept[near[rows]]][:, slaves]
        parts.append(sp.csr_array(beside @ R))
        counts[near[rows]], dropped = np.diff(parts[-1].indptr), dropped + beside.nnz
    stacked = sp.vstack(parts, format="csr")
    indptr = np.concatenate([[0], np.cumsum(counts)])
    return sp.csr_array((stacked.data, stacked.indices, indptr), shape=(len(kept), R.shape[1])), dropped


def _take_rows(A: sp.csr_array, rows: Ints) -> sp.csr_array:
    """``A[rows]``, a view where they follow each other."""
    first, last = int(rows[0]), int(rows[-1]) + 1
    if last - first != len(rows) or (np.diff(rows) != 1).any():
        return sp.csr_array(A[rows])
    begin, end = A.indptr[first], A.indptr[last]
    part = (A.data[begin:end], A.indices[begin:end], A.indptr[first : last + 1] - begin)
    return sp.csr_array(part, shape=(len(rows), A.shape[1]))


def _merge_rows(
    A: sp.csr_array, place: Ints, side: sp.csr_array, first: int, data: NDArray[Any], indices: NDArray[Any]
) -> Ints:
    """Write [A side], row by row, to the beginning of ``data`` and ``indices``, and return the entries of each row.

    Column j of ``A`` becomes ``place[j]`` and is dropped where that is below zero; columns of ``side`` begin at
    ``first``.
    """
    column = place[A.indices]
    stays = column >= 0
    values, begin = A.data, A.indptr
    if not stays.all():
        values, column, begin = values[stays], column[stays], np.concatenate([[0], np.cumsum(stays)])[begin]
    counts: Ints = np.diff(begin)
    ordered = sp.csr_array((values, column, begin), shape=(A.shape[0], first))
    if not ordered.has_sorted_indices:
        # Not in place: the values may be those of the matrix itself.
        ordered = ordered.sorted_indices()
    values, column = ordered.data, ordered.indices
    added: Ints = np.diff(side.indptr)
    end = len(column) + side.nnz
    if not side.nnz:
        data[:end], indices[:end] = values, column
        return counts
    side.sort_indices()
    # Entries of the side end their rows.
    ends = np.repeat(np.cumsum(counts), added) + np.arange(side.nnz)
    own = np.ones(end, dtype=bool)
    own[ends] = False
    data[:end][own], indices[:end][own] = values, column
    data[ends], indices[ends] = side.data, side.indices + first
    return counts + added


def _pieces(A: sp.csr_array, rows: Ints) -> Iterator[slice]:
    """Ranges of ``rows`` that hold about ``TOL.entries_at_once`` entries of ``A``."""
    ends = np.cumsum(np.diff(A.indptr).astype(np.int64)[rows])
    first = 0
    while first < len(rows):
        before = ends[first - 1] if first else 0
        last = max(int(np.searchsorted(ends, before + TOL.entries_at_once, side="right")), first + 1)
        yield slice(first, last)
        first = last
