"""Matrices of a file by their names, and which of them are K, M and D."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError, nearest
from morembs.fem import DofMap, Nodes
from morembs.fem.named_columns import NamedColumns, columns_of_input, columns_of_output
from morembs.fem.tolerances import TOL as FEM
from morembs.importers.imported import Imported

Matrices = dict[str, sp.csr_array]
# Names by which matrices go, in small letters; the first that is there is taken.
USUAL = {
    "K": ("k", "stiffness", "stiffnessmatrix", "kmat", "kgg", "kaa", "stif", "stiff", "kfull"),
    "M": ("m", "mass", "massmatrix", "mmat", "mgg", "maa", "mfull"),
    "D": ("d", "damping", "dampingmatrix", "c", "bgg", "baa", "dmat", "cmat", "e"),
    "G": ("gyroscopic", "gyroscopicmatrix"),
    "N": ("circulatory", "circulatorymatrix"),
}


def square_csr(source: str, name: str, matrix: Any) -> sp.csr_array:
    """A real or complex square CSR matrix in double precision, entries summed and sorted; a vector is a diagonal.

    Raises:
        InputError: no numbers, not square, or entries that are not finite.
    """
    if np.ma.is_masked(matrix):
        raise InputError(
            f"{source}: {name} is a masked array with entries that are masked out; expected a number in each: give "
            f"{name}.filled(0.0) if they are zero"
        )
    try:
        A = sp.csr_array(matrix if sp.issparse(matrix) or np.ndim(matrix) != 1 else sp.diags_array(np.asarray(matrix)))
    except (TypeError, ValueError) as error:
        raise InputError(f"{source}: {name} is not a matrix of numbers ({error})", kind="unsupported") from error
    if A.ndim != 2 or A.shape[0] != A.shape[1] or not A.shape[0]:
        raise InputError(f"{source}: {name} has the shape {A.shape}; expected a square matrix", keyword=name)
    if A.dtype.kind not in "fiubc":
        raise InputError(f"{source}: {name} does not hold numbers; expected a real or complex matrix")
    A = A.astype(np.complex128 if A.dtype.kind == "c" else np.float64)
    if A.dtype.kind == "c" and not A.data.imag.any():
        A = sp.csr_array((A.data.real.copy(), A.indices, A.indptr), shape=A.shape)
    refuse_entries(source, name, A)
    A.sum_duplicates()
    return A


@dataclass(frozen=True, kw_only=True)
class WantedMatrices:
    """Names of the matrices of a file that are K, M, D, G and N, or None; ``B`` and ``C`` those of inputs and outputs,
    which are taken only by name, ``B_names`` and ``C_names`` titles of their columns and rows, apart by commas."""

    K: str | None = None
    M: str | None = None
    D: str | None = None
    G: str | None = None
    N: str | None = None
    B: str | None = None
    C: str | None = None
    B_names: str | None = None
    C_names: str | None = None

    @property
    def names(self) -> set[str]:
        """All names of matrices that were given."""
        given = (self.K, self.M, self.D, self.G, self.N, self.B, self.C)
        return {name for name in given if name is not None and name != "identity"}

    def with_columns(self, imported: Imported, find: Callable[[str], Any]) -> Imported:
        """The matrices of a file with B and C, as far as wanted, which ``find`` gives by their names.

        Raises:
            InputError: matrices or titles that do not fit the rows of K.
        """
        return replace(
            imported,
            inputs=_columns(imported, "B", self.B, self.B_names, find, columns_of_input),
            outputs=_columns(imported, "C", self.C, self.C_names, find, columns_of_output),
        )


def _columns(
    imported: Imported,
    role: str,
    name: str | None,
    titles: str | None,
    find: Callable[[str], Any],
    make: Callable[[str, Any, int, Sequence[str] | None], NamedColumns],
) -> NamedColumns | None:
    if name is None:
        if titles is not None:
            raise InputError(
                f"{role}_names was given without {role}; name the matrix: --set {role}=NAME", kind="conflict"
            )
        return None
    size = 0 if imported.K is None else imported.K.shape[0]
    words = None if titles is None else tuple(word.strip() for word in titles.split(","))
    return make(imported.source, find(name), size, words)


def refuse_entries(source: str, name: str, matrix: sp.csr_array) -> None:
    """Refuse a matrix with entries that nothing can be computed with.

    Raises:
        InputError: entries that are not finite, or beyond ``FEM.largest_number``.
    """
    if not np.isfinite(matrix.data).all():
        raise InputError(
            f"{source}: {name} has entries that are not finite (NaN or infinite); write the file again",
            kind="file",
            keyword=name,
        )
    largest = float(np.abs(matrix.data).max(initial=0.0))
    if largest > FEM.largest_number:
        raise InputError(
            f"{source}: {name} has an entry of {largest:.3g}; the file is damaged, or its units are wrong", kind="file"
        )


def matrices_by_name(
    source: str,
    matrices: Mapping[str, Any],
    wanted: WantedMatrices,
    *,
    nodes: Nodes | None = None,
    dofs: DofMap | None = None,
    notes: tuple[str, ...] = (),
    besides: Mapping[str, Any] | None = None,
) -> Imported:
    """The matrices that are named, else those with usual names; what is left over is noted.

    ``M = "identity"`` stands for the unit matrix. A file of one matrix gives it as K, under any name. ``besides`` are
    what else the file holds, of which B and C may be some.

    Raises:
        InputError: no matrices, or none of a given name.
    """
    if not matrices:
        raise InputError(f"{source} has no square matrix; expected K and M")
    K, besides = wanted.K, {**(besides or {}), **matrices}
    asked, taken = {"K": K, **{role: getattr(wanted, role) for role in ("M", "D", "G", "N")}}, {}
    for role, name in asked.items():
        if name == "identity" and name not in matrices:
            size = (next(iter(matrices.values())) if K is None else matrices[_there(source, matrices, K)]).shape[0]
            taken[role] = ("identity", sp.eye_array(size, format="csr"))
        elif name is not None:
            key = _there(source, matrices, name)
            taken[role] = (key, matrices[key])
    if not taken and len(matrices) == 1 and not {"A", "B", "C"} <= set(besides):
        taken["K"] = next(iter(matrices.items()))
    ends = {role: _there(source, besides, name) for role, name in (("B", wanted.B), ("C", wanted.C)) if name}
    used = {name for name, _ in taken.values()} | set(ends.values())
    for role, names in USUAL.items():
        free = {key.rsplit("/", 1)[-1].lower().replace("_", ""): key for key in matrices if key not in used}
        usual = next((free[name] for name in names if name in free), None)
        if role not in taken and usual is not None and len(matrices) > 1:
            taken[role] = (usual, matrices[usual])
            used.add(usual)
    chosen = ", ".join(f"{role} = {name}" for role, name in ({r: n for r, (n, _) in taken.items()} | ends).items())
    if "K" not in taken and {"A", "B", "C"} <= set(besides):
        raise InputError(
            f"{source} holds a first-order system (A, B, C): its states are no displacements and it has no mass; "
            "expected a second-order one, M u'' + D u' + K u = B f",
            kind="unsupported",
            keyword="matrices",
        )
    if "K" not in taken:
        raise InputError(
            f"{source} has the matrices {', '.join(matrices)}; say which is the stiffness and which the mass: "
            "--set K=NAME --set M=NAME",
            kind="unsupported",
        )
    left = [name for name in matrices if name not in used]
    notes = (*notes, *_unused_columns(besides, used, next(iter(taken.values()))[1].shape[0]))
    notes = (*notes, f"matrices of the file: {chosen}" + (f"; left out: {', '.join(left)}" if left else ""))
    ready = {role: square_csr(source, name, matrix) for role, (name, matrix) in taken.items()}
    imported = Imported(source=source, nodes=nodes, dofs=dofs, notes=notes, **ready)
    return wanted.with_columns(imported, lambda name: besides[_there(source, besides, name)])


def _unused_columns(held: Mapping[str, Any], used: Container[str], size: int) -> list[str]:
    """A note for each matrix under the name of inputs or outputs that is none yet."""
    notes = []
    for role, what, side in (("B", "inputs", 0), ("C", "outputs", -1)):
        name = next((name for name in held if name.upper() == role and name not in used), None)
        shape = () if name is None else np.shape(held[name])
        if shape and shape[side] == size and shape != (size, size):
            notes.append(f"{name} ({' x '.join(map(str, shape))}) is left out; --set {role}={name} takes it as {what}")
    return notes


def _there(source: str, matrices: Mapping[str, Any], name: str) -> str:
    if name in matrices:
        return name
    alike = [key for key in matrices if key.lower() == name.lower()]
    if len(alike) == 1:
        return alike[0]
    raise InputError(f"{source} has no matrix {name!r}; {nearest(name, matrices)}", kind="unknown")
