"""The one base of the solvers: a session holds one pattern for its solver; all that is the same in all solvers is here.

A new solver is one subclass of ``Session`` with a ``SessionSolver`` that names it, in one file, and one line in the
table of ``select``. The session says what its library is called with. From here come the forecast, the memory budget,
blocks of right-hand sides, interruptible calls, statistics, and when what is released.
"""

from __future__ import annotations

import threading
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar, final

import numpy as np

from morembs.base.errors import BudgetError, SolverError
from morembs.base.types import Values
from morembs.linalg.sparse.interruptible import ForeignObject
from morembs.linalg.sparse.solver import Analysis, Factorization, FactorStats, Forecast, LinearSolver
from morembs.linalg.sparse.symmetric import Lower
from morembs.linalg.sparse.tolerances import TOL

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class FactorSize:
    """Size of a numeric factor: stored entries, bytes in memory and on disk; operations, None where as forecast."""

    entries: int
    memory: int
    disk: int = 0
    flops: float | None = None


class Session(ForeignObject):
    """What a solver holds for one pattern: first its symbolic factor, then one numeric factor after the other.

    Solvers write the methods with an underscore only. ``library`` is what the configuration has opened.
    """

    # Name of the library in messages, and its words for codes of failure.
    title: ClassVar[str]
    words: ClassVar[Mapping[int, str]] = {}
    # What a user may do whose memory budget has no room for the factor.
    instead: ClassVar[str] = 'give more memory or take solver = "mumps", which can keep it on disk'
    # Whether several threads may solve with one factor at the same time.
    thread_safe: ClassVar[bool] = False
    # Whether the next numeric factor takes the memory of the one before.
    overwrites: ClassVar[bool] = False

    def __init__(self, solver: SessionSolver, A: Lower, structure: str) -> None:
        super().__init__()
        self.solver, self.structure = solver, structure
        self.n, self.lower_nnz, self.nnz = A.n, A.nnz, 2 * A.nnz - A.n
        self.library = solver.open_library(structure)
        # Type of solutions, and columns that are solved at once (None: all).
        self.dtype = np.dtype(np.complex128 if structure.startswith("complex") else np.float64)
        self.columns: int | None = TOL.block_columns
        self.solving: AbstractContextManager[Any] = nullcontext() if self.thread_safe else threading.RLock()
        self._news = ""

    @abstractmethod
    def _analyse(self, A: Lower) -> Forecast:
        """Make the symbolic factor of the pattern of ``A``, and say the need of a numeric one."""

    @abstractmethod
    def _factorize(self, A: Lower) -> FactorSize:
        """Make the numeric factor of ``A``, in place of the one before.

        Raises:
            SingularMatrixError: a pivot that the library cannot take.
            SolverError: the library failed.
        """

    @abstractmethod
    def _solve(self, B: Values) -> Values:
        """A X = B for a Fortran-ordered block (n, k), which may be overwritten."""

    def _solve_transposed(self, B: Values) -> Values:
        """A' X = B (not conjugated), as ``_solve``; solvers of matrices that are not symmetric have their own."""
        return self._solve(B)

    def _negative_pivots(self) -> int | None:
        """Number of negative eigenvalues of the matrix, None where the solver cannot say."""
        return None

    def _on_disk(self) -> Forecast | None:
        """The forecast with the factor on disk, None where it stays in memory."""
        return None

    @abstractmethod
    def _forget(self) -> None:
        """Free the numeric factor, keep the symbolic one."""

    def _free(self) -> None:
        """Free everything."""
        self._forget()

    @final
    def run(self, function: Callable[..., T], *args: object) -> T:
        """``function(*args)``, which a signal can interrupt; the analysis and the numeric phase tell how long it takes.

        Raises:
            SolverError: a call before was interrupted.
        """
        return self.call(function, *args, news=self._news)

    @final
    def analyse(self, A: Lower) -> Forecast:
        """As ``_analyse``, within the memory budget.

        Raises:
            BudgetError: the factor has no room.
        """
        self._news = "analysing"
        try:
            wanted = self._analyse(A)
        finally:
            self._news = ""
        budget = self.solver.memory
        if budget is not None and wanted.memory > budget:
            raise BudgetError(
                f"{budget / 1e6:.1f} MB are left of the memory budget for the factorisation; {wanted.memory / 1e6:.1f} "
                f"MB are needed by {self.title}, which keeps the factor in memory; {self.instead}",
                needed=wanted.memory,
            )
        return wanted

    @final
    def factorize(self, A: Lower, flops: float) -> FactorSize:
        """As ``_factorize``, which takes some ``flops`` operations."""
        self._news = f"factorising ({flops:.2g} operations)"
        try:
            return self._factorize(A)
        finally:
            self._news = ""

    def solve(self, B: Values, transposed: bool = False) -> Values:
        """Overwrite the Fortran-ordered ``B`` (n, k) with the solution, a block of columns at a time."""
        apply = self._solve_transposed if transposed else self._solve
        with self.solving:
            step = self.columns or B.shape[1]
            if B.shape[1] <= step:
                return apply(B).astype(self.dtype, copy=False)
            for first in range(0, B.shape[1], step):
                part = B[:, first : first + step]
                X = apply(part)
                if X is not part:
                    part[:] = X
        return B

    def negative_pivots(self) -> int | None:
        """Number of negative eigenvalues of the matrix, None where the solver cannot say."""
        return self._negative_pivots()

    def on_disk(self) -> Forecast | None:
        """The forecast with the factor on disk, None where it stays in memory."""
        return self._on_disk()

    @final
    def forget(self) -> None:
        """Free the numeric factor, keep the symbolic one; an interrupted call frees both when it has ended."""
        if not self.abandoned:
            self._forget()

    @final
    def forecast(self, *, entries: int, flops: float, memory: int, kept: int, **more: Any) -> Forecast:
        """The forecast of this solver and size; ``more`` are other fields of ``Forecast``."""
        return Forecast(
            backend=self.solver.name, size=self.n, factor_entries=entries, flops=flops, memory=memory, kept=kept, **more
        )

    def failure(self, phase: str, code: int, message: str = "") -> SolverError:
        """The exception for a call that failed with ``code``."""
        words = self.words.get(code, f"see the manual of {self.title}")
        return SolverError(f"{self.title} failed in {phase}: {message or f'status {code}'}: {words}")


class SessionAnalysis(Analysis):
    """The analysis of one pattern by a session."""

    def __init__(self, session: Session, A: Lower) -> None:
        super().__init__(A, session.structure)
        self.session = session
        try:
            self._forecast = session.analyse(A)
        except BaseException:
            self.close()
            raise

    @property
    def forecast(self) -> Forecast:
        return self._forecast

    @property
    def on_disk(self) -> Forecast | None:
        return self.session.on_disk()

    def factorize_unchecked(self, A: Lower) -> Factorization:
        start = time.perf_counter()
        size = self.session.factorize(A, self._forecast.flops)
        more: dict[str, Any] = {} if size.flops is None else {"flops": size.flops}
        more |= {"memory_bytes": size.memory, "disk_bytes": size.disk, "out_of_core": size.disk > 0}
        return SessionFactor(self, self._stats(start, size.entries, **more))

    def _release(self) -> None:
        self.session.close()


class SessionFactor(Factorization):
    """The numeric factor in a session."""

    def __init__(self, analysis: SessionAnalysis, stats: FactorStats) -> None:
        super().__init__(stats, analysis.session.dtype)
        self.session = analysis.session

    def _solve(self, B: Values) -> Values:
        return self.session.solve(B)

    def _solve_transposed(self, B: Values) -> Values:
        return self.session.solve(B, transposed=True)

    def _negative_pivots(self) -> int | None:
        return self.session.negative_pivots()

    def _release(self) -> None:
        self.session.forget()

    def _give_way(self) -> None:
        if not self.session.overwrites:
            self.session.forget()


@dataclass(frozen=True, kw_only=True)
class SessionSolver(LinearSolver):
    """A solver by its ``session``, whose ``library`` is the one that is found here, or the reason why there is none."""

    session: ClassVar[type[Session]]
    library: ClassVar[Callable[..., Any]] = staticmethod(lambda: None)

    @classmethod
    def unavailable(cls) -> str:
        library = cls.library()
        return library if isinstance(library, str) else ""

    def open_library(self, structure: str) -> Any:
        """The library for matrices of ``structure``."""
        return type(self).library()

    def _analyse(self, A: Lower, structure: str) -> Analysis:
        return SessionAnalysis(self.session(self, A, structure), A)
