"""Bounds of the error of a reduced transfer function, from the residual of the full equations.

With u_r = V y and the residual r = B - A(i omega) V y, a Galerkin projection (or one with test space W and the
residual of the dual problem) has the error

    H - H_r = r_du' A^-1 r = sum over all modes k of (phi_k' r_du)(phi_k' r) / a_k

with a_k = lam_k - omega^2 + i omega d_k. The modes below lam_c are known, and a Sturm count proved that none is
missing: their part is evaluated. Of the rest only rho = G_e r is needed: |sum| <= gamma |rho_du|_K |rho|_K with
gamma = lam_c / (lam_c - omega^2), the inverse of the inf-sup constant of A on the unknown modes in the norm of K.
This is the residual bound of Rozza, Huynh and Patera 2008 in its primal-dual form, with the known modes deflated,
which keeps it sharp at resonances. It takes one static solve for each reduced coordinate and no factorisation.

It holds for undamped models, for D = alpha M + beta K and for structural damping, (1 + i eta) K, to the accuracy of
the known modes: in all of them a_k = c lam_k + g with Re(c + g / lam_k) = 1 - omega^2 / lam_k, which is 1 / gamma at
lam_c and grows with lam_k. For other damping it is an estimate: gamma then neglects what damping couples the unknown
modes to the known ones, and the force of modal damping on a basis is seen through the reference model.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.budget import Budget
from morembs.linalg.columns import (
    dot,
    m_norms,
    map_columns,
    multiply_into,
    orthonormal,
    project_out,
    projected,
    subtract,
)
from morembs.linalg.eigen import Modes
from morembs.problem import Problem
from morembs.responses.reference import Reference

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
        states = P / (a / size * np.maximum(size - abs(c) * off, np.finfo(float).tiny))[:, None]
    gamma = 1.0 / (1.0 - omega**2 / modes.verified_below)
    spectral, _ = primal[0].tail(P, rho, values)
    _, frobenius = dual[0].tail(P_du, rho_du, values)
    known = float(np.linalg.norm(P_du.T @ states))
    return SAFETY * (known + gamma * (spectral + rest) * (frobenius + rest_du))


def static_response(problem: Problem) -> Floats:
    """G_e B (Nc, m): elastic displacements under unit interface loads, solved for once. Not to be changed."""
    flexibility = problem.elastic.flexibility
    return problem.shared("static response", lambda: map_columns(flexibility, problem.B, problem.budget))


def residual_of(problem: Problem, V: Floats, W: Floats, modes: Modes, reference: Reference) -> Residual:
    """Residuals on the elastic basis ``V`` (Nc, n), tested with ``W`` (Nc, n), both free of rigid-body motion.

    Peak memory: 2 n + m columns of length Nc where the budget wants them (3 n + m with damping other than Rayleigh's),
    and a few blocks; n static solves, 2 n for a damping matrix of the model's own.
    """
    K, M, budget = problem.K, problem.M, problem.budget
    n = V.shape[1]
    modes_M = _between(modes.vectors, M, V, budget)
    modes_D = modal_damping(problem, modes.eigenvalues)[:, None] * modes_M
    if problem.D is not None:
        modes_D = _between(modes.vectors, problem.D, V, budget)
    gram = projected(V, K, budget)
    L = np.linalg.cholesky(gram)
    Vk = multiply_into(V, sl.solve_triangular(L, np.eye(n), lower=True).T, budget.empty(V.shape, order="F"), budget)
    basis, projected_D = _EnergyBasis(problem, Vk), np.zeros((n, 0))
    for X in _inputs(problem, V):
        basis.add(X)
    for X in _damping_forces(problem, V, modes, modes_M, reference):
        # D V = K G_e D V, as seen by columns without rigid-body motion.
        projected_D = np.hstack([projected_D, dot(W, K @ X, budget)])
        basis.add(X)
    return Residual(
        V_of_V=np.asarray(L.T), V_of_X=np.hstack(basis.of_V), Q_of_X=basis.coordinates(),
        rest=np.concatenate(basis.rest), modes_of_B=modes.vectors.T @ problem.B,
        modes_K=_between(modes.vectors, K, V, budget), modes_M=modes_M, modes_D=modes_D,
        projected_B=np.asarray(problem.B.T @ W).T, projected_K=gram if W is V else _between(W, K, V, budget),
        projected_M=_between(W, M, V, budget), projected_D=projected_D if projected_D.size else np.zeros((n, n)),
    )  # fmt: skip


class _EnergyBasis:
    """K-orthonormal directions Q beside those of ``Vk`` (Nc, n), made of columns X that come block by block.

    ``of_V`` and ``coordinates`` are the coordinates of X, ``rest`` the norms of what is left of it.
    """

    def __init__(self, problem: Problem, Vk: Floats) -> None:
        self.problem, self.Vk = problem, Vk
        self.Q: list[Floats] = []
        self.of_V: list[Floats] = []
        self.of_Q: list[list[Floats]] = []
        self.rest: list[Floats] = []

    def add(self, X: Floats) -> None:
        """Take in some columns ``X`` (Nc, j), which are overwritten."""
        K, budget = self.problem.K, self.problem.budget
        size = m_norms(X, K @ X)
        self.of_V.append(project_out(self.Vk, X, K, budget=budget))
        coordinates = [project_out(Q, X, K, budget=budget) for Q in self.Q]
        # Directions that one pass takes for round-off of its largest ones are found by the next.
        for _ in range(3):
            Q = orthonormal(X, K, size)
            if not Q.shape[1]:
                break
            # Q only needs to be orthonormal; what it misses of the columns stays in the rest.
            coordinates.append(dot(Q, K @ X, budget))
            subtract(Q, coordinates[-1], X, budget)
            self.Q.append(budget.store(Q))
        self.of_Q.append(coordinates)
        self.rest.append(m_norms(X, K @ X))

    def coordinates(self) -> Floats:
        """(q, x) coordinates of all X in all Q: later directions have no part in earlier columns."""
        found = np.zeros((sum(Q.shape[1] for Q in self.Q), sum(len(rest) for rest in self.rest)))
        column = 0
        for blocks, rest in zip(self.of_Q, self.rest, strict=True):
            part = np.vstack([found[:0, : len(rest)], *blocks])
            found[: len(part), column : column + len(rest)] = part
            column += len(rest)
        return found


def _inputs(problem: Problem, V: Floats) -> Iterator[Floats]:
    """G_e B and G_e M V, some columns at a time."""
    width = problem.budget.columns(len(V), copies=10)
    static = static_response(problem)
    for at in range(0, static.shape[1], width):
        yield np.array(static[:, at : at + width], order="F")
    for at in range(0, V.shape[1], width):
        yield problem.elastic.flexibility(problem.M @ V[:, at : at + width])


def _damping_forces(
    problem: Problem, V: Floats, modes: Modes, modes_M: Floats, reference: Reference
) -> Iterator[Floats]:
    """G_e D V, some columns at a time; nothing for Rayleigh damping.

    Modal damping of the known modes is known; what they leave of V is seen through the modes of the reference.
    """
    width = problem.budget.columns(len(V), copies=10)
    # G_e D of a mode is d_k / lam_k of it.
    on_known, on_rest = (modal_damping(problem, v)[:, None] / v[:, None] for v in (modes.eigenvalues, reference.values))
    for at in range(0, V.shape[1], width):
        some = slice(at, at + width)
        if problem.D is not None:
            yield problem.elastic.flexibility(problem.D @ V[:, some])
        elif problem.damping.is_modal:
            rest = V[:, some] - modes.vectors @ modes_M[:, some]
            C = reference.coordinates(rest)
            known = modes.vectors @ (on_known * modes_M[:, some])
            yield known + reference.vectors(on_rest * C)


def modal_damping(problem: Problem, values: Floats) -> Floats:
    """Modal damping (k,) in 1/s of modes with eigenvalues ``values`` (k,) in (rad/s)2; zero for Rayleigh damping."""
    return problem.damping.of_modes(values) if problem.damping.is_modal else np.zeros(len(values))


def _between(W: Floats, A: sp.csr_array, V: Floats, budget: Budget) -> Floats:
    """W' A V, some columns of V at a time."""
    width = budget.columns(len(V))
    parts = [dot(W, A @ V[:, at : at + width], budget) for at in range(0, V.shape[1], width)]
    return np.hstack(parts) if parts else np.zeros((W.shape[1], 0))
