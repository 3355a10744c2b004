"""PARDISO of Intel's MKL: supernodal factor of symmetric matrices, in memory, with the inertia.

Schenk and Gärtner 2004. The pattern is analysed once, in the order of METIS that MUMPS gets as well.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from morembs.base.errors import SingularMatrixError
from morembs.base.types import Ints, Values
from morembs.linalg.sparse.ordering import metis_ordering
from morembs.linalg.sparse.pardiso_library import KINDS, SINGULAR, WORDS, Phase, Place, Unit, mkl_library
from morembs.linalg.sparse.session import FactorSize, Session, SessionSolver
from morembs.linalg.sparse.solver import MECHANISM, Forecast
from morembs.linalg.sparse.symmetric import Lower
from morembs.linalg.sparse.tolerances import TOL


class _Handle:
    """One pattern in PARDISO and the array ``iparm``, which says how it is treated and what came of it.

    ``wide`` takes 64-bit integers. ``matching`` permutes and scales large values towards the diagonal, which
    needs the values in the analysis and makes it good for that matrix alone.
    """

    def __init__(
        self, library: Any, A: Lower, structure: str, order: Ints | None, *, wide: bool, matching: bool
    ) -> None:
        self._integer: Any = ctypes.c_int64 if wide else ctypes.c_int32
        self._function = library.pardiso_64 if wide else library.pardiso
        dtype = np.int64 if wide else np.int32
        self._n, self._kind = A.n, KINDS[structure]
        self._indptr = np.ascontiguousarray(A.indptr, dtype=dtype)
        self._indices = np.ascontiguousarray(A.indices, dtype=dtype)
        self._order = np.zeros(A.n, dtype=dtype) if order is None else order.astype(dtype)
        self._pt = np.zeros(Place.LENGTH, dtype=np.int64)
        self.iparm = np.zeros(Place.LENGTH, dtype=dtype)
        # Not 10 for two levels, the newer variant: it gives no inertia, and solves four times slower. Minus one asks
        # for the entries of the factor and for the operations in millions.
        settings = {
            Place.NOT_DEFAULT: 1,
            Place.ORDERING: 2,
            Place.GIVEN_ORDER: order is not None,
            Place.ZERO_PIVOT: TOL.zero_pivot_digits,
            Place.SCALING: matching,
            Place.MATCHING: matching,
            Place.ENTRIES: -1,
            Place.MEGAFLOPS: -1,
            Place.TWO_BY_TWO_PIVOTS: 1,
            Place.TWO_LEVELS: 1,
            Place.FROM_ZERO: 1,
        }
        for place, value in settings.items():
            self.iparm[place] = value
        # Values of the matrix, which the solution does not read again.
        self.values: Values = A.data

    def run(self, phase: int, B: Values | None = None, X: Values | None = None) -> int:
        """The code of an error, 0 for none."""

        def number(value: int) -> Any:
            return ctypes.byref(self._integer(value))

        def address(array: Values | None) -> ctypes.c_void_p:
            # Not array.ctypes.data: that imports a module, which fails when the interpreter is ending.
            return ctypes.c_void_p(None if array is None else array.__array_interface__["data"][0])

        code = self._integer(0)
        columns = 1 if B is None else B.shape[1]
        self._function(
            address(self._pt),
            *map(number, (1, 1, self._kind, phase, self._n)),
            *map(address, (self.values, self._indptr, self._indices, self._order)),
            number(columns),
            address(self.iparm),
            number(0),
            *map(address, (B, X)),
            ctypes.byref(code),
        )
        return int(code.value)

    def lost_pivots(self, code: int) -> bool:
        """True if pivots vanished, by the ``code`` of the factorisation, or were replaced: then the factor is one of
        another matrix."""
        return code in SINGULAR or (code == 0 and bool(self.iparm[Place.REPLACED_PIVOTS]))


class _PardisoSession(Session):
    """The handles of one pattern: that of its analysis, and one for a single matrix whose pivots vanished."""

    title = "PARDISO"
    words = WORDS

    def __init__(self, solver: SessionSolver, A: Lower, structure: str) -> None:
        super().__init__(solver, A, structure)
        self.columns = TOL.supernodal_columns
        self._order = metis_ordering(A)
        self._handles: list[_Handle] = []
        # The matrix and its largest value, where solutions have to be refined.
        self._A: Lower | None = None
        self._size = 0.0

    def _open(self, A: Lower, *, wide: bool, matching: bool = False) -> None:
        """One handle more, with 64-bit integers where they are wanted (``wide``) or needed."""
        # The order of METIS would pull apart what the matching joins.
        order = None if matching else self._order
        handle = _Handle(self.library, A, self.structure, order, wide=wide, matching=matching)
        self._handles.append(handle)
        code = self.run(handle.run, Phase.ANALYSE)
        memory = Unit.KIBIBYTE * int(handle.iparm[Place.KEPT_BY_FACTOR])
        entries = max(int(handle.iparm[Place.ENTRIES]), memory // self.dtype.itemsize)
        if not wide and (code or not 0 < entries <= np.iinfo(np.int32).max):
            self._handles.pop().run(Phase.FREE)
            self._open(A, wide=True, matching=matching)
        elif code:
            raise self.failure("the analysis", code)

    def _analyse(self, A: Lower) -> Forecast:
        self._open(A, wide=A.nnz > np.iinfo(np.int32).max)
        iparm = self._handles[-1].iparm
        places = (Place.PEAK_OF_ANALYSIS, Place.KEPT_BY_ANALYSIS, Place.KEPT_BY_FACTOR)
        peak, symbolic, numeric = (Unit.KIBIBYTE * int(iparm[place]) for place in places)
        integers = iparm.itemsize * (self.lower_nnz + 2 * self.n)
        kept = symbolic + numeric + integers
        flops = 1e6 * float(iparm[Place.MEGAFLOPS])
        return self.forecast(
            entries=int(iparm[Place.ENTRIES]), flops=flops, memory=max(peak + integers, kept), kept=kept
        )

    def _factorize(self, A: Lower) -> FactorSize:
        """Once more, with large values moved to the diagonal, where a pivot vanished."""
        for special in self._handles[1:]:
            special.run(Phase.FREE)
        del self._handles[1:]
        code = self._eliminate(A)
        if self.structure != "spd" and self._handles[-1].lost_pivots(code):
            self.forget()
            self._open(A, wide=self._handles[-1].iparm.itemsize == np.dtype(np.int64).itemsize, matching=True)
            code = self._eliminate(A)
        if self._handles[-1].lost_pivots(code):
            self.forget()
            if self.structure == "spd":
                raise SingularMatrixError(f"the matrix should be positive definite but is not; {MECHANISM}")
            raise SingularMatrixError(f"the matrix is singular, or PARDISO finds no pivots for it; {MECHANISM}")
        if code:
            raise self.failure("the factorisation", code)
        entries = int(self._handles[-1].iparm[Place.ENTRIES])
        return FactorSize(entries=entries, memory=self.dtype.itemsize * entries)

    def _eliminate(self, A: Lower) -> int:
        """Numerical phase with the newest handle; the code of an error, 0 for none."""
        handle = self._handles[-1]
        handle.values, self._A = np.ascontiguousarray(A.data), None
        code = self.run(handle.run, Phase.FACTORIZE)
        handle.values = handle.values[:0]
        if code == 0 and self.structure != "spd" and self._trial_error(A) > TOL.refined_error:
            self._A = A
        return code

    def _trial_error(self, A: Lower) -> float:
        """Backward error of a random right-hand side."""
        b = np.asfortranarray(np.random.default_rng(13).standard_normal((self.n, 1)).astype(self.dtype))
        x = self._solve(b)
        self._size = float(A.largest_in_rows().max())
        return self._backward_error(b - A @ x, x, b)

    def _backward_error(self, residual: Values, x: Values, b: Values) -> float:
        """Largest backward error of the columns ``x`` with their ``residual``."""
        norms = [np.linalg.norm(V, axis=0) for V in (residual, x, b)]
        return float((norms[0] / (self._size * norms[1] + norms[2] + np.finfo(float).tiny)).max())

    def _solve(self, B: Values) -> Values:
        """The solution, refined in steps of our own: those of PARDISO stopped at 5e-14 after three."""
        X = self._substitute(B)
        for _ in range(TOL.refinement_steps if self._A is not None else 0):
            residual = np.asfortranarray(B - self._A @ X)
            if self._backward_error(residual, X, B) <= TOL.refined_error:
                break
            X += self._substitute(residual)
        return X

    def _substitute(self, B: Values) -> Values:
        X = np.empty_like(B, order="F")
        if code := self.run(self._handles[-1].run, Phase.SOLVE, B, X):
            raise self.failure("the solution", code)
        return X

    def _negative_pivots(self) -> int | None:
        return None if self.dtype.kind == "c" else int(self._handles[-1].iparm[Place.NEGATIVE_PIVOTS])

    def _forget(self) -> None:
        self._A = None
        self._handles[-1].run(Phase.FREE_FACTOR)

    def _free(self) -> None:
        for handle in self._handles:
            handle.run(Phase.FREE)


@dataclass(frozen=True, kw_only=True)
class Pardiso(SessionSolver):
    """PARDISO of MKL, in memory; ``scratch`` has no effect."""

    name: ClassVar[str] = "pardiso"
    session = _PardisoSession
    library = staticmethod(mkl_library)
