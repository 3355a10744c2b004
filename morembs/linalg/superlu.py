"""SuperLU of SciPy: always there, several times slower and larger than a symmetric factor."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from morembs.errors import InputError, SingularMatrixError, SolverError
from morembs.linalg.solver import Factorization, FactorStats, Floats, LinearSolver

# A value and a row number of 32 bits for every entry.
_BYTES = 12


class _SuperLUFactor(Factorization):
    """LU with the pivots on the diagonal."""

    def __init__(self, lu: Any, A: sp.csc_array, refine: bool, seconds: float) -> None:
        super().__init__(A.shape[0])
        self._lu = lu
        self._A = A if refine else None
        self._stats = FactorStats(
            backend=SuperLU.name, size=self.n, nnz=int(A.nnz), factor_entries=int(lu.nnz),
            memory_bytes=int(lu.nnz) * _BYTES, out_of_core=False, seconds=seconds,
        )

    @property
    def stats(self) -> FactorStats:
        return self._stats

    def _solve(self, B: Floats) -> Floats:
        X: Floats = np.asfortranarray(self._lu.solve(B))
        if self._A is not None:
            # Without a choice of pivots an indefinite factor loses digits; one step regains them.
            X += self._lu.solve(B - self._A @ X)
        return X

    def _negative_pivots(self) -> int | None:
        if not np.array_equal(self._lu.perm_r, self._lu.perm_c):
            return None
        # With equal permutations U = D L^T, and D is congruent to the matrix.
        return int(np.count_nonzero(self._lu.U.diagonal() < 0.0))

    def _close(self) -> None:
        self._lu = self._A = None


@dataclass(frozen=True, kw_only=True)
class SuperLU(LinearSolver):
    """SuperLU with a symmetric order; ``memory`` and ``scratch`` have no effect."""

    name: ClassVar[str] = "superlu"

    @classmethod
    def unavailable(cls) -> str:
        return ""

    def _factorize(self, A: sp.csc_array, structure: str) -> Factorization:
        """Raises InputError (empty), SingularMatrixError or SolverError (out of memory)."""
        if A.shape[0] == 0:
            raise InputError("the matrix has no rows; nothing can be solved with it")
        start = time.perf_counter()
        try:
            lu = spla.splu(
                A, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            )
        except RuntimeError as error:
            if "singular" in str(error):
                raise SingularMatrixError(
                    "the matrix is exactly singular; likely a mechanism, an unconnected part, or a body "
                    "that is not held where it should be"
                ) from None
            raise SolverError(f"SuperLU failed: {error}") from error
        except MemoryError as error:
            raise SolverError(
                f"SuperLU ran out of memory with {A.shape[0]} rows; a MUMPS solver needs a sixth of it"
            ) from error
        return _SuperLUFactor(lu, A, structure == "symmetric", time.perf_counter() - start)
