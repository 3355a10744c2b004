"""CHOLMOD: supernodal Cholesky factor L L' of positive definite matrices, in memory.

Chen, Davis, Hager and Rajamanickam 2008. Half the storage and none of the pivot search of a factor L D L'.
Its supernodal part is under the GPL: it is loaded from the user's system where it is installed, never shipped.
"""

from __future__ import annotations

import ctypes
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from threadpoolctl import ThreadpoolController

from morembs.base.errors import SingularMatrixError
from morembs.base.types import Ints, Values
from morembs.linalg.sparse.cholmod_library import Code, Library, cholmod_library
from morembs.linalg.sparse.ordering import metis_ordering
from morembs.linalg.sparse.session import FactorSize, Session, SessionSolver
from morembs.linalg.sparse.solver import MECHANISM, Forecast
from morembs.linalg.sparse.symmetric import Lower
from morembs.linalg.sparse.tolerances import TOL

# The number of threads of the BLAS belongs to the whole process.
_SIDE_BY_SIDE = threading.Lock()


class _Place:
    """Where one thread solves: a workspace of CHOLMOD, and two arrays that it allocates for a block of right-hand sides
    and uses again for the next."""

    def __init__(self, library: Library) -> None:
        self.common = library.start_workspace()
        self.workspace = [ctypes.c_void_p(), ctypes.c_void_p()]


class _CholmodSession(Session):
    """The workspace of CHOLMOD and the factor, first symbolic."""

    title = "CHOLMOD"
    words: ClassVar[dict[int, str]] = {
        -1: "it was built without a part that is needed",
        -2: "memory could not be allocated",
        -3: "the matrix is too large for its integers",
        -4: "it found its input invalid",
    }
    library: Library

    def __init__(self, solver: SessionSolver, A: Lower, structure: str) -> None:
        super().__init__(solver, A, structure)
        self.columns = TOL.supernodal_columns
        self._factor = ctypes.c_void_p()
        self._blas = ThreadpoolController().select(user_api="blas")
        self._places = [_Place(self.library)]
        self.common = common = self._places[0].common
        common.supernodal, common.final_ll, common.quick_return_if_not_posdef = Code.ALWAYS_SUPERNODAL, 1, 1
        common.postorder = 1

    @property
    def factor(self) -> Any:
        """The structure cholmod_factor."""
        return self.library.structures["factor"].from_address(self._factor.value or 0)

    def _call_checked(self, name: str, *args: Any) -> None:
        """Call cholmod_l_``name``; raises SolverError where CHOLMOD reports an error."""
        self.run(self._call, name, *args)
        code = int(self.common.status)
        if code < 0:
            raise self.failure(name, code)

    def _call(self, name: str, *args: Any) -> None:
        with self.library.serial_loops():
            result = self.library.functions[name](*args, ctypes.byref(self.common))
        if name == "analyze_p":
            # Noted here, because no other holder may be left to free it.
            self._factor = ctypes.c_void_p(result)

    def eliminate(self, A: Lower, order: Ints | None) -> None:
        """Make the symbolic factor of the pattern of ``A``, eliminated in ``order`` (n,)."""
        if order is not None:
            self.common.nmethods, self.common.method[0].ordering = 1, Code.GIVEN_ORDER
        # Keeps the array alive as long as the call may read it.
        given = None if order is None else order.ctypes.data_as(ctypes.c_void_p)
        matrix = self.library.sparse(A, values=False)
        self._call_checked("analyze_p", ctypes.byref(matrix), given, None, ctypes.c_size_t(0))

    def _analyse(self, A: Lower) -> Forecast:
        self.eliminate(A, metis_ordering(A))
        factor, common = self.factor, self.common
        entries = int(factor.xsize)
        kept_bytes = 8 * entries + int(common.memory_inuse)
        # Integers of our copy of the matrix; then the permuted copy that CHOLMOD makes, with its values.
        matrix = 8 * (self.lower_nnz + self.n) + 16 * self.lower_nnz + 8 * self.n
        peak = kept_bytes + matrix + 8 * int(factor.maxcsize)
        return self.forecast(entries=entries, flops=float(common.fl), memory=peak, kept=kept_bytes)

    def _factorize(self, A: Lower) -> FactorSize:
        matrix = self.library.sparse(A)
        self._call_checked("factorize", ctypes.byref(matrix), self._factor)
        if self.common.status == Code.NOT_POSITIVE_DEFINITE:
            pivot = self.factor.minor + 1
            self.forget()
            raise SingularMatrixError(
                f"the matrix should be positive definite but its pivot {pivot} of {self.factor.n} is not "
                f"positive; {MECHANISM}"
            )
        entries = int(self.factor.xsize)
        return FactorSize(entries=entries, memory=8 * entries)

    def _forget(self) -> None:
        if self._factor:
            self._call("change_factor", 0, 1, 1, 1, 1, self._factor)

    def solve(self, B: Values, transposed: bool = False) -> Values:
        with self.solving:
            try:
                return super().solve(B)
            finally:
                if not self.abandoned:
                    self._free_workspace()

    def _solve(self, B: Values) -> Values:
        self.run(self._solve_side_by_side, B)
        return B

    def _solve_side_by_side(self, X: Values) -> None:
        """Overwrite ``X`` in parts, one for each thread of the BLAS.

        The many small products of a solve gain little from threads of their own; parts share their input.
        """
        threads = max((library.num_threads for library in self._blas.lib_controllers), default=1)
        parts = min(threads, X.shape[1] // TOL.columns_per_thread)
        if parts < 2:
            self._solve_part(self._places[0], X)
            return
        self._places.extend(_Place(self.library) for _ in range(parts - len(self._places)))
        edges = [X.shape[1] * part // parts for part in range(parts + 1)]
        columns = [X[:, first:last] for first, last in pairwise(edges)]
        with _SIDE_BY_SIDE, self._blas.limit(limits=1), ThreadPoolExecutor(parts) as pool:
            list(pool.map(self._solve_part, self._places[:parts], columns))

    def _solve_part(self, place: _Place, X: Values) -> None:
        B, solution = self.library.dense(X), self.library.dense(X)
        # CHOLMOD copies the right-hand side before it writes the solution, so both may be one array.
        target = ctypes.pointer(solution)
        handles = [ctypes.byref(handle) for handle in place.workspace]
        given = (Code.SOLVE_WHOLE, self._factor, ctypes.byref(B), None, ctypes.byref(target), None)
        with self.library.serial_loops():
            done = self.library.functions["solve2"](*given, *handles, ctypes.byref(place.common))
        if not done or place.common.status < 0 or ctypes.addressof(target.contents) != ctypes.addressof(solution):
            raise self.failure("the solution", int(place.common.status))

    def _negative_pivots(self) -> int | None:
        return 0

    def _free_workspace(self) -> None:
        for place in self._places:
            for handle in place.workspace:
                self.library.functions["free_dense"](ctypes.byref(handle), ctypes.byref(place.common))

    def _free(self) -> None:
        self._free_workspace()
        self.library.functions["free_factor"](ctypes.byref(self._factor), ctypes.byref(self.common))
        for place in self._places:
            self.library.functions["finish"](ctypes.byref(place.common))


@dataclass(frozen=True, kw_only=True)
class Cholmod(SessionSolver):
    """CHOLMOD of the system (Debian: libsuitesparse-dev), in memory; ``scratch`` has no effect."""

    name: ClassVar[str] = "cholmod"
    structures: ClassVar[tuple[str, ...]] = ("spd",)
    counts: ClassVar[bool] = False
    session = _CholmodSession
    library = staticmethod(cholmod_library)


@dataclass(frozen=True)
class Fill:
    """What Cholesky would fill in: ``order`` (n,) is a postorder of the elimination tree with the same fill,
    ``entries`` and ``flops`` those of a real L."""

    order: Ints
    entries: int
    flops: float


def fill_of(A: Lower, order: Ints | None) -> Fill | None:
    """Fill of the pattern of ``A`` eliminated in ``order`` (n,); None where there is no CHOLMOD."""
    if isinstance(cholmod_library(), str):
        return None
    session = _CholmodSession(Cholmod(), A, "spd")
    try:
        session.eliminate(A, order)
        integers = ctypes.c_int64 * A.n
        postorder = np.ctypeslib.as_array(integers.from_address(session.factor.Perm)).copy()
        return Fill(postorder, int(session.common.lnz), float(session.common.fl))
    finally:
        session.close()
