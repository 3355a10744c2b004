"""What every sparse solver is: a frozen configuration that turns a matrix into a factorisation.

    solver.analyse(A)  ->  Analysis (pattern only: forecast)  ->  analysis.factorize(A)  ->  Factorization

``solver.factorize(A)`` is both steps in one. A backend writes the methods with an underscore only.
"""

from __future__ import annotations

import logging
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, ClassVar, Self, final

import numpy as np
import scipy.sparse as sp

from morembs.base.closing import Closing
from morembs.base.errors import BudgetError, InputError, SingularMatrixError, SolverError
from morembs.base.former_names import with_old_names
from morembs.base.progress import SILENT, Progress
from morembs.base.types import Floats, Values
from morembs.linalg.sparse.symmetric import General, Lower
from morembs.linalg.sparse.threads import blas_threads

log = logging.getLogger(__name__)

SYMMETRIC_STRUCTURES = ("spd", "symmetric", "complex-symmetric")
STRUCTURES = (*SYMMETRIC_STRUCTURES, "unsymmetric", "complex-unsymmetric")
# Inverse iteration from a random start sees 1/eps for a singular matrix; the finest slender
# meshes of practice stay below 1e12.
SINGULAR = 1e14
BACKWARD_ERROR = 1e-10
# What a matrix lacks that should be positive definite.
MECHANISM = "likely a mechanism, an unconnected part, or a body that is not held where it should be"
# Starting vectors of the one step that a factor on disk is checked with: every step reads it all.
_ON_DISK = 4


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """What a factorisation will need, from its symbolic analysis. Bytes and operations.

    ``memory`` is the peak of the factorisation itself, without the matrix that the caller holds;
    ``disk`` the size of its scratch files, 0 in core; ``kept`` what stays in memory for the solves. Where there are
    several ``ranks`` on this machine, all of it is theirs, and ``memory`` and ``kept`` are those of all together.
    """

    backend: str
    size: int
    factor_entries: int
    flops: float
    memory: int
    kept: int
    disk: int = 0
    precision: str = "double"
    ranks: int = 1

    @property
    def out_of_core(self) -> bool:
        """Whether the factor lies on disk."""
        return self.disk > 0


@dataclass(frozen=True, kw_only=True)
class FactorStats:
    """Cost of one factorisation: stored factor entries, operations, bytes of factors held in memory and
    on disk, arithmetic, threads of the BLAS (0: not known), seconds.

    ``columns`` have been solved for with it so far, in ``passes`` over the whole factor: each reads a factor on disk
    twice, there and back."""

    backend: str
    size: int
    nnz: int
    factor_entries: int
    memory_bytes: int
    out_of_core: bool
    seconds: float
    flops: float = 0.0
    disk_bytes: int = 0
    precision: str = "double"
    threads: int = 0
    columns: int = 0
    passes: int = 0


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
    def replaced(self) -> None:
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
            raise SolverError("solve was called on a factorisation that is closed; factorise again")
        if B.ndim not in (1, 2) or B.shape[0] != self.n:
            raise InputError(f"a right-hand side of shape {B.shape} was given; expected ({self.n}, k)")
        if B.dtype.kind == "c" and self.dtype.kind != "c":
            raise InputError("a complex right-hand side was given for a real matrix; solve for both parts")
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
            raise SolverError(f"{self.stats.backend} gives no inertia of this matrix; take another solver")
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

    @abstractmethod
    def factorize_unchecked(self, A: Lower) -> Factorization:
        """Factor of a matrix with the pattern of this analysis, for those who check it or only count its pivots.

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
            raise SolverError("factorize was called on an analysis that is closed; analyse again")
        lower = _stored(A, self.structure, what)
        if lower.n != self.n or lower.pattern != self._pattern:
            raise InputError(
                f"{what} has another pattern than the matrix that was analysed; store zeros where a value is missing"
            )
        if (lower.data.dtype.kind == "c") != self.structure.startswith("complex"):
            raise InputError(f"{what} has other values (real or complex) than {self.structure}, which was analysed")
        if not np.isfinite(lower.data).all():
            raise InputError(f"{what} has values that are not finite; check the input matrices")
        if self._current is not None:
            self._current.replaced()
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


@with_old_names(knowing="with_near_null_space")
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
        if structure not in STRUCTURES:
            raise InputError(f"structure = {structure!r} was given; expected one of {', '.join(STRUCTURES)}")
        if structure not in self.structures:
            raise InputError(
                f"solver = {self.name!r} takes {' or '.join(self.structures)} matrices; {what} is {structure}"
            )
        reason = self.unavailable()
        if reason:
            raise InputError(f"solver = {self.name!r} cannot run here: {reason}")
        lower = _stored(A, structure, what)
        if (lower.data.dtype.kind == "c") != structure.startswith("complex"):
            raise InputError(
                f"{what} was declared {structure}, but its values are "
                f"{'complex' if lower.data.dtype.kind == 'c' else 'real'}"
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
        if structure not in STRUCTURES:
            raise InputError(f"structure = {structure!r} was given; expected one of {', '.join(STRUCTURES)}")
        lower = _stored(A, structure, what)
        analysis = self.analyse(lower, structure, what)
        try:
            factor = analysis.factorize(lower, what)
        except BaseException:
            analysis.close()
            raise
        factor.analysis = analysis
        return factor


@dataclass(frozen=True, kw_only=True)
class ForeignSolver(LinearSolver):
    """A solver whose ``library`` is loaded where the user has it: the library, or why there is none."""

    progress: Progress = field(default=SILENT, compare=False, repr=False)

    library: ClassVar[Callable[[], Any]]

    @classmethod
    def unavailable(cls) -> str:
        library = cls.library()
        return library if isinstance(library, str) else ""

    @classmethod
    def _loaded(cls) -> Any:
        """The library, which ``analyse`` has found available before."""
        return cls.library()


def _stored(A: sp.sparray | Lower, structure: str, what: str) -> Lower:
    """``A`` as solvers of its ``structure`` read it, checked."""
    return General.of(A, what) if structure.endswith("unsymmetric") else Lower.of(A, what)


def refuse_beyond_memory(solver: LinearSolver, wanted: Forecast, who: str, advice: str) -> None:
    """Raise BudgetError where a factor that has to stay in memory exceeds the budget of ``solver``."""
    if solver.memory is not None and wanted.memory > solver.memory:
        raise BudgetError(
            f"{solver.memory / 1e6:.1f} MB are left of the memory budget for the factorisation; "
            f"{wanted.memory / 1e6:.1f} MB are needed by {who}, which keeps the factor in memory; "
            f'give more memory or take solver = "mumps", which {advice}',
            needed=wanted.memory,
        )


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
    on_disk = factor.stats.out_of_core
    x = np.random.default_rng(7).standard_normal((A.n, _ON_DISK if on_disk else 1))
    x = (x / np.linalg.norm(x, axis=0)).astype(factor.dtype)
    steps = 1 if on_disk else 2
    for step in range(steps):
        other = isinstance(A, General) and step == 1
        b = x.conj() if other else x
        # D A D x = b means A (D x) = b / d.
        x = factor.solve(b / d, transposed=other) / d
        growth = float(np.linalg.norm(x, axis=0).max())
        seen = growth * np.sqrt(A.n / _ON_DISK) if on_disk else growth
        if not np.isfinite(growth) or norm * seen > SINGULAR:
            raise SingularMatrixError(f"{what} is singular (condition above {SINGULAR:.0e}); {MECHANISM}")
        used = A.transposed() if other else A
        residual = float(np.linalg.norm(d * (used @ (d * x)) - b, axis=0).max()) / (norm * growth + 1.0)
        if residual > BACKWARD_ERROR:
            raise SolverError(
                f"{factor.stats.backend} solved with {what} to a backward error of only {residual:.1e} "
                f"(needed {BACKWARD_ERROR:.0e}); take another solver, or move the shift"
            )
        x /= growth
