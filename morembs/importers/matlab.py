"""MATLAB files: v4, v6 and v7 through SciPy, v7.3 as HDF5."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import h5py
import scipy.io
import scipy.sparse as sp

from morembs.errors import InputError
from morembs.imported import Imported
from morembs.importers.hdf5_sparse import import_hdf5
from morembs.importers.named import matrices_by_name


def import_matlab(path: Path, *, K: str | None = None, M: str | None = None, D: str | None = None) -> Imported:
    """Matrices of a .mat file by their names; by default K, M and D (or C).

    Raises:
        InputError: not a MATLAB file, or no matrix of a name.
    """
    path = Path(path)
    if path.is_file() and h5py.is_hdf5(path):
        return import_hdf5(path, K=K, M=M, D=D)
    try:
        held = scipy.io.loadmat(path, spmatrix=False)
    except (OSError, ValueError, TypeError, NotImplementedError, KeyError, IndexError, EOFError, zlib.error) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{path.name} cannot be read as a MATLAB file ({reason}); save it again") from error
    except Exception as error:  # MatReadError has no base of its own
        raise InputError(f"{path.name} cannot be read as a MATLAB file ({error}); save it again") from error
    return matrices_by_name(
        path.name, {name: value for name, value in held.items() if _is_square(value)}, K=K, M=M, D=D
    )


def _is_square(value: Any) -> bool:
    shape: tuple[int, ...] = getattr(value, "shape", ())
    numbers = sp.issparse(value) or getattr(getattr(value, "dtype", None), "kind", "") in "fiuc"
    return numbers and len(shape) == 2 and shape[0] == shape[1] and shape[0] > 0
