"""Products of large sparse matrices, piece by piece."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.budget import Budget

_ENTRIES = 1 << 22


def congruence(T: sp.csr_array, A: sp.csr_array, budget: Budget) -> sp.csr_array:
    """T' A T (m, m) of a symmetric ``A`` (n, n), where most rows of ``T`` (n, m) are rows of the identity.

    Peak memory: the result, where the budget wants it, and pieces of some 50 MB.
    """
    Tt = sp.csr_array(T.T)
    pieces = _row_pieces(Tt, A)
    # A first pass over the patterns would cost as much as the product: this many entries are enough.
    most = A.nnz + _added_at_most(T, A)
    index = np.int32 if most < np.iinfo(np.int32).max else np.int64
    data, indices = budget.empty(most), budget.empty(most, index)
    indptr = np.zeros(Tt.shape[0] + 1, dtype=index)
    used = 0
    for first, last in pieces:
        part = sp.csr_array(sp.csr_array(Tt[first:last] @ A) @ T)
        part.sort_indices()
        end = used + part.nnz
        data[used:end], indices[used:end] = part.data, part.indices
        indptr[first + 1 : last + 1] = used + part.indptr[1:]
        used = end
        budget.relax()
    result = sp.csr_array((data[:used], indices[:used], indptr), shape=(T.shape[1],) * 2)
    result.has_canonical_format = True
    return result


def max_norm(A: sp.csr_array) -> float:
    """Largest sum of magnitudes in a row of ``A``."""
    best = 0.0
    for first, last in _row_pieces(sp.csr_array(sp.eye_array(A.shape[0], format="csr")), A):
        best = max(best, float(abs(A[first:last]).sum(axis=1).max(initial=0.0)))
    return best


def _row_pieces(Tt: sp.csr_array, A: sp.csr_array) -> list[tuple[int, int]]:
    """Ranges of rows of ``Tt`` (m, n) whose products with ``A`` take about ``_ENTRIES`` multiplications."""
    length = np.diff(A.indptr).astype(np.int64)
    total = np.concatenate([[0], np.cumsum(length[Tt.indices])])
    work = total[Tt.indptr[1:]]
    count = int(work[-1] // _ENTRIES) + 1 if len(work) else 1
    cuts = np.searchsorted(work, np.linspace(0, total[-1], count + 1)[1:-1]) + 1
    edges = np.unique(np.concatenate([[0], cuts, [Tt.shape[0]]]).astype(int))
    edges = edges[edges <= Tt.shape[0]]
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def _added_at_most(T: sp.csr_array, A: sp.csr_array) -> int:
    """Bound of the entries that rows of ``T`` with several entries add to those of ``A``."""
    several = np.flatnonzero(np.diff(T.indptr) > 1)
    masters = np.unique(T.indices[_entries_of(T, several)]) if len(several) else several
    reached = int(np.diff(A.indptr)[several].sum())
    # Every row that a slave touches may couple with every master, on both sides of the diagonal.
    return int(2 * len(masters) * (min(reached, A.shape[0]) + len(masters)))


def _entries_of(T: sp.csr_array, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    mask = np.zeros(T.shape[0], dtype=bool)
    mask[rows] = True
    return np.flatnonzero(np.repeat(mask, np.diff(T.indptr)))
