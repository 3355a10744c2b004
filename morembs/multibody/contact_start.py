"""Start and restart of generalised-alpha with contact: forces, accelerations and second-order corrections.

Which points press, stick or slide comes from complementarity of accelerations; with that held, the corrections
are those of constrained systems (Arnold, Bruels and Cardona 2015).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from morembs.multibody.contact import Contacts, Meeting
from morembs.multibody.contact_law import Forces, Law, law
from morembs.multibody.integrate import Scheme, _saddle
from morembs.multibody.lemke import lemke
from morembs.multibody.system import Assembly

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int_]
_AT_REST = 1e-8
# Accelerations of points below this part of what they are made of are round-off.
_ROUND = 1e-13


@dataclass(frozen=True, kw_only=True, eq=False)
class Start:
    """Acceleration and joint multipliers, forces (m,) and friction (m, 2) of contacts, and the corrected auxiliary
    acceleration and velocity of the scheme."""

    acceleration: Floats
    multipliers: Floats
    force: Floats
    friction: Floats
    sliding: Bools
    auxiliary: Floats
    velocity: Floats


def speed_limit(meeting: Meeting, v: Floats, least: float) -> float:
    """Relative velocities below this are round-off, m/s."""
    parts = np.abs(meeting.N) @ np.abs(v), np.abs(meeting.T) @ np.abs(v)
    return _AT_REST * max([least, *(float(p.max(initial=0.0)) for p in parts)])


def compliant_forces(group: Contacts, x: Floats, meeting: Meeting) -> Floats:
    """(m,) normal forces of points with compliance, zero for others."""
    force = np.zeros(group.count)
    rows = np.flatnonzero(group.compliant)
    if len(rows):
        R = group.flexibility(x, meeting)[np.ix_(rows, rows)]
        force[rows] = lemke(R, meeting.gap[rows]).z
    return force


class _Held:
    """Accelerations of a system with the points of ``pressing`` closed and those of ``sticking`` held."""

    def __init__(
        self, assembly: Assembly, group: Contacts, h: float, pressing: Ints, sticking: Ints, ratio: Floats
    ) -> None:
        self.assembly, self.group, self.h = assembly, group, h
        self.pressing, self.sticking, self.ratio = pressing, sticking, ratio

    def _pull(self, meeting: Meeting) -> Floats:
        """(m, k): generalised force per normal force, with the friction of sliding points."""
        return np.asarray(meeting.N + np.einsum("ia,iak->ik", self.ratio, meeting.T))

    def accelerations(self, t: float, x: Floats, v: Floats) -> Floats:
        """(k,)"""
        a, k = self.assembly, self.assembly.size
        places, meeting = a.places(x), self.group.meet(x)
        M, g = a.dynamics(t, x, v, places)
        _, B = a.constraints(t, places)
        pull, T = self._pull(meeting), meeting.T[self.sticking].reshape(-1, k)
        rows = np.vstack((B, meeting.N[self.pressing], T))
        columns = np.vstack((B, -pull[self.pressing], -T))
        S = np.zeros((k + len(rows),) * 2)
        S[:k, :k], S[:k, k:], S[k:, :k] = M, columns.T, rows
        touched = np.union1d(self.pressing, self.sticking)
        normal, tangential = np.zeros(self.group.count), np.zeros((self.group.count, 2))
        if len(touched):
            normal[touched], tangential[touched] = self.group.rates(x, v, self.h, touched)
        given = compliant_forces(self.group, x, meeting) @ pull
        bent = (a.driven(2, t) - a.curvature(x, v, self.h), -normal[self.pressing], -tangential[self.sticking].ravel())
        return _least(S, np.concatenate((given - g, *bent)))[:k]


def _least(S: Floats, right: Floats) -> Floats:
    """Solution of least norm: points may hold one motion twice."""
    return np.asarray(np.linalg.lstsq(S, right, rcond=1e-13)[0])


def begin(
    scheme: Scheme, assembly: Assembly, group: Contacts, t: float, x: Floats, v: Floats, h: float, closed: Bools,
    corrected: bool,
) -> Start:  # fmt: skip
    """Forces and accelerations at a state where the points ``closed`` (m,) touch and do not approach.

    Raises:
        RayError: no forces keep the points apart.
    """
    meeting = group.meet(x)
    given = compliant_forces(group, x, meeting)
    rows = np.flatnonzero(closed | group.compliant)
    rate, multipliers, forces = _balance(assembly, group, t, x, v, h, meeting, rows, given)
    force, friction, sliding = np.zeros(group.count), np.zeros((group.count, 2)), np.zeros(group.count, dtype=bool)
    force[rows], friction[rows], sliding[rows] = forces.normal, forces.friction, forces.sliding
    state = Start(
        acceleration=rate, multipliers=multipliers, force=force, friction=friction, sliding=sliding, auxiliary=rate,
        velocity=v,
    )  # fmt: skip
    if not corrected:
        return state
    ratio = np.zeros((group.count, 2))
    slips = sliding & (force > 0)
    ratio[slips] = friction[slips] / force[slips, None]
    pressing = np.flatnonzero((force > 0) & ~group.compliant)
    held = _Held(assembly, group, h, pressing, np.flatnonzero((force > 0) & (group.friction > 0) & ~sliding), ratio)
    ahead, behind = (
        held.accelerations(t + k, assembly.moved(x, k * v + 0.5 * k * k * rate), v + k * rate) for k in (h, -h)
    )
    jerk = 0.5 * (ahead - behind)
    offset = scheme.alpha_m - scheme.alpha_f
    shift = h * ((1 - 6 * scheme.beta - 3 * offset) / 6 * jerk + h / 12 * assembly.bracket(v, rate))
    places = assembly.places(x)
    M, _ = assembly.dynamics(t, x, v, places)
    J = np.vstack((assembly.constraints(t, places)[1], meeting.N[pressing]))
    change = _least(_saddle(M, J), np.concatenate((np.zeros(assembly.size), J @ shift)))
    return replace(state, auxiliary=rate + offset * jerk, velocity=v + change[: assembly.size])


def _balance(
    assembly: Assembly, group: Contacts, t: float, x: Floats, v: Floats, h: float, meeting: Meeting, rows: Ints,
    given: Floats,
) -> tuple[Floats, Floats, Forces]:  # fmt: skip
    """Acceleration, joint multipliers and contact forces of ``rows`` by complementarity of accelerations."""
    places, k = assembly.places(x), assembly.size
    M, g = assembly.dynamics(t, x, v, places)
    _, B = assembly.constraints(t, places)
    S = _saddle(M, B)
    N, T = meeting.N[rows], meeting.T[rows]
    right = np.zeros((len(S), 1 + 3 * len(rows)))
    right[:k, 0], right[k:, 0] = -g, assembly.driven(2, t) - assembly.curvature(x, v, h)
    right[:k, 1 : 1 + len(rows)] = N.T
    right[:k, 1 + len(rows) :] = T.reshape(-1, k).T
    Y = np.asarray(np.linalg.solve(S, right), dtype=np.float64)
    y, YN, YT = Y[:, 0], Y[:, 1 : 1 + len(rows)].copy(), Y[:, 1 + len(rows) :].reshape(len(S), -1, 2)
    if not len(rows):
        return y[:k], y[k:], Forces(normal=np.zeros(0), friction=np.zeros((0, 2)), sliding=np.zeros(0, dtype=bool))
    limit = speed_limit(meeting, v, h * float(np.abs(T @ y[:k]).max()))
    against, pyramid = np.zeros((len(rows), 2)), list[Floats | None]()
    for number, i in enumerate(rows):
        D, slip = group.directions(i), T[number] @ v
        if group.friction[i] > 0 and np.linalg.norm(slip) > limit:
            against[number] = group.friction[i] * D[int(np.argmin(D @ slip))]
            YN[:, number] += YT[:, number] @ against[number]
            pyramid.append(None)
        else:
            pyramid.append(D if group.friction[i] > 0 else None)
    normal, tangential = group.rates(x, v, h, rows)
    problem = law(
        N=N, T=T, XN=YN[:k], XT=YT[:k], gap=N @ y[:k] + normal, slip=T @ y[:k] + tangential,
        friction=group.friction[rows], pyramid=pyramid, compliance=np.zeros((len(rows), len(rows))),
        noise=(_ROUND * float((np.abs(N) @ np.abs(y[:k])).max()), _ROUND * float((np.abs(T) @ np.abs(y[:k])).max())),
    )  # fmt: skip
    forces = _with_known(problem, np.flatnonzero(group.compliant[rows]), given[rows]).solve(rows, group.count)
    total = y + YN @ forces.normal + np.einsum("kia,ia->k", YT, forces.friction)
    moving = np.abs(against).max(axis=1) > 0
    friction = forces.friction + against * forces.normal[:, None]
    return total[:k], total[k:], Forces(normal=forces.normal, friction=friction, sliding=forces.sliding | moving)


def _with_known(problem: Law, known: Ints, force: Floats) -> Law:
    """The same problem with some normal forces given: those of compliant points follow from their gaps."""
    if not len(known):
        return problem
    gap, NN, NT = problem.gap.copy(), problem.NN.copy(), problem.NT.copy()
    NN[known], NT[known] = 0.0, 0.0
    NN[known, known], gap[known] = 1.0, -force[known]
    return replace(problem, gap=gap, NN=NN, NT=NT)
