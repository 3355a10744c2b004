"""CHOLMOD: supernodal Cholesky factor L L' of positive definite matrices, in memory.

Chen, Davis, Hager and Rajamanickam 2008. Half the storage and none of the pivot search of a factor L D L'.
Its supernodal part is under the GPL: it is loaded from the user's system where it is installed, never shipped.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import ClassVar

from morembs.linalg.sparse.cholmod_library import Library, cholmod_library
from morembs.linalg.sparse.cholmod_session import Session, sparse
from morembs.linalg.sparse.ordering import metis_ordering
from morembs.linalg.sparse.solver import (
    Analysis,
    Factorization,
    FactorStats,
    Forecast,
    ForeignSolver,
    Values,
    refuse_beyond_memory,
)
from morembs.linalg.sparse.symmetric import Lower


class _CholmodAnalysis(Analysis):
    """The symbolic factor, which takes the values of one matrix after the other."""

    def __init__(self, solver: Cholmod, library: Library, A: Lower, structure: str) -> None:
        super().__init__(A, structure)
        self.solver = solver
        self.session = Session(library)
        try:
            self.session.analyse(sparse(library, A, values=False), metis_ordering(A), solver.progress)
            self._forecast = self._demand()
            refuse_beyond_memory(solver, self._forecast, "CHOLMOD", "can keep it on disk")
        except BaseException:
            self.close()
            raise

    def _demand(self) -> Forecast:
        """What the symbolic factor says."""
        factor, common = self.session.factor, self.session.common
        entries = int(factor.xsize)
        held = 8 * entries + int(common.memory_inuse)
        # Integers of our copy of the matrix; then the permuted copy that CHOLMOD makes, with its values.
        matrix = 8 * (self.lower_nnz + self.n) + 16 * self.lower_nnz + 8 * self.n
        return Forecast(
            backend=self.solver.name, size=self.n, factor_entries=entries, flops=float(common.fl),
            memory=held + matrix + 8 * int(factor.maxcsize), kept=held,
        )  # fmt: skip

    @property
    def forecast(self) -> Forecast:
        return self._forecast

    def _factorize(self, A: Lower) -> Factorization:
        start = time.perf_counter()
        news = f"factorising ({self._forecast.flops:.2g} operations)"
        self.session.factorize(sparse(self.session.library, A), self.solver.progress, news)
        return _CholmodFactor(self.session, self._stats(start, int(self.session.factor.xsize)))

    def _release(self) -> None:
        self.session.close()


class _CholmodFactor(Factorization):
    """The factor that an analysis holds."""

    def __init__(self, session: Session, stats: FactorStats) -> None:
        super().__init__(stats)
        self._session = session

    def _solve(self, B: Values) -> Values:
        self._session.solve(B)
        return B

    def _negative_pivots(self) -> int | None:
        return 0

    def _release(self) -> None:
        self._session.forget()


@dataclass(frozen=True, kw_only=True)
class Cholmod(ForeignSolver):
    """CHOLMOD of the system (Debian: libsuitesparse-dev), in memory; ``scratch`` has no effect."""

    name: ClassVar[str] = "cholmod"
    structures: ClassVar[tuple[str, ...]] = ("spd",)
    counts: ClassVar[bool] = False
    library = staticmethod(cholmod_library)

    def _analyse(self, A: Lower, structure: str) -> Analysis:
        return _CholmodAnalysis(self, self._loaded(), A, structure)
