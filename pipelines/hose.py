#!/usr/bin/env python3
"""A hose that is bent to a half circle: motion of its base in, reaction at its far end out (Waiboer, EUROMECH 524).

A straight beam is bent from a circle as guess; the tangent of that equilibrium is reduced, and its state space with the
motion of the base as input is compared with the exact solution of an inextensional ring. Draws hose.png.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from common import OURS, THEIRS, THIRD, Curve, Floats, Panel, draw, parse
from scipy.optimize import brentq

import morembs
from morembs.dynamics.nonlinear import PlanarBeam, Section, equilibrium
from morembs.fem import DofMap, FEModel, Nodes

LENGTH, MASS, E, OUTER, INNER, LOSS = 0.3, 0.05557, 4e7, 8e-3, 5.5e-3, 0.05  # m, kg/m with water, Pa, m, m
AREA, MOMENT = np.pi / 4 * (OUTER**2 - INNER**2), np.pi / 64 * (OUTER**4 - INNER**4)
EI, RADIUS = E * MOMENT, LENGTH / np.pi
ELEMENTS, MODES = 80, 12


def bent(stretch: float) -> tuple[PlanarBeam, Floats]:
    """The hose, of ``stretch`` times its stiffness of extension, and its coordinates in the half circle.

    It has next to no rotary inertia, as the ring has none.
    """
    EA = stretch * E * AREA
    section = Section(EA=EA, GA=EA / 3, EI=EI, mass=MASS, rotary=1e-3 * MASS * MOMENT / AREA)
    hose, turn = PlanarBeam.straight(LENGTH, ELEMENTS, section), np.linspace(0, np.pi, ELEMENTS + 1)
    circle = np.column_stack((RADIUS * np.sin(turn), RADIUS * (1 - np.cos(turn)), turn)).ravel()
    held = np.concatenate((hose.frames["start"], hose.frames["end"]))
    return hose, equilibrium(hose, held=held, x=circle)


def linear(hose: PlanarBeam, x: Floats) -> FEModel:
    """Small motions about the equilibrium x (N,), whose bending moment takes part in the stiffness."""
    xyz, number = x.reshape(-1, 3).copy(), np.arange(hose.size)
    xyz[:, 2] = 0
    return FEModel(
        K=sp.csr_array(hose.tangent(x)),
        M=sp.csr_array(hose.M),
        nodes=Nodes(ids=np.arange(1, len(xyz) + 1), xyz=xyz),
        dofs=DofMap(node=number // 3, component=np.array([0, 1, 5])[number % 3]),
    )


def ring(square: complex, loss: float = 0.0) -> Floats:
    """From one end to the other, exact, at a frequency squared: tangential and normal motion, turn, moment, forces."""
    k, inertia = 1 / RADIUS, MASS * square
    rates = np.array(
        [
            [0, k, 0, 0, 0, 0],
            [-k, 0, 1, 0, 0, 0],
            [0, 0, 0, 1 / (EI * (1 + 1j * loss)), 0, 0],
            [0, 0, 0, 0, 0, -1],
            [-inertia, 0, 0, 0, 0, k],
            [0, -inertia, 0, 0, -k, 0],
        ]
    )
    return np.asarray(sl.expm(rates * LENGTH))


def ring_frequencies(highest: float) -> Floats:
    """Hz, with both ends held."""
    f = np.linspace(5, highest, 400)

    def free(f: float) -> float:
        return float(np.linalg.det(ring((2 * np.pi * f) ** 2)[:3, 3:]).real)

    d = [free(x) for x in f]
    return np.array([brentq(free, f[k], f[k + 1]) for k in range(len(f) - 1) if d[k] * d[k + 1] < 0])


def ring_moments(w: float) -> Floats:
    """Complex moment (2,) Nm at the far end by a unit tangential and normal motion of the base."""
    T = ring(w * w, LOSS)
    return np.asarray((T[3:, :3] - T[3:, 3:] @ np.linalg.solve(T[:3, 3:], T[:3, :3]))[0, :2])


def moments(space: morembs.StateSpace, w: float) -> Floats:
    """The same of a state space without loss: a stiffness (1 + i LOSS) K scales the reaction and the frequency."""
    s = 1j * w / np.sqrt(1 + 1j * LOSS)
    H = space.D + space.C @ np.linalg.solve(s * np.eye(len(space.A)) - space.A, space.B)
    return np.asarray((1 + 1j * LOSS) * (H.reshape(2, 3) @ [1, s, s * s]))


def main(arguments: Sequence[str] | None = None) -> int:
    options = parse(arguments, __doc__, __file__)
    exact = ring_frequencies(180.0)
    print(f"ring:                    {'  '.join(f'{f:9.3f}' for f in exact)} Hz")
    for stretch in (1.0, 100.0):
        hose, x = bent(stretch)
        model, forces = linear(hose, x), hose.resultants(x)
        ends = [
            morembs.make_interface(model, name=name, nodes=np.array([node]), coupling="direct")
            for name, node in (("base", 0), ("far", ELEMENTS))
        ]
        with morembs.Problem(model, ends) as problem:
            reduced = morembs.CraigBampton(modes=MODES).reduce(problem)
            body = morembs.elastic_body(problem, reduced, morembs.make_part(problem, nodes="interfaces"))
        space = morembs.state_space(body, ["base:displacement:x+y"], ["far:reaction:rz"], held=["base:rz", "far"])
        f = np.sort(np.abs(space.poles().imag))[1::2][: len(exact)] / (2 * np.pi)
        print(
            f"{stretch:3g} times EA, {len(space.A)} states: {'  '.join(f'{value:9.3f}' for value in f)} Hz, "
            f"moment {forces[:, 2].mean():.6f} Nm (EI / R {EI / RADIUS:.6f}), force {np.abs(forces[:, :2]).max():.1e} N"
        )
    print("largest gap of frequencies: " + ", ".join(f"{100 * gap:.2f} %" for gap in f / exact - 1))
    print("rad/s   moment of the far end by a tangential and a normal motion of the base, Nm/m   gap to the ring")
    for w in (1.0, 400.0):
        ours, theirs = moments(space, w), ring_moments(w)
        gap = np.abs(np.abs(ours) / np.abs(theirs) - 1).max()
        print(f"{w:5g}   {'  '.join(f'{value.real:.5f} {value.imag:+.5f}i' for value in ours)}   {100 * gap:.3f} %")
    w = np.linspace(1, 900, 120 if options.quick else 600)
    ours, theirs = (np.abs([f(v) for v in w]) for f in (lambda v: moments(space, v), ring_moments))
    curves = [
        Curve(w, ours[:, k], words, color) for k, (words, color) in enumerate((("tangential", OURS), ("normal", THIRD)))
    ]
    curves += [Curve(w, theirs[:, k], "" if k else "inextensional ring", THEIRS, "--") for k in range(2)]
    shape = x.reshape(-1, 3)
    draw(
        options.folder / "hose.png",
        "Hose in a half circle",
        [
            Panel("Equilibrium", "x, m", "y, m", [Curve(shape[:, 0], shape[:, 1])]),
            Panel("Moment at the far end by the motion of the base", "rad/s", "Nm/m", curves, logarithmic=True),
        ],
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
