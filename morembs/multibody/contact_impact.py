"""Impacts: complementarity of velocities with Newton's restitution (Moreau 1988), and where in a step they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from morembs.multibody.contact import Contacts
from morembs.multibody.contact_law import law
from morembs.multibody.contact_start import speed_limit
from morembs.multibody.contact_step import ContactState
from morembs.multibody.integrate import _saddle
from morembs.multibody.system import Assembly

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int_]
# A crossing this near to the begin of a step, as part of it, is the one that the step starts from.
_BEGIN = 1e-9
_SHORTEST = 1e-4


@dataclass(frozen=True, kw_only=True, eq=False)
class Jump:
    """Velocity after an impact, ``impulse`` (m,) and ``friction`` (m, 2), points that stay ``closed`` (m,), ``work`` J,
    and the ``limit`` m/s below which velocities are round-off."""

    v: Floats
    impulse: Floats
    friction: Floats
    closed: Bools
    work: float = 0.0
    limit: float = 0.0


def jump(
    assembly: Assembly, group: Contacts, t: float, x: Floats, v: Floats, touching: Bools, restitution: Floats,
    h: float,
) -> Jump:  # fmt: skip
    """Velocities after an impact of all points that touch, with ``restitution`` (m,) of each.

    What forces change within a millionth of a step of size ``h`` is round-off of velocities.

    Raises:
        RayError: no impulses keep the points apart.
    """
    k, rows = assembly.size, np.flatnonzero(touching)
    r, places, meeting = len(rows), assembly.places(x), group.meet(x)
    M, g = assembly.dynamics(t, x, v, places)
    _, B = assembly.constraints(t, places)
    N, T = meeting.N[rows], meeting.T[rows]
    least = speed_limit(meeting, v, h * float(np.abs(meeting.N @ np.linalg.solve(M, g)).max(initial=0.0)))
    right = np.zeros((k + len(B), 1 + 3 * r))
    right[k:, 0] = assembly.driven(1, t) - B @ v
    right[:k, 1 : 1 + r], right[:k, 1 + r :] = N.T, T.reshape(-1, k).T
    Y = np.asarray(np.linalg.solve(_saddle(M, B), right), dtype=float)[:k]
    y, YN, YT = v + Y[:, 0], Y[:, 1 : 1 + r], Y[:, 1 + r :].reshape(k, r, 2)
    impulse, friction, closed = np.zeros(group.count), np.zeros((group.count, 2)), np.zeros(group.count, dtype=bool)
    if not r:
        return Jump(v=y, impulse=impulse, friction=friction, closed=closed, limit=least)
    back = restitution[rows] * np.minimum(N @ v, 0.0)
    found = law(
        N=N, T=T, XN=YN, XT=YT, gap=N @ y + back, slip=T @ y, friction=group.friction[rows],
        pyramid=[group.directions(int(i)) if group.friction[i] > 0 else None for i in rows],
        compliance=np.zeros((r, r)), noise=(1e-2 * least, 1e-2 * least),
    ).solve(rows, group.count)  # fmt: skip
    after = y + YN @ found.normal + np.einsum("kia,ia->k", YT, found.friction)
    impulse[rows], friction[rows] = found.normal, found.friction
    # A rebound that would last less than a thousandth of a step is none.
    slow = N @ after <= 1e5 * least
    if slow.any() and float((N @ after)[slow].max()) > least:
        J = np.vstack((B, N[slow]))
        bent = np.concatenate((np.zeros(k), assembly.driven(1, t) - B @ after, -N[slow] @ after))
        after = after + np.asarray(np.linalg.lstsq(_saddle(M, J), bent, rcond=1e-13)[0], dtype=np.float64)[:k]
    closed[rows] = slow
    mean = 0.5 * (v + after)
    work = float(found.normal @ (N @ mean) + np.einsum("ia,ia->", found.friction, T @ mean))
    return Jump(v=after, impulse=impulse, friction=friction, closed=closed, work=work, limit=least)


def closed_up(assembly: Assembly, group: Contacts, t: float, x: Floats, touching: Bools) -> Floats:
    """The configuration nearest to x, in the norm of the mass matrix, where touching points and joints are closed."""
    rows = np.flatnonzero(touching)
    for _ in range(3):
        places, meeting = assembly.places(x), group.meet(x)
        M, _ = assembly.dynamics(t, x, np.zeros(assembly.size), places)
        Phi, B = assembly.constraints(t, places)
        S = _saddle(M, np.vstack((B, meeting.N[rows])))
        right = np.concatenate((np.zeros(assembly.size), -Phi, -meeting.gap[rows]))
        if not np.abs(right).max(initial=0.0) > 0:
            break
        change = np.asarray(np.linalg.lstsq(S, right, rcond=1e-13)[0], dtype=np.float64)
        x = assembly.moved(x, change[: assembly.size])
    return x


def first_touch(before: ContactState, after: ContactState, watched: Ints) -> tuple[float, Ints]:
    """The time, as a part (0 to 1) of the step, at which the first of the points ``watched`` reaches its surface, and
    the points that do so in the step; infinity for none. Gaps are taken as cubic in time."""
    h = after.state.time - before.state.time
    g0, g1 = before.meeting.gap, after.meeting.gap
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
    """First falling zero of the cubic in (0, 1]; zero where it is negative at once, infinity for none."""
    if g0 <= 0 and r0 < 0:
        return 0.0
    cubic = np.array([2 * g0 - 2 * g1 + r0 + r1, -3 * g0 + 3 * g1 - 2 * r0 - r1, r0, g0])
    roots = np.roots(cubic)
    real = np.sort(roots[np.abs(roots.imag) < 1e-9].real)
    for s in real:
        if (s > _BEGIN or (r0 < 0 and s >= 0)) and s <= 1 and np.polyval(np.polyder(cubic), s) < 0:
            return float(s)
    return 1.0 if g1 < 0 and g0 > 0 else (0.0 if g1 < 0 else np.inf)


def sliding_ends(before: ContactState, after: ContactState, group: Contacts, least: float) -> float:
    """The part of the step at which sliding of a point first ends or turns round, from its velocity and acceleration
    at the begin; infinity for none. Velocities up to ``least`` m/s are none."""
    pressed = (before.force > 0) & (after.force > 0) & (group.friction > 0)
    limit = max([least, *(speed_limit(s.meeting, s.state.v, 1e-12) for s in (before, after))])
    h, earliest = after.state.time - before.state.time, np.inf
    old, new = before.slip, after.slip
    for i in np.flatnonzero(pressed):
        stops = bool(np.linalg.norm(new[i]) <= limit) and not after.sliding[i]
        if np.linalg.norm(old[i]) <= limit or not (stops or old[i] @ new[i] < 0):
            continue
        slowing = -h * float(old[i] @ (before.meeting.T[i] @ before.state.acceleration))
        speed = float(old[i] @ old[i])
        part = speed / slowing if slowing > speed else 1.0
        # At the end of the step that is cut there the point sticks, so it may not be of no length.
        earliest = min(earliest, max(part, _SHORTEST))
    return earliest
