#!/usr/bin/env python3
"""A Coriolis mass-flow meter: the phase between its sensors, by flow and by the damping of its mounts (van de Ridder).

Fluid in the window of tube that twists to and fro bends it by its Coriolis force, and the sensors at its outer corners
see a phase in proportion to the mass flow. Damping that differs between the two mounts of the casing makes a phase as
well, without any flow: largest where the damper works most, and where the casing resonates on its mount. One reduced
body of tube and fluid serves all mounts. Draws coriolis_meter.png.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from common import Curve, Floats, Panel, draw, parse

import morembs
from morembs.base.types import Complexes
from morembs.fem import skew

TUBE = morembs.Tube(outer=3e-3, inner=2.6e-3, young=195e9, density=8000.0)
CORNERS = np.array([[0, -5, 0], [0, -69.25, 0], [92.5, -69.25, 0], [92.5, 69.25, 0], [0, 69.25, 0], [0, 5, 0]]) * 1e-3
PER_SIDE, SENSORS = 6, (12, 18)  # elements; nodes at the outer corners
CASING, SIZE = 1.25, np.array([0.05, 0.13, 0.03])  # kg, m
MOUNTS = {"A": -0.065, "B": 0.065}  # m, each of two springs and dampers across the plane at x = -+0.025 m
STIFFNESS_A, DAMPING_A = 400.0, 0.3  # N/m, Ns/m
TWIST_HZ = 126.19


def window(mass_flow: float, held: bool) -> morembs.FEModel:
    """The tube with water at ``mass_flow`` kg/s, its feet clamped where ``held``."""
    parts = [a + (b - a) * np.arange(PER_SIDE)[:, None] / PER_SIDE for a, b in pairwise(CORNERS)]
    points = np.vstack([*parts, CORNERS[-1:]])
    flow = morembs.Flow(mass_flow=mass_flow, density=1000.0, area=np.pi / 4 * TUBE.inner**2)
    model = morembs.tube_model(points, TUBE, held=(0, len(points) - 1) if held else ())
    return morembs.add_flow(model, np.arange(len(points)), flow)


def sensors(model: morembs.FEModel) -> morembs.Interface:
    """The outer corners; their motion across the plane is what the last rows of a body, 2 and 5, have."""
    return morembs.make_interface(
        model, name="sensors", nodes=np.array(SENSORS), coupling="direct", components=[0, 1, 2]
    )


def phase(s: Complexes, motions: Complexes) -> float:
    """Phase in rad between the sensors in the twist mode nearest to ``TWIST_HZ``; ``motions`` (6, m) of modes ``s``."""
    first, second = motions[2], motions[5]
    twist = np.abs(first - second) > np.abs(first + second)
    at = np.flatnonzero(twist)[np.argmin(np.abs(s[twist].imag / (2 * np.pi) - TWIST_HZ))]
    return float(2 * ((first[at] + second[at]) / (first[at] - second[at])).imag)


def held_phase(mass_flow: float) -> tuple[Floats, float]:
    """Frequencies in Hz and the phase with clamped feet."""
    model = window(mass_flow, held=True)
    with morembs.Problem(model, [sensors(model)]) as problem:
        body = morembs.Krylov(shifts_hz=[60.0, TWIST_HZ, 250.0], moments=2).reduce(problem)
    s, X = body.complex_modes()
    return s.imag / (2 * np.pi), phase(s, body.C @ X)


class Meter:
    """The tube at rest on a casing, reduced once; mounts and casing act on the coordinates of its interface."""

    def __init__(self) -> None:
        model = window(0.0, held=False)
        feet = morembs.make_interface(model, name="casing", nodes=np.array([0, len(model.nodes) - 1]), point=[0, 0, 0])
        with morembs.Problem(model, [feet, sensors(model)]) as problem:
            self.body = morembs.CraigBampton(modes=12).reduce(problem)
        inertia = CASING / 12 * np.diag((SIZE**2).sum() - SIZE**2)
        self.mass = self.body.M.copy()
        self.mass[:6, :6] += np.block([[CASING * np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), inertia]])

    def phase(self, stiffness: float, damping: float) -> float:
        """Phase without flow for mount B."""
        K, D = self.body.K.copy(), self.body.D.copy()
        for y, k, d in ((MOUNTS["A"], STIFFNESS_A, DAMPING_A), (MOUNTS["B"], stiffness, damping)):
            for x in (-0.025, 0.025):
                across = np.append([0.0, 0.0, 1.0], -skew(np.array([x, y, 0.0]))[2])
                K[:6, :6] += 0.5 * k * np.outer(across, across)
                D[:6, :6] += 0.5 * d * np.outer(across, across)
        s, X = replace(self.body, M=self.mass, K=K, D=D).complex_modes()
        return abs(phase(s, self.body.C[6:] @ X))


def main(arguments: Sequence[str] | None = None) -> int:
    options = parse(arguments, __doc__, __file__)
    flows = np.array([1e-3, 2.5e-3, 5e-3])
    hz = held_phase(0.0)[0]
    phases = np.array([held_phase(flow)[1] for flow in flows])
    print("held: " + ", ".join(f"{f:.2f}" for f in hz[:4]) + f" Hz; {phases[0] / flows[0]:.4f} rad per kg/s")
    print(f"linear up to 5 g/s within {np.abs(phases / flows / (phases[0] / flows[0]) - 1).max():.1e}")
    meter, count = Meter(), 25 if options.quick else 161
    dampings = np.unique(np.append(np.geomspace(1e-2, 1e6, count), np.linspace(230, 280, 11 if options.quick else 101)))
    stiffnesses = np.unique(np.append(np.geomspace(10, 1e7, count), np.linspace(1.9e5, 2.2e5, 31)))
    soft = np.array([meter.phase(1e3, d) for d in dampings])
    loose = np.array([meter.phase(k, 10.0) for k in stiffnesses])
    print(f"without flow the phase is largest at {dampings[soft.argmax()]:.4g} Ns/m on a mount B of 1e3 N/m")
    print("mount B: N/m   Ns/m   phase, rad")
    for k, d in ((1e3, 253.9), (2.05e5, 10.0), (1e6, 10.0), (1e3, 1e5)):
        print(f"{k:12.4g} {d:6.4g}   {meter.phase(k, d):.4g}")
    draw(
        options.folder / "coriolis_meter.png",
        "Coriolis meter: phase between the sensors",
        [
            Panel(
                "Mount B of 1e3 N/m",
                "log10 of damping of mount B, Ns/m",
                "rad",
                [Curve(np.log10(dampings), soft, "without flow", "C0")],
            ),
            Panel(
                "Mount B of 10 Ns/m",
                "log10 of stiffness of mount B, N/m",
                "rad",
                [Curve(np.log10(stiffnesses), loose, "without flow", "C1")],
                logarithmic=True,
            ),
        ],
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
