"""Fill-reducing order by METIS on the graph of indistinguishable rows.

The three displacements of one finite-element node have the same pattern. Merging them makes the graph
nine times smaller, the ordering faster, and keeps them together in one pivot block.
"""

from __future__ import annotations

import ctypes
import logging
from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base.types import Ints
from morembs.linalg.sparse.foreign import find_library
from morembs.linalg.sparse.symmetric import Lower
from morembs.linalg.sparse.tolerances import TOL

log = logging.getLogger(__name__)

# Of METIS 5: length of its array of options, and what its functions return.
METIS = {"METIS_NOPTIONS": 40, "METIS_OK": 1}
_LAST: list[tuple[int | None, Ints | None]] = [(None, None)]


@cache
def metis_library() -> tuple[Any, type[np.signedinteger[Any]]] | None:
    """The METIS library and its integer type, None where there is none of version 5."""
    path = find_library("metis")
    if path is None:
        return None
    options = np.zeros(2 * METIS["METIS_NOPTIONS"], dtype=np.int32)
    try:
        library = ctypes.CDLL(path)
        library.METIS_NodeND.restype = ctypes.c_int
        # Missing in version 4, whose NodeND takes other arguments.
        library.METIS_SetDefaultOptions(ctypes.c_void_p(options.ctypes.data))
    except (OSError, AttributeError):
        return None
    # It sets every option to -1: with 64-bit integers that fills the second half as well.
    return library, (np.int64 if (options == -1).all() else np.int32)


def metis_ordering(A: Lower) -> Ints | None:
    """Order in which to eliminate the rows of a symmetric ``A`` (n, n).

    The last one is kept, as solvers are compared on the same pattern.

    Returns:
        (n,) row numbers in their order of elimination; None without METIS, or where it is of no use.
    """
    key, order = _LAST[0]
    if key != A.pattern:
        order = _order_by_metis(A)
        # One assignment: another thread sees the old pair or the new one.
        _LAST[0] = A.pattern, order
    return order


def _order_by_metis(A: Lower) -> Ints | None:
    metis = metis_library()
    n = A.n
    if metis is None or n < TOL.smallest_graph:
        return None
    library, integer = metis
    graph, starts = node_graph(A)
    vertices = graph.shape[0]
    if vertices < TOL.smallest_graph or graph.nnz == 0 or graph.nnz > np.iinfo(integer).max:
        return None
    counts = np.diff(np.append(starts, n))
    arrays = [np.ascontiguousarray(array, dtype=integer) for array in (graph.indptr, graph.indices, counts)]
    order, position = np.empty(vertices, dtype=integer), np.empty(vertices, dtype=integer)
    count = np.array([vertices], dtype=integer)
    xadj, adjncy, weights = (ctypes.c_void_p(array.ctypes.data) for array in arrays)
    code = library.METIS_NodeND(
        ctypes.c_void_p(count.ctypes.data),
        xadj,
        adjncy,
        weights,
        None,
        ctypes.c_void_p(order.ctypes.data),
        ctypes.c_void_p(position.ctypes.data),
    )
    if code != METIS["METIS_OK"]:
        log.warning("METIS failed with code %d; the solver orders the matrix itself", code)
        return None
    return explode(order.astype(np.int64), starts, counts)


def node_graph(A: Lower) -> tuple[sp.csr_array, Ints]:
    """Graph of the groups of equal rows (symmetric, no loops, no values of use), and the first row of each group."""
    first = _new_pattern(A)
    return _quotient(A, first), np.flatnonzero(first)


def _new_pattern(A: Lower) -> NDArray[np.bool_]:
    """(n,) whether a row of the whole matrix has another pattern than the row before it.

    In the lower triangle, rows j - 1 and j of equal pattern have columns that differ by the entry (j, j - 1)
    alone, and rows that differ by the diagonal entry (j, j) alone. Columns are compared entry by entry. Rows
    are compared by the sums of a random number for each column; an error there costs fill, nothing else.
    """
    counts = np.diff(A.indptr).astype(np.int64)
    first = np.ones(A.n, dtype=bool)
    key = np.random.default_rng(5).uniform(1.0, 2.0, A.n)
    row = _row_sums(A, key)
    first[1:] = (counts[1:] != counts[:-1] - 1) | (np.abs(row[1:] - key[1:] - row[:-1]) > TOL.same_key_sum * row[1:])
    same = np.flatnonzero(~first)
    for columns in _pieces(same, counts):
        here, length = _places(A.indptr[columns], counts[columns])
        before, _ = _places(A.indptr[columns - 1] + 1, counts[columns])
        differs = A.indices[here] != A.indices[before]
        first[np.repeat(columns, length)[differs]] = True
    return first


def _row_sums(A: Lower, key: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum (n,) of ``key`` (n,) over the columns that each row of the triangle has."""
    counts = np.diff(A.indptr).astype(np.int64)
    total = np.zeros(A.n)
    for columns in _pieces(np.arange(A.n), counts):
        begin, end = A.indptr[columns[0]], A.indptr[columns[-1] + 1]
        total += np.bincount(A.indices[begin:end], weights=np.repeat(key[columns], counts[columns]), minlength=A.n)
    return total


def _pieces(columns: Ints, counts: Ints) -> list[Ints]:
    """``columns`` cut into pieces of about ``graph_entries``: the temporaries are several times as large."""
    ends = np.cumsum(counts[columns])
    limits = np.arange(TOL.graph_entries, ends[-1] if columns.size else 0, TOL.graph_entries)
    return [part for part in np.split(columns, np.searchsorted(ends, limits)) if part.size]


def _places(begin: Ints, length: Ints) -> tuple[Ints, Ints]:
    """Consecutive numbers, ``length`` of them from each ``begin``; and ``length``."""
    offset = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
    return np.repeat(begin, length) + offset, length


def _quotient(A: Lower, first: NDArray[np.bool_]) -> sp.csr_array:
    """Graph of the groups that start where ``first`` holds: symmetric, no loops, no values of use."""
    group = np.cumsum(first, dtype=np.int32) - np.int32(1)
    starts = np.flatnonzero(first)
    counts = np.diff(A.indptr).astype(np.int64)
    rows, columns = [], []
    for part in _pieces(starts, counts):
        place, length = _places(A.indptr[part], counts[part])
        column = np.repeat(group[part], length)
        row = group[A.indices[place]]
        keep = row != column
        keep[1:] &= (row[1:] != row[:-1]) | (column[1:] != column[:-1])
        rows.append(row[keep])
        columns.append(column[keep])
    row, column = np.concatenate(rows), np.concatenate(columns)
    size = (len(starts), len(starts))
    half = sp.csr_array((np.ones(row.size, dtype=np.int8), (row, column)), shape=size)
    # METIS reads beyond its arrays when an edge is stored in one direction only.
    return sp.csr_array(half + half.T)


def explode(order: Ints, starts: Ints, counts: Ints) -> Ints:
    """Rows of the groups in ``order``."""
    return np.asarray(_places(starts[order], counts[order])[0], dtype=np.int64)
