"""SuperLU of SciPy: always there, several times slower and larger than a symmetric factor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from morembs.base.errors import SingularMatrixError, SolverError
from morembs.base.types import Values
from morembs.linalg.sparse.ordering import metis_ordering
from morembs.linalg.sparse.session import FactorSize, Session, SessionSolver
from morembs.linalg.sparse.solver import MECHANISM, STRUCTURES, Forecast
from morembs.linalg.sparse.symmetric import Lower
from morembs.linalg.sparse.tolerances import TOL


def _backward_error(lu: Any, A: sp.csc_array) -> float:
    """Backward error of a trial solution."""
    b = np.random.default_rng(3).standard_normal(A.shape[0]).astype(A.dtype)
    x = lu.solve(b)
    return float(np.linalg.norm(A @ x - b) / (np.linalg.norm(abs(A) @ abs(x)) + np.linalg.norm(b)))


class _SuperLUSession(Session):
    """The order of elimination, as SuperLU has no symbolic phase of its own; then LU with the pivots on the diagonal,
    of the matrix in that order."""

    title = "SuperLU"
    instead = "give more memory or take a MUMPS solver, which can keep its factor on disk"
    thread_safe = True

    def __init__(self, solver: SessionSolver, A: Lower, structure: str) -> None:
        super().__init__(solver, A, structure)
        self.columns = None
        self._order = metis_ordering(A)
        self._lu: Any = None
        self._A: sp.csc_array | None = None

    @property
    def _entry(self) -> int:
        """Bytes of an entry: its value and its row number."""
        return self.dtype.itemsize + np.dtype(np.int32).itemsize

    def _analyse(self, A: Lower) -> Forecast:
        entries = int(TOL.superlu_fill * self.n ** (4 / 3))
        size = entries * self._entry
        # n^2 operations (George 1973) in terms of the entries, of which there are about n^(4/3).
        return self.forecast(entries=entries, flops=0.5 * entries**1.5, memory=size, kept=size)

    def _factorize(self, A: Lower) -> FactorSize:
        matrix = A.full()
        definite = self.structure == "spd"
        if self._order is not None:
            matrix = sp.csc_array(matrix[self._order][:, self._order])
        lu = self._decompose(matrix, pivots=False)
        if not definite and _backward_error(lu, matrix) > TOL.backward_error:
            # Pivots off the diagonal cost fill and the inertia, but save the solution.
            lu = self._decompose(matrix, pivots=True)
        self._lu, self._A = lu, None if definite else matrix
        entries = int(lu.nnz)
        return FactorSize(entries=entries, memory=self._entry * entries)

    def _decompose(self, matrix: sp.csc_array, *, pivots: bool) -> Any:
        order = "MMD_AT_PLUS_A" if self._order is None else "NATURAL"
        try:
            if pivots:
                return spla.splu(matrix, permc_spec="COLAMD" if self._order is None else order)
            return spla.splu(matrix, permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        except RuntimeError as error:
            if "singular" in str(error):
                raise SingularMatrixError(f"the matrix is exactly singular; {MECHANISM}") from None
            raise SolverError(f"SuperLU failed: {error}") from error
        except MemoryError as error:
            raise SolverError(
                f"SuperLU ran out of memory with {self.n} rows; a MUMPS solver needs a sixth of it"
            ) from error

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
        symmetric = self.structure in ("spd", "symmetric")
        if not symmetric or not np.array_equal(self._lu.perm_r, self._lu.perm_c):
            return None
        # With equal permutations U = D L^T, and D is congruent to the matrix.
        return int(np.count_nonzero(self._lu.U.diagonal() < 0.0))

    def _forget(self) -> None:
        self._lu = self._A = None


@dataclass(frozen=True, kw_only=True)
class SuperLU(SessionSolver):
    """SuperLU in the order of METIS, in memory only."""

    name: ClassVar[str] = "superlu"
    structures: ClassVar[tuple[str, ...]] = STRUCTURES
    session = _SuperLUSession
