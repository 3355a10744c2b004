"""The space of a certified reference: a Krylov space and the modes that it misses, with what leaves it."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.linalg.columns import dot, hstack, map_columns, orthonormal, project_out, subtract, symmetric
from morembs.linalg.congruence import scaled_row_sums
from morembs.linalg.eigen import Modes
from morembs.problem import Problem
from morembs.responses.reference import ReferenceSpace

Floats = NDArray[np.float64]
EPS = float(np.finfo(float).eps)
# Modes of which the Krylov space misses more than this part join it.
MISSED = 1e-6


class KrylovSpace:
    """Columns ``V`` (Nc, n), M-orthonormal: the Krylov space of the loads and the modes that it misses."""

    def __init__(self, problem: Problem, space: ReferenceSpace, modes: Modes, everything: bool = False) -> None:
        self.problem = problem
        lanczos, K, M, budget = space.lanczos, problem.K, problem.M, problem.budget
        V = lanczos.V[:, : lanczos.size]
        seen = (dot(V, M @ modes.vectors, budget) ** 2).sum(axis=0)
        missed = (1 - seen > (0.0 if everything else MISSED**2)).nonzero()[0]
        X = np.array(modes.vectors[:, missed], order="F")
        for _ in range(2 if len(missed) else 0):
            project_out(V, X, M, budget=budget)
            X = orthonormal(X, M, np.ones(X.shape[1]) if X.shape[1] == len(missed) else None)
        self.V = V if not X.shape[1] else hstack(V, X, budget=budget)
        cross, own = dot(V, K @ X, budget), X.T @ (K @ X)
        self.stiffness = symmetric(np.block([[space.stiffness, cross], [cross.T, own]]))
        # Of G M V these columns alone leave the space.
        self.rows = np.r_[np.arange(lanczos.last.start, lanczos.last.stop), lanczos.size + np.arange(X.shape[1])]
        Z = np.array(lanczos.rest_vectors, order="F")
        if X.shape[1]:
            Z = np.hstack([Z, problem.elastic.flexibility(M @ X)])
        for _ in range(2):
            subtract(self.V, np.asarray(np.linalg.solve(self.stiffness, dot(self.V, K @ Z, budget))), Z, budget)
        self.root = root(Z.T @ (K @ Z))

    def residual(self, Y: Floats) -> Floats:
        """(q, k) coordinates of G s_p / theta_p, but for the sign, for Ritz vectors V ``Y`` (n, k)."""
        return np.asarray(self.root @ Y[self.rows])

    def uncertain(self, Y: Floats) -> Floats:
        """(k,) how far round-off in K moves the eigenvalues of V ``Y`` at most, as ``Problem.uncertainty``."""
        weights = self.problem.shared("row sums of |K|", lambda: scaled_row_sums(self.problem.K))
        budget, n = self.problem.budget, self.V.shape[1]
        width = budget.columns(len(self.V))
        parts = [dot(self.V, weights[:, None] * self.V[:, at : at + width], budget) for at in range(0, n, width)]
        return np.asarray(EPS * np.einsum("ij,ij->j", Y, np.hstack(parts) @ Y))


def static_response(problem: Problem) -> Floats:
    """G_e B (Nc, m): elastic displacements under unit interface loads, solved for once. Not to be changed."""
    flexibility = problem.elastic.flexibility
    return problem.shared("static response", lambda: map_columns(flexibility, problem.B, problem.budget))


def root(gram: Floats) -> Floats:
    """R (q, q) with R'R = ``gram``, not less than it up to round-off."""
    size = np.abs(np.diag(gram))
    # Where nothing but round-off is left the diagonal may be negative, and smaller than what is beside it.
    scale = np.sqrt(np.maximum(size, max(EPS * size.max(initial=0.0), float(np.finfo(float).tiny))))
    values, U = sl.eigh(symmetric(gram / np.outer(scale, scale)))
    return np.asarray(np.sqrt(np.maximum(values, 0.0) + len(values) * EPS)[:, None] * U.T * scale)
