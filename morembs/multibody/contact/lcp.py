"""Complementarity of contact: forces or impulses that keep points apart and obey a pyramid of friction.

With response y = y0 + X (forces), the unknowns are normal forces l, friction along the directions of the pyramid b
and sliding s of each point: 0 <= gap(y) _|_ l >= 0, 0 <= D v(y) + s _|_ b >= 0, 0 <= friction l - sum b _|_ s >= 0
(Stewart and Trinkle 1996).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from morembs.errors import SolverError
from morembs.multibody.contact.lemke import Complementary, RayError, lemke

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
# A problem that is not solved is tried with these parts of its diagonal added: round-off of redundant points.
_REGULAR = (1e-10, 1e-6, 1e-3)
_REPEATS = 8
_BROKEN = 1e-8
_NEAR = 1e-4


@dataclass(frozen=True, kw_only=True, eq=False)
class Forces:
    """Of r points: ``normal`` (r,), ``friction`` (r, 2) along the tangents, ``sliding`` (r,) bool."""

    normal: Floats
    friction: Floats
    sliding: Bools


NO_FORCES = Forces(normal=np.zeros(0), friction=np.zeros((0, 2)), sliding=np.zeros(0, dtype=bool))


@dataclass(frozen=True, kw_only=True, eq=False)
class Responses:
    """Solutions without contact forces y (s,), and per unit of normal force YN (s, r) and of friction YT (s, r, 2)."""

    y: Floats
    YN: Floats
    YT: Floats

    @classmethod
    def solved(cls, solve: Callable[[Floats], ArrayLike], right: Floats, N: Floats, T: Floats) -> Responses:
        """Those of ``solve`` to the right-hand side (s,) and to the forces of rows N (r, k) and T (r, 2, k)."""
        r, k = N.shape
        columns = np.zeros((len(right), 1 + 3 * r))
        columns[:, 0], columns[:k, 1 : 1 + r], columns[:k, 1 + r :] = right, N.T, T.reshape(-1, k).T
        Y = np.asarray(solve(columns), dtype=np.float64)
        return cls(y=Y[:, 0], YN=Y[:, 1 : 1 + r], YT=Y[:, 1 + r :].reshape(len(Y), r, 2))

    def total(self, forces: Forces) -> Floats:
        """(s,) with contact forces."""
        return np.asarray(self.y + self.YN @ forces.normal + np.einsum("kia,ia->k", self.YT, forces.friction))


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactLCP:
    """The problem of r points.

    ``gap`` (r,) and ``slip`` (r, 2): values without contact forces; ``NN`` (r, r), ``NT`` (r, r, 2), ``TN`` (r, 2, r)
    and ``TT`` (r, 2, r, 2): their change per normal and friction force; ``friction`` (r,) coefficients; ``pyramid``
    directions (f, 2) per point, none for points without friction of their own; ``noise``: gaps and slips of less are
    round-off and taken as zero.
    """

    gap: Floats
    slip: Floats
    NN: Floats
    NT: Floats
    TN: Floats
    TT: Floats
    friction: Floats
    pyramid: Sequence[Floats | None]
    noise: tuple[float, float]

    @classmethod
    def of(
        cls, *, N: Floats, T: Floats, XN: Floats, XT: Floats, gap: Floats, slip: Floats, friction: Floats,
        pyramid: Sequence[Floats | None], compliance: Floats, noise: tuple[float, float],
    ) -> ContactLCP:  # fmt: skip
        """The problem of rows N (r, k), T (r, 2, k) with the responses XN (k, r) and XT (k, r, 2) to unit forces."""
        return cls(
            gap=gap, slip=slip, NN=N @ XN + compliance, NT=np.einsum("ik,kjc->ijc", N, XT), TN=T @ XN,
            TT=np.einsum("iak,kjc->iajc", T, XT), friction=friction, pyramid=pyramid, noise=noise,
        )  # fmt: skip

    def given(self, known: NDArray[np.int_], force: Floats) -> ContactLCP:
        """The same problem with some normal forces given: those of compliant points follow from their gaps."""
        if not len(known):
            return self
        gap, NN, NT = self.gap.copy(), self.NN.copy(), self.NT.copy()
        NN[known], NT[known] = 0.0, 0.0
        NN[known, known], gap[known] = 1.0, -force[known]
        return replace(self, gap=gap, NN=NN, NT=NT)

    def solve(self, rows: NDArray[np.int_], count: int) -> Forces:
        """The forces; the points are ``rows`` (r,) of ``count`` in all.

        Raises:
            RayError: no forces do it; its ``direction`` (count,) is that of the normal forces of all points.
            SolverError: numerical failure.
        """
        M, q, scale, owner = self._matrix()
        try:
            solution = self._solved(M, q)
        except RayError as error:
            direction = np.zeros(count)
            direction[rows] = (error.direction * scale)[: len(rows)]
            raise RayError(str(error), direction=direction) from None
        z, r = solution.z * scale, len(self.gap)
        friction, sliding = np.zeros((r, 2)), np.zeros(r, dtype=bool)
        end = r
        for i in owner:
            D = self.pyramid[i]
            if D is not None:
                friction[i] = z[end : end + len(D)] @ D
                end += len(D)
        for k, i in enumerate(owner):
            sliding[i] = solution.basic[end + k] and z[end + k] > 0
        return Forces(normal=z[:r], friction=friction, sliding=sliding)

    @staticmethod
    def _solved(M: Floats, q: Floats) -> Complementary:
        try:
            return lemke(M, q)
        except SolverError:
            # Redundant points have no unique forces, and round-off of their gaps may leave none. A little compliance
            # about the last forces (a proximal point) gives some; it counts only where it solves the problem itself.
            diagonal = np.diag(M).copy()
            unit = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
            for part in _REGULAR:
                z = np.zeros(len(q))
                try:
                    for _ in range(_REPEATS):
                        solution = lemke(M + part * np.diag(diagonal), q - part * diagonal * z)
                        # Huge forces in a problem without solution would pass a check against their own size.
                        change = part * np.abs(diagonal * (solution.z - z)) * unit
                        if (change <= _BROKEN * np.abs(q * unit).max()).all():
                            return solution
                        z = solution.z
                except SolverError:
                    continue
            raise

    def near(self, normal: Floats, friction: Floats) -> ContactLCP:
        """The same problem with a little compliance about given forces (r,), (r, 2): of the many solutions with
        redundant points it has one near to them, and where they solve the problem they are the solution."""
        r = np.arange(len(self.gap))
        n = _NEAR * np.diag(self.NN)
        t = _NEAR * 0.5 * np.einsum("iaia->i", self.TT)
        NN, TT = self.NN + np.diag(n), self.TT.copy()
        for a in range(2):
            TT[r, a, r, a] += t
        return replace(self, gap=self.gap - n * normal, slip=self.slip - t[:, None] * friction, NN=NN, TT=TT)

    def _matrix(self) -> tuple[Floats, Floats, Floats, list[int]]:
        """M, q, the scales of the unknowns, and the points with friction."""
        r = len(self.gap)
        owner = [i for i in range(r) if self.pyramid[i] is not None]
        pyramids = [D for D in self.pyramid if D is not None]
        counts = [len(D) for D in pyramids]
        b, f = sum(counts), len(owner)
        of = np.repeat(owner, counts).astype(int)
        D = np.concatenate([*pyramids, np.zeros((0, 2))])
        E = np.zeros((b, f))
        E[np.arange(b), np.repeat(np.arange(f), counts)] = 1.0
        M, q = np.zeros((r + b + f, r + b + f)), np.zeros(r + b + f)
        M[:r, :r] = self.NN
        M[:r, r : r + b] = np.einsum("ijc,jc->ij", self.NT[:, of], D)
        M[r : r + b, :r] = np.einsum("jc,jci->ji", D, self.TN[of])
        M[r : r + b, r : r + b] = np.einsum("ia,iajc,jc->ij", D, self.TT[of][:, :, of], D)
        M[r : r + b, r + b :] = E
        M[r + b :, r : r + b] = -E.T
        M[np.arange(r + b, r + b + f), owner] = self.friction[owner]
        slip = np.einsum("ja,ja->j", D, self.slip[of])
        q[:r] = np.where(np.abs(self.gap) > self.noise[0], self.gap, 0.0)
        q[r : r + b] = np.where(np.abs(slip) > self.noise[1], slip, 0.0)
        scale = np.ones(r + b + f)
        # Sliding is a velocity: in the units of friction forces all of its rows are of order one.
        scale[r + b :] = np.sqrt(np.maximum(np.diag(self.NN)[owner], 1e-300))
        return M * np.outer(scale, scale), q * scale, scale, owner
