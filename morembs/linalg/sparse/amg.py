"""Algebraic multigrid: an iterative solver for compact bodies, whose memory grows with the rows only.

Smoothed aggregation with the near-nullspace (Vanek, Mandel and Brezina 1996), set up by PyAMG with prolongations
of least energy (Olson, Schroder and Tuminaro 2011). The V-cycle is our own, as those of PyAMG take one vector at
a time: it smooths whole blocks of right-hand sides with Chebyshev polynomials (Adams, Brezina, Hu and Tuminaro
2003) in single precision, and preconditions block conjugate gradients in double precision.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import ClassVar

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base.errors import InputError, SingularMatrixError, SolverError
from morembs.base.types import Floats, Ints, Values
from morembs.linalg.sparse.conjugate_gradient import conjugate_gradients
from morembs.linalg.sparse.ordering import node_graph
from morembs.linalg.sparse.session import FactorSize, Session, SessionSolver
from morembs.linalg.sparse.solver import MECHANISM, Forecast
from morembs.linalg.sparse.symmetric import Lower
from morembs.linalg.sparse.tolerances import TOL

log = logging.getLogger(__name__)
Singles = NDArray[np.float32]

_CURE = 'take a direct solver (solver = "auto")'


@dataclass(frozen=True)
class _Level:
    """A (n, n) divided by its largest diagonal, P (n, m) to the next level and R = P' in single precision."""

    A: sp.csr_array
    P: sp.csr_array
    R: sp.csr_array
    inverse: Singles
    top: float

    def smooth(self, B: Singles, X: Singles | None) -> Singles:
        """``X`` (None: zero) after a Chebyshev polynomial in D^-1 A for A X = B (n, k)."""
        upper, lower = self.top * TOL.spectrum_margin, self.top / TOL.smoothed_part
        center, half = (upper + lower) / 2, (upper - lower) / 2
        first = center / half
        rho = 1 / first
        R = B.copy() if X is None else B - self.A @ X
        D = R * self.inverse
        D *= np.float32(1 / center)
        X = D.copy() if X is None else np.add(X, D, out=X)
        for _ in range(TOL.smoother_degree - 1):
            R -= self.A @ D
            before, rho = rho, 1 / (2 * first - rho)
            D *= np.float32(rho * before)
            step = R * self.inverse
            step *= np.float32(2 * rho / half)
            D += step
            X += D
        return X

    @property
    def nbytes(self) -> int:
        """Bytes held, with the pattern that the first level shares with the matrix."""
        return int(self.inverse.nbytes) + sum(_bytes(matrix) for matrix in (self.A, self.P, self.R))


class Hierarchy:
    """The levels of A (n, n), and the dense Cholesky factor of the coarsest."""

    def __init__(self, A: sp.csr_array, near: Floats | None, starts: Ints) -> None:
        self.unit = float(A.diagonal().max())
        self.levels: list[_Level] = []
        coarsest = A
        if A.shape[0] > TOL.coarsest_rows:
            coarsest = self._coarsen(A, near, starts)
        dense = coarsest.toarray() / self.unit
        size = np.sqrt(np.diag(dense).clip(0.0))
        # Motions that depend on each other within an aggregate leave empty rows.
        empty = size == 0
        dense[empty, empty] = 1.0
        self._scale = 1.0 / np.where(empty, 1.0, size)
        try:
            self._factor = np.linalg.cholesky(self._scale[:, None] * dense * self._scale)
        except np.linalg.LinAlgError:
            raise _singular() from None
        if np.diag(self._factor).min() ** 2 < 1.0 / TOL.singular_condition:
            raise _singular()
        self.entries = dense.size // 2 + int(sum(level.A.nnz + level.P.nnz for level in self.levels))
        self.nbytes = int(self._factor.nbytes) + sum(level.nbytes for level in self.levels)

    def _coarsen(self, A: sp.csr_array, near: Floats | None, starts: Ints) -> sp.csr_array:
        """Fill ``levels``; returns the matrix of the coarsest one."""
        import pyamg

        blocks, place, near = by_nodes(A, near, starts)
        try:
            levels = pyamg.smoothed_aggregation_solver(
                blocks,
                B=near,
                symmetry="symmetric",
                strength=("symmetric", {"theta": TOL.strong_coupling}),
                smooth=("energy", {"maxiter": TOL.prolongation_steps, "degree": 1}),
                improve_candidates=None,
                presmoother=None,
                postsmoother=None,
                max_levels=TOL.levels,
                max_coarse=TOL.coarsest_rows // TOL.aggregate_motions,
            ).levels
        except (ValueError, RuntimeError, IndexError, ZeroDivisionError, MemoryError) as error:
            raise SolverError(
                f"PyAMG could not set up a multigrid hierarchy ({error}); {_CURE}", keyword="solver"
            ) from error
        del blocks, near
        for number, level in enumerate(levels[:-1]):
            P = sp.csr_array(level.P, dtype=np.float32)
            self.levels.append(_level(sp.csr_array(level.A) if number else A, P if number else P[place], self.unit))
            levels[number] = None
        if levels[-1].A.shape[0] > TOL.failed_coarsest_rows:
            raise SolverError(
                f"multigrid could not coarsen below {levels[-1].A.shape[0]} rows: the unknowns hardly couple; {_CURE}"
            )
        return sp.csr_array(levels[-1].A) if len(levels) > 1 else A

    def precondition(self, R: Floats) -> Floats:
        """One V-cycle for A Z = R (n, k); the solution where there is one level only."""
        if not self.levels:
            return self._solve_coarsest(R) / self.unit
        size = np.linalg.norm(R, axis=0)
        size[size == 0] = 1.0
        B = np.empty(R.shape, dtype=np.float32)
        np.divide(R, size, out=B, casting="same_kind")
        Z = np.empty(R.shape, order="F")
        np.multiply(self._cycle(0, B), size / self.unit, out=Z)
        return Z

    def _solve_coarsest(self, B: Values) -> Floats:
        scale = self._scale[:, None]
        Y = sl.cho_solve((self._factor, True), scale * B, overwrite_b=True, check_finite=False)
        return np.asarray(scale * Y)

    def _cycle(self, number: int, B: Singles) -> Singles:
        if number == len(self.levels):
            return self._solve_coarsest(B).astype(np.float32)
        level = self.levels[number]
        X = level.smooth(B, None)
        X += level.P @ self._cycle(number + 1, level.R @ (B - level.A @ X))
        return level.smooth(B, X)


def _level(A: sp.csr_array, P: sp.csr_array, unit: float) -> _Level:
    """A level in single precision; shares the pattern of ``A``."""
    d = A.diagonal() / unit
    if not (d >= 0).all():
        raise SingularMatrixError("the matrix should be positive definite but has a negative value on its diagonal")
    inverse = np.divide(1.0, d, out=np.zeros_like(d), where=d > 0).astype(np.float32)
    single = sp.csr_array(((A.data / unit).astype(np.float32), A.indices, A.indptr), shape=A.shape)
    x = np.random.default_rng(17).standard_normal(A.shape[0]).astype(np.float32)
    top = 1.0
    for _ in range(TOL.power_steps):
        x = inverse * (single @ (x / np.linalg.norm(x)))
        top = float(np.linalg.norm(x))
    return _Level(single, P, sp.csr_array(P.T), inverse[:, None], top)


def by_nodes(A: sp.csr_array, near: Floats | None, starts: Ints) -> tuple[sp.bsr_matrix, Ints, Floats]:
    """``A`` in blocks of one node each, the place (n,) of its rows there, and the near-nullspace there.

    Rows of equal pattern, which begin at ``starts``, are treated as a node, three at a time; a node with fewer gets
    rows of its own that touch nothing. Without a near-nullspace it is one constant for each unknown of a node.
    """
    n = A.shape[0]
    width = TOL.node_rows if len(starts) <= n / 2 else 1
    counts = np.diff(np.append(starts, n))
    offset = np.arange(n) - np.repeat(starts, counts)
    head = offset % width == 0
    place = (np.cumsum(head) - 1) * width + offset % width
    size = int(np.count_nonzero(head)) * width
    indptr = np.zeros(size + 1, dtype=np.int32)
    indptr[place + 1] = np.diff(A.indptr)
    np.cumsum(indptr, out=indptr)
    indices = place.astype(np.int32)[A.indices]
    blocks = sp.csr_matrix((A.data, indices, indptr), shape=(size, size)).tobsr((width, width))
    row = np.repeat(np.arange(size // width), np.diff(blocks.indptr))
    diagonal = blocks.data[row == blocks.indices]
    idle = np.ones(size, dtype=bool)
    idle[place] = False
    which = np.flatnonzero(idle)
    diagonal[which // width, which % width, which % width] = diagonal[which // width, 0, 0]
    blocks.data[row == blocks.indices] = diagonal
    wide = np.zeros((size, width if near is None else near.shape[1]))
    wide[place] = np.eye(width)[place % width] if near is None else near
    return blocks, place, wide


class AmgSession(Session):
    """The nodes, as the pattern shows them; then the hierarchy, and the matrix in double precision.

    ``levels`` are the rows of the levels, finest first, ``steps`` those of the last solution.
    """

    title = "multigrid"
    instead = "give more memory or take a coarser mesh"
    thread_safe = True
    solver: Amg

    def __init__(self, solver: Amg, A: Lower, structure: str) -> None:
        super().__init__(solver, A, structure)
        self.near = solver.near_nullspace
        if self.near is not None and (
            self.near.ndim != 2 or self.near.shape[0] != A.n or not np.isfinite(self.near).all()
        ):
            raise InputError(
                f"a near-nullspace of shape {self.near.shape} was given; expected finite values ({A.n}, r)",
                keyword="near",
            )
        self._starts: Ints | None = None
        self._A: sp.csr_array | None = None
        self._hierarchy: Hierarchy | None = None
        self._norm = 0.0
        self.steps = 0
        self.levels: list[int] = []

    def _analyse(self, A: Lower) -> Forecast:
        peak, kept = (
            int(entry * self.nnz + row * self.n + other)
            for entry, row, other in (TOL.multigrid_peak, TOL.multigrid_kept)
        )
        entries = int(TOL.multigrid_entries * self.nnz)
        return self.forecast(entries=entries, flops=TOL.multigrid_flops * self.nnz, memory=peak, kept=kept)

    def _factorize(self, A: Lower) -> FactorSize:
        """Both triangles of ``A`` are held in double precision, which the forecast counts.

        Raises SingularMatrixError (also where not positive definite) or SolverError (no hierarchy).
        """
        if self._starts is None:
            self._starts = node_graph(A)[1] if A.n > TOL.coarsest_rows else np.arange(A.n)
        matrix = A.full()
        # Symmetric, so its columns are its rows; PyAMG takes indices of 32 bits only.
        indices, indptr = (index.astype(np.int32, copy=False) for index in (matrix.indices, matrix.indptr))
        rows = sp.csr_array((matrix.data, indices, indptr), shape=matrix.shape)
        del matrix
        hierarchy = Hierarchy(rows, self.near, self._starts)
        kept = hierarchy.nbytes + (int(rows.data.nbytes) if hierarchy.levels else _bytes(rows))
        self._A, self._hierarchy = rows, hierarchy
        self._norm = float(abs(rows).sum(axis=1).max())
        self.columns = TOL.block_columns
        if (budget := self.solver.memory) is not None:
            room = (budget - kept) // (TOL.multigrid_solve_bytes * self.n)
            self.columns = min(TOL.block_columns, max(1, room))
        self.levels = [level.A.shape[0] for level in hierarchy.levels]
        log.debug("multigrid with levels of %s rows", self.levels)
        return FactorSize(entries=hierarchy.entries, memory=kept)

    def _solve(self, B: Values) -> Values:
        """Raises SolverError where the iteration does not converge."""
        if self._A is None or self._hierarchy is None:
            raise SolverError("multigrid holds no hierarchy any more; factorise again")
        solution = conjugate_gradients(self._A.__matmul__, self._hierarchy.precondition, B, norm=self._norm)
        self.steps = solution.steps
        error = float(solution.residual.max(initial=0.0))
        log.debug("multigrid: %d steps to a backward error of %.1e", solution.steps, error)
        if solution.stagnated or not error <= TOL.iteration_accuracy:
            raise SolverError(
                f"multigrid came to a backward error of only {error:.1e} in {solution.steps} steps (needed "
                f"{TOL.iteration_accuracy:.0e}); it converges slowly for slender bodies, thin walls and stretched "
                f"elements, and not at all for a body that is not held: {_CURE}",
                keyword="solver",
            )
        return solution.X

    def _forget(self) -> None:
        self._A = self._hierarchy = None


@dataclass(frozen=True, kw_only=True)
class Amg(SessionSolver):
    """Multigrid of positive definite matrices, for compact bodies; ``scratch`` has no effect.

    ``near_nullspace`` (n, r) holds motions that cost next to no energy, such as the rigid-body modes of the body
    without its supports; without it each unknown of a node is constant, which takes more steps.
    """

    near_nullspace: Floats | None = field(default=None, compare=False, repr=False)

    name: ClassVar[str] = "amg"
    structures: ClassVar[tuple[str, ...]] = ("spd",)
    counts: ClassVar[bool] = False
    session: ClassVar[type[Session]] = AmgSession

    @classmethod
    def unavailable(cls) -> str:
        return "" if find_spec("pyamg") else "PyAMG is not installed; get it with: pip install pyamg"


def _bytes(A: sp.csr_array) -> int:
    return int(A.data.nbytes + A.indices.nbytes + A.indptr.nbytes)


def _singular() -> SingularMatrixError:
    return SingularMatrixError(f"the matrix is singular or not positive definite; {MECHANISM}")
