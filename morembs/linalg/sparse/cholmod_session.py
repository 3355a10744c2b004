"""One pattern in CHOLMOD: the thin layer between arrays and the structures of its C interface."""

from __future__ import annotations

import ctypes
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from morembs.base.errors import SingularMatrixError, SolverError
from morembs.base.progress import SILENT, Progress
from morembs.base.types import Values
from morembs.linalg.sparse.cholmod_library import (
    GIVEN,
    LONG,
    NOT_POSITIVE_DEFINITE,
    REAL,
    SUPERNODAL,
    Library,
    cholmod_library,
)
from morembs.linalg.sparse.interruptible import ForeignObject
from morembs.linalg.sparse.solver import MECHANISM
from morembs.linalg.sparse.symmetric import Lower

# Columns solved at once. Narrow blocks spend their time in reading the factor; wider ones gain nothing more.
_BLOCK = 128
# Fewer columns than this are not worth a thread: it reads the whole factor for them.
_NARROW = 8
# The number of threads of the BLAS belongs to the whole process.
_SIDE_BY_SIDE = threading.Lock()
_WORDS = {
    -1: "it was built without a part that is needed",
    -2: "memory could not be allocated",
    -3: "the matrix is too large for its integers",
    -4: "it found its input invalid",
}


class _Place:
    """Where one thread solves: a workspace of CHOLMOD, and two arrays that it allocates for a block of right-hand sides
    and uses again for the next."""

    def __init__(self, common: Any) -> None:
        self.common = common
        common.print = 0
        common.error_handler = None
        self.workspace = [ctypes.c_void_p(), ctypes.c_void_p()]


class Session(ForeignObject):
    """The foreign objects of one pattern: the workspace of CHOLMOD and the factor, first symbolic."""

    def __init__(self, library: Library) -> None:
        super().__init__()
        self.library = library
        self.common = library.new("common")
        self._factor = ctypes.c_void_p()
        self._solving = threading.Lock()
        self._blas = ThreadpoolController().select(user_api="blas")
        library.functions["start"](ctypes.byref(self.common))
        self._places = [_Place(self.common)]
        common = self.common
        common.supernodal, common.final_ll, common.quick_return_if_not_posdef = SUPERNODAL, 1, 1
        common.postorder = 1

    @property
    def factor(self) -> Any:
        """The structure cholmod_factor."""
        return self.library.structures["factor"].from_address(self._factor.value or 0)

    def run(self, name: str, *args: Any, progress: Progress = SILENT, news: str = "") -> Any:
        """Call cholmod_l_``name`` with ``args`` and the workspace; its result.

        Raises:
            SolverError: CHOLMOD reports an error, or a call before was abandoned.
        """
        result = self.call(self._call, name, args, progress=progress, news=news)
        code = int(self.common.status)
        if code < 0:
            raise SolverError(f"CHOLMOD failed in {name}: status {code}: {_WORDS.get(code, 'see its manual')}")
        return result

    def _call(self, name: str, args: tuple[Any, ...]) -> Any:
        with self.library.serial_loops():
            result = self.library.functions[name](*args, ctypes.byref(self.common))
        if name == "analyze_p":
            # Noted here, because no other holder may be left to free it.
            self._factor = ctypes.c_void_p(result)
        return result

    def analyse(self, A: Any, order: NDArray[np.int64] | None, progress: Progress) -> None:
        """Make the symbolic factor of ``A``, a structure cholmod_sparse."""
        if order is not None:
            self.common.nmethods, self.common.method[0].ordering = 1, GIVEN
        # Keeps the array alive as long as the call may read it.
        given = None if order is None else order.ctypes.data_as(ctypes.c_void_p)
        self.run("analyze_p", ctypes.byref(A), given, None, ctypes.c_size_t(0), progress=progress, news="analysing")

    def factorize(self, A: Any, progress: Progress, news: str) -> None:
        """Put the values of ``A`` into the factor.

        Raises:
            SingularMatrixError: not positive definite.
        """
        self.run("factorize", ctypes.byref(A), self._factor, progress=progress, news=news)
        if self.common.status == NOT_POSITIVE_DEFINITE:
            pivot = self.factor.minor + 1
            self.forget()
            raise SingularMatrixError(
                f"the matrix should be positive definite but its pivot {pivot} of {self.factor.n} is not "
                f"positive; {MECHANISM}"
            )

    def forget(self) -> None:
        """Drop the values of the factor and keep its pattern."""
        if not self.abandoned and self._factor:
            self._call("change_factor", (0, 1, 1, 1, 1, self._factor))

    def solve(self, X: Values) -> None:
        """Overwrite the Fortran-ordered ``X`` (n, k) with the solution, a block of columns at a time."""
        with self._solving:
            try:
                for first in range(0, X.shape[1], _BLOCK):
                    self.call(self._solve_block, X[:, first : first + _BLOCK])
            finally:
                if not self.abandoned:
                    self._free_workspace()

    def _solve_block(self, X: Values) -> None:
        """Solve in parts side by side, one for each thread of the BLAS.

        The many small products of a solve gain little from threads of their own; parts share what they read.
        """
        threads = max((library.num_threads for library in self._blas.lib_controllers), default=1)
        parts = min(threads, X.shape[1] // _NARROW)
        if parts < 2:
            self._solve_part(self._places[0], X)
            return
        while len(self._places) < parts:
            common = self.library.new("common")
            self.library.functions["start"](ctypes.byref(common))
            self._places.append(_Place(common))
        edges = [X.shape[1] * part // parts for part in range(parts + 1)]
        columns = [X[:, first:last] for first, last in pairwise(edges)]
        with _SIDE_BY_SIDE, self._blas.limit(limits=1), ThreadPoolExecutor(parts) as pool:
            list(pool.map(self._solve_part, self._places[:parts], columns))

    def _solve_part(self, place: _Place, X: Values) -> None:
        B, solution = _dense(self.library, X), _dense(self.library, X)
        # CHOLMOD copies the right-hand side before it writes the solution, so both may be one array.
        target = ctypes.pointer(solution)
        handles = [ctypes.byref(handle) for handle in place.workspace]
        with self.library.serial_loops():
            done = self.library.functions["solve2"](
                0, self._factor, ctypes.byref(B), None, ctypes.byref(target), None, *handles, ctypes.byref(place.common)
            )
        if not done or place.common.status < 0 or ctypes.addressof(target.contents) != ctypes.addressof(solution):
            raise SolverError(f"CHOLMOD failed in the solution: status {int(place.common.status)}")

    def _free_workspace(self) -> None:
        for place in self._places:
            for handle in place.workspace:
                self.library.functions["free_dense"](ctypes.byref(handle), ctypes.byref(place.common))

    def _free(self) -> None:
        functions, common = self.library.functions, ctypes.byref(self.common)
        self._free_workspace()
        functions["free_factor"](ctypes.byref(self._factor), common)
        for place in self._places:
            functions["finish"](ctypes.byref(place.common))


def sparse(library: Library, A: Lower, values: bool = True) -> Any:
    """``A`` as a structure cholmod_sparse, which keeps its arrays alive; its pattern only without ``values``."""
    matrix = library.new("sparse")
    numbers = [array.astype(np.int64) for array in (A.indptr, A.indices)]
    matrix.p, matrix.i = (array.ctypes.data for array in numbers)
    matrix.held = numbers
    if values:
        data = np.ascontiguousarray(A.data, dtype=np.float64)
        matrix.x, matrix.xtype = data.ctypes.data, REAL
        matrix.held.append(data)
    matrix.nrow = matrix.ncol = A.n
    matrix.nzmax = A.nnz
    matrix.stype, matrix.itype, matrix.sorted, matrix.packed = -1, LONG, 1, 1
    return matrix


def _dense(library: Library, X: Values) -> Any:
    """The Fortran-ordered ``X`` (n, k) as a structure cholmod_dense."""
    matrix = library.new("dense")
    matrix.nrow, matrix.ncol = X.shape
    matrix.d, matrix.nzmax = X.shape[0], X.size
    matrix.x, matrix.xtype = X.ctypes.data, REAL
    matrix.held = X
    return matrix


@dataclass(frozen=True)
class Fill:
    """What Cholesky would fill in: ``order`` (n,) is a postorder of the elimination tree with the same fill,
    ``entries`` and ``flops`` those of a real L."""

    order: NDArray[np.int64]
    entries: int
    flops: float


def fill_of(A: Lower, order: NDArray[np.int64] | None) -> Fill | None:
    """Fill of the pattern of ``A`` eliminated in ``order`` (n,); None where there is no CHOLMOD."""
    library = cholmod_library()
    if isinstance(library, str):
        return None
    session = Session(library)
    try:
        session.analyse(sparse(library, A, values=False), order, SILENT)
        integers = ctypes.c_int64 * A.n
        postorder = np.ctypeslib.as_array(integers.from_address(session.factor.Perm)).copy()
        return Fill(postorder, int(session.common.lnz), float(session.common.fl))
    finally:
        session.close()
