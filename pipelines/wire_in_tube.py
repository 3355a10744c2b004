#!/usr/bin/env python3
"""A straight wire in a tube of constant curvature: contact by a penalty at Simpson's points (Meijaard, EUROMECH 524).

Inside the wire follows the tube with the moment EI / R and without contact forces; at each end there are two, of the
outer wall at its tip and of the inner one at a distance a. With the play g of the wire, a^2 = 6 g R and their size is
EI / (R a), for a << R. Draws wire_in_tube.png.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from common import OURS, THEIRS, THIRD, Curve, Floats, Panel, draw, parse

from morembs.dynamics.nonlinear import BeamInTube, CurvedTube, PlanarBeam, Section, equilibrium

RADIUS, LENGTH, DIAMETER = 0.2, 0.2, 5e-4  # m
SECTION = Section.of(E=2e11, A=np.pi / 4 * DIAMETER**2, I=np.pi / 64 * DIAMETER**4, density=7850.0)
ELEMENTS, QUICK_ELEMENTS = 400, 200
PLAYS = (4e-4, 2e-4, 1e-4)  # m from wall to wall, for the axis of the wire
SOFT, HARD, STAGES = 1e3, 1e10, 29  # N/m2 of the penalty


def settle(play: float, elements: int) -> tuple[BeamInTube, Floats]:
    """The wire in equilibrium, from the inner wall and a soft penalty on; its middle is held along the tube."""
    beam, inner = PlanarBeam.straight(LENGTH, elements, SECTION), RADIUS - play / 2
    turn = np.linspace(-LENGTH / 2, LENGTH / 2, elements + 1) / inner
    x = np.column_stack((inner * np.sin(turn), inner * np.cos(turn), -turn)).ravel()
    for penalty in np.geomspace(SOFT, HARD, STAGES):
        wire = BeamInTube(beam, CurvedTube(radius=RADIUS, clearance=play / 2, penalty=float(penalty)))
        x = equilibrium(wire, held=np.array([3 * (elements // 2)]), x=x, steps=1)
    return wire, x


def ends(play: float) -> tuple[float, float]:
    """Distance (m) and size (N) of both forces at an end, to first order in a / R."""
    distance = np.sqrt(6 * play * RADIUS)
    return distance, SECTION.EI / RADIUS / distance


def main(arguments: Sequence[str] | None = None) -> int:
    options = parse(arguments, __doc__, __file__)
    elements = QUICK_ELEMENTS if options.quick else ELEMENTS
    print(
        "play, mm   force at the tip, N, per analytic   distance of the other, mm, per analytic   sum   "
        "moment inside per EI / R   forces inside per tip"
    )
    shown, bending = [], []
    for play, color in zip(PLAYS, (THIRD, THEIRS, OURS), strict=True):
        wire, x = settle(play, elements)
        force, s, (distance, size) = wire.contact(x), wire.along, ends(play)
        tip, other = (s < LENGTH / 4) & (force > 0), (s < LENGTH / 4) & (force < 0)
        at = force[other] @ s[other] / force[other].sum()
        inside = np.abs(force[(s > 2 * distance) & (s < LENGTH - 2 * distance)]).sum()
        moment = np.abs(wire.beam.resultants(x)[:, 2])
        middle = moment[elements // 2 - elements // 8 : elements // 2 + elements // 8].mean() * RADIUS / SECTION.EI
        print(
            f"{1e3 * play:8.2f}   {force[tip].sum():15.5f} {force[tip].sum() / size:17.4f}   {1e3 * at:22.3f} "
            f"{at / distance:16.4f}   {-force[other].sum() / force[tip].sum():5.3f}   {middle:23.4f}   "
            f"{inside / force[tip].sum():.4f}"
        )
        shown.append(Curve(1e3 * s, force, f"play {1e3 * play:g} mm", color, width=1.2))
        centres = (s[:-1:2] + s[2::2]) / 2
        bending.append(Curve(1e3 * centres, moment * RADIUS / SECTION.EI, f"play {1e3 * play:g} mm", color, width=1.2))
    draw(
        options.folder / "wire_in_tube.png",
        "Wire in a curved tube",
        [
            Panel(
                "Forces of the walls at Simpson's points, positive by the outer one", "along the wire, mm", "N", shown
            ),
            Panel("Bending moment", "along the wire, mm", "per EI / R", bending),
        ],
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
