"""Second-order Krylov spaces of s^2 M + s D + K about s0, by two-level orthogonal Arnoldi.

With A0 = s0^2 M + s0 D + K and E = 2 s0 M + D the blocks are (Bai and Su 2005)

    r_0 = A0^-1 F,   r_1 = -A0^-1 E r_0,   r_j = -A0^-1 (E r_{j-1} + M r_{j-2}),

the derivatives of A(s)^-1 F at s0 up to factors. The recurrence itself loses them after some blocks. It is the
Arnoldi process of a linearisation in pairs (r_j, r_{j-1}), whose vectors are [Q S1; Q S2] with one orthonormal Q:
the first level makes Q orthonormal, the second the small [S1; S2] (Su, Zhang and Bai 2008; Lu, Su and Bai 2016).
Only Q has the length of the model, and both levels stay orthonormal to working precision.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

from morembs.base.types import Values
from morembs.linalg.columns import orthonormal
from morembs.linalg.space import Space
from morembs.linalg.tolerances import TOL

Solve = Callable[[Values], Values]


class SecondOrderArnoldi:
    """The Krylov space of M and ``D`` (N, N) about ``shift``, started at ``start`` = A0^-1 F (N, p).

    M is that of ``space``. It grows with ``expand``.

    ``blocks`` are M-orthonormal, real if ``start`` and ``shift`` are, else complex (orthonormal in x^H M y).
    ``scale`` is a frequency in rad/s of the order of those of interest: blocks r_j scale^j are what is orthogonalised,
    so that the two halves of a pair have one unit. Peak memory: the blocks and four blocks more.
    """

    def __init__(self, space: Space, D: sp.sparray, start: Values, *, shift: complex, scale: float) -> None:
        self.space, self.M, self.D, self.scale = space, space.M, D, scale
        self.shift = complex(shift) if complex(shift).imag else complex(shift).real
        Q = orthonormal(start, self.M, passes=TOL.krylov_passes)
        self.blocks: list[Values] = []
        self._add(Q)
        k = Q.shape[1]
        self.deflated = [start.shape[1] - k]
        # One column of [S1; S2] for every vector of the linearisation; the last ones are what comes next.
        self.upper: Values = np.eye(k, dtype=Q.dtype)
        self.lower: Values = np.zeros((k, k), dtype=Q.dtype)
        self.last = slice(0, k)

    @property
    def size(self) -> int:
        """Number of columns of all blocks."""
        return sum(block.shape[1] for block in self.blocks)

    @property
    def finished(self) -> bool:
        """True if the space holds all that the loads can reach."""
        return bool(self.last.stop == self.last.start)

    def expand(self, solve: Solve) -> None:
        """One block r_j more; ``solve`` gives A0^-1 F of a block (N, k)."""
        upper, lower = self.upper[:, self.last], self.lower[:, self.last]
        newest, before = self._vectors(upper), self._vectors(lower)
        E = 2 * self.shift * (self.M @ newest) + self.D @ newest
        W = -solve(self.scale * E + self.scale**2 * (self.M @ before))
        del newest, before, E
        coordinates, Q = self.space.orthogonalize(self.blocks, W, passes=TOL.krylov_passes)
        coordinates = np.vstack([coordinates, Q.conj().T @ (self.M @ W)])
        self.deflated.append(W.shape[1] - Q.shape[1])
        self._add(Q)
        self._second_level(coordinates, np.vstack([upper, np.zeros((Q.shape[1], upper.shape[1]))]))

    def _second_level(self, upper: Values, lower: Values) -> None:
        """New columns of [S1; S2], orthonormalised against the known ones."""
        k, width = len(upper), self.upper.shape[1]
        grown = [np.vstack([S, np.zeros((k - len(S), width))]) for S in (self.upper, self.lower)]
        S, T = np.vstack(grown), np.vstack([upper, lower])
        start = np.linalg.norm(T, axis=0)
        for _ in range(2):
            T = T - S @ (S.conj().T @ T)
        T = orthonormal(T, None, start, passes=TOL.krylov_passes)
        T = orthonormal(T - S @ (S.conj().T @ T), None, passes=TOL.krylov_passes)
        both = np.hstack([S, T])
        self.upper, self.lower = both[:k], both[k:]
        self.last = slice(width, width + T.shape[1])

    def _vectors(self, C: Values) -> Values:
        """Q C (N, j), a block of Q at a time."""
        at, total = 0, np.zeros((self.M.shape[0], C.shape[1]), dtype=C.dtype, order="F")
        for block in self.blocks:
            total += block @ C[at : at + block.shape[1]]
            at += block.shape[1]
            self.space.budget.release_if_tight()
        return total

    def _add(self, Q: Values) -> None:
        self.blocks.append(self.space.budget.store(np.asfortranarray(Q)))
