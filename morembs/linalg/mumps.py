"""MUMPS: multifrontal factor of symmetric matrices, in memory or on disk, with the inertia."""

from __future__ import annotations

import logging
import shutil
import tempfile
import time
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.errors import InputError, SingularMatrixError, SolverError
from morembs.linalg.mumps_library import LOCK, USE_COMM_WORLD, Library, embedded_library, system_library
from morembs.linalg.ordering import metis_ordering
from morembs.linalg.solver import Factorization, FactorStats, Floats, LinearSolver

log = logging.getLogger(__name__)

_SYM = {"spd": 1, "symmetric": 2}
_MEGABYTE = 1_000_000
_RELAXATION = 30
_ATTEMPTS = 4
# Workspace or buffers found too small in the numerical phase: more of them cures it.
_TOO_SMALL = {-8, -9, -14, -15, -17, -18, -20}
_SINGULAR = {-10, -40}
# Columns solved at once: wide blocks are fast, and on disk each block reads every factor again.
_BLOCK, _BLOCK_ON_DISK = 64, 128
_WORDS = {
    -5: "memory could not be allocated", -7: "memory could not be allocated",
    -13: "memory could not be allocated", -8: "integer workspace too small", -9: "workspace too small",
    -11: "workspace too small for the solution", -14: "integer workspace too small for the solution",
    -19: "the memory budget is too small", -20: "buffer too small",
    -51: "the graph is too large for 32-bit integers", -52: "the graph is too large for 32-bit integers",
    -90: "the scratch folder cannot be written or is full",
}


class _MumpsFactor(Factorization):
    """One instance of MUMPS. ``run`` computes the factor; whoever calls it closes it when it fails."""

    def __init__(self, library: Library, backend: str, n: int, structure: str) -> None:
        super().__init__(n)
        self._library = library
        self._backend = backend
        self._structure = structure
        self._folder: weakref.finalize[..., Any] | None = None
        self._stats: FactorStats | None = None
        self._negative = 0
        # MUMPS keeps the addresses: these have to live as long as it may read them.
        self._arrays: list[NDArray[Any]] = []
        # None where MUMPS has no instance: a call would end the process without a message.
        self._data: Any = None
        data: Any = library.structure()
        data.par, data.sym, data.comm_fortran = 1, _SYM[structure], USE_COMM_WORLD
        library.call(data, -1)
        self._data = data
        for number in (1, 2, 3, 4):
            self._control(number, 0)
        self._control(14, _RELAXATION)

    def _control(self, number: int, value: int) -> None:
        """Set ICNTL(number) of the manual."""
        self._data.icntl[number - 1] = value

    def _info(self, number: int) -> int:
        """INFOG(number) of the manual."""
        return int(self._data.infog[number - 1])

    def _entries(self, number: int) -> int:
        """INFOG(number), a count that MUMPS gives in negative millions where 32 bits are too few."""
        value = self._info(number)
        return value if value >= 0 else -value * 1_000_000

    def _call(self, job: int) -> int:
        """Run a job of MUMPS and return INFOG(1), which is negative when it failed."""
        self._library.call(self._data, job)
        return self._info(1)

    def _set_matrix(self, A: sp.csc_array) -> None:
        """Give MUMPS the lower triangle, numbered from one."""
        column = np.repeat(np.arange(self.n, dtype=np.int32), np.diff(A.indptr))
        lower = A.indices >= column
        irn = A.indices[lower].astype(np.int32) + np.int32(1)
        jcn = column[lower] + np.int32(1)
        values = np.ascontiguousarray(A.data[lower], dtype=np.float64)
        self._arrays += [irn, jcn, values]
        self._data.n, self._data.nnz = self.n, values.size
        self._data.irn, self._data.jcn = irn.ctypes.data, jcn.ctypes.data
        self._data.a = values.ctypes.data

    def _set_order(self, order: NDArray[np.int64] | None) -> None:
        if order is None:
            # Its own METIS; a build without one takes the next best.
            self._control(7, 5)
            return
        position = np.empty(self.n, dtype=np.int32)
        position[order] = np.arange(1, self.n + 1, dtype=np.int32)
        self._arrays.append(position)
        self._data.perm_in = position.ctypes.data
        self._control(7, 1)

    def run(self, A: sp.csc_array, memory: int | None, scratch: Path | None) -> None:
        """Analyse and factorise ``A`` within ``memory`` bytes, on disk in ``scratch`` where that is needed.

        Raises:
            SingularMatrixError: zero pivot, or a pivot that is not positive in an "spd" matrix.
            SolverError: it does not fit into the budget even on disk, or MUMPS failed.
        """
        start = time.perf_counter()
        self._set_matrix(A)
        self._set_order(metis_ordering(A))
        self._analyse()
        in_core = self._info(16)
        if memory is not None and in_core * _MEGABYTE > memory:
            self._use_disk(scratch)
            self._analyse()
            on_disk = self._info(26)
            if on_disk * _MEGABYTE > memory:
                raise SolverError(
                    f"{memory / _MEGABYTE:.1f} MB were given for factors; {on_disk} MB are needed even with "
                    f"the factors on disk ({in_core} MB without); give more memory or take a coarser mesh"
                )
            self._control(23, memory // _MEGABYTE)
        self._eliminate()
        self._free_matrix()
        entries = self._entries(29)
        self._stats = FactorStats(
            backend=self._backend, size=self.n, nnz=int(A.nnz), factor_entries=entries,
            memory_bytes=0 if self._folder else 8 * entries, out_of_core=self._folder is not None,
            seconds=time.perf_counter() - start,
        )

    def _analyse(self) -> None:
        if self._call(1) < 0:
            raise self._error("analysis")

    def _eliminate(self) -> None:
        """Numerical phase, with more workspace each time it was too small."""
        relaxation = _RELAXATION
        for attempt in range(_ATTEMPTS):
            code = self._call(2)
            if code >= 0:
                break
            if code not in _TOO_SMALL or attempt == _ATTEMPTS - 1:
                raise self._error("factorisation")
            relaxation *= 2
            log.info("%s: INFOG(1) = %d, again with %d %% more workspace", self._backend, code, relaxation)
            self._control(14, relaxation)
        self._negative = self._info(12)
        if self._structure == "spd" and self._negative > 0:
            raise SingularMatrixError(
                f"the matrix should be positive definite but has {self._negative} negative pivots; likely a "
                "mechanism, an unconnected part, or a body that is not held where it should be"
            )

    def _free_matrix(self) -> None:
        """MUMPS reads the matrix no more once factorised, as no refinement is asked for."""
        self._data.irn = self._data.jcn = self._data.a = self._data.perm_in = None
        self._arrays.clear()

    def _use_disk(self, scratch: Path | None) -> None:
        """Make a private folder in ``scratch`` and have the factors written there."""
        if scratch is not None:
            try:
                scratch.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(f"the scratch folder {scratch} cannot be made: {error}") from error
        try:
            folder = tempfile.mkdtemp(prefix="morembs-", dir=scratch)
        except OSError as error:
            raise InputError(f"the scratch folder {scratch} cannot be written: {error}") from error
        # Also runs when the interpreter ends without a close.
        self._folder = weakref.finalize(self, shutil.rmtree, folder, True)
        path = str(Path(folder).resolve()).encode()
        room = self._library.structure.ooc_tmpdir.size - 1
        if len(path) > room:
            raise InputError(
                f"the scratch folder {folder} has a path of {len(path)} bytes; "
                f"MUMPS {self._library.version} takes up to {room}: give a shorter one"
            )
        self._data.ooc_tmpdir, self._data.ooc_prefix = path, b"factor"
        self._control(22, 1)

    def _error(self, phase: str) -> SolverError | SingularMatrixError:
        code, detail = self._info(1), self._info(2)
        if code in _SINGULAR:
            return SingularMatrixError(
                f"the matrix is singular (MUMPS INFOG(1) = {code}); likely a mechanism, an unconnected part, "
                "or a body that is not held where it should be"
            )
        words = _WORDS.get(code, "see the manual of MUMPS")
        return SolverError(f"MUMPS failed in the {phase}: INFOG(1) = {code}, INFOG(2) = {detail}: {words}")

    @property
    def stats(self) -> FactorStats:
        if self._stats is None:
            raise SolverError("the factorisation has not been computed")
        return self._stats

    def _solve(self, B: Floats) -> Floats:
        columns = B.shape[1]
        self._control(27, _BLOCK_ON_DISK if self._folder else _BLOCK)
        # The entries of a right-hand side are counted in 32 bits in places.
        step = max(1, (2**31 - 1) // self.n)
        for first in range(0, columns, step):
            part = B[:, first : first + step]
            with LOCK:
                self._data.rhs, self._data.lrhs, self._data.nrhs = part.ctypes.data, self.n, part.shape[1]
                if self._call(3) < 0:
                    raise self._error("solution")
                self._data.rhs = None
        return B

    def _negative_pivots(self) -> int | None:
        return self._negative

    def _close(self) -> None:
        if self._data is not None:
            self._call(-2)
            self._data = None
        self._arrays.clear()
        if self._folder is not None:
            self._folder()


@dataclass(frozen=True, kw_only=True)
class _MumpsSolver(LinearSolver):
    """What both libraries share."""

    library: ClassVar[Callable[[], Library | str]]

    @classmethod
    def unavailable(cls) -> str:
        found = cls.library()
        return found if isinstance(found, str) else ""

    def _factorize(self, A: sp.csc_array, structure: str) -> Factorization:
        """Raises InputError (empty, scratch folder), SingularMatrixError, SolverError."""
        library = type(self).library()
        if isinstance(library, str):
            raise InputError(f"solver = {self.name!r} cannot run here: {library}")
        if A.shape[0] == 0:
            raise InputError("the matrix has no rows; nothing can be solved with it")
        if A.nnz == 0:
            raise SingularMatrixError("the matrix is zero")
        factor = _MumpsFactor(library, self.name, A.shape[0], structure)
        try:
            factor.run(A, self.memory, self.scratch)
        except BaseException:
            factor.close()
            raise
        return factor


@dataclass(frozen=True, kw_only=True)
class Mumps(_MumpsSolver):
    """The sequential MUMPS of the system (Debian: libmumps-seq-dev)."""

    name: ClassVar[str] = "mumps"
    library: ClassVar[Callable[[], Library | str]] = staticmethod(system_library)


@dataclass(frozen=True, kw_only=True)
class EmbeddedMumps(_MumpsSolver):
    """The MUMPS that comes with the CasADi package."""

    name: ClassVar[str] = "mumps-embedded"
    library: ClassVar[Callable[[], Library | str]] = staticmethod(embedded_library)
