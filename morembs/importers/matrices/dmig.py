"""Nastran DMIG entries of bulk data: matrices by name, with grid and component of each row and column.

Grammar: MSC Nastran Quick Reference Guide, DMIG; small field (8 characters), large field (16) and free field.
A file may hold other cards, which are passed over, and include files.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.importers.matrices.dmig_cards import Column, columns_of
from morembs.importers.matrices.triplets import Numbering, Renumbered, TripletStore, assemble, complete
from morembs.importers.nastran.cards import Cards
from morembs.importers.nastran.text import BulkText
from morembs.importers.tolerances import TOL


class Form(IntEnum):
    """Forms of a matrix (MSC Nastran Quick Reference Guide, DMIG); columns are labelled, or numbered."""

    SQUARE = 1
    RECTANGULAR = 2
    SYMMETRIC = 6
    NUMBERED_COLUMNS = 9


class GridRow:
    """A row (the same guide) as one integer: grid * ``COMPONENTS`` + component, 1 to 6, or that of scalar points."""

    COMPONENTS = 8
    SCALAR_POINT = 0


_RECTANGULAR = (Form.RECTANGULAR, Form.NUMBERED_COLUMNS)


@dataclass(frozen=True, kw_only=True, eq=False)
class DmigMatrix:
    """A matrix, real or complex, and (grid, component) of its ``rows`` (N, 2) and ``columns`` (k, 2), ascending.

    Component 0 is a scalar point. Columns of the forms 2 and 9 that Nastran counts are (number, 0) for 9. ``form``
    1 square, 2 or 9 rectangular, 6 symmetric, whose both triangles are filled. ``type`` as in ``OP4Matrix``.
    """

    matrix: sp.csr_array
    rows: Ints
    columns: Ints
    form: int
    type: int = 2


@dataclass
class _Named:
    """What is known of one matrix while the file is read."""

    header: tuple[int, int, bool, int]
    real: TripletStore
    imaginary: TripletStore
    entries: int = 0
    labels: list[Ints] = field(default_factory=list)


def read_dmig(path: str | Path | BulkText) -> dict[str, DmigMatrix]:
    """DMIG matrices of a file (or its text) by name, in its order.

    Memory is that of the matrices (CSR) and blocks of text.

    Raises:
        InputError: no bulk data, no DMIG entries, or entries that are cut off, given twice, or contradict their header.
    """
    text = path if isinstance(path, BulkText) else BulkText(Path(path))
    with ExitStack() as stack:
        named: dict[str, _Named] = {}
        for piece in text:
            for column in columns_of(Cards(piece, text)):
                _take(piece.file, named, column, stack)
        if not named:
            raise InputError(
                f"{text.file} has no DMIG entries; expected Nastran bulk data with DMIG", kind="missing", keyword="DMIG"
            )
        return {name: _matrix(text.file, name, matrix) for name, matrix in named.items()}


def _take(file: str, named: dict[str, _Named], column: Column, stack: ExitStack) -> None:
    if column.header is not None:
        if column.name in named:
            raise InputError(f"{file} has two headers of the DMIG {column.name}; expected one")
        stores = [stack.enter_context(TripletStore(file)) for _ in range(2)]
        named[column.name] = _Named(_header(file, column), stores[0], stores[1])
        return
    if column.name not in named:
        raise InputError(
            f"{file}: entries of the DMIG {column.name} come before its header (DMIG,{column.name},0,...)",
            kind="file",
            keyword="DMIG",
        )
    matrix = named[column.name]
    form, kind, polar, _ = matrix.header
    a, b = column.a, column.b
    if kind < 3 and b.any():
        raise InputError(
            f"{file}: the DMIG {column.name} is real (type {kind}) but has imaginary parts; check it",
            kind="file",
            keyword="DMIG",
        )
    if polar:
        a, b = a * np.cos(np.deg2rad(b)), a * np.sin(np.deg2rad(b))
    rows = column.grid * GridRow.COMPONENTS + column.component
    numbered = form == Form.NUMBERED_COLUMNS
    columns = column.column_grid * GridRow.COMPONENTS + (0 if numbered else column.column_component)
    matrix.entries += len(rows)
    matrix.labels.append(np.unique(np.concatenate([rows, columns]) if form not in _RECTANGULAR else rows))
    matrix.real.add(rows, columns, a)
    if b.any():
        matrix.imaginary.add(rows, columns, b)


def _header(file: str, column: Column) -> tuple[int, int, bool, int]:
    """Form, type, whether polar, and number of columns."""
    fields = [*(column.header or []), "", "", "", "", "", "", "", ""][2:8]
    try:
        form, kind, _, polar = (int(f or "0") for f in fields[:4])
        count = int(fields[5] or "0")
    except ValueError:
        raise InputError(
            f"{file}: the header of the DMIG {column.name} has fields {fields}; give numbers",
            kind="file",
            keyword="DMIG",
        ) from None
    if form not in tuple(Form) or kind not in (1, 2, 3, 4):
        raise InputError(
            f"{file}: the DMIG {column.name} has form {form} and type {kind}; expected form 1, 2, 6 or 9, type 1 to 4",
            kind="unsupported",
            keyword="DMIG",
        )
    return form, kind, polar == 1, count


def _matrix(file: str, name: str, read: _Named) -> DmigMatrix:
    form, kind, _, count = read.header
    codes = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *read.labels]))
    if not len(codes):
        raise InputError(
            f"{file}: the DMIG {name} has a header but no entries; it is cut off", kind="file", keyword="DMIG"
        )
    rows = Numbering(codes)
    columns = rows
    if form in _RECTANGULAR:
        columns = Numbering(_column_codes(file, name, read, form, count))
    parts = []
    for store in (read.real, read.imaginary):
        placed = Renumbered(triplets=store, rows=rows, columns=columns)
        parts.append(_assemble(file, name, placed, (len(rows), len(columns)), form))
    matrix = sp.csr_array(parts[0] + 1j * parts[1]) if kind > 2 else parts[0]
    labels = [np.stack([c.codes // GridRow.COMPONENTS, c.codes % GridRow.COMPONENTS], axis=1) for c in (rows, columns)]
    return DmigMatrix(matrix=matrix, rows=labels[0], columns=labels[1], form=form, type=kind)


def _column_codes(file: str, name: str, read: _Named, form: int, count: int) -> Ints:
    parts = [np.unique(columns) for store in (read.real, read.imaginary) for _, columns, _ in store]
    codes = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *parts]))
    if form == Form.NUMBERED_COLUMNS:
        largest = int(codes.max(initial=0)) // GridRow.COMPONENTS
        if largest > count or count > TOL.max_dmig_columns or (len(codes) and codes.min() < GridRow.COMPONENTS):
            raise InputError(
                f"{file}: the DMIG {name} has column {largest}, but its header says {count} columns",
                kind="file",
                keyword="DMIG",
            )
        return np.arange(1, count + 1) * GridRow.COMPONENTS
    return codes


def _assemble(file: str, name: str, placed: Renumbered, shape: tuple[int, int], form: int) -> sp.csr_array:
    def place(row: int, column: int) -> str:
        (a, b), (c, d) = (
            divmod(int(codes[at]), GridRow.COMPONENTS)
            for codes, at in ((placed.rows.codes, row), (placed.columns.codes, column))
        )
        return f"the row of grid {a}, component {b}, the column of grid {c}, component {d}"

    name = f"{file}: the DMIG {name}"
    if form == Form.SYMMETRIC:
        half, matrix = complete(placed, shape[0], name, place)
        if not half and (matrix != matrix.T).nnz:
            raise InputError(
                f"{name} is symmetric (form 6) but has differing entries in both triangles; give one, or form 1",
                kind="file",
                keyword="DMIG",
            )
        return matrix
    return assemble(placed, shape, mirror=False, name=name, place=place)
