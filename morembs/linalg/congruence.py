"""Products of large sparse matrices, piece by piece."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.budget import Budget
from morembs.errors import InputError

Ints = NDArray[np.int64]
_ENTRIES = 1 << 20


def congruence(T: sp.csr_array, A: sp.csr_array, budget: Budget, *, skew: bool = False) -> sp.csr_array:
    """T' A T (m, m) of a symmetric, or ``skew``, ``A`` (n, n), where T = [I 0; 0 R] but for the order of its rows.

    Rows of A that T keeps are copied, with the zeros they store: the unknowns of a node keep equal patterns.
    Peak memory: the result, where the budget wants it, and pieces of some 50 MB.

    Raises:
        InputError: ``T`` has another form.
    """
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
    parts = (sp.csr_array(sp.hstack([_renumbered(A[kept[rows]], place, f), side[rows]])) for rows in _pieces(A, kept))
    for part in chain(parts, [below]):
        part.sort_indices()
        end = used + part.nnz
        data[used:end], indices[used:end] = part.data, part.indices
        indptr[row + 1 : row + 1 + part.shape[0]] = used + part.indptr[1:]
        used, row = end, row + part.shape[0]
        budget.release_if_tight()
    result = sp.csr_array((data, indices, indptr), shape=(f + m, f + m))
    result.has_canonical_format = True
    return result


def magnitudes(A: sp.csr_array, X: NDArray[np.float64]) -> NDArray[np.float64]:
    """|A| |X| (n, k): what round-off in A X is measured by. |A| is made piece by piece."""
    X, result = np.abs(X), np.empty((A.shape[0], X.shape[1]))
    for part in _pieces(A, np.arange(A.shape[0])):
        result[part] = abs(A[part]) @ X
    return result


def cancelling(A: sp.csr_array, X: NDArray[np.float64], scalar: NDArray[np.bool_]) -> NDArray[np.float64]:
    """What cancels in A X (n, k) of motions ``X``, which leave the ``scalar`` (n,) dofs at zero.

    Modes of held nodes couple to other dofs by round-off alone, which is no measure of itself: a coupling that counts
    is near sqrt(A_ii A_jj).
    """
    terms = magnitudes(A, X)
    if scalar.any():
        size = np.sqrt(np.abs(A.diagonal()))
        terms[scalar] = np.maximum(terms[scalar], np.outer(size[scalar], (size[:, None] * np.abs(X)).max(axis=0)))
    return terms


def scaled_row_sums(A: sp.csr_array) -> NDArray[np.float64]:
    """Weights w (n,) with |x|' |A| |x| <= w' x^2 independent of the units: the row sums of the equilibrated ``A``."""
    d = np.sqrt(np.abs(A.diagonal()))
    d[d == 0] = 1.0
    return np.asarray(d * magnitudes(A, 1.0 / d[:, None])[:, 0])


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
    rest = sp.csr_array(T[slaves])
    if rest.nnz and rest.indices.min() < f:
        raise InputError("a transformation must either keep an unknown or express it by others, not both")
    return kept, slaves, sp.csr_array(rest[:, f:])


def _coupling(A: sp.csr_array, kept: Ints, slaves: Ints, R: sp.csr_array) -> tuple[sp.csr_array, int]:
    """A[kept][:, slaves] R, and the number of stored entries of A[kept][:, slaves], of which most rows have none."""
    inside, touched = np.zeros(A.shape[0], dtype=bool), np.zeros(A.shape[0], dtype=bool)
    inside[slaves] = True
    for first in range(0, A.nnz, _ENTRIES):
        hits = (first + np.flatnonzero(inside[A.indices[first : first + _ENTRIES]])).astype(A.indptr.dtype)
        touched[np.searchsorted(A.indptr, hits, side="right") - 1] = True
    near = np.flatnonzero(touched[kept])
    counts, parts, dropped = np.zeros(len(kept), dtype=np.int64), [sp.csr_array((0, R.shape[1]))], 0
    for rows in _pieces(A, kept[near]):
        beside = A[kept[near[rows]]][:, slaves]
        parts.append(sp.csr_array(beside @ R))
        counts[near[rows]], dropped = np.diff(parts[-1].indptr), dropped + beside.nnz
    whole = sp.vstack(parts, format="csr")
    indptr = np.concatenate([[0], np.cumsum(counts)])
    return sp.csr_array((whole.data, whole.indices, indptr), shape=(len(kept), R.shape[1])), dropped


def _renumbered(A: sp.csr_array, place: Ints, count: int) -> sp.csr_array:
    """``A`` with column j at ``place[j]`` of ``count`` ones; without the columns whose place is below zero."""
    column = place[A.indices]
    stays = column >= 0
    if stays.all():
        return sp.csr_array((A.data, column, A.indptr), shape=(A.shape[0], count))
    indptr = np.concatenate([[0], np.cumsum(stays)])[A.indptr]
    return sp.csr_array((A.data[stays], column[stays], indptr), shape=(A.shape[0], count))


def _pieces(A: sp.csr_array, rows: Ints) -> Iterator[slice]:
    """Ranges of ``rows`` that hold about ``_ENTRIES`` entries of ``A``."""
    ends = np.cumsum(np.diff(A.indptr).astype(np.int64)[rows])
    first = 0
    while first < len(rows):
        before = ends[first - 1] if first else 0
        last = max(int(np.searchsorted(ends, before + _ENTRIES, side="right")), first + 1)
        yield slice(first, last)
        first = last
