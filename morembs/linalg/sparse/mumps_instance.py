"""One instance of MUMPS: the thin layer between arrays and the structure of its C interface."""

from __future__ import annotations

from typing import Any

import numpy as np

from morembs.base.types import Values
from morembs.linalg.sparse.mumps_codes import (
    KINDS,
    Control,
    Info,
    Job,
    Keep,
    RealControl,
    RealInfo,
    Setting,
    Unit,
    World,
)
from morembs.linalg.sparse.mumps_library import Library
from morembs.linalg.sparse.symmetric import General, Lower

_SILENT = (Control.ERROR_STREAM, Control.DIAGNOSTIC_STREAM, Control.GLOBAL_STREAM, Control.PRINT_LEVEL)


class Instance:
    """MUMPS between its first job and its last one, ``end``."""

    def __init__(self, library: Library, structure: str, dtype: Any) -> None:
        self.library = library
        self.dtype = np.dtype(dtype)
        # MUMPS keeps the addresses: these have to live as long as it may read them.
        self._held: dict[str, Values] = {}
        data: Any = library.structure()
        data.par, data.sym, data.comm_fortran = 1, KINDS[structure], World.SEQUENTIAL
        library.call(data, Job.NEW)
        self._data = data
        for stream in _SILENT:
            self.set(stream, Setting.NO)
        if library.other_blas and data.keep[Keep.SYMMETRIC_PRODUCT] == Keep.DGEMMT:
            # By blocks of DGEMM: OpenBLAS makes DGEMMT column by column, and not all others have it.
            data.keep[Keep.SYMMETRIC_PRODUCT] = Keep.DGEMM

    def set(self, control: Control, value: int) -> None:
        """Set ICNTL(control)."""
        self._data.icntl[control - 1] = value

    def set_real(self, control: RealControl, value: float) -> None:
        """Set CNTL(control)."""
        self._data.cntl[control - 1] = value

    def info(self, number: int) -> int:
        """INFOG(number)."""
        return int(self._data.infog[number - 1])

    def count(self, number: Info) -> int:
        """INFOG(number), a count that may not fit into 32 bits."""
        value = self.info(number)
        return value if value >= 0 else -value * Unit.MILLION

    def real_info(self, number: RealInfo) -> float:
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

    def give_pattern(self, A: Lower) -> None:
        """Row and column numbers of the lower triangle, from one; of both triangles where they differ."""
        rows = A.indices.astype(np.int32) + np.int32(1)
        columns = np.repeat(np.arange(1, A.n + 1, dtype=np.int32), np.diff(A.indptr))
        if isinstance(A, General):
            off_diagonal = rows != columns
            rows, columns = np.append(rows, columns[off_diagonal]), np.append(columns, rows[off_diagonal])
        self._data.n, self._data.nnz = A.n, len(rows)
        self.give("irn", rows)
        self.give("jcn", columns)

    def give_values(self, A: Lower) -> None:
        """Values in the order of the pattern, in the arithmetic of this instance."""
        values = A.data
        if isinstance(A, General):
            lower, upper = A.triangles()
            values = np.append(lower, upper[A.indices != A.columns()])
        self.give("a", np.ascontiguousarray(values, dtype=self.dtype))

    def take_matrix(self) -> None:
        """Take the matrix back, which MUMPS reads only while it analyses and factorises."""
        for name in ("irn", "jcn", "a", "perm_in"):
            self.give(name, None)

    def use_folder(self, folder: bytes) -> None:
        """Write the factors below ``folder``."""
        self._data.ooc_tmpdir, self._data.ooc_prefix = folder, b"factor"
        self.set(Control.ON_DISK, Setting.YES)

    @property
    def longest_folder(self) -> int:
        """Bytes that the path of the scratch folder may have."""
        return int(self.library.structure.ooc_tmpdir.size) - 1

    def run(self, job: Job) -> int:
        """Run a job; its code, which is negative when it failed."""
        self.library.call(self._data, job)
        return self.info(Info.CODE)

    def solve(self, B: Values) -> int:
        """Overwrite the Fortran-ordered ``B`` (n, k) with the solution; the code as of ``run``."""
        self._data.nrhs, self._data.lrhs = B.shape[1], self._data.n
        self.give("rhs", B)
        try:
            return self.run(Job.SOLVE)
        finally:
            self.give("rhs", None)

    def end(self) -> None:
        """Free everything; no call may follow."""
        self.library.call(self._data, Job.END)
        self._held.clear()
