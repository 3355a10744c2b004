"""NumPy archives: one matrix of ``scipy.sparse.save_npz``, or several arrays by name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError, MorembsError
from morembs.base.types import Values
from morembs.importers.imported import Imported
from morembs.importers.matrices.hdf5 import checked_csc, checked_csr
from morembs.importers.matrices.named import Matrices, WantedMatrices, matrices_by_name
from morembs.importers.tolerances import TOL
from morembs.storage.archive import refuse_unsafe_archive

_PARTS = ("data", "indices", "indptr", "shape")


def import_npz(
    path: Path,
    *,
    K: str | None = None,
    M: str | None = None,
    D: str | None = None,
    G: str | None = None,
    N: str | None = None,
    B: str | None = None,
    C: str | None = None,
    B_names: str | None = None,
    C_names: str | None = None,
) -> Imported:
    """Matrices of an .npz file: that of ``save_npz``, dense arrays, or arrays NAME_data, NAME_indices, NAME_indptr and
    NAME_shape (CSR) for each. B and C are inputs and outputs.

    Raises:
        InputError: not such a file, damaged, or no matrix of a name.
    """
    path, wanted = Path(path), WantedMatrices(K=K, M=M, D=D, G=G, N=N, B=B, C=C, B_names=B_names, C_names=C_names)
    notes: tuple[str, ...] = ()
    other: Matrices = {}
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as held:
            if not isinstance(held, np.lib.npyio.NpzFile):
                raise InputError(f"{path.name} holds one array without a name (.npy); expected an .npz archive")
            refuse_unsafe_archive(path.name, held.zip)
            names = set(held.files)
            if "format" in names and "shape" in names:
                matrix, notes = _read_saved(path.name, held)
                matrices: Matrices = {"the matrix": matrix}
            else:
                matrices, other = _by_name(path.name, held, names)
    except MorembsError:
        raise
    except Exception as error:  # zipfile, zlib and numpy's own reader of headers raise many kinds
        reason = " ".join(str(error).split())[: TOL.shown_reason] or type(error).__name__
        raise InputError(
            f"{path.name} cannot be read as a NumPy archive ({reason}); save it again", kind="file", keyword=path.name
        ) from error
    return matrices_by_name(path.name, matrices, wanted, notes=notes, besides=other)


def _by_name(source: str, held: Mapping[str, Values], names: set[str]) -> tuple[Matrices, Matrices]:
    """Matrices that may be K, M or D, and dense ones that are not square; B and C may be vectors."""
    matrices: Matrices = {}
    other: Matrices = {}
    for name in sorted(names):
        if name.endswith("_indptr") and all(f"{name[:-6]}{part}" in names for part in _PARTS):
            data, indices, indptr, shape = (held[f"{name[:-6]}{part}"] for part in _PARTS)
            matrices[name[:-7]] = checked_csr(f"{source}: {name[:-7]}", data, indices, indptr, _sizes(source, shape))
        elif (array := held[name]).ndim == 2 and array.dtype.kind in "fiuc":
            (matrices if array.shape[0] == array.shape[1] else other)[name] = sp.csr_array(array)
        elif array.ndim == 1 and array.dtype.kind in "fiuc" and name.upper() in ("B", "C"):
            other[name] = sp.csr_array(array[:, None] if name.upper() == "B" else array[None, :])
    return matrices, other


def _sizes(source: str, shape: Values) -> tuple[int, int]:
    """Rows and columns; SciPy trusts those of a file, and would use memory outside a matrix that is too small."""
    if shape.shape != (2,) or shape.dtype.kind not in "iu" or not (shape >= 0).all():
        raise InputError(f"{source} has the shape {shape.tolist()}; expected numbers of rows and columns")
    return int(shape[0]), int(shape[1])


def _read_saved(source: str, held: Mapping[str, Values]) -> tuple[sp.csr_array, tuple[str, ...]]:
    """The matrix of ``scipy.sparse.save_npz`` in any of its formats, and what to say of it."""
    kind = held["format"].item()
    kind = kind.decode("ascii", "replace") if isinstance(kind, bytes) else str(kind)
    shape, data = _sizes(source, held["shape"]), held["data"]
    if max(shape) > TOL.rows_per_entry * (1 + data.size):
        raise InputError(
            f"{source} has the shape {shape} but only {data.size} entries; it is damaged, save it again", kind="file"
        )
    if kind in ("csr", "csc"):
        checked = checked_csr if kind == "csr" else checked_csc
        return checked(source, data, held["indices"], held["indptr"], shape), ()
    if kind == "coo":
        return _read_triplets(source, sp.coo_array((data, (held["row"], held["col"])), shape=shape))
    if kind == "dia":
        return sp.csr_array(sp.dia_array((data, held["offsets"]), shape=shape)), ()
    if kind == "bsr":
        blocks = sp.bsr_array((data, held["indices"], held["indptr"]), shape=shape)
        blocks.check_format(full_check=True)
        return sp.csr_array(blocks), ()
    raise InputError(f"{source} is of the sparse format {kind[:20]!r}; expected csr, csc, coo, dia or bsr")


def _read_triplets(source: str, triplets: sp.coo_array) -> tuple[sp.csr_array, tuple[str, ...]]:
    """The sum of triplets, which is what SciPy means by them, as those of element matrices.

    Raises:
        InputError: all of them are there twice, which no assembly gives.
    """
    row, column = triplets.coords
    order = np.lexsort((np.abs(triplets.data), column, row))
    row, column, value = row[order], column[order], triplets.data[order]
    first = np.concatenate([[True], (np.diff(row) != 0) | (np.diff(column) != 0)])[: len(row)]
    more = int((~first).sum())
    if not more:
        return sp.csr_array(triplets), ()
    place = np.cumsum(first) - 1
    same = value == value[np.flatnonzero(first)][place]
    if same.all() and np.bincount(place).min() > 1:
        raise InputError(
            f"{source} gives every entry {np.bincount(place).min()} times with the same value, the first in row "
            f"{row[0] + 1}, column {column[0] + 1} ({value[0]:.6g}); it was appended to itself, save it again",
            kind="file",
        )
    return sp.csr_array(triplets), (f"{more} triplets at places of others were added to them, as COO matrices are",)
