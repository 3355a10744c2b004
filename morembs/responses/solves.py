"""How far computed static solutions are from the true ones, by their residuals alone.

A solution x of K x = f, elastic part, has the residual rho = K x - f, and the error G rho. Of U with U'K U = Theta, the
lowest Ritz vectors, let C be the K-orthogonal complement and P = G - U Theta^-1 U' what the flexibility has there. Then

    max_{y in C} rho'y / |y|_K = |rho|_P <= |rho|_W softness,   |rho|_W^2 = rho' W^-1 rho,

W the scaled row sums of |K|, so that |x|'|K||y| <= |W^(1/2) x| |W^(1/2) y|, and the product K x is known to
gamma |W^(1/2) x| in that norm, gamma = (entries of a row + 4) eps / 2 (Higham 2002, section 3.1). softness^2 is the
largest eigenvalue of S = W^(1/2) P W^(1/2). For g with independent normal entries, its unit vector v, and any x that
stands for G f, f = W^(1/2) g, with the residual rho and the part z = x - U Theta^-1 U'K x on C,

    softness^2 |v'g| <= |S g| <= |W^(1/2) z| + softness^2 |rho|_W,

as z - P f = P rho. All of the 8 random vectors g have |v'g| < ``TOL.least_random_part`` with a probability of 1e-12.
Nothing is assumed of the solver.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from morembs.base.types import Floats
from morembs.linalg.congruence import extended_product, scaled_row_sums
from morembs.problem import Problem
from morembs.responses.tolerances import TOL

EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, kw_only=True)
class Softness:
    """``value``, in which residuals are turned into energies; ``proven`` is False where the solver is too inexact."""

    value: float
    proven: bool


class Solves:
    """Static solutions of a problem, with limits of their residuals."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

    @cached_property
    def weights(self) -> Floats:
        """W (Nc,) of K."""
        return self.problem.system.row_sums

    @cached_property
    def gamma(self) -> float:
        """Round-off of a product with K or M, relative to that of the sizes of its terms."""
        rows = max(int(np.diff(A.indptr).max(initial=0)) for A in (self.problem.K, self.problem.M))
        return float((rows + 4 + self.problem.rigid.shape[1]) * 0.5 * EPS)

    @cached_property
    def _mass(self) -> tuple[Floats, float]:
        """Scaled row sums of |M|, and the root of the largest of them over those of K."""
        heavy = scaled_row_sums(self.problem.M)
        return heavy, float(np.sqrt((heavy / self.weights).max()))

    def flexibility(self, F: Floats) -> tuple[Floats, Floats]:
        """Solutions (Nc, k) for the loads ``F`` (Nc, k), refined where they need it, and their residuals (k,)."""
        return self.checked(self.problem.free_free.flexibility(F), F)

    def checked(self, X: Floats, F: Floats) -> tuple[Floats, Floats]:
        """``X`` (Nc, k), refined where it needs it, and limits (k,) of |K X - F|_W, round-off included."""
        best = X, *self._residual(X, F)
        for _ in range(TOL.refinement_steps):
            X, rho, left, lost = best
            if (left <= TOL.residual_over_roundoff * lost).all():
                break
            Y = X - self.problem.free_free.flexibility(rho)
            # Rigid motion has no residual.
            Y -= self.problem.rigid @ (self.problem.rigid.T @ (self.problem.M @ Y))
            new = Y, *self._residual(Y, F)
            if not new[2].max() <= 0.5 * left.max():
                break
            best = new
        return best[0], best[2] + best[3]

    def _residual(self, X: Floats, F: Floats) -> tuple[Floats, Floats, Floats]:
        """K X - F (Nc, k) without what rigid motion balances, its norms (k,), and by how much they may be off."""
        problem, w = self.problem, self.weights
        # C = M Z.
        balance = problem.free_free.C @ (problem.rigid.T @ F)
        rho = problem.K @ X
        rho -= F
        rho += balance
        lost = _norms(X, w) + _norms(F, 1 / w) + _norms(balance, 1 / w)
        return rho, _norms(rho, 1 / w), self.gamma * lost

    def inertia(self, V: Floats, known: float = 0.0) -> Floats:
        """(k,) by how much M ``V`` (Nc, k), a part ``known`` of other unit motions beside, may be off in that norm."""
        heavy, largest = self._mass
        return np.asarray((self.gamma + known) * largest * _norms(V, heavy))

    def product(self, weights: Floats, A: Any, V: Floats) -> Floats:
        """(k,) by how much ``A`` ``V`` (Nc, k) may be off in that norm, ``weights`` the scaled row sums of |A|."""
        rows = int(np.diff(A.indptr).max(initial=0)) + 4
        return np.asarray(0.5 * EPS * rows * np.sqrt((weights / self.weights).max()) * _norms(V, weights))

    def of_modes(self, U: Floats, values: Floats, KU: Floats, MU: Floats, known: Floats) -> Floats:
        """(k,) limits of |K u / value - M u + known|_W for Ritz vectors ``U`` (Nc, k) and their products."""
        w = self.weights
        lost = (_norms(U, w) + _norms(KU, 1 / w)) / values + _norms(known, 1 / w) + _norms(MU, 1 / w)
        return np.asarray(_norms(KU / values - MU + known, 1 / w) + self.gamma * lost + self.inertia(U))

    def energy_of_modes(self, U: Floats, values: Floats, Ze: Floats, softness: float) -> Floats:
        """(k,) limits of |K (u / value + Ze) - M u|_P for Ritz vectors ``U`` (Nc, k) and ``Ze`` (Nc, k).

        The residual is taken in extended precision, where there is one, and solved for: of a stiff model ``softness``
        makes more of the round-off of its evaluation than of the residual.
        """
        problem, w, K = self.problem, self.weights, self.problem.K
        energy, width = np.empty(len(values)), problem.budget.columns(len(U), TOL.block_copies, TOL.block_columns)
        finer = float(np.finfo(np.longdouble).eps) / EPS * self.gamma
        for at in range(0, len(values), width):
            block = slice(at, at + width)
            u = U[:, block].astype(np.longdouble)
            y = u / values[block] + Ze[:, block]
            rho = np.asarray(extended_product(K, y) - extended_product(problem.M, u), dtype=float)
            x, left = self.flexibility(rho)
            z = x - U @ ((U.T @ (K @ x)) / values[:, None])
            own = np.einsum("ij,ij->j", z, K @ z) + self.gamma * _norms(z, w) ** 2
            lost = finer * (_norms(y.astype(float), w) + self.inertia(U[:, block]) / self.gamma)
            lost += EPS * _norms(rho, 1 / w)
            energy[block] = np.sqrt(np.maximum(own, 0.0)) + softness * (left + lost)
        return energy

    def softness(self, U: Floats, values: Floats) -> Softness:
        """The number that turns residuals into energies beside the lowest modes ``U`` (Nc, k) with ``values`` (k,)."""
        x, error = self.problem.compute_once("random solutions", self._random)
        z = x - U @ ((U.T @ (self.problem.K @ x)) / values[:, None])
        grown, least = float(_norms(z, self.weights).max()), TOL.least_random_part - error
        proven = least > TOL.proven_random_part * TOL.least_random_part
        return Softness(value=float(np.sqrt(grown / (least if proven else TOL.least_random_part))), proven=proven)

    def _random(self) -> tuple[Floats, float]:
        """Solutions (Nc, trials) for random loads, and a limit of their residuals."""
        root = np.sqrt(self.weights)[:, None]
        x, left = self.flexibility(root * np.random.default_rng(11).standard_normal((len(root), TOL.random_loads)))
        return x, float(left.max())


def _norms(X: Floats, weights: Floats) -> Floats:
    """(k,) norms of the columns of ``X`` (Nc, k)."""
    return np.asarray(np.sqrt(weights @ (X * X)))
