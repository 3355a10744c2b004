"""NumPy archives: one matrix of ``scipy.sparse.save_npz``, or several arrays by name."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from morembs.errors import InputError
from morembs.imported import Imported
from morembs.importers.hdf5_sparse import checked_csr
from morembs.importers.named import Matrices, matrices_by_name

_DAMAGED = (
    OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, EOFError, zipfile.BadZipFile
)  # fmt: skip
_PARTS = ("data", "indices", "indptr", "shape")


def import_npz(path: Path, *, K: str | None = None, M: str | None = None, D: str | None = None) -> Imported:
    """Matrices of an .npz file: that of ``save_npz``, dense square arrays, or arrays NAME_data, NAME_indices,
    NAME_indptr and NAME_shape (CSR) for each.

    Raises:
        InputError: not such a file, damaged, or no matrix of a name.
    """
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as held:
            names = set(held.files)
            if "format" in names and "shape" in names:
                return matrices_by_name(path.name, {"the matrix": sp.csr_array(sp.load_npz(path))}, K=K, M=M, D=D)
            found: Matrices = {}
            for name in sorted(names):
                if name.endswith("_indptr") and all(f"{name[:-6]}{part}" in names for part in _PARTS):
                    data, indices, indptr, shape = (held[f"{name[:-6]}{part}"] for part in _PARTS)
                    sizes = (int(shape[0]), int(shape[1]))
                    found[name[:-7]] = checked_csr(f"{path.name}: {name[:-7]}", data, indices, indptr, sizes)
                elif held[name].ndim == 2 and held[name].shape[0] == held[name].shape[1]:
                    found[name] = sp.csr_array(held[name])
    except InputError:
        raise
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        IndexError,
        EOFError,
        zipfile.BadZipFile,
    ) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{path.name} cannot be read as a NumPy archive ({reason}); save it again") from error
    return matrices_by_name(path.name, found, K=K, M=M, D=D)
