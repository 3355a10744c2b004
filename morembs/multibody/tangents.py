"""Stiffness and damping matrices of a system.

One-sided differences are enough for Newton's method, and lead a search away from where they vanish. Linearisation and
sensitivities take the exact ones of parts that know them, and central differences of the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from morembs.multibody.component import Component, Marker
from morembs.multibody.forces import Force
from morembs.multibody.joints import Constraint
from morembs.multibody.system import Assembly

Floats = NDArray[np.float64]
Forces = Callable[[Floats, Floats], Floats]
Varied = Callable[[Floats], tuple[Floats, Floats]]
# Steps of one-sided and of central differences, near the square and the cube root of round-off.
_STEP, _CENTRAL = 1e-6, 1e-5


def stiffness_and_damping(
    assembly: Assembly, t: float, x: Floats, v: Floats, acceleration: Floats, multipliers: Floats, *,
    exact: bool = False,
) -> tuple[Floats, Floats]:  # fmt: skip
    """K and C (k, k): derivatives of M dv/dt + g + B' multipliers by the configuration and by the velocity.

    By one-sided differences, or ``exact`` as far as parts know their own. Each part is varied in the coordinates of
    its own components only.
    """
    h = _CENTRAL if exact else _STEP
    K, C = np.zeros((assembly.size, assembly.size)), np.zeros((assembly.size, assembly.size))

    def varied(i: int, step: Floats) -> tuple[Floats, Floats]:
        at, result = assembly.in_x[i], x.copy()
        result[at] = assembly.components[i].moved(x[at], step[assembly.in_v[i]])
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
                K[:, column] += slope(partial(varied, i), step, forces, base)
                if moving:
                    C[:, column] += slope(faster, step, forces, base)

    for i, (component, in_x, in_v) in enumerate(zip(assembly.components, assembly.in_x, assembly.in_v, strict=True)):
        if exact:
            known = component.tangents(x[in_x], v[in_v], acceleration[in_v], assembly.gravity)
        else:
            known = component.slopes(t, x[in_x], v[in_v])
        if known is None:
            add([component], _inner(assembly, i, t, acceleration))
        else:
            K[in_v, in_v] += known[0]
            C[in_v, in_v] += known[1]
    for force in assembly.forces:
        slopes = _of_force(assembly, force, t, x, v) if exact else None
        if slopes is None:
            add([m.component for m in force.markers], _loaded(assembly, force, t))
        else:
            K -= slopes
    for joint, r in zip(assembly.joints, assembly.in_rows, strict=True):
        slopes = _of_joint(assembly, joint, x, multipliers[r]) if exact else None
        if slopes is None:
            add([joint.first.component, joint.second.component], _held(assembly, joint, multipliers[r]), moving=False)
        else:
            K += slopes
    return K, C


def _of_force(assembly: Assembly, force: Force, t: float, x: Floats, v: Floats) -> Floats | None:
    places = [assembly.place(m, x) for m in force.markers]
    twists = [assembly.twist(m, place, v) for m, place in zip(force.markers, places, strict=True)]
    bend = force.bend(t, places)
    return None if bend is None else _pulled(assembly, x, force.markers, force.wrenches(t, places, twists), bend)


def _of_joint(assembly: Assembly, joint: Constraint, x: Floats, multipliers: Floats) -> Floats | None:
    a, b = assembly.place(joint.first, x), assembly.place(joint.second, x)
    bend, (_, *G) = joint.bend(a, b, multipliers), joint.rows(a, b)
    wrenches = [multipliers @ each for each in G]
    return None if bend is None else _pulled(assembly, x, (joint.first, joint.second), wrenches, bend)


def _pulled(
    assembly: Assembly, x: Floats, markers: Sequence[Marker], wrenches: Sequence[Floats], bend: Floats
) -> Floats | None:
    """(k, k): derivative by the configuration of the generalised forces of ``wrenches`` (6,) on markers, which change
    by ``bend`` (6 e, 6 e) with the motions of these; None where a marker does not know its own."""
    J, result = np.zeros((6 * len(markers), assembly.size)), np.zeros((assembly.size, assembly.size))
    for number, (marker, wrench) in enumerate(zip(markers, wrenches, strict=True)):
        i = assembly.index(marker.component)
        if i is None:
            continue
        at, own = assembly.in_v[i], marker.bend(x[assembly.in_x[i]], wrench)
        if own is None:
            return None
        result[at, at] += own
        J[6 * number : 6 * number + 6, at] = assembly.place(marker, x).jacobian
    return np.asarray(result + J.T @ bend @ J)


def _inner(assembly: Assembly, i: int, t: float, acceleration: Floats) -> Callable[[Floats, Floats], Floats]:
    in_x, in_v = assembly.in_x[i], assembly.in_v[i]

    def forces(x: Floats, v: Floats) -> Floats:
        M, g = assembly.components[i].dynamics(t, x[in_x], v[in_v], assembly.gravity)
        result = np.zeros(assembly.size)
        result[in_v] = M @ acceleration[in_v] + g
        return result

    return forces


def _loaded(assembly: Assembly, force: Force, t: float) -> Callable[[Floats, Floats], Floats]:
    def forces(x: Floats, v: Floats) -> Floats:
        result = np.zeros(assembly.size)
        assembly.load(force, t, v, [assembly.place(m, x) for m in force.markers], result)
        return result

    return forces


def _held(assembly: Assembly, joint: Constraint, multipliers: Floats) -> Callable[[Floats, Floats], Floats]:
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
