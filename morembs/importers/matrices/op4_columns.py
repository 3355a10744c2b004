"""What every variant of an OP4 file is: a header, then columns made of strings of neighbouring rows."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.importers.matrices.triplets import asymmetry
from morembs.importers.tolerances import TOL

FORMS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 15)
TYPES = {1: np.float32, 2: np.float64, 3: np.complex64, 4: np.complex128}


class Form(IntEnum):
    """Forms of a matrix that matter here (MSC Nastran DMAP Programmer's Guide, OUTPUT4); ``FORMS`` are all."""

    SQUARE = 1
    RECTANGULAR = 2
    DIAGONAL = 3
    SYMMETRIC = 6
    IDENTITY = 8


class Packed:
    """Row and length of a string in one 32-bit integer, row + 65536 (words + 1), of files that are not "bigmat".

    Matrices with as many ``ROWS`` or more are "bigmat" even without a negative row count (the same guide).
    """

    LENGTH_BITS = 16
    ROWS = 1 << LENGTH_BITS
    ROW_MASK = ROWS - 1
    MOST_WORDS = (1 << 15) - 2


@dataclass(frozen=True, kw_only=True, eq=False)
class OP4Matrix:
    """One matrix of an OP4 file.

    ``matrix`` is a csr_array where the file stores strings or where a dense array would be more than twice as
    large as what is stored, else an ndarray; double precision. ``form`` 1 square, 2 rectangular, 3 diagonal,
    6 symmetric, 8 identity; ``type`` 1 real single, 2 real double, 3 complex single, 4 complex double, as in the
    file. A symmetric matrix with more than four million entries comes transposed (the same but for round-off).
    ``storage`` "dense", "bigmat" or "nonbigmat"; ``mirrored`` says that the file held one triangle of a symmetric
    matrix and the other was filled in.
    """

    matrix: sp.csr_array | NDArray[Any]
    form: int
    type: int
    storage: str
    mirrored: bool = False


@dataclass(frozen=True, kw_only=True)
class Header:
    """Size, form, type and name of one matrix; ``bigmat`` as the sign or the size of the row count says."""

    columns: int
    rows: int
    form: int
    type: int
    name: str
    bigmat: bool

    @property
    def complex(self) -> bool:
        """True if entries have an imaginary part."""
        return self.type > 2


def header(file: str, columns: int, rows: int, form: int, kind: int, name: str) -> Header:
    """Checked header.

    Raises:
        InputError: sizes, form, type or name that no matrix has.
    """
    bigmat = rows < 0 or rows >= Packed.ROWS
    rows = abs(rows)
    if columns < 1 or rows < 1 or form not in FORMS or kind not in TYPES:
        raise InputError(
            f"{file}: the matrix {name!r} is said to have {rows} rows, {columns} columns, form {form} and type {kind}; "
            "expected sizes above 0, a form of 1 to 15 and a type of 1 to 4; check that this is a whole OP4 file"
        )
    if form in (Form.SQUARE, Form.SYMMETRIC, Form.IDENTITY) and rows != columns:
        raise InputError(
            f"{file}: the matrix {name!r} has form {form} (square) but {rows} rows and {columns} columns; "
            "write it again",
            kind="file",
        )
    if not name or not name.isprintable():
        raise InputError(f"{file}: a matrix has the name {name!r}; expected letters and digits")
    return Header(columns=columns, rows=rows, form=form, type=kind, name=name, bigmat=bigmat)


class Collector:
    """Takes strings column by column and makes the matrix; ``bound`` is the largest count of entries.

    Only pages that are filled cost memory, so a bound that is too large does not.
    """

    def __init__(self, file: str, head: Header, bound: int, storage: str) -> None:
        self.file, self.head, self.storage = file, head, storage
        self.dtype = np.dtype(complex if head.complex else float)
        small = max(bound, head.rows, head.columns) < 2**31
        self.indices = np.empty(bound, dtype=np.int32 if small else np.int64)
        self.data = np.empty(bound, dtype=self.dtype)
        self.counts = np.zeros(head.columns + 1, dtype=np.int64)
        self.used = 0
        self.below = self.above = False
        self.stored = 0

    def add(self, column: Ints, row: Ints, length: Ints, values: NDArray[Any]) -> None:
        """Strings of ``length`` (k,) entries from ``row`` (k,) on in ``column`` (k,), counted from 0, ascending."""
        head = self.head
        if len(row) and (row.min() < 0 or (row + length).max() > head.rows or length.min() < 1):
            raise InputError(
                f"{self.file}: the matrix {head.name!r} has entries outside its {head.rows} rows", kind="unsupported"
            )
        if not np.isfinite(values).all():
            raise InputError(
                f"{self.file}: the matrix {head.name!r} holds NaN or infinite entries; write it again",
                kind="file",
                keyword=self.file,
            )
        first = np.cumsum(length) - length
        rows = np.repeat(row - first, length) + np.arange(len(values))
        columns = np.repeat(column, length)
        falling = (rows[1:] <= rows[:-1]) & (columns[1:] == columns[:-1])
        if falling.any():
            raise InputError(
                f"{self.file}: the matrix {head.name!r} has a column whose rows do not ascend; write it again",
                kind="file",
                keyword=self.file,
            )
        kept = values != 0
        rows, columns = rows[kept], columns[kept]
        end = self.used + len(rows)
        self.indices[self.used : end], self.data[self.used : end] = rows, values[kept]
        self.counts += np.bincount(columns + 1, minlength=head.columns + 1)
        self.below |= bool((rows > columns).any())
        self.above |= bool((rows < columns).any())
        self.used, self.stored = end, self.stored + len(values)

    def matrix(self) -> OP4Matrix:
        """The matrix.

        Raises:
            InputError: it is not what its form says.
        """
        head, indptr = self.head, np.cumsum(self.counts).astype(self.indices.dtype)
        self.data.resize(self.used, refcheck=False)
        self.indices.resize(self.used, refcheck=False)
        if head.form == Form.IDENTITY and not self.used:
            eye = sp.eye_array(head.rows, format="csr")
            return OP4Matrix(matrix=sp.csr_array(eye), form=head.form, type=head.type, storage=self.storage)
        by_column = sp.csc_array((self.data, self.indices, indptr), shape=(head.rows, head.columns))
        mirrored = head.form == Form.SYMMETRIC and self.below != self.above
        if mirrored:
            result = sp.csr_array(by_column + by_column.T - sp.diags_array(by_column.diagonal()))
        elif head.form == Form.SYMMETRIC:
            self._refuse_asymmetric(by_column.T)
            # A' = A but for round-off, so the columns of a large matrix serve as rows, without a copy.
            result = by_column.T if self.used > TOL.copied_entries else sp.csr_array(by_column)
        elif head.form == Form.DIAGONAL and head.columns == 1:
            result = sp.csr_array(sp.diags_array(by_column.toarray().ravel()))
        else:
            result = sp.csr_array(by_column)
        dense = self.storage == "dense" and result.shape[0] * result.shape[1] <= 2 * max(self.stored, 1)
        return OP4Matrix(
            matrix=result.toarray() if dense else result,
            form=head.form,
            type=head.type,
            storage=self.storage,
            mirrored=mirrored,
        )

    def _refuse_asymmetric(self, matrix: sp.csr_array) -> None:
        if asymmetry(matrix) > TOL.op4_asymmetry:
            raise InputError(
                f"{self.file}: the matrix {self.head.name!r} has form 6 (symmetric) but its two triangles differ; "
                "write it again",
                kind="file",
                keyword=self.file,
            )
