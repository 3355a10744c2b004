"""Parts of a model that are no classes of ours, as files hold them: named sets of rows, and sparse matrices."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from morembs.base.types import Ints
from morembs.storage.table import Row, Table

if TYPE_CHECKING:
    import scipy.sparse as sp


def sets_table(largest: str = "") -> Table:
    """Sets of rows by their names; rows are ``largest`` as those of ``Row``."""
    return Table(
        (
            Row("names", "words", "sets", doc="of the sets"),
            Row("offsets", "whole", "any", doc="set i holds `rows[offsets[i]:offsets[i+1]]`"),
            Row("rows", "whole", "any", "from 0", largest=largest),
        ),
        build=_sets,
        parts=_sets_parts,
    )


def _sets(names: tuple[str, ...], offsets: Ints, rows: Ints) -> dict[str, Ints]:
    if len(offsets) != len(names) + 1 or offsets[0] != 0 or offsets[-1] != len(rows) or (np.diff(offsets) < 0).any():
        raise ValueError("sets do not fit their names")
    return {name: rows[offsets[i] : offsets[i + 1]] for i, name in enumerate(names)}


def _sets_parts(sets: Mapping[str, Ints]) -> Mapping[str, object]:
    rows = np.concatenate([np.empty(0, dtype=np.int64), *sets.values()])
    return {"names": list(sets), "offsets": np.cumsum([0, *map(len, sets.values())]), "rows": rows}


def matrix_table(units: str) -> Table:
    """A CSR matrix as SciPy keeps it; imaginary parts have a dataset of their own."""
    return Table(
        (
            Row("data", "entries", "any", units=units, doc="values, their real parts"),
            Row("data_imag", "entries", "any", units=units, doc="their imaginary parts", when="of complex matrices"),
            Row("indices", "index", "any", doc="columns of the values"),
            Row("indptr", "index", "any", doc="where each row begins"),
            Row("shape", "whole", "2", doc="rows and columns"),
        ),
        parts=_matrix_parts,
        attributes={"format": "csr"},
    )


def _matrix_parts(matrix: sp.csr_array) -> Mapping[str, Any]:
    if not matrix.has_canonical_format:
        matrix = matrix.copy()
        matrix.sum_duplicates()
    return {
        "data": np.ascontiguousarray(matrix.data.real),
        "data_imag": np.ascontiguousarray(matrix.data.imag) if matrix.data.dtype.kind == "c" else None,
        "indices": matrix.indices,
        "indptr": matrix.indptr,
        "shape": matrix.shape,
    }
