"""Low-rank ADI: Gramians of M x'' + D x' + K x = F u from one solve with A(s) = s^2 M + s D + K for each shift.

With E = diag(I, M), A = [[0, I], [-K, -D]] the state (x, x') has the controllability Gramian P = Z Z', Z = [Zp; Zv],

    A P E' + E P A' + [0; F][0; F]' = 0 .

Each step solves (A + p E)[x; v] = [f; g] for the residual factor [f; g], which needs a matrix of size N only:
(K - p D + p^2 M) x = p M f - D f - g, v = f - p x. A complex shift stands for its conjugate too, and Z and the
residual stay real (Benner, Kuerschner, Saak 2013). Shifts are Ritz values of a small Galerkin model of the
residual, taken where the residual is largest.

Where M, D and K are symmetric and motions are measured where forces act, the observability Gramian
A' Q E + E' Q A + [F; 0][F; 0]' = 0 needs no iteration of its own: (s E - A)'^-1 [F; 0] = [(s M + D) U; U] with
U = A(s)^-1 F, hence Q = Y Y', Y = [M Zv + D Zp; Zp].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base import progress
from morembs.base.errors import SolverError
from morembs.base.types import Floats, Values
from morembs.linalg.columns import orthonormal
from morembs.linalg.dense import symmetric
from morembs.linalg.space import Space
from morembs.linalg.tolerances import TOL


@dataclass(frozen=True, kw_only=True, eq=False)
class SecondOrder:
    """M x'' + D x' + K x = F u as the operations that the iteration needs; all matrices (N, N) symmetric.

    ``solve(s, F)`` gives A(s)^-1 F (N, k), complex for complex ``s``; ``flexibility(F)`` K^-1 F. For a body that
    can move rigidly both leave the rigid motion out, and F is in equilibrium with its inertia.
    """

    M: sp.sparray
    K: sp.sparray
    apply_D: Callable[[Floats], Floats]
    solve: Callable[[complex, Values], Values]
    flexibility: Callable[[Floats], Floats]


@dataclass(frozen=True, kw_only=True, eq=False)
class LowRankGramian:
    """P = Z Z' with Z = [``Zp``; ``Zv``], (N, k) each: positions and velocities.

    ``residual`` is what is left of the loads (see ``low_rank_gramian``), ``shifts`` the shifts used (rad/s), of
    which a complex one stands for its conjugate too.
    """

    Zp: Floats
    Zv: Floats
    residual: float
    shifts: tuple[complex, ...]


def low_rank_gramian(
    system: SecondOrder,
    F: Floats,
    *,
    tolerance: float = TOL.adi_residual,
    max_steps: int = TOL.adi_steps,
    space: Space | None = None,
    rows: int = TOL.adi_rows,
) -> LowRankGramian:
    """Controllability Gramian of ``system`` under the loads ``F`` (N, m).

    The residual of the Lyapunov equation is [f; g][f; g]'. It is measured by f'Mf + g'K^-1 g, column by column
    relative to F'K^-1 F, the static compliance; the iteration stops where the largest is below ``tolerance``.
    In this measure low frequencies count, and the many modes of a fine mesh that no load excites do not.

    Peak memory: Z where ``space`` wants it (compressed whenever it fills its room, so many ``rows`` at a time), 96
    columns or 4 blocks (N, m) of recent solutions twice, and about 12 blocks (N, m).

    Raises:
        SolverError: ``tolerance`` is not reached within ``max_steps`` shifts, or modes are not damped.
    """
    iteration = _Iteration(system, F, space or Space(system.M), rows)
    residual = 1.0
    while residual > tolerance:
        for p in iteration.next_shifts(tolerance):
            if len(iteration.shifts) >= max_steps:
                raise SolverError(
                    f"the Gramian reached a residual of {residual:.1e} of the loads in {max_steps} shifts (needed "
                    f"{tolerance:.1e}): lightly damped modes take about one shift each; allow more steps, raise the "
                    "tolerance, or take the Gramian over a frequency band",
                    keyword="max_steps",
                )
            residual = iteration.step(p)
            progress.update(f"ADI: {len(iteration.shifts)} shifts, residual {residual:.1e}")
            if residual <= tolerance:
                break
    Zp, Zv = iteration.factor.columns()
    return LowRankGramian(Zp=Zp, Zv=Zv, residual=residual, shifts=tuple(iteration.shifts))


def dense_gramian(K: Floats, M: Floats, D: Floats, F: Floats, rigid: int) -> LowRankGramian:
    """The same by a dense Lyapunov equation in all elastic modes (Bartels and Stewart 1972), for small systems.

    Columns below the round-off of P, sqrt(eps) of the leading one, are left out; ``residual`` is that of the equation
    relative to its right side. Peak memory: a dozen matrices (2 N, 2 N).

    Args:
        rigid: number of rigid-body motions, whose modes come first.

    Raises:
        SolverError: a mode is not damped.
    """
    values, Phi = sl.eigh(K, M)
    omega, Phi = np.sqrt(values[rigid:]), Phi[:, rigid:]
    # Positions as energies: both halves of the state have one unit.
    A = np.block([[np.zeros((len(omega),) * 2), np.diag(omega)], [-np.diag(omega), -(Phi.T @ D @ Phi)]])
    G = np.vstack([np.zeros((len(omega), F.shape[1])), Phi.T @ F])
    poles = np.linalg.eigvals(A)
    if (poles.real > -TOL.undamped_mode * np.abs(poles)).any():
        raise SolverError("a mode is not damped; give it damping, or take the Gramian over a frequency band")
    P = symmetric(sl.solve_continuous_lyapunov(A, -G @ G.T))
    residual = np.linalg.norm(A @ P + P @ A.T + G @ G.T) / np.linalg.norm(G @ G.T)
    sizes, U = sl.eigh(P)
    kept = sizes > np.finfo(float).eps * len(sizes) * sizes[-1]
    Z = U[:, kept] * np.sqrt(sizes[kept])
    Zp, Zv = Phi @ (Z[: len(omega)] / omega[:, None]), Phi @ Z[len(omega) :]
    return LowRankGramian(Zp=Zp, Zv=Zv, residual=float(residual), shifts=())


class _Iteration:
    """The residual factor [f; g] and what was solved so far."""

    def __init__(self, system: SecondOrder, F: Floats, space: Space, rows: int) -> None:
        self.system = system
        self.f: Floats = np.zeros(F.shape)
        self.g = np.array(F, dtype=float)
        self.static = system.flexibility(self.g)
        self.start = np.einsum("ij,ij->j", self.g, self.static)
        if not (self.start > 0).all():
            raise SolverError("a load does not deform the body; leave it out")
        self.recent: list[Floats] = []
        self.shifts: list[complex] = []
        stiffness, mass = (np.sqrt(np.maximum(A.diagonal(), 0.0)) for A in (system.K, system.M))
        self.factor = _Factor(stiffness, mass, max(TOL.adi_first_columns, 6 * F.shape[1]), space, rows)

    def step(self, p: complex) -> float:
        """One shift (with its conjugate); returns the residual."""
        M, f, g = self.system.M, self.f, self.g
        real = p.imag == 0.0
        rate: Any = p.real if real else p
        x = self.system.solve(-rate, rate * (M @ f) - self.system.apply_D(f) - g)
        v = f - rate * x
        if real:
            size = np.sqrt(-2 * p.real)
            new = [(size * x, size * v)]
            f, g = f + size**2 * x, g + size**2 * (M @ v)
        else:
            size, ratio = 2 * np.sqrt(-p.real), p.real / p.imag
            x1, v1 = x.real + ratio * x.imag, v.real + ratio * v.imag
            other = size * np.sqrt(ratio**2 + 1)
            new = [(size * x1, size * v1), (other * x.imag, other * v.imag)]
            f, g = f + size**2 * x1, g + size**2 * (M @ v1)
        for block in new:
            self.factor.append(*block)
        self.recent.append(np.hstack([xp for xp, _ in new]))
        while len(self.recent) > 2 and sum(block.shape[1] for block in self.recent) > TOL.adi_recent_columns:
            del self.recent[0]
        self.f, self.g, self.static = f, g, self.system.flexibility(g)
        self.shifts.append(p)
        left = np.einsum("ij,ij->j", f, M @ f) + np.einsum("ij,ij->j", g, self.static)
        return float((left / self.start).max())

    def next_shifts(self, tolerance: float) -> list[complex]:
        """Ritz values at which the residual is largest, each after the ones before it have acted."""
        system = self.system
        scale = np.sqrt(self.start)
        parts = [self.static / scale, self.f / scale, *self.recent]
        parts.append(system.flexibility(system.M @ parts[0]))
        Q = orthonormal(np.hstack(parts), system.M)
        K = _stiffness(system, Q)
        values, Y = sl.eigh(K)
        elastic = values > len(K) * np.finfo(float).eps * values[-1]
        if not elastic.all():
            # Columns that fill a small model: the last of them is rigid motion, made of round-off.
            Q = Q @ Y[:, elastic]
            K = _stiffness(system, Q)
        D = Q.T @ system.apply_D(Q)
        D = symmetric(D)
        k = len(K)
        A = np.block([[np.zeros((k, k)), np.eye(k)], [-K, -D]])
        poles, X = sl.eig(A)
        # Columns of unit size in the measure of the residual: f'f + g'K^-1 g.
        L = sl.cholesky(K, lower=True)
        X = X / np.sqrt(
            np.sum(abs(X[:k]) ** 2, axis=0) + np.sum(abs(sl.solve_triangular(L, X[k:], lower=True)) ** 2, 0)
        )
        W = np.vstack([Q.T @ (system.M @ self.f), Q.T @ self.g]) / scale
        share = np.linalg.norm(np.linalg.solve(X, W), axis=1)
        usable = (poles.imag >= 0) & (poles.real < -TOL.undamped_mode * np.abs(poles))
        chosen: list[complex] = []
        while len(chosen) < TOL.adi_shifts_at_once and usable.any():
            at = int(np.argmax(np.where(usable, share, -1.0)))
            if chosen and share[at] ** 2 < TOL.adi_share * tolerance:
                break
            p = complex(poles[at])
            p = complex(p.real) if p.imag < TOL.real_shift * abs(p) else p
            share = share * np.abs((poles - p.conjugate()) / (poles + p))
            if p.imag:
                share = share * np.abs((poles - p) / (poles + p.conjugate()))
            usable[at] = False
            chosen.append(p)
        if not chosen:
            raise SolverError(
                "the Gramian does not exist: no mode that the loads excite is damped; give the model damping, or take "
                "the Gramian over a frequency band",
                keyword="damping",
            )
        return chosen


def _stiffness(system: SecondOrder, Q: Floats) -> Floats:
    """Q' K Q (k, k)."""
    K = Q.T @ (system.K @ Q)
    return symmetric(K)


class _Factor:
    """The columns of Z, replaced by fewer, ``rows`` of them at a time, whenever they fill their room."""

    def __init__(self, stiffness: Floats, mass: Floats, capacity: int, space: Space, rows: int) -> None:
        self.stiffness, self.mass, self.space, self.rows = stiffness, mass, space, rows
        self.size = 0
        self.Zp, self.Zv = (space.budget.empty((len(mass), capacity), order="F") for _ in range(2))

    def append(self, Xp: Floats, Xv: Floats) -> None:
        width = Xp.shape[1]
        if self.size + width > self.Zp.shape[1]:
            self.compress()
            if 2 * self.size > self.Zp.shape[1] or self.size + width > self.Zp.shape[1]:
                self._enlarge(2 * self.Zp.shape[1])
        self.Zp[:, self.size : self.size + width] = Xp
        self.Zv[:, self.size : self.size + width] = Xv
        self.size += width
        self.space.budget.release_if_tight()

    def compress(self) -> None:
        """Turn the columns onto the principal directions of Z and drop the negligible ones.

        Positions count with the diagonal of K and velocities with that of M. Only the triangle of a QR
        factorisation is made, a block of rows at a time, so nothing is squared.
        """
        R: Floats = np.zeros((0, self.size))
        for Z, scale in ((self.Zp, self.stiffness), (self.Zv, self.mass)):
            for first in range(0, len(Z), self.rows):
                rows = slice(first, first + self.rows)
                rows_too = np.vstack([R, scale[rows, None] * Z[rows, : self.size]])
                R = sl.qr(rows_too, mode="r", overwrite_a=True, check_finite=False)[0][: self.size]
                self.space.budget.release_if_tight()
        _, values, Y = sl.svd(R, full_matrices=False)
        keep = values > TOL.dropped_direction * values[0]
        kept = int(keep.sum())
        for Z in (self.Zp, self.Zv):
            self.space.multiply_into(Z[:, : self.size], Y[keep].T, Z[:, :kept])
        self.size = kept

    def columns(self) -> tuple[Floats, Floats]:
        """Zp and Zv (N, k), compressed."""
        self.compress()
        return self.Zp[:, : self.size], self.Zv[:, : self.size]

    def _enlarge(self, capacity: int) -> None:
        for name in ("Zp", "Zv"):
            old = getattr(self, name)
            new = self.space.budget.empty((len(old), capacity), order="F")
            new[:, : self.size] = old[:, : self.size]
            setattr(self, name, new)
