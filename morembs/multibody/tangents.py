"""Stiffness and damping matrices of a system by differences.

One-sided ones affect only the convergence of Newton's method; central ones are for linearisation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
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
    central: bool = False,
) -> tuple[Floats, Floats]:  # fmt: skip
    """K and C (k, k): derivatives of M dv/dt + g + B' multipliers by the configuration and by the velocity.

    Each part is varied in the coordinates of its own components only; ``central`` differences take twice the time.
    """
    h = _CENTRAL if central else _STEP
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
        base = None if central else forces(x, v)
        for i in sorted({i for c in components if (i := assembly.index(c)) is not None}):
            for column in range(assembly.in_v[i].start, assembly.in_v[i].stop):
                step = np.zeros(assembly.size)
                step[column] = h
                K[:, column] += slope(partial(varied, i), step, forces, base)
                if moving:
                    C[:, column] += slope(faster, step, forces, base)

    for i, component in enumerate(assembly.components):
        at = assembly.in_v[i]
        own = None if central else component.slopes(t, x[assembly.in_x[i]], v[at])
        if own is None:
            add([component], _inner(assembly, i, t, acceleration))
        else:
            K[at, at] += own[0]
            C[at, at] += own[1]
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
