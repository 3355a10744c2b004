"""Bounds of the error of a reduced transfer function, from the residual of the full equations.

With u_r = V y and the residual r = B - A(i omega) V y, a Galerkin projection (or one with test space W and the
residual of the dual problem) has the error

    H - H_r = r_du' A^-1 r = sum over all modes k of (phi_k' r_du)(phi_k' r) / a_k

with a_k = lam_k - omega^2 + i omega d_k. The modes below lam_c are known, and a Sturm count proved that none is
missing: their part is evaluated. Of the rest only rho = G_e r is needed: |sum| <= gamma |rho_du|_K |rho|_K with
gamma = lam_c / (lam_c - omega^2), the inverse of the inf-sup constant of A on the unknown modes in the norm of K.
This is the residual bound of Rozza, Huynh and Patera 2008 in its primal-dual form, with the known modes deflated,
which keeps it sharp at resonances. It takes one static solve for each reduced coordinate and no factorisation.

It holds for undamped models and for D = alpha M + beta K, to the accuracy of the known modes. For other damping it
is an estimate: gamma then neglects what damping couples the unknown modes to the known ones, and the force of modal
damping on a basis is seen through the reference model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.linalg.eigen import Modes
from morembs.linalg.orthogonal import combine, dot, m_norms, m_orthonormal, remove, subtract
from morembs.linalg.statics import solved
from morembs.problem import Problem
from morembs.reference import Reference

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
# What the vectors of the known modes leave out.
SAFETY = 1 + 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Residual:
    """What the residuals of all loads on a basis V (Nc, n) need: rho = V^ a + Q b + a remainder.

    V^ and Q together are K-orthonormal; ``V_of_V`` (n, n), ``V_of_X`` (n, x) and ``Q_of_X`` (q, x) are the
    coordinates of V and of X = G_e [B, M V, D V] in them, ``rest`` (x,) the K-norms of what they miss of X; D is
    damping other than Rayleigh damping, without which x = m + n. ``modes_of_B`` (k, m), ``modes_K``, ``modes_M`` and
    ``modes_D`` (k, n) are Phi'B, Phi'K V, Phi'M V and Phi'D V of the known modes Phi, ``projected_B`` (n, m),
    ``projected_K``, ``projected_M`` and ``projected_D`` (n, n) the same of the test space W.
    """

    V_of_V: Floats
    V_of_X: Floats
    Q_of_X: Floats
    rest: Floats
    modes_of_B: Floats
    modes_K: Floats
    modes_M: Floats
    modes_D: Floats
    projected_B: Floats
    projected_K: Floats
    projected_M: Floats
    projected_D: Floats

    def projected(self, y: Complexes, omega: float, c: complex, g: complex) -> Complexes:
        """W' r (n, m), which a reduced model with exact matrices makes vanish."""
        return np.asarray(
            self.projected_B - (c * self.projected_K + g * self.projected_M + 1j * omega * self.projected_D) @ y
        )

    def at(self, y: Complexes, omega: float, c: complex, g: complex) -> tuple[Complexes, Complexes, float]:
        """Residual of the coordinates ``y`` (n, m), where A = ``c`` K + ``g`` M + i omega D.

        Phi' r (k, m) of the known modes, a factor (n + q, m) of rho in the norm of K, and the norm of its remainder.
        """
        m, n = self.modes_of_B.shape[1], len(y)
        X = np.vstack([np.eye(m), -g * y, -1j * omega * y])[: len(self.rest)]
        rho = np.vstack([self.V_of_X @ X - c * (self.V_of_V @ y), self.Q_of_X @ X])
        rest = float(np.linalg.norm(self.rest @ np.abs(X)))
        known = self.modes_of_B - (c * self.modes_K + g * self.modes_M) @ y
        if len(self.rest) > m + n:
            known = known - 1j * omega * (self.modes_D @ y)
        return known, rho, rest

    def scaled(self, S: Floats) -> Residual:
        """The same with the loads scaled by ``S`` (m,)."""
        both = np.concatenate([S, np.ones(len(self.rest) - len(S))])
        return replace(
            self, V_of_X=self.V_of_X * both, Q_of_X=self.Q_of_X * both, rest=self.rest * both,
            modes_of_B=self.modes_of_B * S, projected_B=self.projected_B * S,
        )  # fmt: skip

    def tail(self, known: Complexes, rho: Complexes, values: Floats) -> tuple[float, float]:
        """Spectral and Frobenius norm of the part of ``rho`` that the modes with eigenvalues ``values`` do not span."""
        # Phi' r = lam Phi' M rho, and the modes are K-orthogonal with lam as their square.
        gram = rho.conj().T @ rho - known.conj().T @ (known / values[:, None])
        found = np.maximum(sl.eigvalsh(gram), 0.0)
        return float(np.sqrt(found[-1])), float(np.sqrt(found.sum()))


def bound_of(
    primal: tuple[Residual, Complexes], dual: tuple[Residual, Complexes], modes: Modes, omega: float, c: complex,
    g: complex, D: Floats, off: Floats,
) -> float:  # fmt: skip
    """Bound of |r_du' A^-1 r|_F at ``omega`` in rad/s, from both residuals and their coordinates y (n, m).

    ``c`` and ``g`` as in ``Residual.at``; ``D`` (k,) or (k, k) is the further damping of the known modes,
    ``off`` (k,) how far their eigenvalues may be off.
    """
    (P, rho, rest), (P_du, rho_du, rest_du) = (part.at(y, omega, c, g) for part, y in (primal, dual))
    values = modes.eigenvalues
    if D.ndim == 2:
        states = np.linalg.solve(np.diag(c * values + g) + 1j * omega * D, P)
    else:
        a = c * values + g + 1j * omega * D
        size = np.maximum(np.abs(a), np.finfo(float).tiny)
        states = P / (a / size * np.maximum(size - off, np.finfo(float).tiny))[:, None]
    gamma = modes.verified_below / (modes.verified_below - omega**2)
    spectral, _ = primal[0].tail(P, rho, values)
    _, frobenius = dual[0].tail(P_du, rho_du, values)
    known = float(np.linalg.norm(P_du.T @ states))
    return SAFETY * (known + gamma * (spectral + rest) * (frobenius + rest_du))


def static_response(problem: Problem) -> Floats:
    """G_e B (Nc, m): elastic displacements under unit interface loads, solved for once. Not to be changed."""
    return problem.shared("static response", lambda: solved(problem.elastic.flexibility, problem.B, problem.budget))


def residual_of(problem: Problem, V: Floats, W: Floats, modes: Modes, reference: Reference) -> Residual:
    """Residuals on the elastic basis ``V`` (Nc, n), tested with ``W`` (Nc, n), both free of rigid-body motion.

    Peak memory: 4 n + 2 m columns of length Nc; n static solves, 2 n for a damping matrix of the model's own.
    """
    K, M, budget = problem.K, problem.M, problem.budget
    n, m = V.shape[1], problem.B.shape[1]
    damped = problem.D is not None or bool(problem.damping.modal)
    X = budget.empty((len(V), m + n + (n if damped else 0)), order="F")
    X[:, :m] = static_response(problem)
    _fill(X[:, m : m + n], problem, M, V)
    modes_M = dot(modes.vectors, M @ V, budget)
    modes_D = np.zeros_like(modes_M)
    if problem.D is not None:
        _fill(X[:, m + n :], problem, problem.D, V)
        modes_D = dot(modes.vectors, problem.D @ V, budget)
    elif damped:
        X[:, m + n :], modes_D = _modally_damped(problem, V, modes, modes_M, reference)
    # D V = K G_e D V, as seen by columns without rigid-body motion.
    projected_D = dot(W, K @ X[:, m + n :], budget) if damped else np.zeros((n, n))
    gram = dot(V, K @ V, budget)
    L = np.linalg.cholesky(0.5 * (gram + gram.T))
    Vk = combine(V, sl.solve_triangular(L, np.eye(n), lower=True).T, budget.empty(V.shape, order="F"), budget)
    V_of_X = remove(Vk, X, K, budget=budget)
    Q_of_X = np.zeros((0, X.shape[1]))
    size = m_norms(X, K @ X)
    # Directions that one pass takes for round-off of its largest ones are found by the next.
    for _ in range(3):
        Q = m_orthonormal(X, K, size)
        if not Q.shape[1]:
            break
        # Q only needs to be orthonormal; what it misses of the old directions stays in the remainder.
        coordinates = dot(Q, K @ X, budget)
        subtract(Q, coordinates, X, budget)
        Q_of_X = np.vstack([Q_of_X, coordinates])
    return Residual(
        V_of_V=np.asarray(L.T), V_of_X=V_of_X, Q_of_X=Q_of_X, rest=m_norms(X, K @ X),
        modes_of_B=modes.vectors.T @ problem.B, modes_K=dot(modes.vectors, K @ V, budget), modes_M=modes_M,
        modes_D=modes_D, projected_B=(problem.B.T @ W).T, projected_K=gram if W is V else dot(W, K @ V, budget),
        projected_M=dot(W, M @ V, budget), projected_D=projected_D,
    )  # fmt: skip


def _fill(X: Floats, problem: Problem, A: sp.csr_array, V: Floats) -> None:
    """G_e A V into ``X`` (Nc, n), some columns at a time."""
    width = problem.budget.columns(len(V))
    for at in range(0, V.shape[1], width):
        X[:, at : at + width] = problem.elastic.flexibility(A @ V[:, at : at + width])
        problem.budget.relax()


def _modally_damped(
    problem: Problem, V: Floats, modes: Modes, modes_M: Floats, reference: Reference
) -> tuple[Floats, Floats]:
    """G_e D V (Nc, n) and Phi'D V (k, n), where D gives every mode the same ratio.

    D of the known modes is known; what they leave of V is seen through the modes of the reference.
    """
    ratio = 2 * problem.damping.modal
    rest = V - modes.vectors @ modes_M
    known = modes.vectors @ (ratio / np.sqrt(modes.eigenvalues)[:, None] * modes_M)
    C = reference.coordinates(rest)
    return known + reference.vectors(ratio / np.sqrt(reference.values)[:, None] * C), ratio * np.sqrt(
        modes.eigenvalues
    )[:, None] * modes_M
