"""UMFPACK: multifrontal factor L U, for any of the matrices here.

Davis 2004. Twice the storage and the operations of a symmetric factor, but a free choice of pivots. It is
under the GPL: it is loaded from the user's system where it is installed, never shipped.
"""

from __future__ import annotations

import ctypes
import time
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base.errors import SingularMatrixError, SolverError
from morembs.base.progress import Progress
from morembs.base.types import Values
from morembs.linalg.sparse.cholmod_session import fill_of
from morembs.linalg.sparse.foreign import find_library, open_deep
from morembs.linalg.sparse.interruptible import ForeignObject
from morembs.linalg.sparse.ordering import metis_ordering
from morembs.linalg.sparse.sessions import SessionAnalysis, SessionFactor
from morembs.linalg.sparse.solver import MECHANISM, Analysis, Factorization, FactorStats, Forecast, ForeignSolver
from morembs.linalg.sparse.symmetric import Lower

HINT = "sudo apt-get install libsuitesparse-dev"
# Places in the array of controls and their values, the same since version 4.
_STRATEGY, _STEPS, _SYMMETRIC_TOLERANCE, _PIVOT_TOLERANCE = 5, 7, 15, 3
_SYMMETRIC = 3
# Places in the array of results.
_UNIT, _PEAK_ESTIMATE, _FLOPS_ESTIMATE, _L_ESTIMATE, _U_ESTIMATE = 3, 21, 22, 23, 24
_SIZE, _FLOPS, _L, _U = 40, 42, 43, 44
# Longer than any version needs.
_CONTROLS, _RESULTS = 64, 256
_SINGULAR, _NO_MEMORY, _OTHER_PATTERN = 1, -1, -11
# Bytes held at the end, and at the peak, for each byte of the entries of L and U, as measured on solid bodies.
_KEPT, _PEAK = 1.04, 1.85
# Componentwise backward error above which a column is corrected once, and the columns looked at together.
_ACCURATE = 1e-14
_BLOCK = 32


@cache
def umfpack_library() -> ctypes.CDLL | str:
    """The UMFPACK of the system, or why there is none."""
    path = find_library("umfpack")
    if path is None:
        return f"no UMFPACK library (libumfpack) was found; get it with: {HINT}"
    try:
        library = open_deep(path)
        control = np.zeros(_CONTROLS)
        library.umfpack_dl_defaults(_pointer(control))
        for kind in "dz":
            for name in ("qsymbolic", "symbolic", "numeric", "solve", "get_numeric"):
                getattr(library, f"umfpack_{kind}l_{name}").restype = ctypes.c_int64
    except (OSError, AttributeError) as error:
        return f"{path} cannot be loaded: {error}; get another with: {HINT}"
    # Its defaults show that the controls are where they are expected.
    if (control[_PIVOT_TOLERANCE], control[_SYMMETRIC_TOLERANCE], control[_STEPS]) != (0.1, 0.001, 2.0):
        return f"{path} is of an unknown version; get another with: {HINT}"
    return library


def _pointer(array: NDArray[Any] | None) -> Any:
    """Address of ``array``, which lives as long as the result."""
    return None if array is None else array.ctypes.data_as(ctypes.c_void_p)


class _Session(ForeignObject):
    """The foreign objects of one pattern: symbolic and numeric factor."""

    def __init__(self, library: ctypes.CDLL, pattern: sp.csc_array, structure: str) -> None:
        super().__init__()
        self.complex = structure == "complex-symmetric"
        self.n = pattern.shape[0]
        self.results = np.zeros(_RESULTS)
        self._library = library
        self._symbolic, self._numeric = ctypes.c_void_p(), ctypes.c_void_p()
        self._pattern = [np.ascontiguousarray(part, dtype=np.int64) for part in (pattern.indptr, pattern.indices)]
        self._control = np.zeros(_CONTROLS)
        self._function("defaults")(_pointer(self._control))
        self._control[_STRATEGY] = _SYMMETRIC
        # A step of its own takes three times as long as a solution; see ``_UmfpackFactor``.
        self._control[_STEPS] = 0
        if structure == "spd":
            self._control[_SYMMETRIC_TOLERANCE] = 0.0

    def _function(self, name: str) -> Any:
        return getattr(self._library, f"umfpack_{'z' if self.complex else 'd'}l_{name}")

    def _split(self, array: NDArray[Any] | None) -> list[Any]:
        """The argument or the two arguments for real or complex values, whose parts alternate."""
        return [_pointer(array), None] if self.complex else [_pointer(array)]

    def analyse(self, order: NDArray[np.int64] | None, progress: Progress) -> None:
        """Make the symbolic factor for the columns in ``order`` (n,)."""
        name = "symbolic" if order is None else "qsymbolic"
        n = ctypes.c_int64(self.n)
        args = [n, n, *map(_pointer, self._pattern), *self._split(None)]
        if order is not None:
            args.append(_pointer(order))
        self._run(name, *args, ctypes.byref(self._symbolic), progress=progress, news="analysing")

    def factorize(self, values: Values, progress: Progress, news: str) -> None:
        """Make the numeric factor of the matrix with ``values`` (nnz,).

        Raises:
            SingularMatrixError: exactly singular.
        """
        args = [*map(_pointer, self._pattern), *self._split(values), self._symbolic, ctypes.byref(self._numeric)]
        if self._run("numeric", *args, progress=progress, news=news) == _SINGULAR:
            self.forget()
            raise SingularMatrixError(f"the matrix is exactly singular; {MECHANISM}")

    def solve(self, B: Values) -> Values:
        """Solution of a right-hand side (n, k) that is Fortran-ordered."""
        X = np.empty_like(B)
        self.call(self._solve, B, X)
        return X

    def _solve(self, B: Values, X: Values) -> None:
        """One column at a time, the only way of UMFPACK."""
        control, results = _pointer(self._control), _pointer(self.results)
        for column in range(B.shape[1]):
            if self.abandoned:
                return
            # The matrix itself is read for refinement only.
            b, x = self._split(B[:, column]), self._split(X[:, column])
            matrix = [None, None, *self._split(None)]
            code = self._function("solve")(ctypes.c_int64(0), *matrix, *x, *b, self._numeric, control, results)
            if code < 0:
                raise SolverError(f"UMFPACK failed in solve: status {code}")

    def diagonal(self) -> NDArray[np.float64] | None:
        """Diagonal (n,) of U if every pivot is on the diagonal of the matrix, else None."""
        P, Q, D = np.empty(self.n, dtype=np.int64), np.empty(self.n, dtype=np.int64), np.empty(self.n)
        code = self._function("get_numeric")(
            *[None] * 6, _pointer(P), _pointer(Q), _pointer(D), ctypes.byref(ctypes.c_int64()), None, self._numeric
        )
        return D if code == 0 and np.array_equal(P, Q) else None

    def _run(self, name: str, *args: Any, progress: Progress, news: str) -> int:
        arrays = _pointer(self._control), _pointer(self.results)
        code = int(self.call(self._function(name), *args, *arrays, progress=progress, news=news))
        if code < 0:
            words = {_NO_MEMORY: "memory could not be allocated", _OTHER_PATTERN: "another pattern"}
            raise SolverError(f"UMFPACK failed in {name}: status {code}: {words.get(code, 'see its manual')}")
        return code

    def forget(self) -> None:
        """Free the numeric factor."""
        if not self.abandoned:
            self._function("free_numeric")(ctypes.byref(self._numeric))

    def _free(self) -> None:
        self._function("free_numeric")(ctypes.byref(self._numeric))
        self._function("free_symbolic")(ctypes.byref(self._symbolic))


class _UmfpackAnalysis(SessionAnalysis):
    """The symbolic factor and the way from the lower triangle to the whole matrix."""

    instead = "needs half and can keep it on disk"
    session: _Session

    def __init__(self, solver: Umfpack, library: ctypes.CDLL, A: Lower, structure: str) -> None:
        # Numbers from one, because zeros would be dropped: where in the triangle each entry comes from.
        self.pattern = Lower(A.indptr, A.indices, np.arange(1, A.nnz + 1)).full()
        self._source = self.pattern.data.astype(np.int64) - 1
        super().__init__(solver, A, structure, _Session(library, self.pattern, structure))

    def _demand(self, A: Lower) -> Forecast:
        """From the fill with pivots on the diagonal; else the bound of UMFPACK, several times too high."""
        order = metis_ordering(A)
        fill = fill_of(A, order)
        # A postorder keeps fewer fronts alive at the same time.
        self.session.analyse(order if fill is None else fill.order, self.solver.progress)
        results, size = self.session.results, 16 if self.session.complex else 8
        if fill is None:
            entries, flops = int(results[_L_ESTIMATE] + results[_U_ESTIMATE]), float(results[_FLOPS_ESTIMATE])
            peak = int(results[_PEAK_ESTIMATE] * results[_UNIT])
        else:
            entries, flops = 2 * fill.entries, 2.0 * fill.flops * (4 if self.session.complex else 1)
            peak = int(_PEAK * size * entries)
        # Of both triangles: row numbers, places in the lower triangle, values.
        matrix = 16 * self.nnz
        values = size * self.nnz
        kept = int(_KEPT * size * entries) + matrix + (0 if self.structure == "spd" else values)
        return Forecast(
            backend=self.solver.name,
            size=self.n,
            factor_entries=entries,
            flops=flops,
            memory=max(peak + matrix + values, kept),
            kept=kept,
        )

    def factorize_unchecked(self, A: Lower) -> Factorization:
        start = time.perf_counter()
        session = self.session
        values = np.ascontiguousarray(A.data[self._source], dtype=np.complex128 if session.complex else np.float64)
        session.factorize(values, self.solver.progress, f"factorising ({self._forecast.flops:.2g} operations)")
        results = session.results
        held = int(results[_SIZE] * results[_UNIT])
        stats = self._stats(start, int(results[_L] + results[_U]), memory_bytes=held, flops=float(results[_FLOPS]))
        whole = None
        if self.structure != "spd":
            whole = sp.csc_array((values, self.pattern.indices, self.pattern.indptr), shape=(self.n, self.n))
        return _UmfpackFactor(session, stats, values.dtype, whole)


class _UmfpackFactor(SessionFactor):
    """The factor that an analysis holds. ``whole`` is the matrix, for a correction where pivots may be small."""

    _session: _Session

    def __init__(self, session: _Session, stats: FactorStats, dtype: Any, whole: sp.csc_array | None) -> None:
        super().__init__(session, stats, dtype)
        self._A = whole

    def _solve(self, B: Values) -> Values:
        X = self._session.solve(B)
        if self._A is None:
            return X
        size = abs(self._A)
        for first in range(0, B.shape[1], _BLOCK):
            part = slice(first, first + _BLOCK)
            residual = B[:, part] - self._A @ X[:, part]
            scale = size @ np.abs(X[:, part]) + np.abs(B[:, part])
            error = np.divide(np.abs(residual), scale, out=np.zeros(scale.shape), where=scale > 0).max(axis=0)
            poor = np.flatnonzero(error > _ACCURATE)
            if len(poor):
                X[:, first + poor] += self._session.solve(np.asfortranarray(residual[:, poor]))
        return X

    def _negative_pivots(self) -> int | None:
        # With pivots on the diagonal U = D L^T up to a positive scaling, and D is congruent to the matrix.
        diagonal = None if self._session.complex else self._session.diagonal()
        return None if diagonal is None else int(np.count_nonzero(diagonal < 0.0))

    def _release(self) -> None:
        self._A = None
        super()._release()


@dataclass(frozen=True, kw_only=True)
class Umfpack(ForeignSolver):
    """UMFPACK of the system (Debian: libsuitesparse-dev), in memory; ``scratch`` has no effect."""

    name: ClassVar[str] = "umfpack"
    # It counts only where all its pivots lie on the diagonal.
    counts: ClassVar[bool] = False
    library = staticmethod(umfpack_library)

    def _analyse(self, A: Lower, structure: str) -> Analysis:
        return _UmfpackAnalysis(self, self._loaded(), A, structure)
