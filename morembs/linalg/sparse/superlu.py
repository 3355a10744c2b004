"""SuperLU of SciPy: always there, several times slower and larger than a symmetric factor."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from numpy.typing import NDArray

from morembs.base.errors import BudgetError, SingularMatrixError, SolverError
from morembs.base.types import Values
from morembs.linalg.sparse.ordering import metis_ordering
from morembs.linalg.sparse.solver import (
    MECHANISM,
    STRUCTURES,
    Analysis,
    Factorization,
    FactorStats,
    Forecast,
    LinearSolver,
)
from morembs.linalg.sparse.symmetric import Lower

# A row number of 32 bits with the value of every entry.
_ROW = 4

# Entries of L and U in a compact body of n unknowns: ENTRIES n^(4/3), as measured with METIS.
_ENTRIES = 48.0
# Relative residual beyond which a factor without pivoting is not good enough to be refined.
_UNSTABLE = 1e-10


def _error(lu: Any, A: sp.csc_array) -> float:
    """Relative residual of a trial solution."""
    b = np.random.default_rng(3).standard_normal(A.shape[0]).astype(A.dtype)
    x = lu.solve(b)
    return float(np.linalg.norm(A @ x - b) / (np.linalg.norm(abs(A) @ abs(x)) + np.linalg.norm(b)))


class _SuperLUFactor(Factorization):
    """LU with the pivots on the diagonal, of the matrix in the order of METIS."""

    def __init__(
        self, lu: Any, A: sp.csc_array, order: NDArray[np.int64] | None, structure: str, stats: FactorStats
    ) -> None:
        super().__init__(stats, A.dtype)
        self._counts = not structure.endswith("unsymmetric")
        self._lu = lu
        self._order = order
        self._A = None if structure == "spd" else A

    def _solve(self, B: Values, trans: str = "N") -> Values:
        if self._order is not None:
            B = np.asfortranarray(B[self._order])
        X: Values = np.asfortranarray(self._lu.solve(B, trans))
        if self._A is not None:
            # Without a choice of pivots an indefinite factor loses digits; one step regains them.
            A = self._A if trans == "N" else self._A.T
            X += self._lu.solve(B - A @ X, trans)
        if self._order is None:
            return X
        result = np.empty_like(X)
        result[self._order] = X
        return result

    def _solve_transposed(self, B: Values) -> Values:
        return self._solve(B, "T")

    def _negative_pivots(self) -> int | None:
        if not self._counts or self.dtype.kind == "c" or not np.array_equal(self._lu.perm_r, self._lu.perm_c):
            return None
        # With equal permutations U = D L^T, and D is congruent to the matrix.
        return int(np.count_nonzero(self._lu.U.diagonal() < 0.0))

    def _release(self) -> None:
        self._lu = self._A = None


class _SuperLUAnalysis(Analysis):
    """The order of elimination; SuperLU has no symbolic phase of its own."""

    def __init__(self, A: Lower, structure: str) -> None:
        super().__init__(A, structure)
        self._order = metis_ordering(A)
        self._entry = _ROW + (16 if structure.startswith("complex") else 8)

    @property
    def forecast(self) -> Forecast:
        entries = int(_ENTRIES * self.n ** (4 / 3))
        size = entries * self._entry
        return Forecast(
            backend=SuperLU.name, size=self.n, factor_entries=entries, flops=0.5 * entries**1.5, memory=size, kept=size
        )

    def factorize_unchecked(self, A: Lower) -> Factorization:
        """Raises SingularMatrixError or SolverError (out of memory)."""
        start = time.perf_counter()
        whole = A.full()
        definite = self.structure == "spd"
        if self._order is not None:
            whole = sp.csc_array(whole[self._order][:, self._order])
        lu = self._decomposed(whole, pivots=False)
        if not definite and _error(lu, whole) > _UNSTABLE:
            # Pivots off the diagonal cost fill and the inertia, but save the solution.
            lu = self._decomposed(whole, pivots=True)
        stats = self._stats(start, int(lu.nnz), memory_bytes=self._entry * int(lu.nnz))
        return _SuperLUFactor(lu, whole, self._order, self.structure, stats)

    def _decomposed(self, whole: sp.csc_array, *, pivots: bool) -> Any:
        order = "MMD_AT_PLUS_A" if self._order is None else "NATURAL"
        try:
            if pivots:
                return spla.splu(whole, permc_spec="COLAMD" if self._order is None else order)
            return spla.splu(whole, permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        except RuntimeError as error:
            if "singular" in str(error):
                raise SingularMatrixError(f"the matrix is exactly singular; {MECHANISM}") from None
            raise SolverError(f"SuperLU failed: {error}") from error
        except MemoryError as error:
            raise SolverError(
                f"SuperLU ran out of memory with {self.n} rows; a MUMPS solver needs a sixth of it"
            ) from error

    def _release(self) -> None:
        self._order = None


@dataclass(frozen=True, kw_only=True)
class SuperLU(LinearSolver):
    """SuperLU in the order of METIS, in memory only."""

    name: ClassVar[str] = "superlu"
    structures: ClassVar[tuple[str, ...]] = STRUCTURES

    @classmethod
    def unavailable(cls) -> str:
        return ""

    def _analyse(self, A: Lower, structure: str) -> Analysis:
        """Raises BudgetError."""
        analysis = _SuperLUAnalysis(A, structure)
        needed = analysis.forecast.memory
        if self.memory is not None and needed > self.memory:
            raise BudgetError(
                f"{self.memory / 1e6:.1f} MB are left of the memory budget for the factorisation; SuperLU needs about "
                f"{needed / 1e6:.0f} MB; give more memory or take a MUMPS solver, which can keep its factor on disk",
                needed=needed,
            )
        return analysis
