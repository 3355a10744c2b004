"""How many free-free modes lie below a frequency, and where, told from the fixed-interface modes.

With all fixed-interface modes Phi (M-orthonormal, eigenvalues lam_k) and the constraint modes Psi, K - s M has the
inertia of (Sylvester; Craig and Bampton 1968)

    [ diag(lam_k) - s        -s L     ]
    [      -s L'          K_c - s M_c ],   K_c = Psi'K Psi,  M_c = Psi'M Psi,  L = Phi'M Psi.

Modes k > n that are not known lie at mu or above, by a Sturm count. Eliminated (Haynsworth 1968), they take
sum_{k>n} s^2 L_k L_k' / (lam_k - s) from the block of the interfaces, for s < mu no more than

    s^2 D + s^3 E mu / (mu - s),   D = sum_{k>n} L_k L_k' / lam_k,   E = sum_{k>n} L_k L_k' / lam_k^2,

so that negative eigenvalues of the small matrix without this are no fewer than those of K - s M. W = G_i M Psi, the
deformation under the inertia of the constraint modes, has W'M Psi and W'M W as the sums D and E over all k. Psi, Phi
and W - Phi diag(1 / lam_k) L, in which K is diag(K_c, lam_k, D), span modes of the free body nearly: their Ritz values
are limits from above, and as many eigenvalues lie below s as Ritz values or more. One solution with the factor that is
there takes the place of a factorisation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.linalg.columns import dot, map_columns, symmetric
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
    (m, m), at ``least`` (rad/s)2 or above. The body has ``rigid`` rigid-body modes."""

    K: Floats
    M: Floats
    D: Floats
    E: Floats
    least: float
    rigid: int

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
            least=fixed.verified_below, rigid=body.statics.Z.shape[1],
        )  # fmt: skip

    def count_below(self, s: float) -> int | None:
        """Number of elastic free-free modes with eigenvalues below ``s`` (rad/s)2; None where that is not certain."""
        if not s < self.least:
            return None
        count = int((self._ritz < s).sum())
        return count if count == int((self._at(s) < s).sum()) - self.rigid else None

    def lowest(self, count: int) -> Floats:
        """(2, count) limits of the lowest ``count`` elastic eigenvalues of the free body; (0, inf) of unknown ones.

        The upper ones are Ritz values, as a rule much closer.
        """
        limits = np.array([np.zeros(count), np.full(count, np.inf)])
        for j, value in enumerate(self._ritz[:count]):
            below = self._limit(j)
            if below is None:
                break
            limits[:, j] = below, value
        return limits

    @cached_property
    def _ritz(self) -> Floats:
        """Ritz values (q,) of the elastic body in the span of Psi, Phi and W, with round-off."""
        m, n = len(self.D), len(self.K) - len(self.D)
        K = sl.block_diag(self.K, self.D)
        M = np.block([[self.M, np.vstack([self.D, np.zeros((n, m))])], [self.D, np.zeros((m, n)), self.E]])
        # What the known modes nearly span has no mass of its own beside them.
        scale = 1.0 / np.sqrt(np.maximum(np.diag(M), TINY))
        values, U = sl.eigh(scale[:, None] * M * scale)
        kept = values > DEPENDENT * values[-1]
        Q = scale[:, None] * U[:, kept] / np.sqrt(values[kept])
        values = sl.eigvalsh(symmetric(Q.T @ K @ Q))
        off = EPS * len(values) * values[min(len(self.K), len(values)) - 1]
        return np.asarray(values[self.rigid :] + off)

    def _at(self, s: float) -> Floats:
        """Eigenvalues (m + n,) with what the unknown modes take at ``s`` at most, less round-off."""
        m, K = len(self.D), self.K.copy()
        K[:m, :m] -= s**2 * (self.D + s * self.least / (self.least - s) * self.E)
        values = sl.eigh(K, self.M, eigvals_only=True)
        return np.asarray(values - EPS * len(K) * values[-1])

    def _limit(self, j: int) -> float | None:
        """An eigenvalue that the ``j``-th elastic one is not below; None where the known modes end.

        What is taken grows with s, so that each step ends on the other side of the limit than it began.
        """
        if self.rigid + j >= len(self.K):
            return None
        limits = [float(self._ritz[j])]
        for _ in range(STEPS):
            if not limits[-1] < self.least:
                return None
            limits.append(max(0.0, float(self._at(limits[-1])[self.rigid + j])))
            if abs(limits[-1] - limits[-2]) <= SAME * limits[-2]:
                break
        return min(limits[-2:])
