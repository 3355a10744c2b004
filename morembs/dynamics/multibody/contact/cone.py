"""Coulomb's cone: normal forces and friction of points that obey the law exactly, with no facets.

Of each point 0 <= u_n _|_ p_n >= 0, |p_t| <= friction p_n, and where u_t is not zero p_t = -friction p_n u_t / |u_t|,
with u = W p + q. The unknowns are p = (p_n, p_t) of all points. With any weight c > 0 the law is a root of
p_n - max(0, p_n - c u_n) and p_t - (p_t - c u_t projected onto the disc of radius friction max(0, p_n - c u_n)), which
is solved by a damped nonsmooth Newton method (Alart and Curnier 1991).
"""

from __future__ import annotations

import numpy as np

from morembs.base.errors import SolverError
from morembs.base.types import Floats
from morembs.dynamics.multibody.contact.tolerances import TOL


def coulomb(W: Floats, q: Floats, friction: Floats, start: Floats) -> Floats:
    """Forces (r, 3) of r points, normal first, for W (3r, 3r), q (3r,), coefficients (r,) and a start (r, 3).

    Raises:
        SolverError: neither Newton's method nor projected sweeps end on a solution.
    """
    r = len(friction)
    diagonal = np.diag(W).reshape(r, 3)
    units = np.stack((diagonal[:, 0], *2 * [0.5 * (diagonal[:, 1] + diagonal[:, 2])]), axis=1)
    units = 1 / np.sqrt(np.where(units > 0, units, 1.0))
    law = _Law(W * np.outer(units, units), q * units.ravel(), friction * units[:, 0] / units[:, 1])
    p, size = start / units, float(np.abs(law.q).max(initial=0.0))
    for _ in range(TOL.cone_rounds):
        for weight in TOL.cone_weights:
            solution = law.newton(p, weight, TOL.cone_roundoff * size)
            if law.error(solution) <= TOL.cone_residual * size:
                # Projected once more, so that points that are open have no force at all.
                return np.asarray((solution - law.residual(solution)) * units)
        p = law.swept(p)
    raise SolverError(
        f"no forces of {r} points that obey the law of friction were computed: it is broken by "
        f"{law.error(p) / max(size, TOL.tiny):.2g} (relative)",
        keyword="friction",
    )


class _Law:
    def __init__(self, W: Floats, q: Floats, friction: Floats) -> None:
        self.W, self.q, self.friction = W, q, friction

    def _parts(self, p: Floats, weight: float) -> tuple[Floats, Floats, Floats, Floats]:
        """Trial normal forces (r,) and friction (r, 2), its length (r,) and the radius (r,) that it may have."""
        trial = p - weight * (self.W @ p.ravel() + self.q).reshape(p.shape)
        n, t = trial[:, 0], trial[:, 1:]
        return n, t, np.linalg.norm(t, axis=1), self.friction * np.maximum(n, 0.0)

    def residual(self, p: Floats, weight: float = 1.0) -> Floats:
        n, t, length, radius = self._parts(p, weight)
        share = np.where(length > radius, radius / np.where(length > 0, length, 1.0), 1.0)
        return np.asarray(p - np.column_stack((np.maximum(n, 0.0), share[:, None] * t)))

    def _size(self, p: Floats, weight: float) -> float:
        return float(np.linalg.norm(self.residual(p, weight)))

    def error(self, p: Floats) -> float:
        """Largest entry of the residual of weight one."""
        return float(np.abs(self.residual(p)).max(initial=0.0))

    def tangent(self, p: Floats, weight: float) -> Floats:
        """(3r, 3r): one of the derivatives of the residual."""
        r = len(p)
        n, t, length, radius = self._parts(p, weight)
        P = np.zeros((r, 3, 3))
        for i in np.flatnonzero(n > 0):
            P[i, 0, 0] = 1.0
            if length[i] <= radius[i]:
                P[i, 1:, 1:] = np.eye(2)
            else:
                d = t[i] / length[i]
                P[i, 1:, 0] = self.friction[i] * d
                P[i, 1:, 1:] = radius[i] / length[i] * (np.eye(2) - np.outer(d, d))
        trial = (np.eye(3 * r) - weight * self.W).reshape(r, 3, 3 * r)
        return np.asarray(np.eye(3 * r) - (P @ trial).reshape(3 * r, 3 * r))

    def newton(self, p: Floats, weight: float, enough: float) -> Floats:
        """The best forces on the way from p; points that are redundant make tangents singular, hence least norm."""
        best, least = p, self.error(p)
        for _ in range(TOL.cone_iterations):
            if least <= enough:
                break
            F = self.residual(p, weight)
            step = np.linalg.lstsq(self.tangent(p, weight), -F.ravel(), rcond=TOL.redundant_point)[0].reshape(p.shape)
            part, now = 1.0, float(np.linalg.norm(F))
            wanted = TOL.sufficient_decrease
            while part > TOL.least_step_part and self._size(p + part * step, weight) > (1 - wanted * part) * now:
                part *= 0.5
            p = p + part * step
            error = self.error(p)
            if error < least:
                best, least = p, error
        return best

    def swept(self, p: Floats) -> Floats:
        """Forces after sweeps of projections point by point: slow, but from anywhere."""
        p, W = p.copy(), self.W.reshape(len(p), 3, -1)
        for _ in range(TOL.cone_sweeps):
            for i in range(len(p)):
                trial = p[i] - W[i] @ p.ravel() - self.q[3 * i : 3 * i + 3]
                n, t = max(trial[0], 0.0), trial[1:]
                length = float(np.linalg.norm(t))
                p[i, 0], p[i, 1:] = n, t * (min(1.0, self.friction[i] * n / length) if length > 0 else 1.0)
        return p
