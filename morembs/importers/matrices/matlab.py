"""MATLAB files: v4 through SciPy, v5 to v7 by the reader next to this one, v7.3 as HDF5."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError, MorembsError
from morembs.importers.imported import Imported
from morembs.importers.matrices.hdf5 import checked_csr, import_hdf5
from morembs.importers.matrices.matlab_v5 import read_matlab_v5
from morembs.importers.matrices.named import WantedMatrices, matrices_by_name
from morembs.importers.tolerances import TOL


def import_matlab(
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
    """Matrices of a .mat file by their names; by default K, M and D (or C, where it is square). B and C
    are inputs and outputs.

    Raises:
        InputError: not a MATLAB file, or no matrix of a name.
    """
    path, wanted = Path(path), WantedMatrices(K=K, M=M, D=D, G=G, N=N, B=B, C=C, B_names=B_names, C_names=C_names)
    if path.is_file() and h5py.is_hdf5(path):
        return import_hdf5(path, **vars(wanted))
    other: dict[str, str] = {}
    try:
        with path.open("rb") as file:
            # The first number of a v4 file has a byte that is zero; text stands there in later ones.
            old = 0 in file.read(4)
        if old:
            from scipy.io import loadmat

            held: dict[str, Any] = loadmat(path, spmatrix=False, mat_dtype=True)
        else:
            matrices = read_matlab_v5(path)
            held, other = dict(matrices.matrices), matrices.other
        square = {name: _once(f"{path.name}: {name}", value) for name, value in held.items() if _is_square(value)}
    except MorembsError:
        raise
    except Exception as error:  # damage shows in every kind of error here, some without a base of their own
        reason = " ".join(str(error).split())[: TOL.shown_reason] or type(error).__name__
        raise InputError(
            f"{path.name} cannot be read as a MATLAB file ({reason}); save it again", kind="file", keyword=path.name
        ) from error
    left = [f"{name} ({kind})" for name, kind in other.items()]
    notes = (f"left out, as they are no matrices: {', '.join(left)}",) if left else ()
    return matrices_by_name(path.name, square, wanted, notes=notes, besides=held)


def _once(source: str, value: Any) -> sp.csr_array:
    """The matrix of a variable; those of v4 come as triplets, each of which MATLAB writes once."""
    if not sp.issparse(value) or value.format != "coo":
        return sp.csr_array(value)
    row, column = value.coords
    order = np.argsort(row, kind="stable")
    start = np.searchsorted(row[order], np.arange(value.shape[0] + 1))
    return checked_csr(source, value.data[order], column[order], start, value.shape)


def _is_square(value: Any) -> bool:
    shape: tuple[int, ...] = getattr(value, "shape", ())
    numbers = sp.issparse(value) or getattr(getattr(value, "dtype", None), "kind", "") in "fiuc"
    return numbers and len(shape) == 2 and shape[0] == shape[1] and shape[0] > 0
