"""Matrix Market files (.mtx, .mtx.gz): one matrix each (Boisvert, Pozo and Remington, NISTIR 5935, 1996)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Values
from morembs.importers.imported import Imported
from morembs.importers.matrices.named import WantedMatrices, square_csr
from morembs.importers.matrices.text import integers, numbers, parallel_map, table, text_blocks
from morembs.importers.matrices.triplets import TripletStore, assemble, refuse_outside
from morembs.importers.tolerances import TOL

Matrix = TypeVar("Matrix", sp.csr_array, Values)
BANNER = b"%%matrixmarket"
_FIELDS = ("real", "double", "integer", "unsigned-integer", "complex")
_SYMMETRIES = ("general", "symmetric", "skew-symmetric", "hermitian")


@dataclass(frozen=True, kw_only=True)
class _Head:
    """First lines of a file; ``size`` rows, columns and (sparse) entries."""

    sparse: bool
    complex: bool
    symmetry: str
    size: tuple[int, ...]

    @property
    def half(self) -> bool:
        return self.symmetry != "general"

    @property
    def shape(self) -> tuple[int, int]:
        return self.size[0], self.size[1]


def import_matrix_market(
    path: Path, *, B: str | None = None, C: str | None = None, B_names: str | None = None, C_names: str | None = None
) -> Imported:
    """The matrix of the file, as K: sparse or dense, real or complex, general, symmetric, skew or Hermitian.

    ``B`` and ``C`` are further files in its folder, inputs and outputs.

    Memory is that of the matrix (CSR) and blocks of text.

    Raises:
        InputError: as ``read_matrix_market``, or a matrix that is not square.
    """
    path = Path(path)
    K = square_csr(path.name, "the matrix", read_matrix_market(path))
    wanted = WantedMatrices(B=B, C=C, B_names=B_names, C_names=C_names)
    return wanted.with_columns(Imported(source=path.name, K=K), lambda name: read_matrix_market(path.parent / name))


def read_matrix_market(path: Path, *, plain: bool = False) -> sp.csr_array | Values:
    """The whole matrix of a file: sparse where the file lists entries, dense where it is an array.

    ``plain`` refuses complex, skew and Hermitian ones.

    Raises:
        InputError: not such a file, cut off, damaged, or a pattern without values.
    """
    blocks = text_blocks(path)
    head, first = _head(next(blocks, b""), path.name, plain)
    rest = (block for part in ((first,), blocks) for block in part)
    return _coordinate(rest, head, path.name) if head.sparse else _array(rest, head, path.name)


def _unreadable(name: str, why: str) -> InputError:
    return InputError(f"{name} cannot be read as a Matrix Market file ({why}); write it again", kind="file")


def _head(block: bytes, name: str, plain: bool) -> tuple[_Head, bytes]:
    """Header of the first lines, and the remainder of the block."""
    lines = block.splitlines(keepends=True)
    words = lines[0].decode("latin-1").lower().split() if lines else []
    if not words or words[0] != BANNER.decode():
        raise InputError(f"{name} does not begin with %%MatrixMarket; expected a Matrix Market file", kind="file")
    at = next((i for i, line in enumerate(lines) if i and line.strip() and not line.startswith(b"%")), None)
    if len(words) != 5 or words[1] != "matrix" or words[2] not in ("coordinate", "array"):
        raise InputError(
            f"{name} starts with {' '.join(words)[:60]!r}; expected '%%MatrixMarket matrix coordinate real ...'",
            kind="file",
            keyword=name,
        )
    _, _, layout, field, symmetry = words
    if field == "pattern":
        raise InputError(f"{name} holds a pattern without values; expected real or complex values")
    fields, symmetries = (_FIELDS[:-1], _SYMMETRIES[:2]) if plain else (_FIELDS, _SYMMETRIES)
    if field not in fields or symmetry not in symmetries or (symmetry == "hermitian" and field != "complex"):
        raise InputError(
            f"{name} is {field[:20]} {symmetry[:20]}, which is not read; expected {fields[0]} to {fields[-1]}, "
            f"{', '.join(symmetries)}",
            kind="unsupported",
        )
    size = lines[at].split() if at is not None else []
    if at is None or len(size) != 2 + (layout == "coordinate") or not all(w.isdigit() and len(w) < 16 for w in size):
        raise _unreadable(name, "it has no line with its size")
    rows, columns, *entries = map(int, size)
    if (symmetry != "general" and rows != columns) or max(rows, columns) >= 2**31:
        raise _unreadable(name, f"it announces a {symmetry} matrix of the shape ({rows}, {columns}), which cannot be")
    if entries and rows > TOL.rows_per_entry * (1 + entries[0]):
        raise _unreadable(name, f"it announces {rows} rows but only {entries[0]} entries")
    head = _Head(
        sparse=layout == "coordinate", complex=field == "complex", symmetry=symmetry, size=(rows, columns, *entries)
    )
    return head, b"".join(lines[at + 1 :])


def _coordinate(blocks: Iterator[bytes], head: _Head, name: str) -> sp.csr_array:
    """Lines "row column value", counted from 1; of a symmetric matrix one triangle."""
    count, above, below = 0, False, False
    with ExitStack() as stack:
        stores = [stack.enter_context(TripletStore(name)) for _ in range(1 + head.complex)]
        for entries in parallel_map(lambda block: table(block, 2 + len(stores), name), blocks):
            row, column = integers(entries[:, :2], "a row or column number", name).T - 1
            count += len(entries)
            above, below = above or bool((row < column).any()), below or bool((row > column).any())
            refuse_outside(row, column, head.shape, name)
            for store, values in zip(stores, entries.T[2:], strict=True):
                store.add(row, column, values)
        if count != head.size[2]:
            raise _unreadable(name, f"it announces {head.size[2]} entries and holds {count}")
        if head.half and above and below:
            raise _unreadable(name, f"it says that it is {head.symmetry} but has entries in both triangles")
        parts = [assemble(store, head.shape, mirror=_even(head, part), name=name) for part, store in enumerate(stores)]
    parts = [_complete(A, head, part, name) for part, A in enumerate(parts)]
    return parts[0] if len(parts) == 1 else sp.csr_array(parts[0] + 1j * parts[1])


def _array(blocks: Iterator[bytes], head: _Head, name: str) -> Values:
    """All entries column by column; of a symmetric matrix the lower triangle, of a skew one that below the diagonal."""
    (size, columns), parts = head.shape, 1 + head.complex
    values = np.concatenate([np.empty(0), *(numbers(block, name) for block in blocks)])
    below = head.symmetry == "skew-symmetric"
    expected = (size * (size - 1) // 2 if below else size * (size + 1) // 2) if head.half else size * columns
    if len(values) != expected * parts:
        raise _unreadable(name, f"it announces {expected * parts} numbers and holds {len(values)}")
    result: Values = np.zeros(head.shape)
    for part in range(parts):
        A = values[part::parts]
        if head.half:
            whole = np.zeros(head.shape)
            whole.T[np.triu_indices(size, int(below))] = A
            A = _complete(whole + np.tril(whole, -1).T if _even(head, part) else whole, head, part, name)
        result = result + (1j if part else 1.0) * A.reshape(head.shape, order="F")
    return result


def _even(head: _Head, part: int) -> bool:
    """True if the other triangle is that of the file; it is its negative in the imaginary part of a Hermitian one."""
    return head.symmetry == "symmetric" or (head.symmetry == "hermitian" and part == 0)


def _complete(A: Matrix, head: _Head, part: int, name: str) -> Matrix:
    """The whole of what is its negative when turned over; an even part is whole already."""
    if not head.half or _even(head, part):
        return A
    if A.diagonal().any():
        raise _unreadable(name, f"it says that it is {head.symmetry}, which its diagonal is not")
    return A - A.T
