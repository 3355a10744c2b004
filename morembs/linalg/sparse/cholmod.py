"""CHOLMOD: supernodal Cholesky factor L L' of positive definite matrices, in memory.

Chen, Davis, Hager and Rajamanickam 2008. Half the storage and none of the pivot search of a factor L D L'.
Its supernodal part is under the GPL: it is loaded from the user's system where it is installed, never shipped.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import ClassVar

from morembs.base.types import Values
from morembs.linalg.sparse.cholmod_library import cholmod_library
from morembs.linalg.sparse.cholmod_session import Session, sparse
from morembs.linalg.sparse.ordering import metis_ordering
from morembs.linalg.sparse.sessions import SessionAnalysis, SessionFactor
from morembs.linalg.sparse.solver import Analysis, Factorization, Forecast, ForeignSolver
from morembs.linalg.sparse.symmetric import Lower


class _CholmodAnalysis(SessionAnalysis):
    """The symbolic factor, which takes the values of one matrix after the other."""

    instead = "can keep it on disk"
    session: Session

    def _demand(self, A: Lower) -> Forecast:
        """What the symbolic factor says."""
        self.session.analyse(sparse(self.session.library, A, values=False), metis_ordering(A), self.solver.progress)
        factor, common = self.session.factor, self.session.common
        entries = int(factor.xsize)
        held = 8 * entries + int(common.memory_inuse)
        # Integers of our copy of the matrix; then the permuted copy that CHOLMOD makes, with its values.
        matrix = 8 * (self.lower_nnz + self.n) + 16 * self.lower_nnz + 8 * self.n
        return Forecast(
            backend=self.solver.name,
            size=self.n,
            factor_entries=entries,
            flops=float(common.fl),
            memory=held + matrix + 8 * int(factor.maxcsize),
            kept=held,
        )

    def factorize_unchecked(self, A: Lower) -> Factorization:
        start = time.perf_counter()
        news = f"factorising ({self._forecast.flops:.2g} operations)"
        self.session.factorize(sparse(self.session.library, A), self.solver.progress, news)
        return _CholmodFactor(self.session, self._stats(start, int(self.session.factor.xsize)))


class _CholmodFactor(SessionFactor):
    """The factor that an analysis holds."""

    _session: Session

    def _solve(self, B: Values) -> Values:
        self._session.solve(B)
        return B

    def _negative_pivots(self) -> int | None:
        return 0


@dataclass(frozen=True, kw_only=True)
class Cholmod(ForeignSolver):
    """CHOLMOD of the system (Debian: libsuitesparse-dev), in memory; ``scratch`` has no effect."""

    name: ClassVar[str] = "cholmod"
    structures: ClassVar[tuple[str, ...]] = ("spd",)
    counts: ClassVar[bool] = False
    library = staticmethod(cholmod_library)

    def _analyse(self, A: Lower, structure: str) -> Analysis:
        return _CholmodAnalysis(self, A, structure, Session(self._loaded()))
