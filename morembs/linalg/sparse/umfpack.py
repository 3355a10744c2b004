"""UMFPACK: multifrontal factor L U, for any of the matrices here.

Davis 2004. Twice the storage and the operations of a symmetric factor, but a free choice of pivots. It is
under the GPL: it is loaded from the user's system where it is installed, never shipped.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base.errors import SingularMatrixError
from morembs.base.types import Floats, Values
from morembs.linalg.sparse.cholmod import fill_of
from morembs.linalg.sparse.foreign import find_library, open_deep
from morembs.linalg.sparse.ordering import metis_ordering
from morembs.linalg.sparse.session import FactorSize, Session, SessionSolver
from morembs.linalg.sparse.solver import MECHANISM, Forecast
from morembs.linalg.sparse.symmetric import Lower
from morembs.linalg.sparse.tolerances import TOL

HINT = "sudo apt-get install libsuitesparse-dev"


class Control(IntEnum):
    """Places in the array of controls, the same since version 4; ``LENGTH`` is more than any version needs."""

    PIVOT_TOLERANCE = 3
    STRATEGY = 5
    REFINEMENT_STEPS = 7
    SYMMETRIC_PIVOT_TOLERANCE = 15
    LENGTH = 64


class Info(IntEnum):
    """Places in the array of results; sizes of memory are in units of ``UNIT`` bytes."""

    UNIT = 3
    PEAK_ESTIMATE = 21
    FLOPS_ESTIMATE = 22
    L_ESTIMATE = 23
    U_ESTIMATE = 24
    SIZE = 40
    FLOPS = 42
    L = 43
    U = 44
    LENGTH = 256


class Code(IntEnum):
    """Values of controls and results."""

    SOLVE_WHOLE = 0
    SINGULAR = 1
    SYMMETRIC_STRATEGY = 3


# Defaults that show that the controls are where they are expected.
_DEFAULTS = {Control.PIVOT_TOLERANCE: 0.1, Control.SYMMETRIC_PIVOT_TOLERANCE: 0.001, Control.REFINEMENT_STEPS: 2.0}


@cache
def umfpack_library() -> ctypes.CDLL | str:
    """The UMFPACK of the system, or why there is none."""
    path = find_library("umfpack")
    if path is None:
        return f"no UMFPACK library (libumfpack) was found; get it with: {HINT}"
    try:
        library = open_deep(path)
        control = np.zeros(Control.LENGTH)
        library.umfpack_dl_defaults(_pointer(control))
        for kind in "dz":
            for name in ("qsymbolic", "symbolic", "numeric", "solve", "get_numeric"):
                getattr(library, f"umfpack_{kind}l_{name}").restype = ctypes.c_int64
    except (OSError, AttributeError) as error:
        return f"{path} cannot be loaded: {error}; get another with: {HINT}"
    if any(control[place] != value for place, value in _DEFAULTS.items()):
        return f"{path} is of an unknown version; get another with: {HINT}"
    return library


def _pointer(array: NDArray[Any] | None) -> Any:
    """Address of ``array``, which lives as long as the result."""
    return None if array is None else array.ctypes.data_as(ctypes.c_void_p)


class _UmfpackSession(Session):
    """Symbolic and numeric factor, and the way from the lower triangle to the whole matrix."""

    title = "UMFPACK"
    words: ClassVar[dict[int, str]] = {-1: "memory could not be allocated", -11: "another pattern"}
    instead = 'give more memory or take solver = "mumps", which needs half and can keep it on disk'
    thread_safe = True
    library: ctypes.CDLL

    def __init__(self, solver: SessionSolver, A: Lower, structure: str) -> None:
        super().__init__(solver, A, structure)
        self.complex = structure == "complex-symmetric"
        # Numbers from one, because zeros would be dropped: where in the triangle each entry comes from.
        self._pattern = Lower(A.indptr, A.indices, np.arange(1, A.nnz + 1)).full()
        self._source = self._pattern.data.astype(np.int64) - 1
        self._indices = [np.ascontiguousarray(a, dtype=np.int64) for a in (self._pattern.indptr, self._pattern.indices)]
        self._symbolic, self._numeric = ctypes.c_void_p(), ctypes.c_void_p()
        # The matrix, for a correction where pivots may be small.
        self._matrix: sp.csc_array | None = None
        self.results, self._control = np.zeros(Info.LENGTH), np.zeros(Control.LENGTH)
        self._function("defaults")(_pointer(self._control))
        self._control[Control.STRATEGY] = Code.SYMMETRIC_STRATEGY
        # Its own step takes three times as long as a solution; see ``_solve``.
        self._control[Control.REFINEMENT_STEPS] = 0
        if structure == "spd":
            self._control[Control.SYMMETRIC_PIVOT_TOLERANCE] = 0.0

    def _function(self, name: str) -> Any:
        return getattr(self.library, f"umfpack_{'z' if self.complex else 'd'}l_{name}")

    def _split(self, array: NDArray[Any] | None) -> list[Any]:
        """The argument or the two arguments for real or complex values, whose parts alternate."""
        return [_pointer(array), None] if self.complex else [_pointer(array)]

    def _call_checked(self, name: str, *args: Any) -> int:
        code = int(self.run(self._function(name), *args, _pointer(self._control), _pointer(self.results)))
        if code < 0:
            raise self.failure(name, code)
        return code

    def _analyse(self, A: Lower) -> Forecast:
        """From the fill with pivots on the diagonal; else the bound of UMFPACK, several times too high."""
        order = metis_ordering(A)
        fill = fill_of(A, order)
        # A postorder keeps fewer fronts alive at the same time.
        order = order if fill is None else fill.order
        n, given = ctypes.c_int64(self.n), [] if order is None else [_pointer(order)]
        name = "qsymbolic" if given else "symbolic"
        self._call_checked(
            name, n, n, *map(_pointer, self._indices), *self._split(None), *given, ctypes.byref(self._symbolic)
        )
        results, size = self.results, self.dtype.itemsize
        if fill is None:
            entries = int(results[Info.L_ESTIMATE] + results[Info.U_ESTIMATE])
            flops = float(results[Info.FLOPS_ESTIMATE])
            peak = int(results[Info.PEAK_ESTIMATE] * results[Info.UNIT])
        else:
            entries, flops = 2 * fill.entries, 2.0 * fill.flops * (4 if self.complex else 1)
            peak = int(TOL.umfpack_peak * size * entries)
        # Of both triangles: row numbers, places in the lower triangle, values.
        matrix, values = 16 * self.nnz, size * self.nnz
        kept = int(TOL.umfpack_kept * size * entries) + matrix + (0 if self.structure == "spd" else values)
        return self.forecast(entries=entries, flops=flops, memory=max(peak + matrix + values, kept), kept=kept)

    def _factorize(self, A: Lower) -> FactorSize:
        values = np.ascontiguousarray(A.data[self._source], dtype=self.dtype)
        matrix = [*map(_pointer, self._indices), *self._split(values)]
        if self._call_checked("numeric", *matrix, self._symbolic, ctypes.byref(self._numeric)) == Code.SINGULAR:
            self.forget()
            raise SingularMatrixError(f"the matrix is exactly singular; {MECHANISM}")
        if self.structure != "spd":
            pattern = self._pattern
            self._matrix = sp.csc_array((values, pattern.indices, pattern.indptr), shape=pattern.shape)
        results = self.results
        memory = int(results[Info.SIZE] * results[Info.UNIT])
        entries = int(results[Info.L] + results[Info.U])
        return FactorSize(entries=entries, memory=memory, flops=float(results[Info.FLOPS]))

    def _solve(self, B: Values) -> Values:
        """The solution, corrected once where its componentwise backward error is large."""
        X = self.substitute(B)
        if self._matrix is None:
            return X
        residual = B - self._matrix @ X
        scale = abs(self._matrix) @ np.abs(X) + np.abs(B)
        error = np.divide(np.abs(residual), scale, out=np.zeros(scale.shape), where=scale > 0).max(axis=0)
        poor = np.flatnonzero(error > TOL.refined_error)
        if len(poor):
            X[:, poor] += self.substitute(np.asfortranarray(residual[:, poor]))
        return X

    def substitute(self, B: Values) -> Values:
        """Solution of the Fortran-ordered ``B`` (n, k) with the factor as it is."""
        X = np.empty_like(B, order="F")
        self.run(self._substitute, B, X)
        return X

    def _substitute(self, B: Values, X: Values) -> None:
        """One column at a time, the only way of UMFPACK."""
        control, results = _pointer(self._control), _pointer(self.results)
        # The matrix itself is read for refinement only.
        matrix = [None, None, *self._split(None)]
        for column in range(B.shape[1]):
            if self.abandoned:
                return
            b, x = self._split(B[:, column]), self._split(X[:, column])
            system = ctypes.c_int64(Code.SOLVE_WHOLE)
            code = self._function("solve")(system, *matrix, *x, *b, self._numeric, control, results)
            if code < 0:
                raise self.failure("solve", code)

    def _negative_pivots(self) -> int | None:
        # With pivots on the diagonal U = D L^T up to a positive scaling, and D is congruent to the matrix.
        diagonal = None if self.complex else self._diagonal()
        return None if diagonal is None else int(np.count_nonzero(diagonal < 0.0))

    def _diagonal(self) -> Floats | None:
        """Diagonal (n,) of U if every pivot is on the diagonal of the matrix, else None."""
        P, Q, D = np.empty(self.n, dtype=np.int64), np.empty(self.n, dtype=np.int64), np.empty(self.n)
        code = self._function("get_numeric")(
            *[None] * 6, _pointer(P), _pointer(Q), _pointer(D), ctypes.byref(ctypes.c_int64()), None, self._numeric
        )
        return D if code == 0 and np.array_equal(P, Q) else None

    def _forget(self) -> None:
        self._matrix = None
        self._function("free_numeric")(ctypes.byref(self._numeric))

    def _free(self) -> None:
        self._forget()
        self._function("free_symbolic")(ctypes.byref(self._symbolic))


@dataclass(frozen=True, kw_only=True)
class Umfpack(SessionSolver):
    """UMFPACK of the system (Debian: libsuitesparse-dev), in memory; ``scratch`` has no effect."""

    name: ClassVar[str] = "umfpack"
    # It counts only where all its pivots lie on the diagonal.
    counts: ClassVar[bool] = False
    session = _UmfpackSession
    library = staticmethod(umfpack_library)
