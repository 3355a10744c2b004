"""A reduced planar member: two frames and a few amplitudes of bending modes (global modal parameterisation).

q = (x, y, angle of the start, x, y, angle of the end, eta). The chord from start to end has the length d and the
direction phi; t = the angles of the ends less phi. Frames remain coordinates, so that members share them.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from morembs.base.arguments import checked
from morembs.base.limits import Count
from morembs.base.types import Floats
from morembs.dynamics.gmp.data import Formulation, Parameterised
from morembs.dynamics.gmp.plan import AngleRange, Plan, Report
from morembs.dynamics.gmp.shapes import shapes
from morembs.dynamics.gmp.tolerances import TOL
from morembs.dynamics.nonlinear.component import NonlinearComponent
from morembs.dynamics.nonlinear.member import MemberState


@checked
class ReducedMember:
    """A member of 6 + ``modes`` coordinates made of a nonlinear component with frames ``start`` and ``end``.

    Args:
        component: see morembs.dynamics.nonlinear.
        modes: number of bending modes, zero or more.
        formulation: "membrane" (of beams), "tangent" (of any component), "foreshortened" (no nonlinear solves) or
            "linear" (floating frame with component modes).
        reach: largest angle (rad) of an end to the chord, the range of the tables; or an ``AngleRange``.
        points_per_angle, tolerance, workers, checkpoint, symmetric: see ``Plan``.

    ``report`` tells what the offline stage did; None for a member from a file.

    Raises:
        InputError: too many modes, a range that crosses a bifurcation or has no equilibrium, a tolerance not met.
        OutputError: the checkpoint cannot be written.
    """

    report: Report | None = None

    def __init__(
        self,
        component: NonlinearComponent,
        *,
        modes: Count,
        formulation: Formulation = "tangent",
        reach: float | AngleRange = TOL.default_reach,
        points_per_angle: int | None = None,
        tolerance: float = TOL.table_error,
        workers: int = 1,
        checkpoint: str | Path | None = None,
        symmetric: bool = True,
    ) -> None:
        plan = Plan(
            reach=reach,
            points_per_angle=points_per_angle,
            tolerance=tolerance,
            workers=workers,
            checkpoint=checkpoint,
            symmetric=symmetric,
        )
        data, self.report = shapes(component, formulation=formulation, modes=modes, plan=plan)
        self._take(data)

    @classmethod
    def of(cls, data: Parameterised, report: Report | None = None) -> ReducedMember:
        """From what was made or stored before."""
        member = cls.__new__(cls)
        member.report = report
        member._take(data)
        return member

    def _take(self, data: Parameterised) -> None:
        self.data, self.modes, self.length = data, data.count, data.length
        self.M = sp.csr_matrix(data.fields.M)
        self._eye = np.eye(3 + data.count, 6 + data.count, 3)
        unit, turn, (r, p) = data.fields.one, data.fields.turn, (len(data.fields.one), data.fields.size)
        self.rigid = np.zeros((p, 3))
        self.rigid[:r, 0] = self.rigid[r : 2 * r, 1] = unit
        self.rigid[2 * r :, 2] = turn
        self._Psi = data.Psi[:, : data.count]
        self._Lambda = data.squares[: data.count]
        self._stiff = np.diag(self._Lambda)

    @property
    def size(self) -> int:
        return 6 + self.modes

    def start(self, frames: Floats) -> Floats:
        return np.concatenate((frames, np.zeros(self.modes)))

    def nodes(self, x: Floats) -> Floats:
        """Coordinates (N, ...) of the component from those of a moment, (p, ...)."""
        return self.data.fields.expand(x)

    @staticmethod
    def chord(q: Floats) -> tuple[float, float, Floats]:
        """Length d, direction phi in the turn of the start, and t (2,)."""
        dx, dy = q[3] - q[0], q[4] - q[1]
        phi = math.atan2(dy, dx)
        phi += 2 * math.pi * round((q[2] - phi) / (2 * math.pi))
        return math.hypot(dx, dy), phi, np.array([q[2] - phi, q[5] - phi])

    def at(self, q: Floats) -> MemberState:
        d, phi, t = self.chord(q)
        value, first, (W, W_t, W_tt) = self.data.at(t)
        (X, A, d0, k, c, H), (X_t, A_t, d0_t, k_t, c_t, H_t) = self.data.parts(value), self.data.parts(first)
        m, eta = self.modes, q[6:]
        c, c_t = c[:m], c_t[:, :m]
        eps, cos, sin = d / d0 - 1, math.cos(phi), math.sin(phi)
        # Derivatives of the chord and of p = (t, eps, eta) by q.
        phi_q = np.zeros(6 + m)
        phi_q[0], phi_q[1], phi_q[3], phi_q[4] = sin / d, -cos / d, -sin / d, cos / d
        P = self._eye.copy()
        P[:2] = -phi_q
        P[0, 2] = P[1, 5] = 1
        P[2] = (-d / d0**2) * (d0_t @ P[:2])
        P[2, :6] += np.array([-cos, -sin, 0, cos, sin, 0]) / d0
        # Shape in the frame of the chord, then turned and moved.
        G = np.empty((len(X), 3 + m))
        G[:, :2], G[:, 2], G[:, 3:] = (X_t + eps * A_t).T, A, self._Psi
        x, J = self._turn(cos, sin, X + A * eps + self._Psi @ eta), self._turn(cos, sin, G @ P)
        r = len(self.data.fields.one)
        side = self.rigid[:, 2].copy()
        side[:r], side[r : 2 * r] = -x[r : 2 * r], x[:r]
        J += side[:, None] * phi_q
        J[:, :2] += self.rigid[:, :2]
        x += self.rigid @ np.array([q[0], q[1], phi])
        # Energy; d2e/dp2 is kept where it multiplies eta, which is the tension stiffening.
        Heta = H @ eta
        e = float(eps + c @ eta + 0.5 * (eta @ Heta))
        e_p = np.concatenate((c_t @ eta + 0.5 * (H_t @ eta) @ eta, [1.0], c + Heta))
        tension = float(k) * e
        gradient = tension * e_p
        gradient[:2] += W_t + 0.5 * k_t * e * e
        gradient[3:] += self._Lambda * eta
        V = float(W) + 0.5 * tension * e + 0.5 * float(self._Lambda @ eta**2)
        S = (k * e_p)[:, None] * e_p
        S[:2, :2] += W_tt
        S[3:, 3:] += self._stiff
        resisting = S.copy()
        S[3:, 3:] += tension * H
        S[:2, 3:] += tension * c_t
        S[3:, :2] += tension * c_t.T
        return MemberState(
            x=x, J=J, V=V, force=gradient @ P, stiffness=lambda: P.T @ S @ P, strains=lambda: P.T @ resisting @ P
        )

    def bending(self, q: Floats, v: Floats) -> Floats:
        """(dJ/dt) v, (p,): the acceleration of x while q moves on at the constant rate v, from second derivatives of
        the tables (exact within their range)."""
        d, phi, t = self.chord(q)
        value, first, second = self.data.table.at(t)
        gap, rate = q[3:5] - q[:2], v[3:5] - v[:2]
        d1 = float(gap @ rate) / d
        d2 = (float(rate @ rate) - d1**2) / d
        phi1 = float(gap[0] * rate[1] - gap[1] * rate[0]) / d**2
        phi2 = -2 * phi1 * d1 / d
        t1 = v[[2, 5]] - phi1
        along = t1 @ first
        twice = np.einsum("i,ijs,j->s", t1, second, t1) - phi2 * first.sum(axis=0)
        (X, A, d0, *_), (X1, A1, c1, *_), (X2, A2, c2, *_) = (self.data.parts(n) for n in (value, along, twice))
        eps = d / d0 - 1
        eps1 = d1 / d0 - d * c1 / d0**2
        eps2 = d2 / d0 - (2 * d1 * c1 + d * c2) / d0**2 + 2 * d * c1**2 / d0**3
        u = X + A * eps + self._Psi @ q[6:]
        u1 = X1 + A1 * eps + A * eps1 + self._Psi @ v[6:]
        u2 = X2 + A2 * eps + 2 * A1 * eps1 + A * eps2
        # In the turning frame of the chord: Coriolis, angular and centripetal acceleration of positions.
        r = len(self.data.fields.one)
        u2[:r] -= 2 * phi1 * u1[r : 2 * r] + phi2 * u[r : 2 * r] + phi1**2 * u[:r]
        u2[r : 2 * r] += 2 * phi1 * u1[:r] + phi2 * u[:r] - phi1**2 * u[r : 2 * r]
        result = self._turn(math.cos(phi), math.sin(phi), u2)
        result[2 * r :] += phi2 * self.data.fields.turn
        return result

    def _turn(self, cos: float, sin: float, u: Floats) -> Floats:
        """Amplitudes u (p, ...) turned from the frame of the chord; rotations stay."""
        r, turned = len(self.data.fields.one), u.copy()
        turned[:r] = cos * u[:r] - sin * u[r : 2 * r]
        turned[r : 2 * r] = sin * u[:r] + cos * u[r : 2 * r]
        return turned

    def outside(self, q: Floats) -> tuple[str, float, float] | None:
        t = self.chord(q)[2]
        worst = int(np.abs(t).argmax())
        if abs(t[worst]) <= self.data.reach:
            return None
        return ("t1", "t2")[worst], float(t[worst]), self.data.reach

    def estimate_neglected(self, q: Floats, state: MemberState, load: Floats) -> float:
        data, m = self.data, self.modes
        Psi = data.Psi[:, m:]
        if Psi.shape[1] == 0:
            return 0.0
        d, phi, t = self.chord(q)
        _, _, d0, k, c, H = data.parts(data.at(t)[0])
        eta, turned = q[6:], self._turn(math.cos(phi), -math.sin(phi), load)
        tension = float(k) * float(d / d0 - 1 + c[:m] @ eta + 0.5 * eta @ H @ eta)
        stiffness = data.squares[m:] + max(tension, 0.0) * data.H0[m:]
        amplitude = (Psi.T @ turned - tension * c[m:]) / stiffness
        return float(np.abs(amplitude * data.peaks[m:]).max()) / self.length
