"""A factor of one sparse matrix, the symbolic analysis that makes it, and the check that every factor has to pass."""

from __future__ import annotations

import logging
import time
from abc import abstractmethod
from dataclasses import replace
from typing import Any, final

import numpy as np
import scipy.sparse as sp

from morembs.base.closing import Closing
from morembs.base.errors import InputError, SingularMatrixError, SolverError
from morembs.base.types import Values
from morembs.linalg.sparse.cost import FactorStats, Forecast
from morembs.linalg.sparse.symmetric import General, Lower
from morembs.linalg.sparse.threads import blas_threads
from morembs.linalg.sparse.tolerances import TOL

log = logging.getLogger(__name__)

SYMMETRIC_STRUCTURES = ("spd", "symmetric", "complex-symmetric")
STRUCTURES = (*SYMMETRIC_STRUCTURES, "unsymmetric", "complex-unsymmetric")
# What a matrix lacks that should be positive definite.
MECHANISM = "likely a mechanism, an unconnected part, or a body that is not held where it should be"


class _Resource(Closing):
    """Something that holds memory or files and gives them back."""

    def __init__(self) -> None:
        self.closed = False

    @abstractmethod
    def _close(self) -> None:
        """Release what is held; called once."""

    @final
    def close(self) -> None:
        """Release memory and files; a second call does nothing."""
        if not self.closed:
            self.closed = True
            self._close()

    def __del__(self) -> None:
        if not getattr(self, "closed", True):
            self.close()


class Factorization(_Resource):
    """A factor of one matrix; a context manager that gives its memory and files back.

    ``dtype`` is that of the solutions: float64, or complex128 of a complex symmetric matrix.
    """

    def __init__(self, stats: FactorStats, dtype: Any = np.float64) -> None:
        super().__init__()
        self.n = stats.size
        self.dtype = np.dtype(dtype)
        self._stats = stats
        self._columns = self._passes = 0
        # An analysis made for this factor alone goes when the factor goes.
        self.analysis: Analysis | None = None

    @property
    def stats(self) -> FactorStats:
        """What the factorisation and the solutions with it have cost."""
        return replace(self._stats, columns=self._columns, passes=self._passes)

    @abstractmethod
    def _solve(self, B: Values) -> Values:
        """A X = B for a Fortran-ordered (n, k) right-hand side of ``dtype`` that may be overwritten."""

    def _solve_transposed(self, B: Values) -> Values:
        """A' X = B (not conjugated), as ``_solve``; backends of matrices that are not symmetric have their own."""
        return self._solve(B)

    @abstractmethod
    def _negative_pivots(self) -> int | None:
        """Number of negative eigenvalues, None where the backend cannot say."""

    @abstractmethod
    def _release(self) -> None:
        """Release what the backend holds; called once."""

    def _give_way(self) -> None:
        """Release what the next factor of the same analysis does not overwrite."""
        self._release()

    @final
    def _close(self) -> None:
        self._release()
        if self.analysis is not None:
            self.analysis.close()

    @final
    def make_way(self) -> None:
        """Close this factor, because the next one of the same analysis takes its place."""
        if not self.closed:
            self.closed = True
            self._give_way()

    @final
    def solve(self, B: Values | sp.sparray, *, transposed: bool = False) -> Values:
        """X of A X = B, or of A' X = B; ``B`` (n,) or (n, k) dense, not changed, or sparse (n, k). X is dense.

        Peak memory: two copies of ``B`` besides what the backend needs for a block.

        Raises:
            InputError: wrong shape, or a complex right-hand side for a real matrix.
            SolverError: the factorisation is closed, or the backend failed.
        """
        if self.closed:
            raise SolverError("solve was called on a factorisation that is closed; factorise again", keyword="solve")
        if B.ndim not in (1, 2) or B.shape[0] != self.n:
            raise InputError(f"a right-hand side of shape {B.shape} was given; expected ({self.n}, k)", keyword="B")
        if B.dtype.kind == "c" and self.dtype.kind != "c":
            raise InputError(
                "a complex right-hand side was given for a real matrix; solve for both parts",
                kind="unsupported",
                keyword="B",
            )
        if sp.issparse(B):
            sparse: Any = B
            B = sparse.toarray()
        block = np.array(B.reshape(self.n, -1), dtype=self.dtype, order="F", copy=True)
        if block.shape[1]:
            self._columns += block.shape[1]
            self._passes += 1
        apply = self._solve_transposed if transposed else self._solve
        X = apply(block) if block.shape[1] else block
        return X.reshape(B.shape) if B.ndim == 1 else X

    @final
    def negative_pivots(self) -> int:
        """Number of negative eigenvalues of the matrix (Sylvester's law of inertia).

        Raises:
            SolverError: the backend cannot count them.
        """
        count = self._negative_pivots()
        if count is None:
            raise SolverError(
                f"{self.stats.backend} gives no inertia of this matrix; take another solver", keyword="solver"
            )
        return count


class Analysis(_Resource):
    """Symbolic analysis of one pattern, for matrices with that pattern. One factor of it lives at a time."""

    def __init__(self, pattern: Lower, structure: str) -> None:
        super().__init__()
        self.n, self.lower_nnz = pattern.n, pattern.nnz
        self.nnz = 2 * pattern.nnz - pattern.n
        self.structure = structure
        # Why this solver was chosen, in one line, where there was a choice.
        self.choice = ""
        self._pattern = pattern.pattern
        self._current: Factorization | None = None

    @property
    @abstractmethod
    def forecast(self) -> Forecast:
        """What a factorisation of this pattern will need."""

    @property
    def on_disk(self) -> Forecast | None:
        """The forecast with the factor on disk, None where the solver keeps it in memory only."""
        return None

    @abstractmethod
    def factorize_unchecked(self, A: Lower) -> Factorization:
        """Factor of a matrix with the pattern of this analysis, for callers that check it or only count its pivots.

        Raises:
            SingularMatrixError: the backend came upon a pivot that it cannot take.
            SolverError: the backend failed.
        """

    @abstractmethod
    def _release(self) -> None:
        """Release what the backend holds; called once."""

    def _stats(self, start: float, entries: int, **more: Any) -> FactorStats:
        """Statistics of a factor with ``entries`` of 8 bytes in memory that was begun at ``start``.

        ``more`` are fields of ``FactorStats`` that differ from these.
        """
        plan = self.forecast
        usual: dict[str, Any] = {
            "memory_bytes": 8 * entries,
            "out_of_core": False,
            "flops": plan.flops,
            "precision": plan.precision,
        }
        return FactorStats(
            backend=plan.backend,
            size=self.n,
            nnz=self.nnz,
            factor_entries=entries,
            threads=blas_threads(),
            seconds=time.perf_counter() - start,
            **{**usual, **more},
        )

    @final
    def _close(self) -> None:
        if self._current is not None:
            self._current.close()
        self._release()

    @final
    def factorize(self, A: sp.sparray | Lower, what: str = "the matrix") -> Factorization:
        """Factor of ``A``, checked by solving with it; closes the factor made before.

        Raises:
            InputError: another pattern than the one analysed, or values that are not finite.
            SingularMatrixError: singular to working accuracy.
            SolverError: the backend failed, its solution is inaccurate, or the analysis is closed.
        """
        if self.closed:
            raise SolverError("factorize was called on an analysis that is closed; analyse again", keyword="factorize")
        lower = as_stored(A, self.structure, what)
        if lower.n != self.n or lower.pattern != self._pattern:
            raise InputError(
                f"{what} has another pattern than the matrix that was analysed; store zeros where a value is missing",
                kind="conflict",
                keyword="pattern",
            )
        if (lower.data.dtype.kind == "c") != self.structure.startswith("complex"):
            raise InputError(f"{what} has other values (real or complex) than {self.structure}, which was analysed")
        if not np.isfinite(lower.data).all():
            raise InputError(f"{what} has values that are not finite; check the input matrices", keyword="matrix")
        if self._current is not None:
            self._current.make_way()
        start = time.perf_counter()
        self._current = factor = self.factorize_unchecked(lower)
        try:
            check_factor(factor, lower, what)
        except BaseException:
            factor.close()
            raise
        stats = factor.stats
        log.info(
            "%s: n=%d nnz=%d factor entries=%d (%.3g MB%s, %s precision, %d threads) %.2f s, %.2f s with its check",
            stats.backend,
            stats.size,
            stats.nnz,
            stats.factor_entries,
            (stats.memory_bytes + stats.disk_bytes) / 1e6,
            " out of core" if stats.out_of_core else "",
            stats.precision,
            stats.threads,
            stats.seconds,
            time.perf_counter() - start,
        )
        return factor


def as_stored(A: sp.sparray | Lower, structure: str, what: str) -> Lower:
    """``A`` as solvers of its ``structure`` read it, checked."""
    return General.of(A, what) if structure.endswith("unsymmetric") else Lower.of(A, what)


def check_factor(factor: Factorization, A: Lower, what: str) -> None:
    """Inverse iteration with D A D, whose rows D scales to unit size.

    No backend reports a singular matrix reliably; without the scaling a matrix that mixes forces with
    moments would look singular in small units. In memory two steps with one vector; on disk one step with
    a few vectors, which see the lowest mode with a share of about 1/sqrt(n). A matrix that is not symmetric takes
    its transpose in the second step, so that the least singular value is what is seen.
    """
    size = np.sqrt(A.largest_in_rows())
    if not (size > 0).all():
        raise SingularMatrixError(f"{what} has {int((size == 0).sum())} rows that are zero; remove these dofs")
    d = (1.0 / size)[:, None]
    norm = A.scaled_norm(d[:, 0])
    on_disk, vectors = factor.stats.out_of_core, TOL.check_vectors_on_disk
    x = np.random.default_rng(7).standard_normal((A.n, vectors if on_disk else 1))
    x = (x / np.linalg.norm(x, axis=0)).astype(factor.dtype)
    steps = 1 if on_disk else 2
    for step in range(steps):
        other = isinstance(A, General) and step == 1
        b = x.conj() if other else x
        # D A D x = b means A (D x) = b / d.
        x = factor.solve(b / d, transposed=other) / d
        growth = float(np.linalg.norm(x, axis=0).max())
        expected_growth = growth * np.sqrt(A.n / vectors) if on_disk else growth
        if not np.isfinite(growth) or norm * expected_growth > TOL.singular_condition:
            raise SingularMatrixError(f"{what} is singular (condition above {TOL.singular_condition:.0e}); {MECHANISM}")
        used = A.transpose() if other else A
        residual = float(np.linalg.norm(d * (used @ (d * x)) - b, axis=0).max()) / (norm * growth + 1.0)
        if residual > TOL.backward_error:
            raise SolverError(
                f"{factor.stats.backend} solved with {what} to a backward error of only {residual:.1e} "
                f"(needed {TOL.backward_error:.0e}); take another solver, or move the shift"
            )
        x /= growth
