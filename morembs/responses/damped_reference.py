"""The space of a reference model whose damping is a matrix of its own.

It begins with second-order Krylov blocks at zero, which are real and take one static solve each; where few dofs are
damped, as by discrete dampers, the forces of the dampers count as loads: the response is then exact in the space of
both (Woodbury). Direct solutions of the full equations follow, two at once, where the last ones changed the response
most. They also tell the true error there: the space is good when two pairs in a row find none. Small models take all
their modes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base import progress
from morembs.base.errors import SolverError
from morembs.base.types import Complexes, Floats
from morembs.base.units import in_hz
from morembs.linalg.columns import orthonormal
from morembs.linalg.dense import symmetric
from morembs.linalg.eigen import accurate_eigh
from morembs.linalg.second_order_arnoldi import SecondOrderArnoldi
from morembs.problem import SOFTER, Problem
from morembs.responses.direct import state, states_pool
from morembs.responses.tolerances import TOL


class DampedSpace:
    """Columns V (Nc, k), M-orthonormal, for the elastic response to the loads ``F`` (Nc, p)."""

    def __init__(self, problem: Problem, D: sp.csr_array, F: Floats, omega: Floats) -> None:
        self.problem, self.D, self.F, self.highest = problem, D, F, float(omega.max())
        if len(F) <= TOL.dense_order:
            V = sl.null_space((problem.M @ problem.rigid).T) if problem.rigid.shape[1] else np.eye(len(F))
            self.scale = np.ones(F.shape[1])
            self.V = orthonormal(V, problem.M)
            return
        start = problem.free_free.flexibility(np.hstack([F, _dampers(D)]))
        own = start[:, : F.shape[1]]
        self.scale = 1.0 / np.sqrt(np.maximum(np.einsum("ij,ij->j", F, own), np.finfo(float).tiny))
        own *= self.scale
        space = SecondOrderArnoldi(problem.space, D, start, shift=0.0, scale=self.highest)
        for _ in range(TOL.damped_first_blocks - 1):
            space.expand(problem.free_free.flexibility)
        self.V = problem.space.hstack(*space.blocks)

    def until(self, omega: Floats, tolerance: float) -> tuple[Floats, Floats, Floats, Floats, float]:
        """(V (Nc, k), eigenvalues (k,), Y (k, k), D (k, k), error): grown until H is known to ``tolerance``.

        Raises:
            SolverError: it is not with ``TOL.max_order`` columns.
        """
        if len(self.F) <= TOL.dense_order:
            return (self.V, *self._refine_soft_modes(), 0.0)
        grid = omega[omega > 0][:: max(1, len(omega) // TOL.change_samples)]
        loads, good, visited = self.F * self.scale, 0, list[float]()
        wanted = list(dict.fromkeys([float(omega.max()), float(grid[len(grid) // 2])]))
        before: Complexes = np.zeros((0, 0, 0), dtype=complex)
        with states_pool(self.problem, [1j * wanted[0]] * TOL.shifts_at_once, loads) as pool:
            while True:
                values, Y, D = self._solve_pencil()
                F = Y.T @ self.problem.space.dot(self.V, loads)
                H = np.array([_response(w, values, D, F) for w in grid])
                if visited:
                    change = np.abs(H - before).max(axis=(1, 2)) / np.abs(H).max(axis=(1, 2))
                    wanted = _most_changed(grid, change, visited)
                before, visited = H, visited + wanted
                solved, errors = list[Floats](), list[float]()
                for w, U in zip(wanted, pool.each(state, [1j * w for w in wanted]), strict=True):
                    true = loads.T @ U
                    errors.append(float(np.abs(true - _response(w, values, D, F)).max() / np.abs(true).max()))
                    progress.update(
                        f"frequency response: order {len(values)}, error {errors[-1]:.1e} at {in_hz(w):.4g} Hz"
                    )
                    solved += [U.real, U.imag]
                # Both judge one space: the next one, which has them in it, has to be good as well.
                good = good + 1 if max(errors) <= tolerance else 0
                if good == 2 or not self._extend(np.hstack(solved), max(errors), min(errors) <= tolerance):
                    return (self.V, *self._refine_soft_modes(), max(errors))

    def _extend(self, solved: Floats, error: float, good: bool) -> bool:
        """Take the columns ``solved`` into the space; False where there are no more and it is ``good`` as it is.

        Raises:
            SolverError: no room for them, or none that are new, and an ``error`` above round-off.
        """
        problem, size = self.problem, self.V.shape[1]
        fresh = problem.space.complement([problem.rigid, self.V], solved)
        if fresh.shape[1] and size + fresh.shape[1] <= TOL.max_order:
            self.V = problem.space.hstack(self.V, fresh)
            return True
        # Where nothing is left to add, the rest is the round-off of the direct solution.
        if good or (not fresh.shape[1] and error <= TOL.exhausted_error):
            return False
        raise SolverError(
            f"the response reached an error of only {error:.1e} with {size} vectors; lower the upper "
            f"frequency, {_support(problem.K, self.D, self.highest)}or raise the tolerance"
        )

    def _solve_pencil(
        self, modes: Callable[[Floats, Floats], tuple[Floats, Floats]] = sl.eigh
    ) -> tuple[Floats, Floats, Floats]:
        """Eigenvalues, vectors and damping of the pencil on V.

        Raises:
            SolverError: the columns of V are not independent.
        """
        K, M, D = (self.problem.space.project(self.V, A) for A in (self.problem.K, self.problem.M, self.D))
        try:
            values, Y = modes(K, M)
        except np.linalg.LinAlgError as error:
            raise SolverError(
                f"round-off makes the {len(K)} vectors of the frequency response depend on each other; lower the upper "
                f"frequency, {_support(self.problem.K, self.D, self.highest)}or {SOFTER}"
            ) from error
        return values, Y, symmetric(Y.T @ D @ Y)

    def _refine_soft_modes(self) -> tuple[Floats, Floats, Floats]:
        """``_solve_pencil`` with each eigenvalue known to the round-off of its own energy, not of the highest."""
        problem, space = self.problem, self.problem.space

        def stiffness(Y: Floats) -> Floats:
            return space.project(space.multiply(self.V, Y), problem.K)

        values, Y, D = self._solve_pencil(partial(accurate_eigh, projected=stiffness))
        width = space.budget.columns(len(self.V))
        for at in range(0, len(values), width):
            block = slice(at, at + width)
            X = space.multiply(self.V, Y[:, block])
            values[block] = np.einsum("ij,ij->j", X, problem.K @ X) / np.einsum("ij,ij->j", X, problem.M @ X)
        return values, Y, D


def _most_changed(grid: Floats, change: Floats, visited: Sequence[float]) -> list[float]:
    """The frequencies of ``grid`` (ng,) with the largest ``change`` (ng,), apart from each other and from those
    ``visited``, where the space is exact and a solution proves nothing; one of them where there are no others."""
    chosen: list[float] = []
    for _ in range(TOL.shifts_at_once):
        far = np.abs(grid[:, None] - np.array([*visited, *chosen])).min(axis=1) > TOL.shift_gap * grid[-1]
        if far.any() or not chosen:
            chosen.append(float(grid[np.argmax(np.where(far, change, -1.0))]))
    return chosen


def _response(w: float, values: Floats, D: Floats, F: Floats) -> Complexes:
    A = np.diag(values - w**2) + 1j * w * D
    return np.asarray(F.T @ np.linalg.solve(A, F.astype(complex)))


def _support(K: sp.csr_array, D: sp.csr_array, highest: float) -> str:
    """The cure of dampers that hold their dofs up to ``highest`` rad/s, if there are any."""
    stiffness, force = np.abs(K.diagonal()), highest * np.abs(D.diagonal())
    at = int((force / np.maximum(stiffness, np.finfo(float).tiny)).argmax())
    if force[at] <= TOL.rigid_damper * stiffness[at]:
        return ""
    return (
        f"replace dampers that hold their dofs by supports or rigid couplings (the largest has {D.diagonal()[at]:.1e} "
        f"N s/m, whose force at the upper frequency is {force[at] / stiffness[at]:.0f} times that of the stiffness), "
    )


def _dampers(D: sp.csr_array) -> Floats:
    """Forces (N, d) of dampers, where ``D`` touches few rows; no columns otherwise."""
    rows = np.flatnonzero(np.diff(D.indptr))
    if not 0 < len(rows) <= TOL.damper_rows:
        return np.zeros((D.shape[0], 0))
    values, U = sl.eigh(D[rows][:, rows].toarray())
    kept = U[:, np.abs(values) > TOL.no_damping * np.abs(values).max()]
    forces = np.zeros((D.shape[0], kept.shape[1]))
    forces[rows] = kept
    return forces
