"""One step of generalised-alpha with contact: a complementarity problem in each Newton iteration.

Normal contact is held on the level of positions, at the end of the step, so that gaps do not drift; friction on
the level of velocities.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.errors import SolverError
from morembs.multibody.contact import Contacts, Meeting
from morembs.multibody.contact_law import Forces, law
from morembs.multibody.contact_start import begin
from morembs.multibody.integrate import ChangeLimit, Scheme, State, _newton
from morembs.multibody.system import Assembly
from morembs.multibody.tangents import stiffness_and_damping

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
_ITERATIONS = 30
_SLOW = 0.15
# A point that touches opens where its gap is above this part of the size of the system.
_OPEN = 1e-12
# Gaps and velocities below this part of the size and of the velocities of the system are round-off.
_ROUND = 1e-15


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactState:
    """A moment with contact: the state; force (m,) N, friction (m, 2) N along the tangents, sliding (m,) bool."""

    state: State
    meeting: Meeting
    force: Floats
    friction: Floats
    sliding: Bools
    deflection: Floats

    @property
    def gap(self) -> Floats:
        """(m,) m, with the deflection of compliant points."""
        return np.asarray(self.meeting.gap + self.deflection)

    @property
    def approach(self) -> Floats:
        """(m,) rates of the gaps by the coordinates, m/s."""
        return np.asarray(self.meeting.N @ self.state.v)

    @property
    def slip(self) -> Floats:
        """(m, 2) m/s."""
        return np.asarray(self.meeting.T @ self.state.v)


class ContactStepper:
    """Steps of one size from a state on where the points ``closed`` (m,) touch and do not approach."""

    def __init__(
        self, scheme: Scheme, assembly: Assembly, group: Contacts, *, t: float, x: Floats, v: Floats, h: float,
        tolerance: float, closed: Bools, corrected: bool = True, tangents: tuple[Floats, Floats] | None = None,
    ) -> None:  # fmt: skip
        self.scheme, self.assembly, self.group, self.h = scheme, assembly, group, h
        self.closed = closed.copy()
        start = begin(scheme, assembly, group, t, x, v, h, closed, corrected)
        self._v, self._auxiliary, self._multipliers = start.velocity, start.auxiliary, start.multipliers
        state = State(
            assembly=assembly, time=t, x=x, v=v, acceleration=start.acceleration, multipliers=start.multipliers
        )
        self.state = self._with_contact(state, start.force, start.friction, start.sliding)
        positions = [float(np.abs(p.position).max()) for p in assembly.places(x).values()]
        self.length = max([1e-3, float(np.abs(self.state.meeting.foot).max(initial=0.0)), *positions])
        self._limit = ChangeLimit(tolerance=tolerance, h=h, length=self.length)
        self.tangents = tangents or self._tangents(self.state)

    def _tangents(self, at: ContactState) -> tuple[Floats, Floats]:
        s = at.state
        K, C = stiffness_and_damping(self.assembly, s.time, s.x, s.v, s.acceleration, s.multipliers)
        return K + self.group.stiffness(s.x, at.force, at.friction), C

    def _with_contact(self, state: State, force: Floats, friction: Floats, sliding: Bools) -> ContactState:
        meeting = self.group.meet(state.x)
        deflection = self.group.flexibility(state.x, meeting) @ force
        return ContactState(
            state=state, meeting=meeting, force=force, friction=friction, sliding=sliding, deflection=deflection
        )

    def advance(self, time: float) -> ContactState:
        """One step, to ``time``; points that separate are taken from ``closed``.

        Raises:
            RayError: no forces keep the points apart.
            SolverError: Newton's method does not converge.
        """
        s, h, a, old = self.assembly, self.h, self.scheme, self.state.state
        c_a = (1 - a.alpha_f) / (1 - a.alpha_m)
        c_v, c_q = h * a.gamma * c_a, h * h * a.beta * c_a
        rate, multipliers = old.acceleration.copy(), self._multipliers.copy()
        auxiliary = (a.alpha_f * old.acceleration - a.alpha_m * self._auxiliary) / (1 - a.alpha_m) + c_a * rate
        step = h * (self._v + h * ((0.5 - a.beta) * self._auxiliary + a.beta * auxiliary))
        v = self._v + h * ((1 - a.gamma) * self._auxiliary + a.gamma * auxiliary)
        rows = np.flatnonzero(self.closed | self.group.compliant)
        pressed = self.state.force[rows], self.state.friction[rows]
        factor, last, refreshed, M, noise, size = None, math.inf, False, self.tangents[0], 0.0, math.inf
        for _ in range(_ITERATIONS):
            x = s.moved(old.x, step)
            places = s.places(x)
            mass, g = s.dynamics(time, x, v, places)
            Phi, B = s.constraints(time, places)
            if factor is None:
                M, (K, C) = mass, self.tangents
                newton = _newton(M + c_v * C + s.tangent(c_q * K, step), B, s.tangent(B, step))
                factor = sl.lu_factor(newton, check_finite=False)
                noise = self._limit(M, g, v, old.time)
            residual = np.concatenate((mass @ rate + g + multipliers @ B, Phi / c_q))
            if not np.isfinite(residual).all():
                break
            change, forces = self._respond(factor, residual, x, v, step, rows, c_q, c_v, pressed)
            pressed = forces.normal, forces.friction
            d = change[: s.size]
            rate += d
            multipliers += change[s.size :]
            auxiliary += c_a * d
            step += c_q * d
            v = v + c_v * d
            size = c_v * math.sqrt(max(float(d @ M @ d), 0.0))
            if size <= noise:
                self._v, self._auxiliary, self._multipliers = v, auxiliary, multipliers
                moved = State(
                    assembly=s, time=time, x=s.moved(old.x, step), v=v, acceleration=rate, multipliers=multipliers
                )
                return self._accepted(moved, rows, forces)
            if size > _SLOW * last:
                if not refreshed:
                    self._refresh(time, s.moved(old.x, step), v, rate, multipliers, rows, forces)
                factor, refreshed = None, True
            last = size
        raise SolverError(
            f"the step from t = {old.time:.9g} s with h = {h:.3g} s does not converge in {_ITERATIONS} Newton "
            f"iterations (last change {size:.2g}, limit {noise:.2g}, in the norm of kinetic energy). Take a smaller "
            "step; check for surfaces that are sharper than a step, and for positions where joints lock"
        )

    def _refresh(
        self, t: float, x: Floats, v: Floats, rate: Floats, multipliers: Floats, rows: NDArray[np.int_], forces: Forces
    ) -> None:
        force, friction = np.zeros(self.group.count), np.zeros((self.group.count, 2))
        force[rows], friction[rows] = forces.normal, forces.friction
        K, C = stiffness_and_damping(self.assembly, t, x, v, rate, multipliers)
        self.tangents = K + self.group.stiffness(x, force, friction), C

    def _respond(
        self, factor: tuple[Floats, Floats], residual: Floats, x: Floats, v: Floats, step: Floats,
        rows: NDArray[np.int_], c_q: float, c_v: float, last: tuple[Floats, Floats],
    ) -> tuple[Floats, Forces]:  # fmt: skip
        """Newton's change with the contact forces that go with it, near to the ``last`` ones."""
        k, r = self.assembly.size, len(rows)
        if not r:
            none = Forces(normal=np.zeros(0), friction=np.zeros((0, 2)), sliding=np.zeros(0, dtype=bool))
            return -sl.lu_solve(factor, residual, check_finite=False), none
        meeting = self.group.meet(x)
        N, T = meeting.N[rows], meeting.T[rows]
        right = np.zeros((len(residual), 1 + 3 * r))
        right[:, 0], right[:k, 1 : 1 + r], right[:k, 1 + r :] = -residual, N.T, T.reshape(-1, k).T
        Y = sl.lu_solve(factor, right, check_finite=False)
        y, YN, YT = Y[:, 0], Y[:, 1 : 1 + r], Y[:, 1 + r :].reshape(len(Y), r, 2)
        turned = self.assembly.tangent(N, step)
        problem = law(
            N=turned, T=T, XN=YN[:k], XT=YT[:k], gap=meeting.gap[rows] / c_q + turned @ y[:k],
            slip=T @ (v / c_v + y[:k]), friction=self.group.friction[rows],
            pyramid=[self.group.directions(i) if self.group.friction[i] > 0 else None for i in rows],
            compliance=self.group.flexibility(x, meeting)[np.ix_(rows, rows)] / c_q,
            noise=(_ROUND * self.length / c_q, _ROUND * float((np.abs(T) @ np.abs(v)).max()) / c_v),
        )  # fmt: skip
        if r > 1:
            problem = problem.near(*last)
        forces = problem.solve(rows, self.group.count)
        return y + YN @ forces.normal + np.einsum("kia,ia->k", YT, forces.friction), forces

    def _accepted(self, state: State, rows: NDArray[np.int_], forces: Forces) -> ContactState:
        force, friction = np.zeros(self.group.count), np.zeros((self.group.count, 2))
        sliding = np.zeros(self.group.count, dtype=bool)
        force[rows], friction[rows], sliding[rows] = forces.normal, forces.friction, forces.sliding
        self.state = self._with_contact(state, force, friction, sliding)
        self.closed &= (force > 0) | (self.state.gap <= _OPEN * self.length)
        return self.state
