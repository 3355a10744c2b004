"""Matrix Market files (.mtx, .mtx.gz): one matrix each (Boisvert, Pozo and Remington, NISTIR 5935, 1996)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.importers.imported import Imported
from morembs.importers.named import square_csr
from morembs.importers.text_matrices import ahead, integers, numbers, table, text_blocks
from morembs.importers.triplets import Spool, assembled

Floats = NDArray[np.float64]
BANNER = b"%%matrixmarket"
_FIELDS = ("real", "double", "integer", "unsigned-integer", "complex")
_SYMMETRIES = ("general", "symmetric", "skew-symmetric", "hermitian")
# Rows for each entry above which the size must be wrong.
_SPARSEST = 1000


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


def import_matrix_market(path: Path) -> Imported:
    """The matrix of the file, as K: sparse or dense, real or complex, general, symmetric, skew or Hermitian.

    Memory is that of the matrix (CSR) and blocks of text.

    Raises:
        InputError: not such a file, cut off, damaged, a pattern without values, or a matrix that is not square.
    """
    path = Path(path)
    blocks = text_blocks(path)
    head, first = _head(next(blocks, b""), path.name)
    rest = (block for part in ((first,), blocks) for block in part)
    matrix = _coordinate(rest, head, path.name) if head.sparse else _array(rest, head, path.name)
    return Imported(source=path.name, K=square_csr(path.name, "the matrix", matrix))


def _unreadable(name: str, why: str) -> InputError:
    return InputError(f"{name} cannot be read as a Matrix Market file ({why}); write it again")


def _head(block: bytes, name: str) -> tuple[_Head, bytes]:
    """What the first lines say, and the rest of the block."""
    lines = block.splitlines(keepends=True)
    words = lines[0].decode("latin-1").lower().split() if lines else []
    if not words or words[0] != BANNER.decode():
        raise InputError(f"{name} does not begin with %%MatrixMarket; expected a Matrix Market file")
    at = next((i for i, line in enumerate(lines) if i and line.strip() and not line.startswith(b"%")), None)
    if len(words) != 5 or words[1] != "matrix" or words[2] not in ("coordinate", "array"):
        raise _unreadable(name, f"its first line is {' '.join(words)[:60]!r}")
    if words[3] == "pattern":
        raise InputError(f"{name} holds a pattern without values; expected real or complex values")
    if words[3] not in _FIELDS or words[4] not in _SYMMETRIES or (words[4] == "hermitian" and words[3] != "complex"):
        raise _unreadable(name, f"it is {words[3][:20]} {words[4][:20]}")
    sparse = words[2] == "coordinate"
    size = lines[at].split() if at is not None else []
    if at is None or len(size) != 2 + sparse or not all(word.isdigit() and len(word) < 16 for word in size):
        raise _unreadable(name, "it has no line with its size")
    rows, columns, *entries = map(int, size)
    if rows != columns:
        raise InputError(f"{name}: the matrix has the shape ({rows}, {columns}); expected a square matrix")
    if sparse and rows > _SPARSEST * (1 + entries[0]):
        raise _unreadable(name, f"it announces {rows} rows but only {entries[0]} entries")
    head = _Head(sparse=sparse, complex=words[3] == "complex", symmetry=words[4], size=(rows, columns, *entries))
    return head, b"".join(lines[at + 1 :])


def _coordinate(blocks: Iterator[bytes], head: _Head, name: str) -> sp.csr_array:
    """Lines "row column value", counted from 1; of a symmetric matrix one triangle."""
    size, count = head.size[0], 0
    above = below = False
    with ExitStack() as stack:
        spools = [stack.enter_context(Spool(name)) for _ in range(1 + head.complex)]
        for entries in ahead(lambda block: table(block, 2 + len(spools), name), blocks):
            at = integers(entries[:, :2], "a row or column number", name) - 1
            count += len(entries)
            above, below = above or bool((at[:, 0] < at[:, 1]).any()), below or bool((at[:, 0] > at[:, 1]).any())
            if len(at) and not (at.min() >= 0 and at.max() < size):
                bad = int(at[(at < 0) | (at >= size)][0]) + 1
                raise _unreadable(name, f"an entry is in row or column {bad} of {size}")
            for spool, values in zip(spools, entries.T[2:], strict=True):
                spool.add(at[:, 0], at[:, 1], values)
        if count != head.size[2]:
            raise _unreadable(name, f"it announces {head.size[2]} entries and holds {count}")
        if head.half and above and below:
            raise _unreadable(name, f"it says that it is {head.symmetry} but has entries in both triangles")
        parts = [
            assembled(spool, (size, size), mirror=_even(head, part), name=name) for part, spool in enumerate(spools)
        ]
    return _joined([_completed(A, head, part, name) for part, A in enumerate(parts)])


def _array(blocks: Iterator[bytes], head: _Head, name: str) -> sp.csr_array:
    """All entries column by column; of a symmetric matrix the lower triangle, of a skew one that below the diagonal."""
    size, parts = head.size[0], 1 + head.complex
    values = np.concatenate([np.empty(0), *(numbers(block, name) for block in blocks)])
    below = head.symmetry == "skew-symmetric"
    expected = (size * (size - 1) // 2 if below else size * (size + 1) // 2) if head.half else size**2
    if len(values) != expected * parts:
        raise _unreadable(name, f"it announces {expected * parts} numbers and holds {len(values)}")
    found = []
    for part in range(parts):
        A = np.zeros((size, size))
        if head.half:
            columns, rows = np.triu_indices(size, int(below))
            A[rows, columns] = values[part::parts]
            if _even(head, part):
                A += np.tril(A, -1).T
        else:
            A[...] = values[part::parts].reshape(size, size, order="F")
        found.append(_completed(sp.csr_array(A), head, part, name))
    return _joined(found)


def _even(head: _Head, part: int) -> bool:
    """Whether the other triangle is that of the file; it is its negative in the imaginary part of a Hermitian one."""
    return head.symmetry == "symmetric" or (head.symmetry == "hermitian" and part == 0)


def _completed(A: sp.csr_array, head: _Head, part: int, name: str) -> sp.csr_array:
    """The whole of what is its negative when turned over; an even part is whole already."""
    if not head.half or _even(head, part):
        return A
    if A.diagonal().any():
        raise _unreadable(name, f"it says that it is {head.symmetry}, which its diagonal is not")
    return sp.csr_array(A - A.T)


def _joined(parts: list[sp.csr_array]) -> sp.csr_array:
    return parts[0] if len(parts) == 1 else sp.csr_array(parts[0] + 1j * parts[1])
