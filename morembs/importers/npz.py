"""NumPy archives: one matrix of ``scipy.sparse.save_npz``, or several arrays by name."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.budget import available_bytes
from morembs.errors import InputError
from morembs.importers.hdf5_sparse import checked_csr
from morembs.importers.imported import Imported
from morembs.importers.named import Matrices, matrices_by_name

Array = NDArray[Any]
_DAMAGED = (
    OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, EOFError, RuntimeError, MemoryError,
    NotImplementedError, zipfile.BadZipFile, zlib.error, SyntaxError,
)  # fmt: skip
_PARTS = ("data", "indices", "indptr", "shape")
# Rows for each entry above which a shape must be wrong.
_SPARSEST = 1000


def import_npz(path: Path, *, K: str | None = None, M: str | None = None, D: str | None = None) -> Imported:
    """Matrices of an .npz file: that of ``save_npz``, dense square arrays, or arrays NAME_data, NAME_indices,
    NAME_indptr and NAME_shape (CSR) for each.

    Raises:
        InputError: not such a file, damaged, or no matrix of a name.
    """
    path = Path(path)
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as held:
            if not isinstance(held, np.lib.npyio.NpzFile):
                raise InputError(f"{path.name} holds one array without a name (.npy); expected an .npz archive")
            _refuse_too_large(path.name, held.zip)
            names = set(held.files)
            if "format" in names and "shape" in names:
                found: Matrices = {"the matrix": _saved(path.name, held)}
            else:
                found = _by_name(path.name, held, names)
    except InputError:
        raise
    except _DAMAGED as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{path.name} cannot be read as a NumPy archive ({reason}); save it again") from error
    return matrices_by_name(path.name, found, K=K, M=M, D=D)


def _refuse_too_large(source: str, archive: Any) -> None:
    """Packed zeros take no room in a file, and all of the memory when they are read."""
    size, free = sum(one.file_size for one in archive.infolist()), available_bytes()
    if free is not None and size > free:
        raise InputError(
            f"{source} holds arrays of {size:.3g} bytes; {free:.3g} bytes of memory are free; check the file, or give "
            "more memory"
        )


def _by_name(source: str, held: Mapping[str, Array], names: set[str]) -> Matrices:
    found: Matrices = {}
    for name in sorted(names):
        if name.endswith("_indptr") and all(f"{name[:-6]}{part}" in names for part in _PARTS):
            data, indices, indptr, shape = (held[f"{name[:-6]}{part}"] for part in _PARTS)
            found[name[:-7]] = checked_csr(f"{source}: {name[:-7]}", data, indices, indptr, _sizes(source, shape))
        elif held[name].ndim == 2 and held[name].shape[0] == held[name].shape[1] and held[name].dtype.kind in "fiuc":
            found[name] = sp.csr_array(held[name])
    return found


def _sizes(source: str, shape: Array) -> tuple[int, int]:
    """Rows and columns; SciPy trusts those of a file, and would use memory outside a matrix that is too small."""
    if shape.shape != (2,) or shape.dtype.kind not in "iu" or not (shape >= 0).all():
        raise InputError(f"{source} has the shape {shape.tolist()}; expected numbers of rows and columns")
    return int(shape[0]), int(shape[1])


def _saved(source: str, held: Mapping[str, Array]) -> sp.csr_array:
    """The matrix of ``scipy.sparse.save_npz`` in any of its formats."""
    kind = held["format"].item()
    kind = kind.decode("ascii", "replace") if isinstance(kind, bytes) else str(kind)
    shape, data = _sizes(source, held["shape"]), held["data"]
    if max(shape) > _SPARSEST * (1 + data.size):
        raise InputError(f"{source} has the shape {shape} but only {data.size} entries; it is damaged, save it again")
    if kind in ("csr", "csc"):
        turned = shape if kind == "csr" else (shape[1], shape[0])
        A = checked_csr(source, data, held["indices"], held["indptr"], turned)
        return A if kind == "csr" else sp.csr_array(A.T)
    if kind == "coo":
        return sp.csr_array(sp.coo_array((data, (held["row"], held["col"])), shape=shape))
    if kind == "dia":
        return sp.csr_array(sp.dia_array((data, held["offsets"]), shape=shape))
    if kind == "bsr":
        blocks = sp.bsr_array((data, held["indices"], held["indptr"]), shape=shape)
        blocks.check_format(full_check=True)
        return sp.csr_array(blocks)
    raise InputError(f"{source} is of the sparse format {kind[:20]!r}; expected csr, csc, coo, dia or bsr")
