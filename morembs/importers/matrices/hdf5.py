"""Sparse matrices in HDF5 files: groups of scipy, MATLAB v7.3 and Octave, and dense datasets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Values
from morembs.importers.imported import Imported
from morembs.importers.matrices.named import Matrices, WantedMatrices, matrices_by_name
from morembs.importers.matrices.triplets import Place, refuse_twice, row_and_column
from morembs.storage.hdf5 import MEMBERS, read_dataset, reading


def import_hdf5(
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
    """Matrices of an HDF5 file, found in its groups by name ("stiffness/K"); MATLAB files of version 7.3 too.

    A sparse matrix is a group {data, indices, indptr[, shape]} (CSR, or CSC where an attribute ``format`` or
    ``h5sparse_format`` says so), {data, ir, jc} (MATLAB), or {data, ridx, cidx, nr, nc} (Octave, also under "value").
    B and C are inputs and outputs.

    Raises:
        InputError: not an HDF5 file, no such matrix, or one that is damaged.
    """
    path, wanted = Path(path), WantedMatrices(K=K, M=M, D=D, G=G, N=N, B=B, C=C, B_names=B_names, C_names=C_names)
    other: Matrices = {}
    with reading(path, "an HDF5 file with matrices", "check the file") as file:
        if K is None:
            _refuse_body(path.name, file)
        matrices: Matrices = {}
        _collect(path.name, file, "", matrices, other, {name.lower() for name in (B, C) if name is not None})
    return matrices_by_name(path.name, matrices, wanted, besides=other)


def _refuse_body(source: str, file: Any) -> None:
    """A body is no model: its matrices are those of reduced coordinates."""
    for key, kind, what in (
        ("format", "morembs-body", "a body file of morembs"),
        ("format", MEMBERS, "a file of planar members"),
        ("type", "ObjectFFRFreducedOrderInterface", "a reduced body for Exudyn"),
    ):
        item = file.get(key)
        if isinstance(item, h5py.Dataset) and item.shape == () and item[()] in (kind, kind.encode()):
            uses = "evaluate" if kind == MEMBERS else "recover"
            raise InputError(
                f"{source} is {what}, the result of a reduction and not a model; give the model it was made from "
                f"(morembs export and morembs {uses} use {'members' if kind == MEMBERS else 'body files'})",
                kind="unsupported",
            )


def _collect(source: str, group: Any, at: str, matrices: Matrices, other: Matrices, wanted: set[str]) -> None:
    """All matrices below ``group`` by their path; rectangular ones are ``other``, if they are ``wanted``."""
    for name, item in group.items():
        here = f"{at}{name}"
        if here.startswith("#refs#") or item is None:
            continue
        if isinstance(item, h5py.Group):
            inner = item["value"] if isinstance(item.get("value"), h5py.Group) else item
            matrix = sparse_group(f"{source}: {here}", inner)
            if matrix is None and isinstance(item.get("value"), h5py.Dataset):
                turned = "MATLAB_class" in item.attrs or "OCTAVE_NEW_FORMAT" in item.attrs
                matrix = _dense(item["value"], turned, here.lower() in wanted)
            if matrix is not None:
                _put(here, matrix, matrices, other, wanted)
            elif not isinstance(group.get(name, getlink=True), h5py.SoftLink):  # which may lead back to here
                _collect(source, item, f"{here}/", matrices, other, wanted)
        elif isinstance(item, h5py.Dataset):
            matrix = _dense(item, "MATLAB_class" in item.attrs, here.lower() in wanted)
            if matrix is not None:
                _put(here, matrix, matrices, other, wanted)


def _put(name: str, matrix: sp.csr_array, matrices: Matrices, other: Matrices, wanted: set[str]) -> None:
    beside = name.lower() in wanted and matrix.shape[0] != matrix.shape[1]
    (other if beside else matrices)[name] = matrix


def _dense(item: Any, transposed: bool, wanted: bool) -> sp.csr_array | None:
    """A dense dataset that is square or ``wanted``; MATLAB and Octave show their arrays transposed here."""
    if item.ndim != 2 or (item.shape[0] != item.shape[1] and not wanted) or item.dtype.kind not in "fiuV":
        return None
    values = _complex(read_dataset(item))
    if values.dtype.kind not in "fiuc":
        return None
    return sp.csr_array(values.T if transposed else values)


def _complex(values: Values) -> Values:
    """Numbers of a compound (real, imag) as complex ones."""
    names = values.dtype.names
    if names and len(names) == 2:
        return np.asarray(values[names[0]] + 1j * values[names[1]])
    return values


def sparse_group(source: str, group: Any) -> sp.csr_array | None:
    """The sparse matrix of a group, None if it is no such group.

    Raises:
        InputError: indices that do not fit.
    """
    if all(key in group for key in ("data", "indices", "indptr")):
        data, indices, indptr = (read_dataset(group[key]) for key in ("data", "indices", "indptr"))
        kind = group.attrs.get("format", group.attrs.get("h5sparse_format", group.attrs.get("datatype", "csr")))
        csc = (kind.decode() if isinstance(kind, bytes) else str(kind)).lower().startswith("csc")
        named = group.attrs.get("shape", group.attrs.get("h5sparse_shape"))
        shape = read_dataset(group["shape"]) if "shape" in group else named
        rows = len(indptr) - 1
        if shape is None:
            shape = (rows, rows)
    elif all(key in group for key in ("data", "ir", "jc")):
        data, indices, indptr = (read_dataset(group[key]) for key in ("data", "ir", "jc"))
        csc, shape = True, (int(group.attrs["MATLAB_sparse"]), len(indptr) - 1)
    elif all(key in group for key in ("ridx", "cidx", "nr", "nc")):
        data = read_dataset(group["data"]) if "data" in group else np.empty(0)
        indices, indptr = (read_dataset(group[key]).ravel() for key in ("ridx", "cidx"))
        csc, shape = True, (int(np.ravel(read_dataset(group["nr"]))[0]), int(np.ravel(read_dataset(group["nc"]))[0]))
    elif "MATLAB_sparse" in group.attrs and "jc" in group:  # without any entry
        indptr = read_dataset(group["jc"])
        data, indices = np.empty(0), np.empty(0, dtype=np.int64)
        csc, shape = True, (int(group.attrs["MATLAB_sparse"]), len(indptr) - 1)
    else:
        return None
    shape = np.ravel(shape)
    if len(shape) != 2 or shape.dtype.kind not in "iuf" or not (shape >= 0).all():
        raise InputError(f"{source} has the shape {shape.tolist()}; expected numbers of rows and columns")
    shape = (int(shape[0]), int(shape[1]))
    data = _complex(data.ravel())
    if data.dtype.kind not in "fiuc":
        raise InputError(f"{source} does not hold numbers; expected a sparse matrix")
    if not csc:
        return checked_csr(source, data, indices, indptr, shape)
    return checked_csc(source, data, indices, indptr, shape)


def checked_csc(source: str, data: Values, indices: Values, indptr: Values, shape: tuple[int, int]) -> sp.csr_array:
    """CSR matrix of the arrays of a CSC one.

    Raises:
        InputError: as ``checked_csr``.
    """
    turned = checked_csr(
        source, data, indices, indptr, (shape[1], shape[0]), lambda column, row: row_and_column(row, column)
    )
    return sp.csr_array(turned.T)


def checked_csr(
    source: str, data: Values, indices: Values, indptr: Values, shape: tuple[int, int], place: Place = row_and_column
) -> sp.csr_array:
    """CSR matrix of arrays that were looked at; ``place`` are words for a row and a column.

    Raises:
        InputError: lengths that do not fit, indices outside the matrix, or a place given twice.
    """
    bad = (
        indptr.ndim != 1
        or len(indptr) != shape[0] + 1
        or indices.shape != data.shape
        or data.ndim != 1
        or indices.dtype.kind not in "iu"
        or indptr.dtype.kind not in "iu"
        or not len(indptr)
    )
    if bad or int(indptr[0]) != 0 or int(indptr[-1]) != len(data) or (np.diff(indptr.astype(np.int64)) < 0).any():
        raise InputError(
            f"{source} is damaged: its row pointers do not fit {len(data)} entries; write the file again", kind="file"
        )
    if len(indices) and not (int(indices.min()) >= 0 and int(indices.max()) < shape[1]):
        raise InputError(
            f"{source} is damaged: indices lie outside the shape {shape}; write the file again", kind="file"
        )
    number = np.int32 if max(len(data), *shape) < np.iinfo(np.int32).max else np.int64
    if indices.dtype not in (np.int32, np.int64) or indices.dtype != indptr.dtype:
        indices, indptr = indices.astype(number), indptr.astype(number)
    matrix = sp.csr_array((data, indices, indptr), shape=shape)
    refuse_twice(matrix, source, place)
    return matrix
