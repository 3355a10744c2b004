"""The space of a reference model whose damping is a matrix of its own.

It begins with second-order Krylov blocks at zero, which are real and take one static solve each; where few dofs are
damped, as by discrete dampers, the forces of the dampers count as loads: the response is then exact in the space of
both (Woodbury). Direct solutions of the full equations follow, each at the frequency where the last one changed the
response most. They also tell the true error there: the space is good when two in a row find none. Small models take
all their modes.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.errors import SolverError
from morembs.linalg.columns import complement, dot, hstack, orthonormal, projected
from morembs.linalg.second_order_arnoldi import SecondOrderArnoldi
from morembs.problem import Problem
from morembs.progress import Progress
from morembs.responses.direct import DENSE, elastic_states

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
MAX_ORDER = 2000
# Blocks of the second-order Krylov space to begin with.
BLOCKS = 4
# Damping matrices that touch no more rows than this are sets of dampers.
FEW_ROWS = 200
# Frequencies at which changes are looked for.
LOOKED_AT = 100
# Error that is put down to round-off where the space cannot grow.
EXHAUSTED = 1e-8
# Nearer to each other than this part of the highest two frequencies count as one.
NEAR = 5e-3


class DampedSpace:
    """Columns V (Nc, k), M-orthonormal, for the elastic response to the loads ``F`` (Nc, p)."""

    def __init__(self, problem: Problem, D: sp.csr_array, F: Floats, omega: Floats) -> None:
        self.problem, self.D, self.F = problem, D, F
        if len(F) <= DENSE:
            V = sl.null_space((problem.M @ problem.rigid).T) if problem.rigid.shape[1] else np.eye(len(F))
            self.scale = np.ones(F.shape[1])
            self.V = orthonormal(V, problem.M)
            return
        start = problem.elastic.flexibility(np.hstack([F, _dampers(D)]))
        own = start[:, : F.shape[1]]
        self.scale = 1.0 / np.sqrt(np.maximum(np.einsum("ij,ij->j", F, own), np.finfo(float).tiny))
        own *= self.scale
        space = SecondOrderArnoldi(problem.M, D, start, shift=0.0, scale=float(omega.max()), budget=problem.budget)
        for _ in range(BLOCKS - 1):
            space.expand(problem.elastic.flexibility)
        self.V = hstack(*space.blocks, budget=problem.budget)

    def until(
        self, omega: Floats, tolerance: float, progress: Progress
    ) -> tuple[Floats, Floats, Floats, Floats, float]:
        """(V (Nc, k), eigenvalues (k,), Y (k, k), D (k, k), error): grown until H is known to ``tolerance``.

        Raises:
            SolverError: it is not with ``MAX_ORDER`` columns.
        """
        if len(self.F) <= DENSE:
            return (self.V, *self._small(), 0.0)
        grid = omega[omega > 0][:: max(1, len(omega) // LOOKED_AT)]
        before, good, at, visited = None, 0, float(omega.max()), list[float]()
        while True:
            values, Y, D = self._small()
            F = Y.T @ dot(self.V, self.F, self.problem.budget) * self.scale
            H = np.array([_response(w, values, D, F) for w in grid])
            if before is not None:
                change = np.abs(H - before).max(axis=(1, 2)) / np.abs(H).max(axis=(1, 2))
                # Where the space was made it is exact, and proves nothing.
                far = np.abs(grid[:, None] - np.array(visited)).min(axis=1) > NEAR * grid[-1]
                at = float(grid[np.argmax(np.where(far, change, -1.0))])
            before = H
            visited.append(at)
            U = elastic_states(self.problem, 1j * at, self.F * self.scale)
            true = (self.F * self.scale).T @ U
            error = float(np.abs(true - _response(at, values, D, F)).max() / np.abs(true).max())
            good = good + 1 if error <= tolerance else 0
            progress.update(f"frequency response: order {len(values)}, error {error:.1e} at {at / (2 * np.pi):.4g} Hz")
            if good == 2:
                return self.V, values, Y, D, error
            fresh = complement(
                [self.problem.rigid, self.V], np.hstack([U.real, U.imag]), self.problem.M, self.problem.budget
            )
            if not fresh.shape[1] or len(values) + fresh.shape[1] > MAX_ORDER:
                # Where nothing is left to add, the rest is the round-off of the direct solution.
                if good or (not fresh.shape[1] and error <= EXHAUSTED):
                    return self.V, values, Y, D, error
                raise SolverError(
                    f"the response reached an error of only {error:.1e} with {len(values)} vectors; lower the upper "
                    "frequency, or raise the tolerance"
                )
            self.V = hstack(self.V, fresh, budget=self.problem.budget)

    def _small(self) -> tuple[Floats, Floats, Floats]:
        """Eigenvalues, vectors and damping of the pencil on V."""
        K, M, D = (projected(self.V, A, self.problem.budget) for A in (self.problem.K, self.problem.M, self.D))
        values, Y = sl.eigh(K, M)
        D = Y.T @ D @ Y
        return values, Y, 0.5 * (D + D.T)


def _response(w: float, values: Floats, D: Floats, F: Floats) -> Complexes:
    A = np.diag(values - w**2) + 1j * w * D
    return np.asarray(F.T @ np.linalg.solve(A, F.astype(complex)))


def _dampers(D: sp.csr_array) -> Floats:
    """Forces (N, d) of dampers, where ``D`` touches few rows; no columns otherwise."""
    rows = np.flatnonzero(np.diff(D.indptr))
    if not 0 < len(rows) <= FEW_ROWS:
        return np.zeros((D.shape[0], 0))
    values, U = sl.eigh(D[rows][:, rows].toarray())
    kept = U[:, np.abs(values) > 1e-12 * np.abs(values).max()]
    forces = np.zeros((D.shape[0], kept.shape[1]))
    forces[rows] = kept
    return forces
