"""What every sparse solver is: a frozen configuration that turns a matrix into a factorisation."""

from __future__ import annotations

import logging
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import ClassVar, Self, final

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.errors import InputError, SingularMatrixError, SolverError

log = logging.getLogger(__name__)
Floats = NDArray[np.float64]

STRUCTURES = ("spd", "symmetric")
# Inverse iteration from a random start sees 1/eps for a singular matrix; the finest slender
# meshes of practice stay below 1e12.
SINGULAR = 1e14
BACKWARD_ERROR = 1e-10


@dataclass(frozen=True, kw_only=True)
class FactorStats:
    """Cost of one factorisation: stored factor entries, bytes of factors held in memory, seconds."""

    backend: str
    size: int
    nnz: int
    factor_entries: int
    memory_bytes: int
    out_of_core: bool
    seconds: float


class Factorization(ABC):
    """A factor of one matrix; a context manager that gives its memory and files back."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.closed = False

    @property
    @abstractmethod
    def stats(self) -> FactorStats:
        """What the factorisation cost."""

    @abstractmethod
    def _solve(self, B: Floats) -> Floats:
        """A X = B for a Fortran-ordered (n, k) right-hand side that may be overwritten."""

    @abstractmethod
    def _negative_pivots(self) -> int | None:
        """Number of negative eigenvalues, None where the backend cannot say."""

    @abstractmethod
    def _close(self) -> None:
        """Release what the backend holds; called once."""

    @final
    def solve(self, B: Floats) -> Floats:
        """X of A X = B; ``B`` (n,) or (n, k), not changed.

        Peak memory: two copies of ``B`` besides what the backend needs for a block.
        """
        if self.closed:
            raise SolverError("solve was called on a factorisation that is closed; factorise again")
        if B.ndim not in (1, 2) or B.shape[0] != self.n:
            raise InputError(f"a right-hand side of shape {B.shape} was given; expected ({self.n}, k)")
        block = np.array(B.reshape(self.n, -1), dtype=np.float64, order="F", copy=True)
        X = self._solve(block) if block.shape[1] else block
        return X.reshape(B.shape) if B.ndim == 1 else X

    @final
    def negative_pivots(self) -> int:
        """Number of negative eigenvalues of the matrix (Sylvester's law of inertia).

        Raises:
            SolverError: the backend cannot count them.
        """
        count = self._negative_pivots()
        if count is None:
            raise SolverError(f"{self.stats.backend} gives no inertia; take another solver")
        return count

    @final
    def close(self) -> None:
        """Release memory and files; a second call does nothing."""
        if not self.closed:
            self.closed = True
            self._close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __del__(self) -> None:
        if not getattr(self, "closed", True):
            self.close()


@dataclass(frozen=True, kw_only=True)
class LinearSolver(ABC):
    """Configuration of a sparse direct solver.

    ``memory`` is the budget for factors in bytes (None: no limit), ``scratch`` the folder for factors
    that do not fit (None: the temporary folder of the system).
    """

    memory: int | None = None
    scratch: Path | None = None

    name: ClassVar[str]

    @classmethod
    @abstractmethod
    def unavailable(cls) -> str:
        """Why this solver cannot run here and how to get it; empty means that it runs."""

    @abstractmethod
    def _factorize(self, A: sp.csc_array, structure: str) -> Factorization:
        """Factor of a symmetric matrix, both triangles stored, sorted, no duplicates."""

    @final
    def factorize(self, A: sp.sparray, structure: str = "symmetric", what: str = "the matrix") -> Factorization:
        """Factor of the sparse symmetric ``A`` (n, n), checked by solving with it.

        Args:
            structure: "spd" (positive definite) or "symmetric" (indefinite, regular).
            what: words for error messages, such as "the stiffness matrix".

        Raises:
            InputError: not square, or values that are not finite.
            SingularMatrixError: singular to working accuracy.
            SolverError: the backend failed or its solution is inaccurate.
        """
        if structure not in STRUCTURES:
            raise InputError(f"structure = {structure!r} was given; expected one of {', '.join(STRUCTURES)}")
        if A.shape[0] != A.shape[1]:
            raise InputError(f"{what} has the shape {A.shape}; a square one is needed")
        A = sp.csc_array(A)
        A.sum_duplicates()
        if not np.isfinite(A.data).all():
            raise InputError(f"{what} has values that are not finite; check the input matrices")
        start = time.perf_counter()
        factor = self._factorize(A, structure)
        try:
            _check(factor, A, what)
        except BaseException:
            factor.close()
            raise
        stats = factor.stats
        log.info(
            "%s: n=%d nnz=%d factor entries=%d (%.3g MB%s) %.2f s",
            stats.backend, stats.size, stats.nnz, stats.factor_entries, stats.memory_bytes / 1e6,
            ", out of core" if stats.out_of_core else "", time.perf_counter() - start,
        )
        return factor


def _check(factor: Factorization, A: sp.csc_array, what: str) -> None:
    """Two steps of inverse iteration with D A D, whose rows D scales to unit size.

    No backend reports a singular matrix reliably; without the scaling a matrix that mixes forces with
    moments would look singular in small units.
    """
    size = np.sqrt(np.asarray(abs(A).max(axis=0).toarray()).ravel())
    if not (size > 0).all():
        raise SingularMatrixError(f"{what} has {int((size == 0).sum())} rows that are zero; remove these dofs")
    d = 1.0 / size
    norm = float((d * (abs(A) @ d)).max())
    x = np.random.default_rng(7).standard_normal(A.shape[0])
    x /= np.linalg.norm(x)
    for _ in range(2):
        b = x
        # D A D x = b means A (D x) = b / d.
        x = factor.solve(b / d) / d
        growth = float(np.linalg.norm(x))
        if not np.isfinite(growth) or norm * growth > SINGULAR:
            raise SingularMatrixError(
                f"{what} is singular (condition above {SINGULAR:.0e}); likely a mechanism, an unconnected "
                "part, or a body that is not held where it should be"
            )
        residual = float(np.linalg.norm(d * (A @ (d * x)) - b)) / (norm * growth + 1.0)
        if residual > BACKWARD_ERROR:
            raise SolverError(
                f"{factor.stats.backend} solved with {what} to a backward error of only {residual:.1e} "
                f"(needed {BACKWARD_ERROR:.0e}); take another solver, or move the shift"
            )
        x /= growth
