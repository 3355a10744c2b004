"""Abaqus *MATRIX INPUT: reduced matrices on interface nodes and one more node for each other coordinate."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.exporters.base import ExportContext, Exported, Exporter, in_two_digits
from morembs.exporters.read_back import ReadBack
from morembs.exporters.reduced import body_transfer, on_interfaces
from morembs.exporters.tolerances import TOL
from morembs.importers.matrices.abaqus import read_abaqus_matrix
from morembs.storage.safefile import replacing, replacing_all

MatrixForm = Literal["matrix input", "labels", "coordinate"]
# Other than the names of Matrix Market files: both may lie beside one body file.
_ENDING = "_abaqus_{}.mtx"


class MatrixInput:
    """What *MATRIX INPUT takes (Abaqus Keywords Guide): labels below a billion, numbers as "%.15e" writes them."""

    LARGEST_LABEL = 999_999_999
    DIGITS = 16


def write_abaqus_matrix(
    path: str | Path,
    matrix: sp.csr_array | NDArray[np.float64],
    node: Ints | None = None,
    dof: Ints | None = None,
    layout: MatrixForm = "matrix input",
) -> None:
    """Write a matrix (N, N) with ``node`` label and ``dof`` (N,) of each row, in a format of *MATRIX OUTPUT.

    "matrix input" holds the lower triangle of a symmetric matrix, the others all entries; "coordinate" has row
    numbers instead of labels. Numbers have 16 digits, as those of Abaqus.

    Raises:
        InputError: shapes, labels or numbers that the file cannot hold.
        OutputError: the file cannot be written.
    """
    pieces = _text(matrix, node, dof, layout)
    with replacing(Path(path)) as file:
        for piece in pieces:
            file.write(piece)


def _text(
    matrix: sp.csr_array | NDArray[np.float64], node: Ints | None, dof: Ints | None, layout: MatrixForm
) -> Iterator[bytes]:
    """The file piece by piece; everything is checked before the first one."""
    if np.iscomplexobj(matrix):
        raise InputError(
            "a complex matrix was given; *MATRIX INPUT takes real ones, write its parts one by one",
            kind="unsupported",
            keyword="matrix",
        )
    A = sp.csr_array(matrix, dtype=float)
    size = A.shape[0]
    if A.shape[1] != size:
        raise InputError(f"a matrix of the shape {A.shape} was given; expected a square one")
    if not A.count_nonzero():
        raise InputError(
            "a matrix without entries was given; *MATRIX INPUT cannot hold that, leave it out", kind="unsupported"
        )
    symmetric = not (A != A.T).nnz
    half = symmetric and layout == "matrix input"
    if layout == "coordinate":
        names = np.array([str(i + 1) for i in range(size)])
        between = " "
    else:
        names = _labels(node, dof, size)
        between = ", "
    entries = sp.coo_array(sp.tril(A) if half else A)
    entries.eliminate_zeros()
    in_two_digits("a matrix", entries.data, "Abaqus")
    return _lines(entries, names, between, symmetric=symmetric)


def _lines(entries: sp.coo_array, names: NDArray[np.str_], between: str, *, symmetric: bool) -> Iterator[bytes]:
    if not symmetric:
        # A triangle alone would be taken for half of a symmetric matrix.
        yield b"*MATRIX INPUT, NAME=UNSYMMETRIC, TYPE=UNSYMMETRIC\n"
    for at in range(0, entries.nnz, TOL.lines_at_once):
        part = slice(at, at + TOL.lines_at_once)
        rows, columns = (names[c[part]].tolist() for c in entries.coords)
        lines = zip(rows, columns, entries.data[part].tolist(), strict=True)
        yield "".join(f"{r}{between}{c}{between}{v:.15e}\n" for r, c, v in lines).encode("ascii")


def _labels(node: Ints | None, dof: Ints | None, size: int) -> NDArray[np.str_]:
    if node is None or dof is None or len(node) != size or len(dof) != size:
        raise InputError(
            f"a matrix of {size} rows needs as many node labels and dofs; or take layout = 'coordinate'",
            kind="missing",
            keyword="labels",
        )
    pairs = list(zip(node.tolist(), dof.tolist(), strict=True))
    largest = MatrixInput.LARGEST_LABEL
    if len(set(pairs)) < size or any(abs(n) > largest or n == 0 or not 1 <= d < 64 for n, d in pairs):
        raise InputError(
            f"node labels or dofs repeat or lie outside 1 to {largest} and 1 to 63; give each row its own",
            keyword="labels",
        )
    return np.array([f"{n}, {d}" for n, d in pairs])


@dataclass(frozen=True, kw_only=True)
class AbaqusExporter(Exporter):
    """An input deck with nodes, and beside conrod.inp the files conrod_abaqus_M.mtx, likewise for K and D.

    The coordinates are changed so that interface degrees of freedom are among them (exactly, all coordinates are
    kept); each other coordinate is dof 1 of a node of its own. ``first_label`` is the label of the first interface
    node; by default behind the labels of the model.
    """

    name: ClassVar[str] = "abaqus"
    suffix: ClassVar[str] = ".inp"
    about: ClassVar[str] = "Abaqus *MATRIX INPUT: reduced matrices on interface nodes"
    takes_massless: ClassVar[bool] = True
    needs_frame: ClassVar[bool] = False
    holds: ClassVar[frozenset[str]] = frozenset({"damping"})

    first_label: int | None = None

    def _write(self, context: ExportContext) -> Exported:
        body = on_interfaces(context, self.first_label, component_of_rest=1, largest_label=MatrixInput.LARGEST_LABEL)
        stem = context.path.name.removesuffix(context.path.suffix)
        paths = {key: context.beside(_ENDING.format(key)) for key in body.matrices}
        if any(not name.isascii() or "," in name for name in (stem,)):
            raise InputError(f"the file name {stem!r} does not fit an Abaqus deck; expected ASCII without commas")
        pieces = {key: _text(A, body.node, body.dof, "matrix input") for key, A in body.matrices.items()}
        lines = ["** Elastic body in SI units", "*NODE"]
        lines += [f"{label}, " + ", ".join(f"{x:.15e}" for x in point) for label, _, point in body.grids]
        lines += [f"{label}, 0., 0., 0." for label in body.rest]
        for label, name, _ in body.grids:
            lines.append(f"** node {label}: interface {name.encode('ascii', 'replace').decode()}")
        lines += [f"*MATRIX INPUT, NAME={key}, INPUT={path.name}" for key, path in paths.items()]
        damping = ", VISCOUS DAMPING=D" if "D" in paths else ""
        lines.append(f"*MATRIX ASSEMBLE, STIFFNESS=K, MASS=M{damping}")
        with replacing_all([context.path, *paths.values()]) as (deck, *files):
            deck.write(("\n".join(lines) + "\n").encode("ascii"))
            for (key, text), file in zip(pieces.items(), files, strict=True):
                file.doing = f"matrix {key}"
                for piece in text:
                    file.write(piece)
                    file.check()
        stale = context.left_from_before([context.beside(_ENDING.format("D"))] if "D" not in paths else ())
        return Exported(paths=(context.path, *paths.values()), notes=("numbers have 16 digits", *body.notes, *stale))

    def _read_back(self, context: ExportContext, files: Mapping[Path, Path]) -> ReadBack:
        body = on_interfaces(context, self.first_label, component_of_rest=1, largest_label=MatrixInput.LARGEST_LABEL)
        found = {}
        for key in body.matrices:
            read = read_abaqus_matrix(files[context.beside(_ENDING.format(key))])
            if read.node is None or read.dof is None:
                raise InputError(f"matrix {key} has no labels; expected FORMAT=MATRIX INPUT", kind="file", keyword=key)
            found[key] = read.matrix, read.node, read.dof
        return ReadBack(
            found=body.transfer(found), expected=body_transfer(context.body), digits=MatrixInput.DIGITS, changed=True
        )
