"""What every sparse solver is: a frozen configuration that turns a matrix into a factorisation.

    solver.analyse(A)  ->  Analysis (pattern only: forecast)  ->  analysis.factorize(A)  ->  Factorization

``solver.factorize(A)`` is both steps in one. A new solver is a ``Session`` (see ``session``) and its configuration.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, final

import scipy.sparse as sp

from morembs.base.arguments import check_value
from morembs.base.errors import InputError
from morembs.base.limits import one_of
from morembs.base.types import Floats
from morembs.linalg.sparse.cost import FactorStats, Forecast
from morembs.linalg.sparse.factorization import (
    MECHANISM,
    STRUCTURES,
    SYMMETRIC_STRUCTURES,
    Analysis,
    Factorization,
    as_stored,
)
from morembs.linalg.sparse.symmetric import Lower

__all__ = [
    "MECHANISM",
    "STRUCTURES",
    "SYMMETRIC_STRUCTURES",
    "Analysis",
    "FactorStats",
    "Factorization",
    "Forecast",
    "LinearSolver",
]


Structure = Annotated[str, one_of(*STRUCTURES)]


@dataclass(frozen=True, kw_only=True)
class LinearSolver(ABC):
    """Configuration of a sparse solver.

    ``memory`` is the budget in bytes for what one factorisation allocates (None: no limit), ``scratch``
    the folder for factors that do not fit (None: the temporary folder of the system).
    """

    memory: int | None = None
    scratch: Path | None = None

    name: ClassVar[str]
    structures: ClassVar[tuple[str, ...]] = SYMMETRIC_STRUCTURES
    # Whether it counts negative eigenvalues.
    counts: ClassVar[bool] = True

    @classmethod
    @abstractmethod
    def unavailable(cls) -> str:
        """Why this solver cannot run here and how to get it; empty means that it runs."""

    @abstractmethod
    def _analyse(self, A: Lower, structure: str) -> Analysis:
        """Symbolic analysis; the values of ``A`` may be used for scaling decisions only."""

    def _inertia(self, A: Lower, what: str) -> int:
        """Number of negative eigenvalues; a backend that need not keep a factor for it may do better."""
        with self.factorize(A, "symmetric", what) as factor:
            return factor.negative_pivots()

    def _inertia_forecast(self, A: Lower) -> Forecast:
        """What ``_inertia`` will need."""
        with self.analyse(A, "symmetric") as analysis:
            return analysis.forecast

    @final
    def inertia_forecast(self, A: sp.sparray | Lower) -> Forecast:
        """What ``negative_eigenvalues`` of a matrix with the pattern of ``A`` will need.

        Raises:
            SolverError: it cannot be kept within the budget.
        """
        return self._inertia_forecast(Lower.of(A))

    @final
    def with_memory(self, memory: int | None) -> Self:
        """The same configuration with another budget."""
        return replace(self, memory=memory)

    @final
    def with_near_null_space(self, near_nullspace: Floats | None) -> Self:
        """The same configuration with the motions (n, r) that cost next to no energy, where it has use for them."""
        if near_nullspace is not None and "near_nullspace" in {f.name for f in fields(self)}:
            changes: dict[str, Any] = {"near_nullspace": near_nullspace}
            return replace(self, **changes)
        return self

    @final
    def negative_eigenvalues(self, A: sp.sparray | Lower, what: str = "the matrix") -> int:
        """Number of negative eigenvalues of a real symmetric, regular ``A`` (Sylvester's law of inertia).

        Raises:
            SingularMatrixError: an eigenvalue is zero to working accuracy.
            SolverError: the backend failed, or cannot count.
        """
        return self._inertia(Lower.of(A, what), what)

    @final
    def analyse(self, A: sp.sparray | Lower, structure: str = "symmetric", what: str = "the matrix") -> Analysis:
        """Symbolic analysis of the pattern of ``A`` (n, n), to be used for several shifts or for a forecast.

        Args:
            structure: "spd" (positive definite), "symmetric" (indefinite, regular), "complex-symmetric",
                "unsymmetric" or "complex-unsymmetric".
            what: words for error messages, such as "the stiffness matrix".

        Raises:
            InputError: not square, not symmetric, not finite, or a structure this solver cannot take.
            SolverError: it cannot be kept within the budget; the message says what would be needed.
        """
        check_value("structure", structure, Structure)
        if structure not in self.structures:
            raise InputError(
                f"solver = {self.name!r} takes {' or '.join(self.structures)} matrices; {what} is {structure}",
                keyword="solver",
            )
        reason = self.unavailable()
        if reason:
            raise InputError(f"solver = {self.name!r} cannot run here: {reason}", kind="program", keyword="solver")
        lower = as_stored(A, structure, what)
        if (lower.data.dtype.kind == "c") != structure.startswith("complex"):
            raise InputError(
                f"{what} was declared {structure}, but its values are "
                f"{'complex' if lower.data.dtype.kind == 'c' else 'real'}",
                kind="conflict",
                keyword="structure",
            )
        return self._analyse(lower, structure)

    @final
    def factorize(self, A: sp.sparray | Lower, structure: str = "symmetric", what: str = "the matrix") -> Factorization:
        """Factor of the sparse ``A`` (n, n), checked by solving with it; as ``analyse``.

        Raises:
            InputError: not square, not symmetric, or values that are not finite.
            SingularMatrixError: singular to working accuracy.
            SolverError: the backend failed or its solution is inaccurate.
        """
        check_value("structure", structure, Structure)
        lower = as_stored(A, structure, what)
        analysis = self.analyse(lower, structure, what)
        try:
            factor = analysis.factorize(lower, what)
        except BaseException:
            analysis.close()
            raise
        factor.analysis = analysis
        return factor
