"""A rough factor (single precision or low rank) that preconditions conjugate gradients in double precision.

Half the memory and disk of a double factor and the same backward error. Where the iteration stagnates, as for
slender or badly scaled models, a double factor takes the place of the rough one.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from morembs.base.errors import InputError, SingularMatrixError
from morembs.base.types import Values
from morembs.linalg.sparse.conjugate_gradient import conjugate_gradients
from morembs.linalg.sparse.mumps import Mumps
from morembs.linalg.sparse.solver import Analysis, Factorization, FactorStats, Forecast, LinearSolver
from morembs.linalg.sparse.symmetric import Lower
from morembs.linalg.sparse.tolerances import TOL

log = logging.getLogger(__name__)


class _MixedAnalysis(Analysis):
    """Analysis of the rough factor, and of the double one once it had to take its place."""

    def __init__(self, solver: Mixed, A: Lower, structure: str) -> None:
        # First, as it may fail: there is nothing to release then.
        self._rough: Analysis = solver.rough().analyse(A, structure)
        super().__init__(A, structure)
        self.solver = solver
        self._double: Analysis | None = None

    @property
    def forecast(self) -> Forecast:
        rough = (self._double or self._rough).forecast
        return rough if self._double else replace(rough, backend=self.solver.name, precision=self.solver.describe())

    def factorize_unchecked(self, A: Lower) -> Factorization:
        if self._double is None:
            try:
                rough = self._rough.factorize_unchecked(A)
            except SingularMatrixError:
                # Perhaps in single precision only: the factor in double precision will tell.
                return self.in_double(A)
            factor = _MixedFactor(self, rough, A)
            try:
                if factor.converges():
                    return factor
            except BaseException:
                factor.close()
                raise
            factor.close()
        return self.in_double(A)

    def in_double(self, A: Lower) -> Factorization:
        """The double factor, after the rough one failed."""
        log.warning("the %s factor does not precondition well enough; a double one is made", self.solver.describe())
        self._rough.close()
        if self._double is None:
            self._double = self.solver.exact().analyse(A, self.structure)
        return self._double.factorize_unchecked(A)

    def _release(self) -> None:
        self._rough.close()
        if self._double is not None:
            self._double.close()


class _MixedFactor(Factorization):
    """Conjugate gradients with the rough factor; keeps the matrix."""

    def __init__(self, analysis: _MixedAnalysis, rough: Factorization, A: Lower) -> None:
        solver = analysis.solver
        super().__init__(replace(rough.stats, backend=solver.name, precision=solver.describe()), rough.dtype)
        self._analysis, self._rough, self._A = analysis, rough, A
        self._exact: Factorization | None = None
        self._norm = float(np.abs(A.data).max())
        self._applied = 0

    @property
    def stats(self) -> FactorStats:
        made = self._stats if self._exact is None else self._exact.stats
        # Each step of the iteration is a pass.
        return replace(made, columns=self._columns, passes=self._applied)

    def converges(self) -> bool:
        """True if a trial right-hand side converges."""
        b = np.asfortranarray(np.random.default_rng(23).standard_normal((self.n, 2)).astype(self.dtype))
        return self._iterate(b) is not None

    def _solve(self, B: Values) -> Values:
        step = TOL.block_columns
        for first in range(0, B.shape[1], step):
            part = B[:, first : first + step]
            X = None if self._exact is not None else self._iterate(part)
            if X is None:
                if self._exact is None:
                    self._rough.close()
                    self._exact = self._analysis.in_double(self._A)
                X = self._exact._solve(part)
                self._applied += 1
            part[:] = X
        return B

    def _iterate(self, B: Values) -> Values | None:
        # Columns of unit size: single precision has no room for tiny or huge ones.
        size = np.abs(B).max(axis=0, initial=0.0)
        size[size == 0.0] = 1.0
        B = B / size
        solution = conjugate_gradients(
            lambda X: np.asfortranarray(self._A @ X),
            self._precondition,
            B,
            norm=self._norm,
            max_steps=TOL.iteration_steps_rough,
        )
        log.debug("%d steps to a backward error of %.1e", solution.steps, solution.residual.max(initial=0.0))
        return None if solution.stagnated else solution.X * size

    def _precondition(self, R: Values) -> Values:
        self._applied += 1
        return self._rough._solve(R.copy(order="F"))

    def _negative_pivots(self) -> int | None:
        """A rough factor may take the sign of an eigenvalue near zero for the other one: no count."""
        return self._exact._negative_pivots() if self._exact is not None else None

    def _release(self) -> None:
        self._rough.close()
        if self._exact is not None:
            self._exact.close()


@dataclass(frozen=True, kw_only=True)
class Mixed(LinearSolver):
    """MUMPS in single precision, or with low-rank blocks, and conjugate gradients in double precision.

    ``low_rank`` is the relative size of terms that a low-rank block drops (0: full rank); with it, ``precision``
    "double" keeps the entries in double precision.
    """

    name: ClassVar[str] = "mumps-mixed"
    counts: ClassVar[bool] = False
    precision: str = "single"
    low_rank: float = 0.0
    out_of_core: bool | None = None
    direct: type[Mumps] = field(default=Mumps, repr=False)

    def __post_init__(self) -> None:
        if self.precision == "double" and not self.low_rank:
            raise InputError(
                "a mixed solver needs precision = 'single' or low_rank > 0; take 'mumps' otherwise",
                kind="missing",
                keyword="precision",
            )

    @classmethod
    def unavailable(cls) -> str:
        return Mumps.lacks("single", "spd")

    def rough(self) -> Mumps:
        """The solver of the rough factor."""
        return self.direct(
            memory=self.memory,
            scratch=self.scratch,
            precision=self.precision,
            low_rank=self.low_rank,
            out_of_core=self.out_of_core,
        )

    def exact(self) -> Mumps:
        """The solver that takes over where the iteration stagnates."""
        return self.direct(memory=self.memory, scratch=self.scratch)

    def describe(self) -> str:
        """Words for the arithmetic of the rough factor."""
        rank = f"low-rank {self.low_rank:.0e} " if self.low_rank else ""
        return f"{rank}{self.precision}"

    def _analyse(self, A: Lower, structure: str) -> Analysis:
        return _MixedAnalysis(self, A, structure)
