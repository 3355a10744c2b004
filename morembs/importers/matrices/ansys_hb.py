"""Harwell-Boeing text (Duff, Grimes and Lewis 1992): assembled real matrices, as HBMAT of ANSYS writes them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.importers.matrices.text import integers, numbers, open_lines
from morembs.importers.matrices.triplets import assemble
from morembs.importers.tolerances import TOL

_FORMAT = re.compile(r"\(\s*(?:\d+P)?,?\s*(\d*)\s*([IEFGD])(\d+)(?:\.\d+)?(?:E\d+)?\s*\)")


@dataclass(frozen=True, kw_only=True)
class _Head:
    rows: int
    entries: int
    symmetric: bool
    # Lines and format of the pointers, the rows and the values.
    lines: tuple[int, int, int]
    formats: tuple[tuple[int, int], ...]


def read_harwell_boeing(path: Path) -> sp.csr_array:
    """Square matrix (N, N), whole where the file holds one triangle. A right-hand side is not read.

    Memory is that of the matrix, its entries and its text.

    Raises:
        InputError: not such a file, cut off, damaged, complex, a pattern, or not assembled.
    """
    with open_lines(path) as file:
        head = _header(file, path)
        names = ("pointers", "row numbers", "values")
        counts = (head.rows + 1, head.entries, head.entries)
        pointer, row, value = (
            _section(file, *each, path.name) for each in zip(names, head.lines, head.formats, counts, strict=True)
        )
    start = integers(pointer, "a pointer", path.name) - 1
    column_of = integers(row, "a row number", path.name) - 1
    if start[0] != 0 or start[-1] != head.entries or (np.diff(start) < 0).any():
        raise InputError(
            f"{path.name} has pointers that do not run from 1 to {head.entries + 1}; it is damaged",
            kind="file",
            keyword=path.name,
        )
    columns = np.repeat(np.arange(head.rows), np.diff(start))
    if head.symmetric and (column_of < columns).any() and (column_of > columns).any():
        raise InputError(
            f"{path.name} says that it is symmetric but has entries in both triangles; it is damaged",
            kind="file",
            keyword=path.name,
        )
    triplets = [(column_of, columns, value)]
    matrix = assemble(triplets, (head.rows, head.rows), mirror=head.symmetric, name=path.name)
    matrix.eliminate_zeros()
    return matrix


def _header(file: BinaryIO, path: Path) -> _Head:
    lines = [file.readline(TOL.longest_matrix_line_bytes).decode("latin-1") for _ in range(4)]
    expected = "expected Matrix Market (*EXPORT,,MMF) or Harwell-Boeing text (HBMAT with Form = ASCII)"
    cards, kind = lines[1].split(), lines[2].split()
    whole = [*cards, *kind[1:]]
    if not 4 <= len(cards) <= 5 or len(kind) not in (4, 5) or not all(w.isdigit() and len(w) < 16 for w in whole):
        raise InputError(f"{path.name} is not a matrix of a known format; {expected}")
    rows, columns, entries = (int(word) for word in kind[1:4])
    code = kind[0].upper()
    if code not in ("RSA", "RUA"):
        raise InputError(
            f"{path.name} is of the type {code!r}; expected RSA or RUA: real, symmetric or not, assembled. Complex "
            "matrices and patterns are not read",
            kind="unsupported",
        )
    counts = [int(word) for word in cards]
    with_right = len(counts) == 5 and counts[4] > 0
    if with_right:
        file.readline(TOL.longest_matrix_line_bytes)
    formats = [(int(count or 1), int(width)) for count, _, width in _FORMAT.findall(lines[3].upper())]
    max_numbers, widest = TOL.harwell_numbers, TOL.harwell_number_characters
    if len(formats) < 3 or any(not (0 < n < max_numbers and 0 < w < widest) for n, w in formats):
        raise InputError(f"{path.name} has the formats {lines[3].strip()[:60]!r}; expected three such as (1I14)")
    if rows != columns or rows < 1 or max(rows, entries) > path.stat().st_size:
        raise InputError(
            f"{path.name} announces {rows} x {columns} with {entries} entries, which it cannot hold; expected a square "
            "matrix, it may be cut off or damaged",
            kind="file",
            keyword=path.name,
        )
    return _Head(
        rows=rows,
        entries=entries,
        symmetric=code == "RSA",
        lines=(counts[1], counts[2], counts[3]),
        formats=tuple(formats[:3]),
    )


def _section(file: BinaryIO, what: str, lines: int, form: tuple[int, int], count: int, name: str) -> Floats:
    """``count`` numbers in ``lines`` lines of the format (numbers per line, width)."""
    per_line, width = form
    if -(-count // per_line) != lines:
        raise InputError(
            f"{name} announces {lines} lines of {what}; expected {-(-count // per_line)} for {count} numbers",
            kind="file",
        )
    text = []
    for _ in range(lines):
        line = file.readline(TOL.longest_matrix_line_bytes)
        if not line.endswith(b"\n"):
            raise InputError(f"{name} ends within its {what}; it is cut off, write it again", kind="file")
        # Numbers may touch each other, so fields are cut by their width.
        text.append(line if per_line == 1 else b" ".join(line[i : i + width] for i in range(0, len(line) - 1, width)))
    values = numbers(b"\n".join(text) + b"\n", name)
    if len(values) != count:
        raise InputError(f"{name} holds {len(values)} {what} where it announces {count}; it is damaged", kind="file")
    return values
