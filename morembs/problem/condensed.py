"""How many free-free modes lie below a frequency, and where, told from the fixed-interface modes.

With all fixed-interface modes Phi (M-orthonormal, eigenvalues lam_k) and the constraint modes Psi, K - s M has the
inertia of (Sylvester; Craig and Bampton 1968)

    [ diag(lam_k) - s        -s L     ]
    [      -s L'          K_c - s M_c ],   K_c = Psi'K Psi,  M_c = Psi'M Psi,  L = Phi'M Psi.

Modes k > n that are not known lie at mu or above, by a Sturm count. Eliminated (Haynsworth 1968), they take from the
block of the interfaces sum_{k>n} s^2 L_k L_k' / (lam_k - s), which for s < mu is neither less nor more than

    s^2 D + s^3 E   and   s^2 D + s^3 E mu / (mu - s),
    D = sum_{k>n} L_k L_k' / lam_k,    E = sum_{k>n} L_k L_k' / lam_k^2,

and W = G_i M Psi, the deformation under the inertia of the constraint modes, has W'M Psi and W'M W as the same sums
over all k. The number of negative eigenvalues of the small matrices with the one and the other encloses that of
K - s M: one solution with the factor that is there takes the place of a factorisation. Psi, Phi and
W - Phi diag(1 / lam_k) L, in which K is diag(K_c, lam_k, D), span modes of the free body nearly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.budget import Budget
from morembs.linalg.columns import dot, map_columns, multiply, subtract, symmetric
from morembs.linalg.eigen import Modes
from morembs.linalg.statics import ConstrainedStatics

Floats = NDArray[np.float64]
# Most steps towards a frequency, and the change that is none; limits hold after any number of them.
STEPS, SAME = 30, 1e-10
EPS, TINY = float(np.finfo(float).eps), float(np.finfo(float).tiny)
# Directions with less than this part of the mass of the largest, displacements scaled to one, are dependent.
DEPENDENT = 1e-10


@dataclass(frozen=True, kw_only=True, eq=False)
class Condensed:
    """``K``, ``M`` (m + n, m + n) of the constraint modes and the known modes, and what the others leave: ``D``, ``E``
    (m, m), at ``least`` (rad/s)2 or above. The body has ``rigid`` rigid-body modes. ``Psi`` (N, m), ``Phi`` (N, n) and
    ``W`` (N, m) are what all are made of."""

    K: Floats
    M: Floats
    D: Floats
    E: Floats
    least: float
    rigid: int
    Psi: Floats
    Phi: Floats
    W: Floats
    budget: Budget

    @classmethod
    def of(cls, body: ConstrainedStatics, M: sp.csr_array, fixed: Modes, Psi: Floats, stiffness: Floats) -> Condensed:
        """From the ``fixed`` modes of ``body`` and its constraint modes ``Psi`` (N, m) with their ``stiffness``.

        Peak memory: N x m, where the budget wants them.
        """
        budget, Phi, values = body.statics.budget, fixed.vectors, fixed.eigenvalues
        width = body.statics.columns(5)
        W = map_columns(lambda P: body.flexibility(M @ P), Psi, budget, width=width)
        parts: list[list[Floats]] = [[], [], [], []]
        for at in range(0, Psi.shape[1], width):
            MP, MW = M @ Psi[:, at : at + width], M @ W[:, at : at + width]
            for part, (A, B) in zip(parts, ((Psi, MP), (Phi, MP), (W, MP), (W, MW)), strict=True):
                part.append(dot(A, B, budget))
        own, L, first, second = (np.hstack(part) for part in parts)
        return cls(
            K=sl.block_diag(symmetric(stiffness), np.diag(values)),
            M=np.block([[symmetric(own), L.T], [L, np.eye(len(values))]]),
            D=symmetric(first - (L.T / values) @ L), E=symmetric(second - (L.T / values**2) @ L),
            least=fixed.verified_below, rigid=body.statics.Z.shape[1], Psi=Psi, Phi=Phi, W=W, budget=budget,
        )  # fmt: skip

    def count_below(self, s: float) -> int | None:
        """Number of elastic free-free modes with eigenvalues below ``s`` (rad/s)2; None where that is not certain."""
        if not s < self.least:
            return None
        counts = {int((self._values(s, most) < s).sum()) - self.rigid for most in (False, True)}
        return counts.pop() if len(counts) == 1 else None

    def lowest(self, count: int) -> Floats:
        """(2, count) limits of the lowest ``count`` elastic eigenvalues of the free body; (0, inf) of unknown ones."""
        limits = np.array([np.zeros(count), np.full(count, np.inf)])
        for j in range(min(count, len(self.K) - self.rigid)):
            low, high = self._limit(j, most=True), self._limit(j, most=False)
            if not np.isfinite([low, high]).all():
                break
            limits[:, j] = low, high
        return limits

    def vectors(self, count: int) -> Floats:
        """The lowest ``count`` elastic modes of the free body nearly (N, count), fewer where there are not as many."""
        m, n = len(self.D), len(self.K) - len(self.D)
        K = sl.block_diag(self.K, self.D)
        M = np.block([[self.M, np.vstack([self.D, np.zeros((n, m))])], [self.D, np.zeros((m, n)), self.E]])
        # What the known modes nearly span has no mass of its own beside them.
        scale = 1.0 / np.sqrt(np.maximum(np.diag(M), TINY))
        values, U = sl.eigh(scale[:, None] * M * scale)
        kept = values > DEPENDENT * values[-1]
        Q = scale[:, None] * U[:, kept] / np.sqrt(values[kept])
        Y = Q @ sl.eigh(symmetric(Q.T @ K @ Q))[1][:, self.rigid : self.rigid + count]
        inner = Y[m : m + n] - (self.M[m:, :m] / np.diag(self.K)[m:, None]) @ Y[m + n :]
        V = multiply(self.W, Y[m + n :], self.budget)
        for part, coordinates in ((self.Psi, Y[:m]), (self.Phi, inner)):
            subtract(part, -coordinates, V, self.budget)
        return V

    def _values(self, s: float, most: bool) -> Floats:
        """Eigenvalues (m + n,) with what the unknown modes take at ``s``, at ``most`` or at least, up to round-off."""
        m, K = len(self.D), self.K.copy()
        K[:m, :m] -= s**2 * (self.D + s * (self.least / (self.least - s) if most else 1.0) * self.E)
        values = sl.eigh(K, self.M, eigvals_only=True)
        off = EPS * len(K) * values[-1]
        return np.asarray(values - off if most else values + off)

    def _limit(self, j: int, most: bool) -> float:
        """The ``j``-th elastic eigenvalue of the matrix that depends on it, from below if ``most``, else from above.

        What is taken grows with s, so that each step ends on the other side of the eigenvalue than it began.
        """
        limits = [0.0, float(sl.eigh(self.K, self.M, eigvals_only=True)[self.rigid + j])]
        for _ in range(STEPS):
            s = limits[-1]
            if not s < self.least:
                return np.inf
            limits.append(max(0.0, float(self._values(s, most)[self.rigid + j])))
            if abs(limits[-1] - limits[-2]) <= SAME * s:
                break
        return min(limits[-2:]) if most else max(limits[-2:])
