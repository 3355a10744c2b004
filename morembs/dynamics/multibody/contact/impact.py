"""Impacts: complementarity of velocities with Newton's restitution (Moreau 1988), and where in a step they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from morembs.base.types import Bools, Floats, Ints
from morembs.dynamics.multibody.contact.kinematics import Contacts, ContactState
from morembs.dynamics.multibody.contact.lcp import ContactProblem, Forces, Responses
from morembs.dynamics.multibody.contact.tolerances import TOL
from morembs.dynamics.multibody.reactions import least_norm, saddle
from morembs.dynamics.multibody.system import Assembly


@dataclass(frozen=True, kw_only=True, eq=False)
class ImpactSolution:
    """Velocity after an impact, ``impulse`` (m,) and ``friction`` (m, 2), points that stay ``closed`` (m,), ``work`` J
    and that of prescribed motions, ``driving`` J, and the ``limit`` m/s below which velocities are round-off."""

    v: Floats
    impulse: Floats
    friction: Floats
    closed: Bools
    work: float = 0.0
    driving: float = 0.0
    limit: float = 0.0


def resolve_impact(
    assembly: Assembly, group: Contacts, t: float, x: Floats, v: Floats, touching: Bools, restitution: Floats, h: float
) -> ImpactSolution:
    """Velocities after an impact of all points that touch, with ``restitution`` (m,) of each.

    Newton's law may add energy where friction turns the sliding round (Kane 1984): restitution is then reduced to where
    none is added, of points that feel each other. What forces change within a millionth of a step of size ``h`` is
    round-off of velocities.

    Raises:
        RayError: no impulses keep the points apart.
    """
    k, rows = assembly.size, np.flatnonzero(touching)
    kinematics, (M, g, _, B) = group.kinematics(x), assembly.equations(t, x, v)
    N, T = kinematics.N[rows], kinematics.T[rows]
    least = kinematics.round_off(v, h * float(np.abs(kinematics.N @ np.linalg.solve(M, g)).max(initial=0.0)))
    right = np.concatenate((np.zeros(k), assembly.motion_derivative(1, t) - B @ v))
    responses = Responses.compute(lambda columns: np.linalg.solve(saddle(M, B), columns)[:k], right, N, T)
    responses = replace(responses, y=v + responses.y)
    y, r = responses.y, len(rows)
    impulse, friction, closed = np.zeros(group.count), np.zeros((group.count, 2)), np.zeros(group.count, dtype=bool)
    if not r:
        return ImpactSolution(v=y, impulse=impulse, friction=friction, closed=closed, limit=least)
    problem = ContactProblem.of(
        N=N,
        T=T,
        XN=responses.YN,
        XT=responses.YT,
        gap=N @ y,
        slip=T @ y,
        friction=group.friction[rows],
        compliance=np.zeros((r, r)),
        noise=(TOL.impact_noise * least, TOL.impact_noise * least),
    )
    rebound = restitution[rows] * np.minimum(N @ v, 0.0)

    def solve_part(part: Floats) -> tuple[Forces, Floats, Floats]:
        """Impulses, velocity and work (r,) of the impulses with a part (r,) of the restitution of each point."""
        forces = replace(problem, gap=problem.gap + part * rebound).solve(rows, group.count)
        after = responses.total(forces)
        mean = 0.5 * (v + after)
        return forces, after, forces.normal * (N @ mean) + np.einsum("ia,ia->i", forces.friction, T @ mean)

    part, kinetic = np.ones(r), float(v @ M @ v)
    forces, after, work = solve_part(part)
    if rebound.any():
        for number in np.unique(owner := problem.independent_groups()):
            points = owner == number
            if rebound[points].any() and work[points].sum() > TOL.no_gain * kinetic:
                part = _without_gain(solve_part, part, points)
                forces, after, work = solve_part(part)
    impulse[rows], friction[rows] = forces.normal, forces.friction
    # A rebound that would last less than a thousandth of a step is none.
    slow = N @ after <= 1e5 * least
    if slow.any() and float((N @ after)[slow].max()) > least:
        bent = np.concatenate((np.zeros(k), assembly.motion_derivative(1, t) - B @ after, -N[slow] @ after))
        after = after + least_norm(saddle(M, np.vstack((B, N[slow]))), bent)[:k]
    closed[rows] = slow
    total = float(work.sum())
    driving = 0.5 * (float(after @ M @ after) - kinetic) - total if assembly.motion_derivative(1, t).any() else 0.0
    return ImpactSolution(
        v=after, impulse=impulse, friction=friction, closed=closed, work=total, driving=driving, limit=least
    )


def _without_gain(solved: Callable[[Floats], tuple[Forces, Floats, Floats]], part: Floats, points: Bools) -> Floats:
    """The largest part (r,) of the restitution of some points that adds no energy; without restitution none is."""
    low, high = 0.0, 1.0
    for _ in range(TOL.restitution_halvings):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if solved(np.where(points, middle, part))[2][points].sum() <= 0 else (low, middle)
    return np.where(points, low, part)


def project_positions(assembly: Assembly, group: Contacts, t: float, x: Floats, touching: Bools) -> Floats:
    """The configuration nearest to x, in the norm of the mass matrix, where touching points and joints are closed."""
    rows = np.flatnonzero(touching)
    for _ in range(3):
        kinematics = group.kinematics(x)
        M, _, Phi, B = assembly.equations(t, x, np.zeros(assembly.size))
        S = saddle(M, np.vstack((B, kinematics.N[rows])))
        right = np.concatenate((np.zeros(assembly.size), -Phi, -kinematics.gap[rows]))
        if not np.abs(right).max(initial=0.0) > 0:
            break
        x = assembly.move(x, least_norm(S, right)[: assembly.size])
    return x


def first_touch(before: ContactState, after: ContactState, watched: Ints) -> tuple[float, Ints]:
    """The time, as a part (0 to 1) of the step, at which the first of the points ``watched`` reaches its surface, and
    the points that do so in the step; infinity for none. Gaps are taken as cubic in time."""
    h = after.time - before.time
    g0, g1 = before.kinematics.gap, after.kinematics.gap
    r0, r1 = h * before.approach, h * after.approach
    earliest, met = np.inf, []
    for i in watched:
        if g1[i] >= 0 and not (r0[i] < 0 < r1[i]):
            continue
        part = _root(float(g0[i]), float(g1[i]), float(r0[i]), float(r1[i]))
        if part < np.inf:
            met.append(i)
            earliest = min(earliest, part)
    return earliest, np.array(met, dtype=int)


def _root(g0: float, g1: float, r0: float, r1: float) -> float:
    """First falling zero of the cubic in (0, 1]; zero where it is negative from the start, infinity for none."""
    if g0 <= 0 and r0 < 0:
        return 0.0
    cubic = np.array([2 * g0 - 2 * g1 + r0 + r1, -3 * g0 + 3 * g1 - 2 * r0 - r1, r0, g0])
    roots = np.roots(cubic)
    real = np.sort(roots[np.abs(roots.imag) < TOL.real_root].real)
    for s in real:
        if (s > TOL.crossing_at_start or (r0 < 0 and s >= 0)) and s <= 1 and np.polyval(np.polyder(cubic), s) < 0:
            return float(s)
    return 1.0 if g1 < 0 and g0 > 0 else (0.0 if g1 < 0 else np.inf)


def sliding_ends(before: ContactState, after: ContactState, group: Contacts, least: float) -> float:
    """The part of the step at which sliding of a point first stops or reverses, from its velocity and acceleration
    at the start; infinity for none. Velocities up to ``least`` m/s are none."""
    pressed = (before.force > 0) & (after.force > 0) & (group.friction > 0)
    limit = max([least, *(s.kinematics.round_off(s.v, TOL.least_sliding) for s in (before, after))])
    h, earliest = after.time - before.time, np.inf
    old, new = before.slip, after.slip
    for i in np.flatnonzero(pressed):
        stops = bool(np.linalg.norm(new[i]) <= limit) and not after.sliding[i]
        if np.linalg.norm(old[i]) <= limit or not (stops or old[i] @ new[i] < 0):
            continue
        slowing = -h * float(old[i] @ (before.kinematics.T[i] @ before.acceleration))
        speed = float(old[i] @ old[i])
        part = speed / slowing if slowing > speed else 1.0
        # At the end of the step that is cut there the point sticks, so it may not be of no length.
        earliest = min(earliest, max(part, TOL.shortest_step))
    return earliest
