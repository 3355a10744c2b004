"""Matrices in text and OP4 files as ``Imported``: nodes known by label only have no coordinates (NaN) yet."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.fem import DofMap, Nodes
from morembs.fem.fe_model import Component
from morembs.importers.imported import Imported
from morembs.importers.matrices.abaqus import AbaqusMatrix, align, read_abaqus_matrix
from morembs.importers.matrices.calculix import read_calculix_matrices
from morembs.importers.matrices.dmig import DmigMatrix, GridRow, read_dmig
from morembs.importers.matrices.named import WantedMatrices, matrices_by_name, square_csr
from morembs.importers.matrices.op4 import read_op4
from morembs.importers.nastran.cards import Cards
from morembs.importers.nastran.geometry import Grids
from morembs.importers.nastran.text import BulkText

_GRID = re.compile(rb"^GRID[ *,][^\n]*\n(?:[*+ ,][^\n]*\n)*", re.MULTILINE)
# Names that Nastran gives the matrices of a superelement, and those by which it takes them.
_USUAL = {
    "K": ("KAAX", "KAA", "K2GG", "K2PP"),
    "M": ("MAAX", "MAA", "M2GG", "M2PP"),
    "D": ("BAAX", "BAA", "B2GG", "B2PP"),
}


def import_op4(
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
    """Matrices of a Nastran OP4 file by their names; the file does not say which dofs its rows are.

    Raises:
        InputError: not such a file, or no matrix of a name.
    """
    path = Path(path)
    wanted = WantedMatrices(K=K, M=M, D=D, G=G, N=N, B=B, C=C, B_names=B_names, C_names=C_names)
    names = wanted.names if K is not None and M is not None else None
    matrices = {name: read.matrix for name, read in read_op4(path, names).items()}
    square = {name: A for name, A in matrices.items() if A.shape[0] == A.shape[1]}
    taken = {*square, *(name.upper() for name in wanted.names)}
    notes = tuple(f"{name} is not square and was left out" for name in matrices if name not in taken)
    return matrices_by_name(path.name, square, wanted, notes=notes, besides=matrices)


def import_dmig(
    path: Path,
    *,
    K: str | None = None,
    M: str | None = None,
    D: str | None = None,
    allow_includes_outside: bool = False,
) -> Imported:
    """DMIG matrices of a Nastran file by their names (KAAX and MAAX are read as K and M), with node labels.

    Where the file has a GRID for each of them, nodes are at their places. Scalar points become scalar dofs.

    Raises:
        InputError: not such a file, or no matrix of a name.
    """
    path = Path(path)
    text = BulkText(path, outside=allow_includes_outside)
    matrices = {name: read for name, read in read_dmig(text).items() if read.matrix.shape[0] == read.matrix.shape[1]}
    labels = np.unique(
        np.concatenate([np.empty((0, 2), dtype=np.int64), *(read.rows for read in matrices.values())]), axis=0
    )
    grown = {name: _spread(read, labels) for name, read in matrices.items()}
    nodes, dofs = label(
        labels[:, 0], np.where(labels[:, 1] == GridRow.SCALAR_POINT, Component.SCALAR, labels[:, 1] - 1)
    )
    nodes = _place(nodes, text)
    given = {"K": K, "M": M, "D": D}
    for role, names in _USUAL.items():
        given[role] = given[role] or next((name for name in names if name in grown), None)
    whole = matrices_by_name(path.name, grown, WantedMatrices(**given), nodes=nodes, dofs=dofs)
    return replace(whole, warnings=text.warnings)


def _place(nodes: Nodes, text: BulkText) -> Nodes:
    """The nodes at the GRID cards of the text, as far as it has some, along the basic axes."""
    grids = Grids(text.file)
    for piece in text:
        cards = b"".join(_GRID.findall(piece.text)) if b"GRID" in piece.text else b""
        if cards:
            for table in Cards(replace(piece, text=cards), text).tables():
                grids.add(table)
    if not grids.count:
        return nodes
    grids.sort([])
    if grids.cp.any() or (grids.cd > 0).any():
        return nodes
    there = grids.labels.has(nodes.ids)
    xyz = np.full((len(nodes), 3), np.nan)
    xyz[there] = grids.xyz[grids.labels.rows(nodes.ids[there], "DMIG names")]
    return Nodes(ids=nodes.ids, xyz=xyz)


def _spread(read: DmigMatrix, labels: Ints) -> sp.csr_array:
    """The matrix with a row for every label."""
    codes, rows = labels[:, 0] * 16 + labels[:, 1], read.rows[:, 0] * 16 + read.rows[:, 1]
    at = np.searchsorted(codes, rows)
    A = read.matrix.tocoo()
    return sp.csr_array(sp.coo_array((A.data, (at[A.row], at[A.col])), shape=(len(labels),) * 2))


def import_abaqus_matrix(path: Path, *, mass: str | None = None, damping: str | None = None) -> Imported:
    """The matrix of one *MATRIX OUTPUT file as K; ``mass`` and ``damping`` are further files next to it.

    Raises:
        InputError: not such files, internal dofs (Lagrange multipliers, connectors), or files that do not fit.
    """
    path = Path(path)
    files = {"K": path} | {role: path.parent / name for role, name in (("M", mass), ("D", damping)) if name is not None}
    return abaqus_matrices(files)


def abaqus_matrices(files: dict[str, Path]) -> Imported:
    """K, M and D of Abaqus files by role, on the union of their dofs."""
    read = {role: read_abaqus_matrix(path) for role, path in files.items()}
    source = files.get("K", next(iter(files.values()))).name
    notes = tuple(_note(files[role].name, matrix) for role, matrix in read.items())
    for role, matrix in read.items():
        if matrix.internal:
            raise InputError(
                f"{files[role].name} has {matrix.internal} internal dofs (Lagrange multipliers, connectors, hybrid "
                "elements), which a body cannot carry; replace these elements",
                kind="unsupported",
            )
    matrices, node, dof = align(*read.values())
    whole = {role: square_csr(source, role, A) for role, A in zip(read, matrices, strict=True)}
    if node is None or dof is None:
        return Imported(source=source, notes=notes, **whole)
    if len(dof) and not (dof.min() >= 1 and dof.max() <= 6):
        raise InputError(
            f"{source} has dofs beyond 6 (temperature, warping), which no body carries; leave them out",
            kind="unsupported",
        )
    nodes, dofs = label(node, dof - 1)
    return Imported(source=source, nodes=nodes, dofs=dofs, notes=notes, **whole)


def _note(name: str, matrix: AbaqusMatrix) -> str:
    return f"{name}: {'one of each pair of entries, the other was filled in' if matrix.half else 'all entries'}"


def import_calculix(path: Path) -> Imported:
    """K and M of job.sti and job.mas of CalculiX (MATRIXSTORAGE), their dofs of job.dof, in the units of its deck.

    Raises:
        InputError: a file is missing or damaged, or has directions beyond x, y, z.
    """
    path = Path(path)
    read = read_calculix_matrices(path)
    if len(read.dof) and read.dof.max() > 3:
        raise InputError(f"{path.name} has directions beyond 3; only displacements can be read", kind="unsupported")
    nodes, dofs = label(read.node, read.dof - 1)
    return Imported(source=path.name, K=read.K, M=read.M, nodes=nodes, dofs=dofs)


def label(labels: Ints, components: Ints) -> tuple[Nodes, DofMap]:
    """Nodes with labels but without coordinates, and dofs on them, of the label and component of each row."""
    ids, row = np.unique(labels, return_inverse=True)
    return Nodes(ids=ids, xyz=np.full((len(ids), 3), np.nan)), DofMap(node=row, component=components)
