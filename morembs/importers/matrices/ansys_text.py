"""Matrices of ANSYS as text: Matrix Market (*EXPORT,,MMF) or Harwell-Boeing (HBMAT), with what maps rows to dofs.

Rows are in the order of the solver, without dofs that supports and couplings eliminate. The mapping is one of

- the .mapping file of HBMAT (Mapping = YES): lines "row node dof";
- the table of nodes of *VEC,BACK,I,IMPORT,FULL,file.full,BACK and *EXPORT,BACK,MMF: node labels in the internal order,
  with NOD2SOLV (*SMAT) or NOD2BCS (*VEC) from internal to solver order, or none where both orders are the same.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.imported import Imported
from morembs.importers.matrices.ansys_hb import read_harwell_boeing
from morembs.importers.matrices.ansys_nodes import COMPONENTS, join
from morembs.importers.matrices.matrix_market import BANNER, read_matrix_market
from morembs.importers.matrices.text import integers, open_lines, text_blocks

_MAPPING_LINE = re.compile(r"\s*(\d{1,10})[\s,]+(\d{1,10})[\s,]+([A-Za-z]+|\d)\s*$")


def import_ansys_matrices(
    path: str | Path,
    *,
    mass: str | Path,
    damping: str | Path | None = None,
    mapping: str | Path | None = None,
    nod2solv: str | Path | None = None,
    nodes: str | Path | None = None,
) -> Imported:
    """Stiffness ``path``, ``mass`` and ``damping`` with the ``mapping`` of their rows and the coordinates of ``nodes``.

    ``nodes`` is the archive of the same model (.cdb) or a list of its nodes (NWRITE, NLIST). Where the mapping does
    not say the order for certain, it is checked: rigid motion must leave K without forces.

    Raises:
        InputError: a file is missing, cut off or of another format; no mapping or nodes; parts that do not fit.
    """
    path = Path(path)
    if mapping is None:
        raise InputError(
            f"{path.name} does not say which node and dof its rows are; write that too (HBMAT with Mapping = YES; or "
            "*VEC,BACK,I,IMPORT,FULL,file.full,BACK and *SMAT,MAP,D,IMPORT,FULL,file.full,NOD2SOLV, both with "
            "*EXPORT,...,MMF) and give it as mapping and nod2solv",
            kind="missing",
            keyword="mapping",
        )
    K = read_ansys_matrix(path)
    matrices = {"K": K, "M": read_ansys_matrix(mass), "D": None if damping is None else read_ansys_matrix(damping)}
    for other, file in (("M", mass), ("D", damping)):
        matrix = matrices[other]
        if matrix is not None and file is not None and matrix.shape != K.shape:
            raise InputError(
                f"{Path(file).name} has the size {matrix.shape[0]}, {path.name} {K.shape[0]}"
                "; give matrices of one model",
                kind="unsupported",
            )
    node, component, sure = _rows(Path(mapping), None if nod2solv is None else Path(nod2solv), K.shape[0])
    order = np.lexsort((component, node))
    same = (np.diff(node[order]) == 0) & (np.diff(component[order]) == 0)
    if same.any():
        at = order[int(np.flatnonzero(same)[0])]
        raise InputError(
            f"{Path(mapping).name} names {COMPONENTS[component[at]]} of the node {node[at]} twice", kind="conflict"
        )
    ordered = {name: None if A is None else sp.csr_array(A[order][:, order]) for name, A in matrices.items()}
    return join(path.name, ordered, node[order], component[order], nodes, (), free=True, sure=sure)


def read_ansys_matrix(path: str | Path) -> sp.csr_array:
    """Square matrix of a text file, Matrix Market or Harwell-Boeing, whole where the file holds one triangle.

    Memory is that of the matrix (CSR) and blocks of text.

    Raises:
        InputError: the file is missing, cut off, binary, complex, or of another format.
    """
    path = Path(path)
    with open_lines(path) as file:
        market = file.read(len(BANNER)).lower() == BANNER
    if not market:
        return read_harwell_boeing(path)
    matrix = _market(path)
    if isinstance(matrix, np.ndarray):
        raise InputError(f"{path.name} is a vector or a dense matrix; expected a sparse one (*SMAT and *EXPORT,,MMF)")
    if matrix.shape[0] != matrix.shape[1]:
        raise InputError(f"{path.name} is {matrix.shape[0]} x {matrix.shape[1]}; expected a square matrix")
    return matrix


def _market(path: Path) -> sp.csr_array | Floats:
    """Sparse matrix, or the column (n,) of an array file."""
    matrix = read_matrix_market(path, plain=True)
    if isinstance(matrix, np.ndarray):
        if matrix.shape[1] != 1:
            raise InputError(f"{path.name} is an array of the shape {matrix.shape}; expected one column")
        return matrix[:, 0]
    return matrix


def _rows(mapping: Path, nod2solv: Path | None, size: int) -> tuple[Ints, Ints, bool]:
    """Node and component (N,) of each row, and whether their order is certain."""
    with open_lines(mapping) as file:
        market = file.read(len(BANNER)).lower() == BANNER
    if not market:
        return (*_mapping_lines(mapping, size), True)
    labels = _market(mapping)
    if not isinstance(labels, np.ndarray):
        raise InputError(
            f"{mapping.name} is a sparse matrix; give the table of nodes (BACK) as mapping, it as nod2solv",
            kind="unsupported",
        )
    label = integers(labels, "a node label", mapping.name)
    if not len(label) or label.min() < 1 or label.max() >= 2**31:
        raise InputError(
            f"{mapping.name} holds {label.min() if len(label) else 'no label'}; expected node labels from 1"
        )
    if nod2solv is None:
        internal, at = size, np.arange(size)
    else:
        internal, at = _solver_order(nod2solv, size)
    per_node = internal // len(label) if internal % len(label) == 0 else 0
    if per_node not in (3, 6):
        raise InputError(
            f"{mapping.name} has {len(label)} nodes for {internal} dofs; expected 3 or 6 dofs at each. Where supports "
            "or couplings eliminate dofs, give nod2solv too (*SMAT,MAP,D,IMPORT,FULL,file.full,NOD2SOLV)",
            kind="file",
            keyword="mapping",
        )
    return label[at // per_node], at % per_node, nod2solv is not None and internal != size


def _solver_order(path: Path, size: int) -> tuple[int, Ints]:
    """Number of internal dofs, and the internal dof (N,) of each row of the solver."""
    choice = _market(path)
    if isinstance(choice, np.ndarray):
        to = integers(choice, "a row number", path.name)
        kept = np.flatnonzero(to > 0)
        if not np.array_equal(np.sort(to[kept]), np.arange(1, size + 1)):
            raise InputError(
                f"{path.name} does not number {size} rows of the matrices; give that of the same model",
                kind="unsupported",
            )
        at = np.empty(size, dtype=np.int64)
        at[to[kept] - 1] = kept
        return len(to), at
    if choice.shape[0] != size or (np.diff(choice.indptr) != 1).any() or (choice.data != 1).any():
        raise InputError(
            f"{path.name} is not a choice of {size} dofs (one 1 in each row); couplings and constraint equations mix "
            "dofs and are not read: write the model without them",
            kind="unsupported",
        )
    at = choice.indices.astype(np.int64)
    if len(np.unique(at)) < len(at):
        raise InputError(f"{path.name} chooses a dof twice; it is damaged", kind="file", keyword=path.name)
    return int(choice.shape[1]), at


def _mapping_lines(path: Path, size: int) -> tuple[Ints, Ints]:
    """Node and component (N,) of the .mapping file of HBMAT."""
    node, component = np.zeros(size, dtype=np.int64), np.zeros(size, dtype=np.int64)
    row_count = 0
    for row, label, dof in _map(path):
        if not 1 <= row <= size or node[row - 1] or label < 1:
            raise InputError(
                f"{path.name} maps the row {row} to the node {label}; expected each row from 1 to {size} once",
                kind="file",
                keyword="mapping",
            )
        node[row - 1], component[row - 1] = label, dof
        row_count += 1
    if row_count != size:
        raise InputError(
            f"{path.name} maps {row_count} rows; the matrices have {size}. Give the mapping of the same HBMAT",
            kind="unsupported",
        )
    return node, component


def _map(path: Path) -> Iterator[tuple[int, int, int]]:
    started = False
    for block in text_blocks(path):
        for line in block.decode("latin-1").splitlines():
            match = _MAPPING_LINE.match(line)
            if match is None:
                if started and line.strip():
                    raise InputError(
                        f"{path.name}: the line {line[:60]!r} is not 'row node dof'; it is damaged",
                        kind="file",
                        keyword=path.name,
                    )
                continue
            started = True
            dof = match[3].upper()
            if dof not in COMPONENTS and not (dof.isdigit() and 1 <= int(dof) <= 6):
                raise InputError(
                    f"{path.name} has the dof {dof}; expected {', '.join(COMPONENTS)} (a structural model)"
                )
            yield int(match[1]), int(match[2]), COMPONENTS.index(dof) if not dof.isdigit() else int(dof) - 1
