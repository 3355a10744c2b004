"""The space of a certified reference: a Krylov space and the modes that it misses, with what leaves it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sl

from morembs.base.types import Floats
from morembs.linalg.columns import m_norms, orthonormal
from morembs.linalg.dense import symmetric
from morembs.linalg.eigen import Modes
from morembs.problem import Problem
from morembs.responses.reference import ReferenceSpace
from morembs.responses.rounding import EPS, absorb_couplings
from morembs.responses.solves import Softness
from morembs.responses.tolerances import TOL


class ReferenceBasis:
    """Columns ``V`` (Nc, n), M-orthonormal: the Krylov space of the loads and the modes that it misses."""

    def __init__(self, problem: Problem, krylov: ReferenceSpace, modes: Modes, everything: bool = False) -> None:
        self.problem = problem
        lanczos, space, K, M = krylov.lanczos, problem.space, problem.K, problem.M
        V = lanczos.V[:, : lanczos.size]
        captured = (space.dot(V, M @ modes.vectors) ** 2).sum(axis=0)
        missed = (1 - captured > (0.0 if everything else TOL.missed_mode**2)).nonzero()[0]
        X = np.array(modes.vectors[:, missed], order="F")
        for _ in range(2 if len(missed) else 0):
            # What soft modes have of rigid motion by round-off would be scaled up to a mode of its own.
            space.orthogonalize_in_place(problem.rigid, X)
            space.orthogonalize_in_place(V, X)
            X = orthonormal(X, M, np.ones(X.shape[1]) if X.shape[1] == len(missed) else None)
        self.V = V if not X.shape[1] else space.hstack(V, X)
        cross, own = space.dot(V, K @ X), X.T @ (K @ X)
        self.stiffness = symmetric(np.block([[krylov.stiffness, cross], [cross.T, own]]))
        # Of G M V these columns alone leave the space.
        self.rows = np.r_[np.arange(lanczos.last.start, lanczos.last.stop), lanczos.size + np.arange(X.shape[1])]
        Z, residuals = np.array(lanczos.rest_vectors, order="F"), krylov.residuals[: lanczos.size]
        if X.shape[1]:
            solved, own = krylov.solves.flexibility(M @ X)
            Z, residuals = np.hstack([Z, solved]), np.append(residuals, own + krylov.solves.inertia(X))
        self.solves, self.residuals = krylov.solves, residuals
        for _ in range(2):
            space.subtract(self.V, np.asarray(np.linalg.solve(self.stiffness, space.dot(self.V, K @ Z))), Z)
        self.Z, self.forces = Z, K @ Z
        self.root = root(Z.T @ self.forces)

    def modes(self, Y: Floats, values: Floats, k: int, highest: float) -> RitzModes:
        """Ritz vectors V ``Y`` (n, n) with ``values`` (n,), the first ``k`` of them for frequencies up to ``highest``
        rad/s as sharp as round-off in K allows."""
        problem, space, K, M = self.problem, self.problem.space, self.problem.K, self.problem.M
        U = space.multiply(self.V, Y[:, :k])
        # Couplings that the small eigenproblem leaves, in parts of the highest eigenvalue, would hide light damping.
        turn = sl.eigh(symmetric(space.dot(U, K @ U)), symmetric(space.dot(U, M @ U)))[1]
        space.multiply_into(U, turn, U)
        MU = M @ U
        norms = m_norms(U, MU)
        U, MU = U / norms, MU / norms
        Y = np.hstack([Y[:, :k] @ turn, Y[:, k:]])
        KU = K @ U
        coupled = np.hstack([space.dot(U, KU), space.dot(self.V, KU).T @ Y[:, k:]])
        values = np.concatenate([np.diag(coupled), values[k:]])
        # Few rows of V, which may lie in a file.
        rows = np.unique(problem.B.indices)
        loaded = space.read_rows(self.V, rows)
        b = np.vstack([(problem.B.T @ U).T, (problem.B[rows].T @ loaded @ Y[:, k:]).T]) * problem.motion_scale
        unsure = np.concatenate([problem.system.roundoff(U), self.eigenvalue_roundoff(Y[:, k:])])
        unsure = np.maximum(unsure, 4 * EPS * (values + highest**2))
        couplings = np.zeros((len(values), len(values)))
        couplings[:k], couplings[k:, :k] = coupled, coupled[:, k:].T
        np.fill_diagonal(couplings, 0.0)
        softness = self.solves.softness(U, values[:k])
        # The residuals of the first ones themselves.
        residuals = self.residuals @ np.abs(Y)
        residuals[:k] = self.solves.of_modes(U, values[:k], KU, MU, self.forces @ Y[self.rows, :k])
        return RitzModes(
            softness=softness,
            values=values,
            Y=Y,
            vectors=U,
            b=b,
            tau=self.residual(Y),
            lost=softness.value * residuals,
            unsure=absorb_couplings(np.sqrt(unsure), np.sqrt(unsure), couplings)[0] ** 2,
            b_off=self._rows(U[rows], loaded, Y[:, k:], np.sqrt(unsure) / values),
        )

    def _rows(self, U: Floats, V: Floats, Y: Floats, rotation: Floats) -> Floats:
        """(n, m) how far the loads of the modes ``U`` and ``V`` ``Y``, of which these are the loaded rows, may be off.

        They are sums of products, and modes take up z'K u_p / lam_p of the rigid motions z.
        """
        problem = self.problem
        rows = np.unique(problem.B.indices)
        B, Z = abs(problem.B[rows]).T, np.abs(problem.B.T @ problem.rigid)
        sums = np.vstack([(B @ np.abs(U)).T, ((B @ np.abs(V)) @ np.abs(Y)).T])
        errors = EPS * (sums + Z.sum(axis=1)) + rotation[:, None] * (
            Z @ np.sqrt(problem.system.roundoff(problem.rigid))
        )
        return np.asarray(errors * problem.motion_scale)

    def refine(self, modes: RitzModes) -> RitzModes:
        """``modes`` with what is lost of the first ones from solutions for their residuals."""
        U, k = modes.vectors, modes.vectors.shape[1]
        e = modes.Y[self.rows, :k]
        lost = modes.lost.copy()
        # The combination Z e itself is rounded.
        rounded = (len(e) + 1) * EPS * np.sqrt(self.solves.weights @ self.Z**2) @ np.abs(e)
        sharp = self.solves.energy_of_modes(U, modes.values[:k], self.Z @ e, modes.softness.value) + rounded
        lost[:k] = np.minimum(lost[:k], sharp)
        return replace(modes, lost=lost)

    def residual(self, Y: Floats) -> Floats:
        """(q, k) coordinates of G s_p / theta_p, but for the sign, for Ritz vectors V ``Y`` (n, k)."""
        return np.asarray(self.root @ Y[self.rows])

    def eigenvalue_roundoff(self, Y: Floats) -> Floats:
        """(k,) how far round-off in K moves the eigenvalues of V ``Y`` at most, as ``System.roundoff``."""
        weights, V, space = self.problem.system.row_sums, self.V, self.problem.space
        width = space.budget.columns(len(V), copies=2)
        gram = np.zeros((V.shape[1], V.shape[1]))
        for first in range(0, V.shape[1], width):
            block, rest = slice(first, first + width), slice(first, None)
            gram[rest, block] = space.dot(V[:, rest], weights[:, None] * V[:, block])
            gram[block, rest] = gram[rest, block].T
        return np.asarray(EPS * np.einsum("ij,ij->j", Y, gram @ Y))


@dataclass(frozen=True, kw_only=True, eq=False)
class RitzModes:
    """Of a space V (Nc, n): ``values`` (n,), coordinates ``Y`` (n, n) of the modes, their scaled loads ``b`` (n, m),
    ``tau`` (q, n) as ``ReferenceBasis.residual``, known but for ``lost`` (n,) by the residuals of the solutions and
    the ``softness``, the ``vectors`` (Nc, k) of the first ones. The stiffness is off by
    ``unsure`` (n,) at most, with couplings of the square root of its products, and b by ``b_off`` (n, m)."""

    values: Floats
    Y: Floats
    vectors: Floats
    b: Floats
    tau: Floats
    lost: Floats
    softness: Softness
    unsure: Floats
    b_off: Floats


def root(gram: Floats) -> Floats:
    """R (q, q) with R'R = ``gram``, not less than it up to round-off."""
    size = np.abs(np.diag(gram))
    # Where nothing but round-off is left the diagonal may be negative, and smaller than what is beside it.
    scale = np.sqrt(np.maximum(size, max(EPS * size.max(initial=0.0), float(np.finfo(float).tiny))))
    values, U = sl.eigh(symmetric(gram / np.outer(scale, scale)))
    return np.asarray(np.sqrt(np.maximum(values, 0.0) + len(values) * EPS)[:, None] * U.T * scale)
