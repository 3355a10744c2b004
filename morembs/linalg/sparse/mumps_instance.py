"""One instance of MUMPS: the thin layer between arrays and the structure of its C interface.

Numbers of controls are those of the manual: ICNTL(k), CNTL(k), INFOG(k), RINFOG(k).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from morembs.base.errors import SingularMatrixError, SolverError
from morembs.base.progress import SILENT, Progress
from morembs.base.types import Values
from morembs.linalg.sparse.interruptible import ForeignObject
from morembs.linalg.sparse.mumps_library import USE_COMM_WORLD, Library
from morembs.linalg.sparse.solver import MECHANISM
from morembs.linalg.sparse.symmetric import General, Lower

SYM = {"spd": 1, "symmetric": 2, "complex-symmetric": 2, "unsymmetric": 0, "complex-unsymmetric": 0}
ANALYSE, FACTORIZE, SOLVE, END, FREE_FACTOR = 1, 2, 3, -2, -4
_SINGULAR = {-10, -40}
_MILLION = 1_000_000
# KEEP(421): -1 where updates of symmetric fronts go through DGEMMT.
_SYMMETRIC_PRODUCT = 420
_WORDS = {
    -5: "memory could not be allocated",
    -7: "memory could not be allocated",
    -13: "memory could not be allocated",
    -8: "integer workspace too small",
    -9: "workspace too small",
    -11: "workspace too small for the solution",
    -14: "integer workspace too small for the solution",
    -19: "the memory budget is too small",
    -20: "buffer too small",
    -51: "the graph is too large for 32-bit integers",
    -52: "the graph is too large for 32-bit integers",
    -90: "the scratch folder cannot be written or is full; make room there, or give another one",
}


class Instance(ForeignObject):
    """MUMPS between JOB = -1 and JOB = -2.

    A signal ends the wait for a job at once. The job itself cannot be stopped: the instance is then abandoned,
    and freed when the job has ended.
    """

    def __init__(self, library: Library, structure: str, dtype: Any) -> None:
        super().__init__()
        self.library = library
        self.dtype = np.dtype(dtype)
        # MUMPS keeps the addresses: these have to live as long as it may read them.
        self._held: dict[str, Values] = {}
        # None where MUMPS has no instance: a call would end the process without a message.
        self._data: Any = None
        data: Any = library.structure()
        data.par, data.sym, data.comm_fortran = 1, SYM[structure], USE_COMM_WORLD
        library.call(data, -1)
        self._data = data
        for number in (1, 2, 3, 4):
            self.control(number, 0)
        if library.other_blas and data.keep[_SYMMETRIC_PRODUCT] == -1:
            # By blocks of DGEMM: OpenBLAS makes DGEMMT column by column, and not all others have it.
            data.keep[_SYMMETRIC_PRODUCT] = 0

    def control(self, number: int, value: int) -> None:
        """Set ICNTL(number)."""
        self._data.icntl[number - 1] = value

    def real_control(self, number: int, value: float) -> None:
        """Set CNTL(number)."""
        self._data.cntl[number - 1] = value

    def info(self, number: int) -> int:
        """INFOG(number)."""
        return int(self._data.infog[number - 1])

    def count(self, number: int) -> int:
        """INFOG(number), a count given in negative millions where 32 bits are too few."""
        value = self.info(number)
        return value if value >= 0 else -value * _MILLION

    def real_info(self, number: int) -> float:
        """RINFOG(number)."""
        return float(self._data.rinfog[number - 1])

    def give(self, name: str, array: Values | None) -> None:
        """Set a pointer of the structure and keep its array alive; None takes it back."""
        if array is None:
            self._held.pop(name, None)
            setattr(self._data, name, None)
        else:
            self._held[name] = array
            setattr(self._data, name, array.ctypes.data)

    def set_pattern(self, A: Lower) -> None:
        """Row and column numbers of the lower triangle, from one; of both triangles where they differ."""
        rows = A.indices.astype(np.int32) + np.int32(1)
        columns = np.repeat(np.arange(1, A.n + 1, dtype=np.int32), np.diff(A.indptr))
        if isinstance(A, General):
            off = rows != columns
            rows, columns = np.append(rows, columns[off]), np.append(columns, rows[off])
        self._data.n, self._data.nnz = A.n, len(rows)
        self.give("irn", rows)
        self.give("jcn", columns)

    def set_values(self, A: Lower) -> None:
        """Values in the order of the pattern, in the arithmetic of this instance."""
        values = A.data
        if isinstance(A, General):
            lower, upper = A.triangles()
            values = np.append(lower, upper[A.indices != A.columns()])
        self.give("a", np.ascontiguousarray(values, dtype=self.dtype))

    def drop_matrix(self) -> None:
        """Forget the matrix, which MUMPS reads only while it analyses and factorises."""
        for name in ("irn", "jcn", "a", "perm_in"):
            self.give(name, None)

    def set_disk(self, folder: bytes) -> None:
        """Write the factors below ``folder``."""
        self._data.ooc_tmpdir, self._data.ooc_prefix = folder, b"factor"
        self.control(22, 1)

    @property
    def longest_folder(self) -> int:
        """Bytes that the path of the scratch folder may have."""
        return int(self.library.structure.ooc_tmpdir.size) - 1

    def run(self, job: int, progress: Progress = SILENT, news: str = "") -> int:
        """Run a job; returns INFOG(1), which is negative when it failed.

        Raises:
            SolverError: an earlier job was interrupted.
        """
        self.call(self.library.call, self._data, job, progress=progress, news=news)
        return self.info(1)

    def solve_dense(self, B: Values) -> None:
        """Overwrite the Fortran-ordered ``B`` (n, k) with the solution."""
        self._data.nrhs, self._data.lrhs = B.shape[1], self._data.n
        self.give("rhs", B)
        try:
            if self.run(SOLVE) < 0:
                raise self.error("solution")
        finally:
            if not self.abandoned:
                self.give("rhs", None)

    def forget(self) -> None:
        """Free the factor: the analysis stays where this version of MUMPS can keep it (JOB = -4), else all goes."""
        if self._data is None or self.abandoned:
            return
        if self.library.keeps_analysis:
            self.library.call(self._data, FREE_FACTOR)
        else:
            self._free()

    @property
    def ended(self) -> bool:
        """Whether MUMPS holds nothing of this instance any more."""
        return self._data is None

    def error(self, phase: str) -> SolverError | SingularMatrixError:
        """The exception for a job that failed."""
        code, detail = self.info(1), self.info(2)
        if code in _SINGULAR:
            return SingularMatrixError(f"the matrix is singular (MUMPS INFOG(1) = {code}); {MECHANISM}")
        words = _WORDS.get(code, "see the manual of MUMPS")
        return SolverError(f"MUMPS failed in the {phase}: INFOG(1) = {code}, INFOG(2) = {detail}: {words}")

    def _free(self) -> None:
        if self._data is None:
            return
        data, self._data = self._data, None
        self.library.call(data, END)
        self._held.clear()
