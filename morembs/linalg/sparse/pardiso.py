"""PARDISO of Intel's MKL: supernodal factor of symmetric matrices, in memory, with the inertia.

Schenk and Gärtner 2004. The pattern is analysed once, in the order of METIS that MUMPS gets as well.
"""

from __future__ import annotations

import ctypes
import threading
import time
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from morembs.base.errors import SingularMatrixError, SolverError
from morembs.base.progress import SILENT, Progress
from morembs.base.types import Values
from morembs.linalg.sparse.interruptible import ForeignObject
from morembs.linalg.sparse.ordering import metis_ordering
from morembs.linalg.sparse.pardiso_library import mkl_library
from morembs.linalg.sparse.sessions import SessionAnalysis, SessionFactor
from morembs.linalg.sparse.solver import MECHANISM, Analysis, Factorization, Forecast, ForeignSolver
from morembs.linalg.sparse.symmetric import Lower

_MTYPE = {"spd": 2, "symmetric": -2, "complex-symmetric": 6}
_ANALYSE, _FACTORIZE, _SOLVE, _FREE_FACTOR, _FREE = 11, 22, 33, 0, -1
_SINGULAR = {-4, -7}
_WORDS = {
    -1: "it found its input invalid",
    -2: "memory could not be allocated",
    -3: "the ordering failed",
    -8: "the matrix is too large for its integers",
}
# Columns solved at once. Blocks of 16 cost twice the time per column, and 64 are close to 128.
_BLOCK = 128
# Pivots below 10^-this of the largest value count as zero. Small ones stay: the check of the factor judges them
# by the scale of their rows, which PARDISO ignores.
_ZERO = 20
# Beyond this backward error solutions are refined, in up to so many steps: beside an eigenvalue each gains a factor of
# twenty. (PARDISO's own refinement stopped at 5e-14 after three.)
_ACCURATE, _STEPS = 1e-14, 5
# Entries of a factor or a matrix that 32-bit integers count.
_MOST_ENTRIES = 2**31 - 1


class _Handle(ForeignObject):
    """One pattern in PARDISO; numbers of ``iparm`` count from zero, as in the C manual.

    ``wide`` takes 64-bit integers. ``matching`` permutes and scales large values towards the diagonal, which
    needs the values in the analysis and makes it good for that matrix alone.
    """

    def __init__(
        self, library: ctypes.CDLL, A: Lower, structure: str, order: Values | None, *, wide: bool, matching: bool
    ) -> None:
        super().__init__()
        self._integer: Any = ctypes.c_int64 if wide else ctypes.c_int32
        self._function = library.pardiso_64 if wide else library.pardiso
        dtype = np.int64 if wide else np.int32
        self.n, self._mtype, self.matching = A.n, _MTYPE[structure], matching
        self._indptr = np.ascontiguousarray(A.indptr, dtype=dtype)
        self._indices = np.ascontiguousarray(A.indices, dtype=dtype)
        self._order = np.zeros(A.n, dtype=dtype) if order is None else order.astype(dtype)
        self._pt, self.iparm = np.zeros(64, dtype=np.int64), np.zeros(64, dtype=dtype)
        iparm = self.iparm
        iparm[0], iparm[1], iparm[34] = 1, 2, 1
        iparm[4] = 0 if order is None else 1
        iparm[9], iparm[20] = _ZERO, 1
        iparm[10] = iparm[12] = int(matching)
        # Not 10, the newer variant of two levels: it gives no inertia, and solves four times slower.
        iparm[23] = 1
        # Ask for the entries of the factor and for the operations in millions.
        iparm[17] = iparm[18] = -1
        self._a: Values = A.data
        # The matrix and its largest value, where solutions have to be refined.
        self._A: Lower | None = None
        self._size = 0.0
        self._solving = threading.Lock()

    def run(
        self, phase: int, B: Values | None = None, X: Values | None = None, progress: Progress = SILENT, news: str = ""
    ) -> int:
        """The code of an error, 0 for none."""
        return self.call(self._call, phase, B, X, progress=progress, news=news)

    def _call(self, phase: int, B: Values | None, X: Values | None) -> int:
        def number(value: int) -> Any:
            return ctypes.byref(self._integer(value))

        def address(array: Values | None) -> ctypes.c_void_p:
            # Not array.ctypes.data: that imports a module, which fails when the interpreter is ending.
            return ctypes.c_void_p(None if array is None else array.__array_interface__["data"][0])

        code = self._integer(0)
        self._function(
            address(self._pt),
            number(1),
            number(1),
            number(self._mtype),
            number(phase),
            number(self.n),
            address(self._a),
            address(self._indptr),
            address(self._indices),
            address(self._order),
            number(1 if B is None else B.shape[1]),
            address(self.iparm),
            number(0),
            address(B),
            address(X),
            ctypes.byref(code),
        )
        return int(code.value)

    def factorize(self, A: Lower, progress: Progress, news: str) -> int:
        """Numerical phase; the code of an error, 0 for none."""
        self._a, self._A = np.ascontiguousarray(A.data), None
        code = self.run(_FACTORIZE, progress=progress, news=news)
        # The solution does not read the matrix again.
        self._a = self._a[:0]
        if code == 0 and self._mtype != _MTYPE["spd"] and self._backward_error(A) > _ACCURATE:
            self._A = A
        return code

    def _backward_error(self, A: Lower) -> float:
        b = np.random.default_rng(13).standard_normal((self.n, 1)).astype(A.data.dtype)
        x = self.solve(np.asfortranarray(b))
        self._size = float(A.largest_in_rows().max())
        return self._worst(b - A @ x, x, b)

    def _worst(self, rest: Values, x: Values, b: Values) -> float:
        """Largest backward error of the columns ``x`` with the residuals ``rest``."""
        norms = [np.linalg.norm(V, axis=0) for V in (rest, x, b)]
        return float((norms[0] / (self._size * norms[1] + norms[2] + np.finfo(float).tiny)).max())

    def solve(self, B: Values) -> Values:
        """Solution (n, k) for the Fortran-ordered ``B`` (n, k)."""
        X = np.empty_like(B, order="F")
        with self._solving:
            for first in range(0, B.shape[1], _BLOCK):
                b, x = B[:, first : first + _BLOCK], X[:, first : first + _BLOCK]
                self._solve(b, x)
                if self._A is not None:
                    self._refine(self._A, b, x)
        return X

    def _refine(self, A: Lower, b: Values, x: Values) -> None:
        step = np.empty_like(b, order="F")
        for _ in range(_STEPS):
            rest = np.asfortranarray(b - A @ x)
            if self._worst(rest, x, b) <= _ACCURATE:
                return
            self._solve(rest, step)
            x += step

    def _solve(self, B: Values, X: Values) -> None:
        code = self.run(_SOLVE, B, X)
        if code:
            raise failure("solution", code)

    def vanished(self, code: int) -> bool:
        """Whether pivots vanished, by the ``code`` of the factorisation, or were replaced: then the factor is one of
        another matrix."""
        return code in _SINGULAR or (code == 0 and bool(self.iparm[13]))

    def drop_factor(self) -> None:
        """Free the numerical factor and keep the analysis."""
        if not self.abandoned:
            self._call(_FREE_FACTOR, None, None)

    def _free(self) -> None:
        self._call(_FREE, None, None)


def failure(phase: str, code: int) -> SolverError:
    """The exception for a call that failed."""
    return SolverError(f"PARDISO failed in the {phase}: error {code}: {_WORDS.get(code, 'see the manual of MKL')}")


class _Session:
    """The handles of one pattern: that of its analysis, and one for a single matrix whose pivots vanished."""

    def __init__(self, library: ctypes.CDLL, A: Lower, structure: str) -> None:
        self.library, self.structure, self.order = library, structure, metis_ordering(A)
        self._handles: list[_Handle] = []

    @property
    def handle(self) -> _Handle:
        """The handle of the newest factor."""
        return self._handles[-1]

    def analyse(self, A: Lower, progress: Progress, *, wide: bool, matching: bool = False) -> None:
        """One handle more, with 64-bit integers where they are wanted (``wide``) or needed."""
        # The order of METIS would pull apart what the matching joins.
        order = None if matching else self.order
        handle = _Handle(self.library, A, self.structure, order, wide=wide, matching=matching)
        self._handles.append(handle)
        code = handle.run(_ANALYSE, progress=progress, news="analysing")
        entries = max(int(handle.iparm[17]), 1024 * int(handle.iparm[16]) // A.data.dtype.itemsize)
        if not wide and (code or not 0 < entries <= _MOST_ENTRIES):
            self._handles.pop().close()
            self.analyse(A, progress, wide=True, matching=matching)
        elif code:
            raise failure("analysis", code)

    def factorize(self, A: Lower, progress: Progress, news: str) -> None:
        """Numerical phase; once more, with large values moved to the diagonal, where a pivot vanished.

        Raises:
            SingularMatrixError: not positive definite, or without pivots.
        """
        for special in self._handles[1:]:
            special.close()
        del self._handles[1:]
        code = self.handle.factorize(A, progress, news)
        if self.structure != "spd" and self.handle.vanished(code):
            self.forget()
            self.analyse(A, progress, wide=self.handle.iparm.itemsize == 8, matching=True)
            code = self.handle.factorize(A, progress, news)
        if self.handle.vanished(code):
            self.forget()
            if self.structure == "spd":
                raise SingularMatrixError(f"the matrix should be positive definite but is not; {MECHANISM}")
            raise SingularMatrixError(f"the matrix is singular, or PARDISO finds no pivots for it; {MECHANISM}")
        if code:
            raise failure("factorisation", code)

    def forget(self) -> None:
        """Free the numerical factor and keep the analysis."""
        self.handle.drop_factor()

    def close(self) -> None:
        """Free everything."""
        for handle in self._handles:
            handle.close()


class _PardisoAnalysis(SessionAnalysis):
    """The symbolic factor, which takes the values of one matrix after the other."""

    instead = "can keep it on disk"
    session: _Session

    def _demand(self, A: Lower) -> Forecast:
        """What the symbolic factor says; PARDISO counts memory in units of 1024 bytes."""
        self.session.analyse(A, self.solver.progress, wide=A.nnz > _MOST_ENTRIES)
        iparm = self.session.handle.iparm
        peak, symbolic, numeric = (1024 * int(value) for value in iparm[14:17])
        integers = iparm.itemsize * (self.lower_nnz + 2 * self.n)
        kept = symbolic + numeric + integers
        return Forecast(
            backend=self.solver.name,
            size=self.n,
            factor_entries=int(iparm[17]),
            flops=1e6 * float(iparm[18]),
            memory=max(peak + integers, kept),
            kept=kept,
        )

    def factorize_unchecked(self, A: Lower) -> Factorization:
        start = time.perf_counter()
        news = f"factorising ({self._forecast.flops:.2g} operations)"
        self.session.factorize(A, self.solver.progress, news)
        entries, dtype = int(self.session.handle.iparm[17]), A.data.dtype
        stats = self._stats(start, entries, memory_bytes=dtype.itemsize * entries)
        return _PardisoFactor(self.session, stats, dtype)


class _PardisoFactor(SessionFactor):
    """The factor that an analysis holds."""

    _session: _Session

    def _solve(self, B: Values) -> Values:
        return self._session.handle.solve(B)

    def _negative_pivots(self) -> int | None:
        return None if self.dtype.kind == "c" else int(self._session.handle.iparm[22])


@dataclass(frozen=True, kw_only=True)
class Pardiso(ForeignSolver):
    """PARDISO of MKL, in memory; ``scratch`` has no effect."""

    name: ClassVar[str] = "pardiso"
    library = staticmethod(mkl_library)

    def _analyse(self, A: Lower, structure: str) -> Analysis:
        return _PardisoAnalysis(self, A, structure, _Session(self._loaded(), A, structure))
