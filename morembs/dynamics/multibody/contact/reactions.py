"""Contact as reactions of a step: a complementarity problem at the start and in each Newton iteration.

Normal contact is held on the level of positions, at the end of the step, so that gaps do not drift; friction on the
level of velocities. At a start, which points press, stick or slide comes from complementarity of accelerations; with
that held, the corrections of second order are those of constrained systems.
"""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.base.types import Bools, Floats
from morembs.dynamics.multibody.contact.impact import resolve_impact
from morembs.dynamics.multibody.contact.kinematics import ContactKinematics, Contacts, ContactState
from morembs.dynamics.multibody.contact.lcp import NO_FORCES, ContactProblem, Forces, Responses
from morembs.dynamics.multibody.contact.lemke import lemke
from morembs.dynamics.multibody.contact.tolerances import TOL
from morembs.dynamics.multibody.reactions import LU, HeldRows, Iterate, Reactions, saddle
from morembs.dynamics.multibody.system import Assembly, State


class ContactReactions(Reactions):
    """Contact forces of a stepper that starts where the points ``closed`` (m,) touch and do not approach."""

    iterations = 30
    advice = "check for surfaces that are sharper than a step, and for positions where joints lock"

    def __init__(self, assembly: Assembly, contacts: Contacts, closed: Bools) -> None:
        super().__init__(assembly)
        self.contacts, self.points_closed, m = contacts, closed.copy(), contacts.count
        self.force, self.friction, self.sliding = np.zeros(m), np.zeros((m, 2)), np.zeros(m, dtype=bool)
        self.size = 0.0
        self._last: tuple[Floats, ContactKinematics] | None = None

    def _kinematics(self, x: Floats) -> ContactKinematics:
        """Those of a configuration, kept while the same array is asked for."""
        if self._last is None or self._last[0] is not x:
            self._last = x, self.contacts.kinematics(x)
        return self._last[1]

    def restart(self, state: State) -> Reactions:
        return ContactReactions(self.assembly, self.contacts, cast(ContactState, state).closed)

    def _compliant_forces(self, x: Floats, kinematics: ContactKinematics) -> Floats:
        """(m,) normal forces of points with compliance, zero for others."""
        force = np.zeros(self.contacts.count)
        rows = np.flatnonzero(self.contacts.compliant)
        if len(rows):
            R = self.contacts.flexibility(x, kinematics)[np.ix_(rows, rows)]
            force[rows] = lemke(R, kinematics.gap[rows]).z
        return force

    # Start: complementarity of accelerations.

    def balance(self, t: float, x: Floats, v: Floats, h: float) -> tuple[Floats, Floats]:
        """Accelerations and joint multipliers; contact forces by complementarity of accelerations.

        Raises:
            RayError: no forces keep the points apart.
        """
        a, k, group = self.assembly, self.assembly.size, self.contacts
        kinematics, (M, g, _, B) = self._kinematics(x), a.equations(t, x, v)
        given = self._compliant_forces(x, kinematics)
        rows = np.flatnonzero(self.points_closed | group.compliant)
        N, T = kinematics.N[rows], kinematics.T[rows]
        right = np.concatenate((-g, a.motion_derivative(2, t) - a.curvature(x, v, h)))
        responses = Responses.compute(lambda columns: np.linalg.solve(saddle(M, B), columns), right, N, T)
        if not len(rows):
            self._hold()
            return responses.y[:k], responses.y[k:]
        y, YN, YT = responses.y[:k], responses.YN.copy(), responses.YT
        # What free fall reaches in a step, also at right angles to the surface, is the scale of round-off at rest.
        fall = h * max(float(np.abs(N @ y).max()), float(np.abs(T @ y).max()))
        against = self._sliding_friction(rows, T @ v, kinematics.round_off(v, fall))
        moving = against.any(axis=1)
        for number in np.flatnonzero(moving):
            YN[:, number] += YT[:, number] @ against[number]
        normal, tangential = group.rates(x, v, h, rows)
        problem = ContactProblem.of(
            N=N,
            T=T,
            XN=YN[:k],
            XT=YT[:k],
            gap=N @ y + normal,
            slip=T @ y + tangential,
            friction=np.where(moving, 0.0, group.friction[rows]),
            compliance=np.zeros((len(rows), len(rows))),
            noise=(_round_off(N, y), _round_off(T, y)),
        )
        forces = problem.fix_forces(np.flatnonzero(group.compliant[rows]), given[rows]).solve(rows, group.count)
        friction = forces.friction + against * forces.normal[:, None]
        self._take(rows, Forces(normal=forces.normal, friction=friction, sliding=forces.sliding | moving))
        self._hold()
        total = replace(responses, YN=YN).total(forces)
        return total[:k], total[k:]

    def _sliding_friction(self, rows: NDArray[np.int_], slip: Floats, limit: float) -> Floats:
        """Friction (r, 2) per normal force of points that slide faster than ``limit``, zero for others."""
        speed = np.linalg.norm(slip, axis=1)
        ratio = np.where(speed > limit, self.contacts.friction[rows] / np.where(speed > 0, speed, 1.0), 0.0)
        return -ratio[:, None] * slip

    def _take(self, rows: NDArray[np.int_], forces: Forces) -> None:
        m = self.contacts.count
        self.force, self.friction, self.sliding = np.zeros(m), np.zeros((m, 2)), np.zeros(m, dtype=bool)
        self.force[rows], self.friction[rows], self.sliding[rows] = forces.normal, forces.friction, forces.sliding

    def _hold(self) -> None:
        """Hold pressing points: sticking ones also along the surface, others with the friction of sliding."""
        pressed, group = self.force > 0, self.contacts
        slips = self.sliding & pressed
        self._ratio = np.zeros((group.count, 2))
        self._ratio[slips] = self.friction[slips] / self.force[slips, None]
        self._pressing = np.flatnonzero(pressed & ~group.compliant)
        self._sticking = np.flatnonzero(pressed & (group.friction > 0) & ~self.sliding)

    def held_rows(self, x: Floats, v: Floats, h: float) -> HeldRows:
        pressing, sticking, group = self._pressing, self._sticking, self.contacts
        kinematics = group.kinematics(x)
        pull = np.asarray(kinematics.N + np.einsum("ia,iak->ik", self._ratio, kinematics.T))
        T = kinematics.T[sticking].reshape(-1, self.assembly.size)
        touched = np.union1d(pressing, sticking)
        normal, tangential = np.zeros(group.count), np.zeros((group.count, 2))
        if len(touched):
            normal[touched], tangential[touched] = group.rates(x, v, h, touched)
        return HeldRows(
            rows=np.vstack((kinematics.N[pressing], T)),
            pull=np.vstack((pull[pressing], T)),
            acceleration=np.concatenate((-normal[pressing], -tangential[sticking].ravel())),
            load=self._compliant_forces(x, kinematics) @ pull,
        )

    def closed_rows(self, x: Floats) -> Floats:
        return np.asarray(self._kinematics(x).N[self._pressing])

    def project(self, t: float, x: Floats, v: Floats, h: float) -> Floats:
        none = np.zeros(self.contacts.count)
        return resolve_impact(self.assembly, self.contacts, t, x, v, self.points_closed, none, h).v

    # Steps: complementarity of positions and of velocities at the end.

    def state(self, state: State, converged: bool = False) -> ContactState:
        """The state with contact; points that separate in a ``converged`` step are no longer closed."""
        kinematics = self._kinematics(state.x)
        deflection = self.contacts.flexibility(state.x, kinematics) @ self.force
        if converged:
            gap = kinematics.gap + deflection
            self.points_closed = self.points_closed & ((self.force > 0) | (gap <= TOL.opening_gap * self.size))
        return ContactState(
            assembly=state.assembly,
            time=state.time,
            x=state.x,
            v=state.v,
            acceleration=state.acceleration,
            multipliers=state.multipliers,
            kinematics=kinematics,
            force=self.force,
            friction=self.friction,
            sliding=self.sliding,
            deflection=deflection,
            closed=self.points_closed,
        )

    def measure(self, state: State, length: float) -> float:
        self.size = max(length, float(np.abs(cast(ContactState, state).kinematics.foot).max(initial=0.0)))
        return self.size

    def stiffness(self, x: Floats) -> Floats:
        return self.contacts.stiffness(x, self.force, self.friction)

    def solve(self, lu: LU, residual: Floats, x: Floats, iterate: Iterate) -> Floats:
        """Newton's change with the contact forces that go with it, near to the last ones."""
        k, group = self.assembly.size, self.contacts
        rows = np.flatnonzero(self.points_closed | group.compliant)
        if not len(rows):
            self._take(rows, NO_FORCES)
            return super().solve(lu, residual, x, iterate)
        kinematics = group.kinematics(x)
        N, T = kinematics.N[rows], kinematics.T[rows]
        responses = Responses.compute(lambda columns: sl.lu_solve(lu, columns, check_finite=False), -residual, N, T)
        turned, y = self.assembly.tangent(N, iterate.step), responses.y[:k]
        sliding = float((np.abs(T) @ np.abs(iterate.v)).max())
        problem = ContactProblem.of(
            N=turned,
            T=T,
            XN=responses.YN[:k],
            XT=responses.YT[:k],
            gap=kinematics.gap[rows] / iterate.c_q + turned @ y,
            slip=T @ (iterate.v / iterate.c_v + y),
            friction=group.friction[rows],
            compliance=group.flexibility(x, kinematics)[np.ix_(rows, rows)] / iterate.c_q,
            noise=(TOL.gap_roundoff * self.size / iterate.c_q, TOL.gap_roundoff * sliding / iterate.c_v),
        )
        if len(rows) > 1:
            problem = problem.near(self.force[rows], self.friction[rows])
        forces = problem.solve(rows, group.count)
        self._take(rows, forces)
        return responses.total(forces)


def _round_off(J: Floats, y: Floats) -> float:
    """Round-off of rows J (..., k) times accelerations y (k,)."""
    return TOL.acceleration_roundoff * float((np.abs(J) @ np.abs(y)).max())
