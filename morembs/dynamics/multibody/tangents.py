"""Stiffness and damping matrices of a system.

One-sided differences are enough for Newton's method, and lead a search away from where they vanish. Linearisation and
sensitivities take the exact ones of parts that know them, and central differences of the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from morembs.base.types import Floats
from morembs.dynamics.multibody.component import Component, Marker, MarkerState
from morembs.dynamics.multibody.forces import Force
from morembs.dynamics.multibody.joints import Constraint
from morembs.dynamics.multibody.system import Assembly, State
from morembs.dynamics.multibody.tolerances import TOL

Forces = Callable[[Floats, Floats], Floats]
Varied = Callable[[Floats], tuple[Floats, Floats]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Pull:
    """A joint or force at one state: its ``wrenches`` (6,) on the left side of the equations of motion, at the markers
    ``ends`` with their ``places``, and how they change with the motions of these, ``bend`` (6 e, 6 e), None where only
    differences tell. ``G`` (m, 6 e) are the derivatives of the ``rows`` of a joint."""

    part: Constraint | Force
    ends: Sequence[Marker]
    places: Sequence[MarkerState]
    wrenches: Sequence[Floats]
    bend: Floats | None
    rows: slice | None = None
    G: Floats | None = None


def pulls(assembly: Assembly, state: State) -> list[Pull]:
    """Those of all joints and forces."""
    result: list[Pull] = []
    for joint, rows in zip(assembly.joints, assembly.in_rows, strict=True):
        ends, multipliers = (joint.first, joint.second), state.multipliers[rows]
        first, second = (assembly.place(marker, state.x) for marker in ends)
        _, *G = joint.rows(first, second)
        bend, wrenches = joint.bend(first, second, multipliers), [multipliers @ each for each in G]
        result.append(
            Pull(part=joint, ends=ends, places=(first, second), wrenches=wrenches, bend=bend, rows=rows, G=np.hstack(G))
        )
    for force in assembly.forces:
        places = [assembly.place(marker, state.x) for marker in force.markers]
        twists = [assembly.twist(m, place, state.v) for m, place in zip(force.markers, places, strict=True)]
        known, given = force.bend(state.time, places), force.wrenches(state.time, places, twists)
        bend = None if known is None else -known
        result.append(
            Pull(part=force, ends=force.markers, places=places, wrenches=[-wrench for wrench in given], bend=bend)
        )
    return result


def stiffness_and_damping(
    assembly: Assembly,
    t: float,
    x: Floats,
    v: Floats,
    acceleration: Floats,
    multipliers: Floats,
    *,
    known: Sequence[Pull] | None = None,
) -> tuple[Floats, Floats]:
    """K and C (k, k): derivatives of M dv/dt + g + B' multipliers by the configuration and by the velocity.

    By one-sided differences; with ``known``, the ``pulls`` here, exact as far as parts know their own. Each part is
    varied in the coordinates of its own components only.
    """
    exact, h = known is not None, TOL.forward_step if known is None else TOL.central_step
    K, C = np.zeros((assembly.size, assembly.size)), np.zeros((assembly.size, assembly.size))

    def vary(i: int, step: Floats) -> tuple[Floats, Floats]:
        at, result = assembly.in_x[i], x.copy()
        result[at] = assembly.components[i].move(x[at], step[assembly.in_v[i]])
        return result, v

    def faster(step: Floats) -> tuple[Floats, Floats]:
        return x, v + step

    def slope(varied: Varied, step: Floats, forces: Forces, base: Floats | None) -> Floats:
        ahead = forces(*varied(step))
        return (ahead - forces(*varied(-step))) / (2 * h) if base is None else (ahead - base) / h

    def add(components: Iterable[Component], forces: Forces, moving: bool = True) -> None:
        base = None if exact else forces(x, v)
        for i in sorted({i for c in components if (i := assembly.index(c)) is not None}):
            for column in range(assembly.in_v[i].start, assembly.in_v[i].stop):
                step = np.zeros(assembly.size)
                step[column] = h
                K[:, column] += slope(partial(vary, i), step, forces, base)
                if moving:
                    C[:, column] += slope(faster, step, forces, base)

    for i, (component, in_x, in_v) in enumerate(zip(assembly.components, assembly.in_x, assembly.in_v, strict=True)):
        if exact:
            own = component.tangents(x[in_x], v[in_v], acceleration[in_v], assembly.gravity)
        else:
            own = component.slopes(t, x[in_x], v[in_v])
        if own is None:
            add([component], _inner(assembly, i, t, acceleration))
        else:
            K[in_v, in_v] += own[0]
            C[in_v, in_v] += own[1]
    known_slopes = {} if known is None else {id(pull.part): _differentiate_pull(assembly, x, pull) for pull in known}
    for force in assembly.forces:
        if (slopes := known_slopes.get(id(force))) is None:
            add([m.component for m in force.markers], _bind_load(assembly, force, t))
        else:
            K += slopes
    for joint, r in zip(assembly.joints, assembly.in_rows, strict=True):
        if (slopes := known_slopes.get(id(joint))) is None:
            add(
                [joint.first.component, joint.second.component],
                _bind_joint(assembly, joint, multipliers[r]),
                moving=False,
            )
        else:
            K += slopes
    return K, C


def _differentiate_pull(assembly: Assembly, x: Floats, pull: Pull) -> Floats | None:
    """(k, k): derivative by the configuration of the forces of ``pull``; None where a part does not know it."""
    if pull.bend is None:
        return None
    J, result = np.zeros((6 * len(pull.ends), assembly.size)), np.zeros((assembly.size, assembly.size))
    for number, (marker, place, wrench) in enumerate(zip(pull.ends, pull.places, pull.wrenches, strict=True)):
        i = assembly.index(marker.component)
        if i is None:
            continue
        at, own = assembly.in_v[i], marker.bend(x[assembly.in_x[i]], wrench)
        if own is None:
            return None
        result[at, at] += own
        J[6 * number : 6 * number + 6, at] = place.jacobian
    return np.asarray(result + J.T @ pull.bend @ J)


def _inner(assembly: Assembly, i: int, t: float, acceleration: Floats) -> Callable[[Floats, Floats], Floats]:
    in_x, in_v = assembly.in_x[i], assembly.in_v[i]

    def forces(x: Floats, v: Floats) -> Floats:
        M, g = assembly.components[i].dynamics(t, x[in_x], v[in_v], assembly.gravity)
        result = np.zeros(assembly.size)
        result[in_v] = M @ acceleration[in_v] + g
        return result

    return forces


def _bind_load(assembly: Assembly, force: Force, t: float) -> Callable[[Floats, Floats], Floats]:
    def forces(x: Floats, v: Floats) -> Floats:
        result = np.zeros(assembly.size)
        assembly.load(force, t, v, [assembly.place(m, x) for m in force.markers], result)
        return result

    return forces


def _bind_joint(assembly: Assembly, joint: Constraint, multipliers: Floats) -> Callable[[Floats, Floats], Floats]:
    def pull(result: Floats, marker: Marker, jacobian: Floats, G: Floats) -> None:
        i = assembly.index(marker.component)
        if i is not None:
            result[assembly.in_v[i]] += (multipliers @ G) @ jacobian

    def forces(x: Floats, v: Floats) -> Floats:
        a, b = assembly.place(joint.first, x), assembly.place(joint.second, x)
        _, Ga, Gb = joint.rows(a, b)
        result = np.zeros(assembly.size)
        pull(result, joint.first, a.jacobian, Ga)
        pull(result, joint.second, b.jacobian, Gb)
        return result

    return forces
