"""Nastran OUTPUT4 files: reduced matrices by name, text or binary."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.exporters.base import ExportContext, Exported, Exporter, in_two_digits
from morembs.exporters.read_back import ReadBack
from morembs.exporters.reduced import reduced_matrices, second_order
from morembs.importers.matrices.op4 import read_op4
from morembs.importers.matrices.op4_columns import Form, OP4Matrix, Packed
from morembs.storage.safefile import replacing

Storage = Literal["dense", "bigmat", "nonbigmat"]
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,7}")
_TYPES = {"f4": 1, "f8": 2, "c8": 3, "c16": 4}


class Text:
    """Numbers of text files (MSC Nastran DMAP Programmer's Guide, OUTPUT4): Fortran's 1P,3E23.16."""

    WIDTH = 23
    DECIMALS = 16
    PER_LINE = 3
    NUMBER = f"%{WIDTH}.{DECIMALS}E"


@checked
def write_op4(
    path: str | Path,
    matrices: Mapping[str, Any],
    *,
    binary: bool = True,
    sparse: Storage = "bigmat",
    byteorder: Literal["little", "big"] = "little",
    bits: Literal[32, 64] = 32,
) -> None:
    """Write matrices (arrays, sparse arrays or OP4Matrix, real or complex, single or double precision) by name.

    ``sparse`` is how columns are stored: "dense" (first to last entry), "bigmat" or "nonbigmat" (up to 65,535
    rows). ``bits`` is the size of integers in a binary file. Binary files keep every bit, text 17 digits.

    Raises:
        InputError: a name that Nastran cannot hold, or a matrix that the format cannot.
        OutputError: the file cannot be written.
    """
    layout = _RecordFormat(order="<" if byteorder == "little" else ">", word=bits // 8, storage=sparse)
    checked = [_Source.of(name, matrix, sparse) for name, matrix in matrices.items()]
    names = [source.name for source in checked]
    if len(set(names)) < len(names) or not names:
        raise InputError(
            f"names {', '.join(names) or '(none)'} were given; expected different names, at least one", keyword="names"
        )
    with replacing(Path(path)) as file:
        for source in checked:
            file.doing = f"matrix {source.name}"
            for piece in _binary(source, layout) if binary else _text(source, sparse):
                file.write(piece)


@dataclass(frozen=True, kw_only=True)
class _RecordFormat:
    order: str
    word: int
    storage: str

    def record(self, *parts: bytes) -> bytes:
        mark = np.array(sum(len(p) for p in parts), dtype=f"{self.order}i4").tobytes()
        return b"".join((mark, *parts, mark))

    def ints(self, *values: int) -> bytes:
        return np.array(values, dtype=f"{self.order}i{self.word}").tobytes()


@dataclass(frozen=True, kw_only=True, eq=False)
class _Source:
    """A matrix by columns: rows ascending, zeros left out."""

    name: str
    matrix: sp.csc_array
    form: int
    type: int

    @classmethod
    def of(cls, name: str, given: Any, storage: str) -> _Source:
        if not _NAME.fullmatch(name):
            raise InputError(
                f"the matrix name {name!r} does not fit OP4; expected a letter, then up to 7 letters, digits or _",
                keyword="name",
            )
        form = given.form if isinstance(given, OP4Matrix) else 0
        matrix = given.matrix if isinstance(given, OP4Matrix) else given
        if np.ndim(matrix) != 2 or 0 in matrix.shape:
            raise InputError(
                f"matrix {name!r} has the shape {np.shape(matrix)}; expected rows and columns", keyword=name
            )
        kind = np.result_type(matrix.dtype, np.float32) if matrix.dtype.kind in "fc" else np.dtype(np.float64)
        code = kind.str[1:]
        if code not in _TYPES:
            raise InputError(
                f"matrix {name!r} has entries of type {matrix.dtype}; expected real or complex numbers", keyword=name
            )
        columns = sp.csc_array(matrix, dtype=kind, copy=True)
        columns.sum_duplicates()
        columns.eliminate_zeros()
        if not np.isfinite(columns.data).all():
            raise InputError(
                f"matrix {name!r} holds NaN or infinite entries; OP4 files cannot be read with these", keyword=name
            )
        if storage == "nonbigmat" and columns.shape[0] >= Packed.ROWS:
            raise InputError(
                f'matrix {name!r} has {columns.shape[0]} rows; nonbigmat holds 65535, take "bigmat"',
                kind="unsupported",
                keyword="layout",
            )
        if not form:
            form = Form.RECTANGULAR if columns.shape[0] != columns.shape[1] else Form.SQUARE
            if form == Form.SQUARE and not (columns != columns.T).nnz:
                form = Form.SYMMETRIC
        return cls(name=name.upper(), matrix=columns, form=form, type=_TYPES[code])

    @property
    def signed_rows(self) -> tuple[int, int]:
        """Number of rows, and the same with the sign that marks bigmat."""
        rows = self.matrix.shape[0]
        return rows, -rows

    def columns(self, storage: str) -> Iterator[tuple[int, list[tuple[int, NDArray[Any]]]]]:
        """For each column that is not zero its number and its strings (first row from 0, values)."""
        A = self.matrix
        for j in range(A.shape[1]):
            part = slice(A.indptr[j], A.indptr[j + 1])
            rows, values = A.indices[part], A.data[part]
            if not len(rows):
                continue
            if storage == "dense":
                whole = np.zeros(int(rows[-1]) - int(rows[0]) + 1, dtype=values.dtype)
                whole[rows - rows[0]] = values
                yield j, [(int(rows[0]), whole)]
                continue
            longest = Packed.MOST_WORDS * 4 // values.dtype.itemsize if storage == "nonbigmat" else len(rows)
            cuts = np.flatnonzero(np.diff(rows) != 1) + 1
            strings = []
            for run in np.split(np.arange(len(rows)), cuts):
                for at in range(0, len(run), longest):
                    piece = run[at : at + longest]
                    strings.append((int(rows[piece[0]]), values[piece]))
            yield j, strings


def _binary(source: _Source, layout: _RecordFormat) -> Iterator[bytes]:
    rows, negative = source.signed_rows
    columns = source.matrix.shape[1]
    name = source.name.ljust(8).encode()
    if layout.word == 8:
        # Each half of the name takes the first half of a word.
        name = name[:4] + b"    " + name[4:] + b"    "
    marked = negative if layout.storage == "bigmat" else rows
    yield layout.record(layout.ints(columns, marked, source.form, source.type), name)
    double = layout.word == 8 or source.type in (2, 4)
    kind = np.dtype(f"{layout.order}{'c' if source.type > 2 else 'f'}{(8 if double else 4) << int(source.type > 2)}")
    size = kind.itemsize // layout.word
    for j, strings in source.columns(layout.storage):
        body = BytesIO()
        for row, values in strings:
            words = len(values) * size
            if layout.storage == "bigmat":
                body.write(layout.ints(words + 1, row + 1))
            elif layout.storage == "nonbigmat":
                body.write(layout.ints(row + 1 + Packed.ROWS * (words + 1)))
            body.write(values.astype(kind).tobytes())
        first = strings[0][0] + 1 if layout.storage == "dense" else 0
        yield layout.record(layout.ints(j + 1, first, body.tell() // layout.word), body.getvalue())
    unit = np.ones(1, dtype=kind).tobytes()
    yield layout.record(layout.ints(columns + 1, 1, size), unit)


def _text(source: _Source, storage: str) -> Iterator[bytes]:
    rows, negative = source.signed_rows
    columns = source.matrix.shape[1]
    if max(rows, columns) >= 10**7:
        raise InputError(f"matrix {source.name!r} is too large for text ({rows} by {columns}); write a binary file")
    marked = negative if storage == "bigmat" else rows
    style = f"1P,{Text.PER_LINE}E{Text.WIDTH}.{Text.DECIMALS}"
    yield f"{columns:8}{marked:8}{source.form:8}{source.type:8}{source.name:<8}{style}\n".encode()
    per = (2 if source.type > 2 else 1) * (2 if source.type in (2, 4) else 1)
    for j, strings in source.columns(storage):
        lines: list[str] = []
        words = 0
        for row, values in strings:
            if storage == "bigmat":
                lines.append(f"{len(values) * per + 1:8}{row + 1:8}\n")
                words += len(values) * per + 2
            elif storage == "nonbigmat":
                lines.append(f"{row + 1 + Packed.ROWS * (len(values) * per + 1):12}\n")
                words += len(values) * per + 1
            lines.append(_numbers(source.name, values))
        if storage == "dense":
            words = len(strings[0][1]) * (2 if source.type > 2 else 1)
        first = strings[0][0] + 1 if storage == "dense" else 0
        yield (f"{j + 1:8}{first:8}{words:8}\n" + "".join(lines)).encode()
    yield f"{columns + 1:8}{1:8}{1:8}\n{Text.NUMBER % 1.0}\n".encode()


def _numbers(name: str, values: NDArray[Any]) -> str:
    flat = values.view(values.real.dtype).astype(float)
    fields = [Text.NUMBER % value for value in in_two_digits(f"matrix {name!r}", flat, "OP4 text").tolist()]
    return "".join("".join(fields[i : i + Text.PER_LINE]) + "\n" for i in range(0, len(fields), Text.PER_LINE))


@dataclass(frozen=True, kw_only=True)
class OP4Exporter(Exporter):
    """Reduced matrices M, K, D, B (and C where it is not B') in a Nastran OP4 file.

    ``text`` writes numbers as text; ``storage`` is "dense", "bigmat" or "nonbigmat". OP4 has no labels: the order
    of coordinates is that of the body file.
    """

    name: ClassVar[str] = "op4"
    suffix: ClassVar[str] = ".op4"
    about: ClassVar[str] = "Nastran OP4: reduced matrices M, K, D, B"
    takes_massless: ClassVar[bool] = True
    needs_frame: ClassVar[bool] = False
    holds: ClassVar[frozenset[str]] = frozenset({"damping", "forces"})

    text: bool = False
    storage: Storage = "dense"

    def _write(self, context: ExportContext) -> Exported:
        write_op4(context.path, reduced_matrices(context.body), binary=not self.text, sparse=self.storage)
        return Exported(paths=(context.path,))

    def _read_back(self, context: ExportContext, files: Mapping[Path, Path]) -> ReadBack:
        found = second_order({key: each.matrix for key, each in read_op4(files[context.path]).items()})
        return ReadBack(found=found, expected=second_order(reduced_matrices(context.body)), digits=Text.DECIMALS + 1)
