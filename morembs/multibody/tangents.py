"""Stiffness and damping matrices of a system by differences; they affect only the convergence of Newton's method."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from morembs.multibody.component import Component, Marker
from morembs.multibody.forces import Force
from morembs.multibody.joints import Constraint
from morembs.multibody.system import Assembly

Floats = NDArray[np.float64]
_STEP = 1e-6


def stiffness_and_damping(
    assembly: Assembly, t: float, x: Floats, v: Floats, acceleration: Floats, multipliers: Floats
) -> tuple[Floats, Floats]:
    """K and C (k, k): derivatives of M dv/dt + g + B' multipliers by the configuration and by the velocity.

    Each part is varied in the coordinates of its own components only.
    """
    K, C = np.zeros((assembly.size, assembly.size)), np.zeros((assembly.size, assembly.size))

    def add(components: Iterable[Component], forces: Callable[[Floats, Floats], Floats], moving: bool = True) -> None:
        base = forces(x, v)
        for i in sorted({i for c in components if (i := assembly.index(c)) is not None}):
            varied = x.copy()
            for column in range(assembly.in_v[i].start, assembly.in_v[i].stop):
                step = np.zeros(assembly.size)
                step[column] = _STEP
                at = assembly.in_x[i]
                varied[at] = assembly.components[i].moved(x[at], step[assembly.in_v[i]])
                K[:, column] += (forces(varied, v) - base) / _STEP
                if moving:
                    C[:, column] += (forces(x, v + step) - base) / _STEP

    for i, component in enumerate(assembly.components):
        add([component], _inner(assembly, i, t, acceleration))
    for force in assembly.forces:
        add([m.component for m in force.markers], _loaded(assembly, force, t))
    for joint, r in zip(assembly.joints, assembly.in_rows, strict=True):
        add([joint.first.component, joint.second.component], _held(assembly, joint, multipliers[r]), moving=False)
    return K, C


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
