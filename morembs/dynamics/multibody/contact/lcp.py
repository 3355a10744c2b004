"""Complementarity of contact: forces or impulses that keep points apart and obey Coulomb's law of friction.

With response y = y0 + X (forces), 0 <= gap(y) _|_ normal >= 0, and friction lies in the cone (``cone.py``). That starts
from a pyramid with friction b along four directions D and sliding s of each point, 0 <= D v(y) + s _|_ b >= 0 and
0 <= friction normal - sum b _|_ s >= 0 (Stewart and Trinkle 1996), whose method of Lemke also tells where there are no
forces at all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import connected_components

from morembs.base.errors import SolverError
from morembs.base.types import Bools, Floats
from morembs.dynamics.multibody.contact.cone import coulomb
from morembs.dynamics.multibody.contact.lemke import RayError, lemke
from morembs.dynamics.multibody.contact.tolerances import TOL

_PYRAMID = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])


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
    def compute(cls, solve: Callable[[Floats], ArrayLike], right: Floats, N: Floats, T: Floats) -> Responses:
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
class ContactProblem:
    """The problem of r points.

    ``gap`` (r,) and ``slip`` (r, 2): values without contact forces; ``NN`` (r, r), ``NT`` (r, r, 2), ``TN`` (r, 2, r)
    and ``TT`` (r, 2, r, 2): their change per normal and friction force; ``friction`` (r,) coefficients;
    ``noise``: gaps and slips of less are round-off and taken as zero.
    """

    gap: Floats
    slip: Floats
    NN: Floats
    NT: Floats
    TN: Floats
    TT: Floats
    friction: Floats
    noise: tuple[float, float]

    @classmethod
    def of(
        cls,
        *,
        N: Floats,
        T: Floats,
        XN: Floats,
        XT: Floats,
        gap: Floats,
        slip: Floats,
        friction: Floats,
        compliance: Floats,
        noise: tuple[float, float],
    ) -> ContactProblem:
        """The problem of rows N (r, k), T (r, 2, k) with the responses XN (k, r) and XT (k, r, 2) to unit forces."""
        return cls(
            gap=gap,
            slip=slip,
            NN=N @ XN + compliance,
            NT=np.einsum("ik,kjc->ijc", N, XT),
            TN=T @ XN,
            TT=np.einsum("iak,kjc->iajc", T, XT),
            friction=friction,
            noise=noise,
        )

    def fix_forces(self, known: NDArray[np.int_], force: Floats) -> ContactProblem:
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
        W, free = self._delassus()
        r, f = len(self.gap), len(owner)
        p, failure = np.zeros((r, 3)), None
        try:
            z = lemke(M, q).z * scale
            p[:, 0], p[owner, 1:] = z[:r], z[r : r + 4 * f].reshape(f, 4) @ _PYRAMID
        except SolverError as error:
            failure = error
        if f or failure:
            try:
                p = coulomb(W, free, self.friction, p)
            except SolverError:
                if not isinstance(failure, RayError):
                    raise
                direction = np.zeros(count)
                direction[rows] = (failure.direction * scale)[:r]
                raise RayError(str(failure), direction=direction) from None
        slip = np.linalg.norm((W @ p.ravel() + free).reshape(r, 3)[:, 1:], axis=1)
        moves = slip > max(self.noise[1], TOL.no_slip * float(np.abs(free).max(initial=0.0)))
        return Forces(normal=p[:, 0], friction=p[:, 1:], sliding=(self.friction > 0) & (p[:, 0] > 0) & moves)

    def independent_groups(self) -> NDArray[np.int_]:
        """(r,) numbers of the groups of points that feel nothing of each other's forces."""
        r = len(self.gap)
        W = np.abs(self._delassus()[0]).reshape(r, 3, r, 3).max(axis=(1, 3))
        size = np.sqrt(np.diag(W))
        return np.asarray(connected_components(TOL.no_response * np.outer(size, size) < W, directed=False)[1])

    def _delassus(self) -> tuple[Floats, Floats]:
        """W (3r, 3r) and q (3r,): gap and slip of each point by its normal force and friction."""
        r = len(self.gap)
        W, q = np.zeros((r, 3, r, 3)), np.column_stack((self.gap, self.slip))
        W[:, 0, :, 0], W[:, 0, :, 1:], W[:, 1:, :, 0], W[:, 1:, :, 1:] = self.NN, self.NT, self.TN, self.TT
        noise = np.array([self.noise[0], self.noise[1], self.noise[1]])
        return W.reshape(3 * r, 3 * r), np.where(np.abs(q) > noise, q, 0.0).ravel()

    def near(self, normal: Floats, friction: Floats) -> ContactProblem:
        """The same problem with a little compliance about given forces (r,), (r, 2): of the many solutions with
        redundant points it has one near to them, and where they solve the problem they are the solution."""
        r = np.arange(len(self.gap))
        n = TOL.near_compliance * np.diag(self.NN)
        t = TOL.near_compliance * 0.5 * np.einsum("iaia->i", self.TT)
        NN, TT = self.NN + np.diag(n), self.TT.copy()
        for a in range(2):
            TT[r, a, r, a] += t
        return replace(self, gap=self.gap - n * normal, slip=self.slip - t[:, None] * friction, NN=NN, TT=TT)

    def _matrix(self) -> tuple[Floats, Floats, Floats, NDArray[np.int_]]:
        """M, q of the pyramid, the scales of the unknowns, and the points with friction."""
        W, free = self._delassus()
        r, owner = len(self.gap), np.flatnonzero(self.friction > 0)
        f = len(owner)
        # Unknowns by those of the cone: forces along the directions of each pyramid.
        G = np.zeros((3 * r, r + 4 * f))
        G[3 * np.arange(r), np.arange(r)] = 1.0
        E = np.kron(np.eye(f), np.ones((4, 1)))
        for k, i in enumerate(owner):
            G[3 * i + 1 : 3 * i + 3, r + 4 * k : r + 4 * k + 4] = _PYRAMID.T
        n = r + 4 * f
        M, q = np.zeros((n + f, n + f)), np.zeros(n + f)
        M[:n, :n], q[:n] = G.T @ W @ G, G.T @ free
        M[r:n, n:], M[n:, r:n] = E, -E.T
        M[np.arange(n, n + f), owner] = self.friction[owner]
        scale = np.ones(n + f)
        # Sliding is a velocity: in the units of friction forces all of its rows are of order one.
        scale[n:] = np.sqrt(np.maximum(np.diag(self.NN)[owner], 1e-300))
        return M * np.outer(scale, scale), q * scale, scale, owner
