"""Fill-reducing order by METIS on the graph of rows that cannot be told apart.

The three displacements of one finite-element node have the same pattern. Merging them makes the graph
nine times smaller, the ordering faster, and keeps them together in one pivot block.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import logging
from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

log = logging.getLogger(__name__)
Ints = NDArray[np.int64]

_OPTIONS = 40
_OK = 1
# Below this any order is good, and METIS is not meant for graphs of a few vertices.
_SMALLEST = 50
_CHUNK = 1 << 22


@cache
def _metis() -> tuple[Any, type[np.signedinteger[Any]]] | None:
    """The METIS library and its integer type, None where there is none of version 5."""
    path = ctypes.util.find_library("metis")
    if path is None:
        return None
    options = np.zeros(2 * _OPTIONS, dtype=np.int32)
    try:
        library = ctypes.CDLL(path)
        library.METIS_NodeND.restype = ctypes.c_int
        # Missing in version 4, whose NodeND takes other arguments.
        library.METIS_SetDefaultOptions(ctypes.c_void_p(options.ctypes.data))
    except (OSError, AttributeError):
        return None
    # It sets every option to -1: with 64-bit integers that fills the second half as well.
    return library, (np.int64 if (options == -1).all() else np.int32)


def metis_ordering(A: sp.csc_array) -> Ints | None:
    """Order in which to eliminate the rows of a symmetric ``A`` (n, n) with sorted indices.

    Returns:
        (n,) row numbers in their order of elimination; None without METIS, or where it is of no use.
    """
    found = _metis()
    n = A.shape[0]
    if found is None or n < _SMALLEST:
        return None
    library, integer = found
    first = _new_pattern(A)
    graph = _quotient(A, first)
    vertices = graph.shape[0]
    if vertices < _SMALLEST or graph.nnz == 0 or graph.nnz > np.iinfo(integer).max:
        return None
    starts = np.flatnonzero(first)
    sizes = np.diff(np.append(starts, n))
    arrays = [np.ascontiguousarray(array, dtype=integer) for array in (graph.indptr, graph.indices, sizes)]
    order, position = np.empty(vertices, dtype=integer), np.empty(vertices, dtype=integer)
    count = np.array([vertices], dtype=integer)
    xadj, adjncy, weights = (ctypes.c_void_p(array.ctypes.data) for array in arrays)
    code = library.METIS_NodeND(
        ctypes.c_void_p(count.ctypes.data), xadj, adjncy, weights, None,
        ctypes.c_void_p(order.ctypes.data), ctypes.c_void_p(position.ctypes.data),
    )
    if code != _OK:
        log.warning("METIS failed with code %d; the solver orders the matrix itself", code)
        return None
    return _explode(order.astype(np.int64), starts, sizes)


def _new_pattern(A: sp.csc_array) -> NDArray[np.bool_]:
    """(n,) whether a column has another pattern than the column before it."""
    counts = np.diff(A.indptr).astype(np.int64)
    first = np.ones(A.shape[0], dtype=bool)
    first[1:] = counts[1:] != counts[:-1]
    same = np.flatnonzero(~first & (counts > 0))
    # In pieces: the temporaries are several times the matrix.
    ends = np.cumsum(counts[same])
    limits = np.arange(_CHUNK, ends[-1] if same.size else 0, _CHUNK)
    for columns in np.split(same, np.searchsorted(ends, limits)):
        length = counts[columns]
        place = np.arange(length.sum()) + np.repeat(A.indptr[columns] - (np.cumsum(length) - length), length)
        differs = A.indices[place] != A.indices[place - np.repeat(length, length)]
        first[np.repeat(columns, length)[differs]] = True
    return first


def _quotient(A: sp.csc_array, first: NDArray[np.bool_]) -> sp.csr_array:
    """Graph of the groups that start where ``first`` holds: symmetric, no loops, no values of use."""
    group = np.cumsum(first) - 1
    part = A[:, np.flatnonzero(first)]
    column = np.repeat(np.arange(part.shape[1]), np.diff(part.indptr))
    row = group[part.indices]
    keep = row != column
    keep[1:] &= (row[1:] != row[:-1]) | (column[1:] != column[:-1])
    row, column = row[keep], column[keep]
    size = (part.shape[1], part.shape[1])
    half = sp.csr_array((np.ones(row.size, dtype=np.int8), (row, column)), shape=size)
    # METIS reads beyond its arrays when an edge is stored in one direction only; rounding to zero on
    # one side of the matrix is enough for that.
    return sp.csr_array(half + half.T)


def _explode(order: Ints, starts: Ints, sizes: Ints) -> Ints:
    """Rows of the groups in ``order``."""
    length = sizes[order]
    offset = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
    return np.asarray(np.repeat(starts[order], length) + offset, dtype=np.int64)
