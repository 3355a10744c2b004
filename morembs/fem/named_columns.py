"""Named columns of generalised forces, such as those of the input matrix B of a second-order system."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.summary import summarised
from morembs.base.types import Floats, Ints
from morembs.fem.arrays import freeze
from morembs.storage.table import dataset, derived

if TYPE_CHECKING:
    import scipy.sparse as sp


@checked
@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class NamedColumns:
    """Loads on the dofs of a model, each under a name.

    Column j of ``matrix`` (N, m), sparse or dense, holds the forces in N, and the moments in Nm on rotations, per unit
    of the generalised force ``names[j]`` in N. Its transpose gives the motion in m that this force does work on.

    Raises:
        InputError: names that are not m different texts without commas, or entries that are not real and finite.

    >>> NamedColumns(names=("left", "right"), matrix=[[1.0, 0.0], [0.0, 1.0]])
    NamedColumns: names left, right; dofs 2
    """

    names: tuple[str, ...] = dataset("words", "columns", "of the columns")
    matrix: sp.csc_array

    def __post_init__(self) -> None:
        # Body files and their checks have models in view, but no sparse matrices.
        import scipy.sparse as sp

        try:
            matrix = sp.csc_array(self.matrix)
        except (TypeError, ValueError) as error:
            raise InputError(f"columns of loads are no matrix of numbers ({error}); expected (N, m)") from error
        if matrix.ndim != 2 or matrix.dtype.kind not in "fiub":
            raise InputError(f"columns of loads hold {matrix.dtype}; expected real numbers (N, m)")
        matrix = sp.csc_array(matrix, dtype=np.float64, copy=True)
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
        if not np.isfinite(matrix.data).all():
            raise InputError("columns of loads have entries that are not finite (NaN or infinite)", kind="value")
        for part in ("data", "indices", "indptr"):
            setattr(matrix, part, freeze(getattr(matrix, part)))
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "names", checked_names(self.names, matrix.shape[1]))

    @derived("whole", "any", "column j holds `data[offsets[j]:offsets[j+1]]`", read=True)
    def offsets(self) -> Ints:
        """(m + 1,) where the entries of each column begin."""
        return np.asarray(self.matrix.indptr)

    @derived("whole", "entries", "rows of the matrices, from 0, of the entries", read=True, largest="dofs-1")
    def rows(self) -> Ints:
        """(k,) rows of the entries."""
        return np.asarray(self.matrix.indices)

    @derived(
        "real", "entries", units="1 or m", doc="entries: of displacements without unit, of rotations lengths", read=True
    )
    def data(self) -> Floats:
        """(k,) entries."""
        return np.asarray(self.matrix.data)

    def _facts(self) -> dict[str, object]:
        return {"names": ", ".join(self.names), "dofs": self.matrix.shape[0]}


def checked_names(names: Sequence[str], count: int) -> tuple[str, ...]:
    """The names of ``count`` columns.

    Raises:
        InputError: another number of them, one that is empty or has a comma, or one that comes twice.
    """
    if isinstance(names, str) or not all(isinstance(name, str) for name in names):
        raise InputError(
            f"names = {names!r} was given; expected a list of {count} texts, one for each column", keyword="names"
        )
    if len(names) != count:
        raise InputError(f"{count} columns have {len(names)} names ({', '.join(names)}); expected one for each")
    for name in names:
        if not name.strip() or name != name.strip() or "," in name or not name.isprintable():
            raise InputError(f"the name {name!r} was given to a column; expected a text without commas, not empty")
        if list(names).count(name) > 1:
            raise InputError(f"two columns are named {name!r}; give each its own name", kind="conflict")
    return tuple(names)


def columns_of_input(source: str, B: Any, size: int, names: Sequence[str] | None = None) -> NamedColumns:
    """The columns of an input matrix B (size, m), or of one column (size,); named 1, 2, ... without ``names``.

    Raises:
        InputError: another number of rows, or as ``NamedColumns``.
    """
    return _columns(source, "B", f"({size}, m)", np.reshape(B, (-1, 1)) if np.ndim(B) == 1 else B, 0, size, names)


def columns_of_output(source: str, C: Any, size: int, names: Sequence[str] | None = None) -> NamedColumns:
    """The rows of an output matrix C (p, size), or the one row (size,), as columns; as ``columns_of_input``."""
    return _columns(source, "C", f"(p, {size})", np.reshape(C, (1, -1)) if np.ndim(C) == 1 else C, 1, size, names)


def _columns(
    source: str, role: str, expected: str, matrix: Any, axis: int, size: int, names: Sequence[str] | None
) -> NamedColumns:
    shape = matrix.shape if hasattr(matrix, "shape") else np.shape(matrix)
    if len(shape) != 2 or shape[axis] != size or not shape[1 - axis]:
        raise InputError(
            f"{source}: {role} has the shape {tuple(shape)}; expected {expected}, as K has {size} rows", keyword=role
        )
    count = shape[1 - axis]
    given = tuple(map(str, range(1, count + 1))) if names is None else names
    try:
        turned = matrix if axis == 0 else (matrix.T if hasattr(matrix, "T") else np.transpose(matrix))
        return NamedColumns(names=given, matrix=turned)  # type: ignore[arg-type]
    except InputError as error:
        raise error.restate(f"{source}: {role}: {error}") from error
