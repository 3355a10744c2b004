r"""What holds on whole parts of a box: lower bounds of K(p) and of K(p) beside M(p), each proven by counts.

On a cell of the morphs t the terms are polynomials of t, K(t) = sum_j beta_j(t) K_j with the Bernstein polynomials
beta_j >= 0, sum_j beta_j = 1: a quadratic form that is positive for all control matrices K_j is so on the whole cell
(Garloff 1986). Without a morph the only control matrix is K itself. The stress of a preload may soften, so that no term
bounds it: beside one t are all parameters of K, and the control matrices those of the corners.

- alpha: K_j - alpha K(p_a) >= 0 with the supports held: no negative pivot.
- Lam^: K_j - Lam^ M_j + sigma W W' >= 0. By Haynsworth (1968), applied to both diagonal blocks of
  [[T, W], [W', -1 / sigma]] with T = K_j - Lam^ M_j, it has as many negative eigenvalues as T less those of
  1 / sigma + W' T^-1 W.

Eigenvalues that are not proven say what to try; the counts decide.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from numpy.typing import NDArray

from morembs.base import progress
from morembs.base.errors import InputError, SingularMatrixError
from morembs.base.types import Floats, Ints
from morembs.linalg.dense import symmetric
from morembs.linalg.dynamic_stiffness import with_fixed_rows
from morembs.linalg.space import Columns
from morembs.linalg.sparse.select import select_solver
from morembs.linalg.sparse.solver import LinearSolver
from morembs.linalg.sparse.symmetric import Lower
from morembs.parametric.law import LINEAR, Law, bernstein
from morembs.parametric.model import ParametricModel
from morembs.parametric.proof import BoxCells
from morembs.parametric.space import GlobalSpace
from morembs.parametric.tolerances import TOL

# Parts of what eigenvalues promise that are tried, one after the other.
TRIED = (0.97, 0.9, 0.8, 0.65)


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """Values ``low`` to ``high`` (P,) of all parameters with ``alpha``, and whether that is ``proven``: of the
    ``corner`` of the cell that has the least."""

    low: Floats
    high: Floats
    alpha: float
    corner: float
    proven: bool

    def halves(self, curved: Ints, whole: Floats) -> list[tuple[Floats, Floats]]:
        """The ends of its halves across its longest side, of the ``curved`` relative to the ``whole`` box (P,)."""
        longest = curved[np.argmax((self.high - self.low)[curved] / whole[curved])]
        below, above = self.high.copy(), self.low.copy()
        below[longest] = above[longest] = 0.5 * (self.low[longest] + self.high[longest])
        return [(self.low, below), (above, self.high)]


class Proofs:
    """Lower bounds on cells of the box of ``space``; ``count`` factorisations so far."""

    def __init__(self, space: GlobalSpace) -> None:
        self.space, self.problem = space, space.problem
        points = space.problem.law_K.points
        self.curved = np.array([j for j, at in enumerate(points) if len(at)], dtype=np.int64)
        self.count = 0

    def controls(self, law: Law, p: Floats, low: Floats, high: Floats) -> Floats:
        """Bernstein coefficients (s, Q) of the terms of ``law`` on a cell, other parameters as in ``p`` (P,)."""
        curved, points = self.curved, self.problem.law_K.points
        turn: Floats = np.ones((1, 1))
        at: Floats = p[None]
        if len(curved):
            grid = np.array(list(product(*(points[j] for j in curved))))
            at = np.tile(p, (len(grid), 1))
            at[:, curved] = grid
        for j in curved:
            turn = np.asarray(np.kron(turn, bernstein(points[j], low[j], high[j])), dtype=np.float64)
        return np.asarray(turn @ law(at))

    def cells(self, finest: int = TOL.max_unproven_cells) -> list[Cell]:
        """The box in cells of the parameters with points, with their alpha; at most ``finest`` of them.

        Raises:
            InputError: values at which a preload makes the body buckle.
        """
        box, curved = self.problem.box, self.curved
        if not len(curved):
            return [Cell(low=box.low, high=box.high, alpha=1.0, corner=1.0, proven=True)]
        cells = [self._cell(box.low, box.high)]
        while len(cells) < finest:
            # Cells are as good as their corners at best: only what Bernstein coefficients lose is gained by halves.
            part = TOL.proven_share if len(cells) < TOL.max_cells else np.finfo(float).tiny
            lossy = [k for k, cell in enumerate(cells) if cell.corner > 0 and cell.alpha < part * cell.corner]
            if not lossy:
                break
            worst = min(lossy, key=lambda k: cells[k].alpha)
            halves = cells[worst].halves(curved, box.high - box.low)
            cells[worst : worst + 1] = [self._cell(low, high) for low, high in halves]
        return [cell if cell.alpha > 0 else self._sample_cell(cell) for cell in cells]

    def _cell(self, low: Floats, high: Floats) -> Cell:
        problem, space = self.problem, self.space
        theta = self.controls(problem.law_K, problem.box.nominal, low, high)
        matrices = [space.stiffness_sum(row) for row in theta]
        progress.update(f"stiffness beside the nominal one on {self._words(low, high)}")
        # The first and the last coefficient of a polynomial are its values at the ends.
        ends = [A for A, corner in zip(matrices, self._corners(len(theta)), strict=True) if corner]
        promised = min(least_ratio(A, space) for A in ends)
        if not promised > 0 and "preload" in problem.box.kinds:
            raise InputError(
                f"the body buckles under [preload] at some of {self._words(low, high)}, where its stiffness is not "
                "positive; lower the upper end of the preload, or raise the least young",
                kind="model",
                keyword="preload",
            )
        for part in TRIED if promised > 0 else ():
            alpha = part * promised
            if all(self.is_positive(A - alpha * space.K, space.supports) for A in matrices):
                return Cell(low=low, high=high, alpha=alpha, corner=promised, proven=True)
        return Cell(low=low, high=high, alpha=0.0, corner=promised, proven=False)

    def _corners(self, size: int) -> NDArray[np.bool_]:
        """Which of the coefficients on a cell are values at its corners."""
        ends = np.ones(1, dtype=bool)
        for j in self.curved:
            axis = np.zeros(len(self.problem.law_K.points[j]), dtype=bool)
            axis[[0, -1]] = True
            ends = np.kron(ends, axis)
        return ends.astype(bool) if len(ends) == size else np.ones(size, dtype=bool)

    def _sample_cell(self, cell: Cell) -> Cell:
        problem, values = self.problem, []
        axes = [np.linspace(cell.low[j], cell.high[j], TOL.morph_samples) for j in self.curved]
        for t in product(*axes):
            p = problem.box.nominal.copy()
            p[self.curved] = t
            values.append(least_ratio(self.space.stiffness_sum(problem.law_K(p)), self.space))
        return replace(cell, alpha=TOL.sampled_share * max(min(values), 0.0))

    def least(self, cells: list[Cell], F: Floats, sigma: float, enough: float, *, proof: bool) -> BoxCells:
        """``cells`` with their Lam^ for W = M_a V ``F`` (n, k), as the reduced terms have it, or with ``proof``; cells
        with less than ``enough`` are split, as K and M on halves are less apart."""
        space, problem = self.space, self.problem
        reduced = space.reduce_model()
        W = np.asarray(problem.M @ (space.columns() @ F)) if proof else None
        W_r = np.tensordot(problem.law_M(problem.box.nominal), reduced.M, 1) @ F
        left, done = list(cells), list[tuple[Cell, float, bool]]()
        while left:
            cell = left.pop(0)
            value, at_corners, is_proven = self._least(cell, reduced, W_r, W, sigma)
            lossy = value < min(enough, TOL.proven_share * at_corners) and len(self.curved) > 0
            if lossy and len(left) + len(done) + 2 <= max(TOL.max_cells, len(cells)):
                ends = cell.halves(self.curved, problem.box.high - problem.box.low)
                left[:0] = [replace(cell, low=low, high=high) for low, high in ends]
            else:
                done.append((cell, value, is_proven))
        return BoxCells(
            low=np.array([cell.low for cell, _, _ in done]),
            high=np.array([cell.high for cell, _, _ in done]),
            alpha=np.array([cell.alpha for cell, _, _ in done]),
            least=np.array([value for _, value, _ in done]),
            proven=np.array([is_proven and cell.proven for cell, _, is_proven in done]),
        )

    def _least(
        self, cell: Cell, reduced: ParametricModel, W_r: Floats, W: Floats | None, sigma: float
    ) -> tuple[float, float, bool]:
        """Lam^ on a cell, what its corners have, and whether it is proven."""
        rows = [self.controls(law, self.soft, cell.low, cell.high) for law in (self.problem.law_K, self.problem.law_M)]
        values = np.array(
            [
                sl.eigvalsh(np.tensordot(a, reduced.K, 1) + sigma * W_r @ W_r.T, np.tensordot(b, reduced.M, 1))[0]
                for a, b in zip(*rows, strict=True)
            ]
        )
        promised, at_corners = float(values.min()), float(values[self._corners(len(values))].min())
        if W is None or not promised > 0:
            return TOL.sampled_share * max(promised, 0.0), at_corners, False
        progress.update(f"modes beside the known ones on {self._words(cell.low, cell.high)}")
        proven_part = next((part for part in TRIED if self._holds(rows, part * promised, W, sigma)), 0.0)
        return proven_part * promised, at_corners, proven_part > 0

    def _holds(self, rows: list[Floats], least: float, W: Floats, sigma: float) -> bool:
        problem = self.problem
        return all(
            self.is_positive(problem.stiffness_sum(a) - least * problem.mass_sum(b), W=W, sigma=sigma)
            for a, b in zip(*rows, strict=True)
        )

    @property
    def soft(self) -> Floats:
        """Values (P,) of the softest and heaviest corner."""
        problem = self.problem
        p = problem.box.nominal.copy()
        for law, end in ((problem.law_K, problem.box.low), (problem.law_M, problem.box.high)):
            used = (law.factors == LINEAR).any(axis=0)
            p[used] = end[used]
        return p

    def is_positive(
        self, A: sp.csr_array, rows: Ints | None = None, *, W: Floats | None = None, sigma: float = 0.0
    ) -> bool:
        """As the function of that name, and counted."""
        self.count += 1
        with self.problem.budget.in_use():
            return is_positive(A, self.problem.solver, rows, W=W, sigma=sigma)

    def _words(self, low: Floats, high: Floats) -> str:
        names = self.problem.box.names
        return ", ".join(f"{names[j]} {low[j]:g} to {high[j]:g}" for j in self.curved) or "the box"


def is_positive(
    A: sp.csr_array, solver: LinearSolver, rows: Ints | None = None, *, W: Floats | None = None, sigma: float = 0.0
) -> bool:
    """True if ``A`` + ``sigma`` W W', with ``rows`` held, has no negative eigenvalue, by a count of pivots."""
    lower = Lower.of(A, "a control matrix", regular=False)
    if rows is not None and len(rows):
        lower = with_fixed_rows(lower, rows)
    counter = solver if solver.counts else select_solver(scratch=solver.scratch)
    try:
        if W is None:
            return counter.negative_eigenvalues(lower, "a control matrix") == 0
        with counter.factorize(lower, "symmetric", "a control matrix") as factor:
            negative = factor.negative_pivots()
            X = Columns().map_columns(factor.solve, W)
    except SingularMatrixError:
        return False
    S = symmetric(np.eye(W.shape[1]) / sigma + W.T @ X)
    return bool(negative == (np.linalg.eigvalsh(S) < 0).sum())


def least_ratio(A: sp.csr_array, space: GlobalSpace) -> float:
    """Estimate of the least eigenvalue of (A, K(p_a)) with the supports held, by Lanczos."""
    K = space.K
    keep = np.setdiff1d(np.arange(K.shape[0]), space.supports)

    def solve(f: Floats) -> Floats:
        F = np.zeros((K.shape[0], 1))
        F[keep, 0] = f.ravel()
        return np.asarray(space.coordinates.flexibility(F)[keep, 0])

    n = len(keep)
    inverse = spl.LinearOperator((n, n), matvec=solve, dtype=np.float64)
    inner = [sp.csr_array(B)[keep][:, keep] for B in (A, K)]
    start = np.random.default_rng(3).standard_normal(n)
    values = spl.eigsh(
        inner[0],
        k=1,
        M=inner[1],
        Minv=inverse,
        which="SA",
        v0=start,
        tol=TOL.least_ratio_residual,
        return_eigenvectors=False,
    )
    return float(values[0])
