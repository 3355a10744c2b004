#!/usr/bin/env python3
"""Three laws of dissipation in contact: the restitution that each gives where another is wanted (Flores).

A ball meets a wall with F = K d^1.5 (1 + chi d'). The same restitution follows by quadrature from the law alone:
with s the rate of penetration, s ds / (1 + chi s) is the same on the way in and out. Draws impact_laws.png.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from common import Curve, Floats, Panel, draw, parse
from scipy.optimize import brentq

from morembs.dynamics.multibody import ContactElement, PowerLaw, RigidBody, System, damping_factor, ground, simulate

LAWS = ("flores", "lankarani-nikravesh", "hunt-crossley")
STIFFNESS, SPEED, RADIUS = 1e9, 1.0, 0.01  # N/m^1.5, m/s, m
DURATION = 2.94 * (1.25 / STIFFNESS) ** 0.4  # s, of a touch without dissipation


def simulated(law: str, wanted: float, steps: int) -> tuple[float, Floats, Floats]:
    """Rebound over approach, and penetration and force over the touch."""
    system = System()
    ball = system.add(
        RigidBody(1.0, (1, 1, 1), position=(0, 0, RADIUS), velocity=(0, 0, -SPEED), markers={"centre": (0, 0, 0)})
    )
    centre, wall = ball.marker("centre"), ground.marker_at((0, 0, 0))
    touch = {"stiffness": PowerLaw(STIFFNESS), "direction": (0, 0, 1), "distance": RADIUS}
    system.add(ContactElement(centre, wall, restitution=wanted, law=law, **touch))
    # A rebound with a tenth of the speed takes that much longer.
    result = simulate(system, end=DURATION * (2 + 1 / wanted), step=DURATION / steps)
    depth, speed = RADIUS - result.position(centre)[:, 2], result.velocity(centre)[:, 2]
    force = np.gradient(speed, result.time)
    inside = depth >= 0
    return float(speed[-1] / SPEED), depth[inside], force[inside]


def by_quadrature(law: str, wanted: float) -> float:
    """The restitution e that solves W(1) = W(-e), where W is the integral of s / (1 + chi s) ds."""
    chi = damping_factor(law, wanted)
    if chi == 0:
        return 1.0

    def W(s: float) -> float:
        return (s - np.log1p(chi * s) / chi) / chi

    # Less than 1 / chi: the force never pulls.
    return float(brentq(lambda e: W(1.0) - W(-e), 1e-12, min(1.0, 1 / chi) * (1 - 1e-12)))


def main(arguments: Sequence[str] | None = None) -> int:
    options = parse(arguments, __doc__, __file__)
    wanted, steps = (np.array([0.3, 0.6, 0.9]), 60) if options.quick else (np.linspace(0.1, 0.9, 9), 200)
    print("wanted   " + "   ".join(f"{law:>22}" for law in LAWS))
    table = np.array([[[simulated(law, e, steps)[0], by_quadrature(law, e)] for law in LAWS] for e in wanted])
    for e, row in zip(wanted, table, strict=True):
        print(f"{e:6.2f}   " + "   ".join(f"{ours:9.4f} ({exact:9.4f})" for ours, exact in row))
    print(f"largest gap to the quadrature: {np.abs(table[:, :, 0] - table[:, :, 1]).max():.1e}")
    laws = [Curve(wanted, table[:, k, 1], law, f"C{k}") for k, law in enumerate(LAWS)]
    laws += [Curve(wanted, table[:, k, 0], "", f"C{k}", "o") for k in range(len(LAWS))]
    touches = [simulated(law, 0.5, steps) for law in LAWS]
    loops = [
        Curve(1e6 * depth, force, law, f"C{k}")
        for k, (law, (_, depth, force)) in enumerate(zip(LAWS, touches, strict=True))
    ]
    panels = [
        Panel("Restitution that is obtained", "wanted", "obtained", [*laws, Curve(wanted, wanted, "", "0.6", "--")]),
        Panel("One touch with a wanted restitution of 0.5", "penetration, um", "N", loops),
    ]
    draw(options.folder / "impact_laws.png", "Laws of dissipation in contact", panels)
    return 0


if __name__ == "__main__":
    sys.exit(main())
