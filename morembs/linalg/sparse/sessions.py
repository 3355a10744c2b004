"""The frame of solvers whose foreign session of one pattern holds its symbolic and one numeric factor, in memory."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np

from morembs.linalg.sparse.solver import (
    Analysis,
    Factorization,
    FactorStats,
    Forecast,
    ForeignSolver,
    refuse_beyond_memory,
)
from morembs.linalg.sparse.symmetric import Lower


class SessionAnalysis(Analysis):
    """The symbolic factor in ``session``, refused where its factor has no room (MUMPS ``instead``)."""

    instead: ClassVar[str]

    def __init__(self, solver: ForeignSolver, A: Lower, structure: str, session: Any) -> None:
        super().__init__(A, structure)
        self.solver, self.session = solver, session
        try:
            self._forecast = self._demand(A)
            refuse_beyond_memory(solver, self._forecast, solver.name.upper(), self.instead)
        except BaseException:
            self.close()
            raise

    @abstractmethod
    def _demand(self, A: Lower) -> Forecast:
        """Analyse the pattern of ``A``, and what its factor will need."""

    @property
    def forecast(self) -> Forecast:
        return self._forecast

    def _release(self) -> None:
        self.session.close()


class SessionFactor(Factorization):
    """The factor that the session of an analysis holds."""

    def __init__(self, session: Any, stats: FactorStats, dtype: Any = np.float64) -> None:
        super().__init__(stats, dtype)
        self._session = session

    def _release(self) -> None:
        self._session.forget()
