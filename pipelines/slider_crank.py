#!/usr/bin/env python3
"""A slider-crank with a flexible connecting rod in two simulators.

Reduces the rod by slider_crank.toml and turns the crank at constant speed, in morembs.multibody and in Exudyn, from
the stretched position with the rod undeformed. The picture slider_crank.png compares both without geometric
stiffening, which Exudyn does not have, and shows what stiffening changes. Gravity is left out.

Crank: on the ground by a revolute joint, its angle driven. Rod: a revolute joint at the crank pin, a spherical one at
the slider (a second revolute joint would only hold again what the first holds, through the stiffness of the rod).
Slider: a prismatic joint with the ground.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from both_simulators import (
    OURS,
    THEIRS,
    THIRD,
    Curve,
    ExudynSystem,
    Floats,
    Made,
    Panel,
    difference,
    draw,
    exudyn_missing,
    make_body,
    parse,
)

from morembs.multibody import (
    DrivenAngle,
    FlexibleBody,
    Motion,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    SphericalJoint,
    System,
    ground,
    simulate,
)

SIZE, CELLS = (0.3, 0.006, 0.008), (20, 1, 1)  # m: length, height in the plane of motion, width
CRANK, SPEED = 0.15, 150.0  # m, rad/s
CRANK_MASS, CRANK_INERTIA = 0.5, (1e-4, 1e-3, 1e-3)
SLIDER_MASS, SLIDER_INERTIA = 0.05, (1e-5, 1e-5, 1e-5)
LENGTH, AXIS = SIZE[0], (0.0, 0.0, 1.0)
TURN = 2 * math.pi / SPEED
STEP, RHO = TURN / 1600, 0.9


@dataclass(frozen=True, kw_only=True, eq=False)
class Motions:
    """Times (s,) and positions (s, 3) m of crank pin, middle and wrist pin of the rod; the slider is at the last."""

    time: Floats
    pin: Floats
    middle: Floats
    wrist: Floats

    @property
    def deflection(self) -> Floats:
        """(s,) m: the middle off the line of the pins, in the plane of motion."""
        line, arm = self.wrist - self.pin, self.middle - self.pin
        return np.asarray((line[:, 0] * arm[:, 1] - line[:, 1] * arm[:, 0]) / np.linalg.norm(line, axis=1))

    @property
    def lead(self) -> Floats:
        """(s,) m: the slider ahead of that of a rigid rod."""
        rigid = CRANK * np.cos(SPEED * self.time) + np.sqrt(LENGTH**2 - (CRANK * np.sin(SPEED * self.time)) ** 2)
        return np.asarray(self.wrist[:, 0] - rigid)

    def gap(self, other: Motions) -> Floats:
        """(s,) m: the largest distance of the three points to those of another run."""
        pairs = ((self.pin, other.pin), (self.middle, other.middle), (self.wrist, other.wrist))
        return np.max([np.linalg.norm(a - b, axis=1) for a, b in pairs], axis=0)


def run_ours(made: Made, end: float, step: float, *, stiffening: bool = False) -> Motions:
    """The mechanism in morembs.multibody."""
    system = System()
    crank = system.add(
        RigidBody(
            CRANK_MASS,
            CRANK_INERTIA,
            angular_velocity=(0, 0, SPEED),
            name="crank",
            markers={"axle": (0, 0, 0), "pin": (CRANK, 0, 0)},
        )
    )
    rod = system.add(
        FlexibleBody(
            made.body.floating,
            position=(CRANK, 0, 0),
            velocity=(0, SPEED * CRANK, 0),
            angular_velocity=(0, 0, -SPEED * CRANK / LENGTH),
            stiffening=stiffening,
            name="rod",
        )
    )
    slider = system.add(
        RigidBody(
            SLIDER_MASS, SLIDER_INERTIA, position=(CRANK + LENGTH, 0, 0), name="slider", markers={"pin": (0, 0, 0)}
        )
    )
    axle = ground.marker_at()
    system.add(RevoluteJoint(axle, crank.marker("axle"), axis=AXIS))
    system.add(DrivenAngle(axle, crank.marker("axle"), axis=AXIS, motion=Motion.steady(SPEED)))
    system.add(RevoluteJoint(crank.marker("pin"), rod.marker("crank_pin"), axis=AXIS))
    system.add(SphericalJoint(rod.marker("wrist_pin"), slider.marker("pin")))
    system.add(PrismaticJoint(ground.marker_at((CRANK + LENGTH, 0, 0)), slider.marker("pin"), axis=(1, 0, 0)))
    result = simulate(system, end=end, step=step, rho=RHO)
    pin, middle, wrist = (result.position(rod.marker(name)) for name in ("crank_pin", "middle", "wrist_pin"))
    return Motions(time=result.time, pin=pin, middle=middle, wrist=wrist)


def run_theirs(made: Made, end: float, step: float) -> Motions:
    """The mechanism in Exudyn."""
    system = ExudynSystem()
    crank = system.rigid(CRANK_MASS, CRANK_INERTIA, position=(0, 0, 0), angular_velocity=(0, 0, SPEED))
    rod = system.elastic(
        made, position=(CRANK, 0, 0), velocity=(0, SPEED * CRANK, 0), angular_velocity=(0, 0, -SPEED * CRANK / LENGTH)
    )
    slider = system.rigid(SLIDER_MASS, SLIDER_INERTIA, position=(CRANK + LENGTH, 0, 0))
    pin, middle, wrist = (system.at_interface(rod, made, name) for name in ("crank_pin", "middle", "wrist_pin"))
    system.joint(system.at_ground(), system.at_body(crank), (1, 1, 1, 1, 1, 0))
    system.drive(crank["node"], axis=2, speed=SPEED)
    system.joint(system.at_body(crank, (CRANK, 0, 0)), pin, (1, 1, 1, 1, 1, 0))
    system.joint(wrist, system.at_body(slider), (1, 1, 1, 0, 0, 0))
    system.joint(system.at_ground((CRANK + LENGTH, 0, 0)), system.at_body(slider), (0, 1, 1, 1, 1, 1))
    for marker in (pin, middle, wrist):
        system.watch(marker)
    time, (first, second, third) = system.solve(end=end, step=step, rho=RHO)
    return Motions(time=time, pin=first, middle=second, wrist=third)


def picture(path: Path, ours: Motions, stiff: Motions, theirs: Motions | None) -> None:
    """Deflection of the rod, motion of the slider and the difference of both simulators."""
    runs = [(ours, "morembs", OURS, "-")]
    if theirs is not None:
        runs.append((theirs, "Exudyn", THEIRS, "--"))
    runs.append((stiff, "morembs with geometric stiffening", THIRD, ":"))
    curves = [
        [Curve(x=SPEED * run.time / (2 * math.pi), y=scale * getattr(run, value), label=label, color=color, style=style)
         for run, label, color, style in runs]
        for value, scale in (("deflection", 1e3), ("lead", 1e6))
    ]  # fmt: skip
    panels = [
        Panel(title="Middle of the rod off the line of its pins", x="turns of the crank", y="mm", curves=curves[0]),
        Panel(title="Slider ahead of that of a rigid rod", x="turns of the crank", y="µm", curves=curves[1]),
    ]
    if theirs is not None:
        panels.append(difference(ours.time, ours.gap(theirs), LENGTH))
    draw(path, "Slider-crank with a flexible connecting rod", panels)


def main(arguments: Sequence[str] | None = None) -> int:
    """Makes body and picture, prints the figures. Returns the exit code."""
    options = parse(arguments, "A slider-crank with a flexible rod in morembs.multibody and in Exudyn.")
    made = make_body(options.folder, "slider_crank", SIZE, CELLS)
    end = TURN / 4 if options.quick else 2 * TURN
    ours, stiff = (run_ours(made, end, STEP, stiffening=stiffening) for stiffening in (False, True))
    theirs = None if exudyn_missing() else run_theirs(made, end, STEP)
    image = options.folder / "slider_crank.png"
    picture(image, ours, stiff, theirs)
    largest = np.abs(ours.deflection).max()
    print(f"rod of {made.body.floating.count} elastic coordinates, {len(ours.time) - 1} steps of {STEP:.3g} s")
    print(f"largest deflection {1e3 * largest:.4f} mm ({largest / LENGTH:.2%} of the length)")
    print(f"with geometric stiffening {1e3 * np.abs(stiff.deflection).max():.4f} mm")
    if theirs is not None:
        print(
            f"in Exudyn {1e3 * np.abs(theirs.deflection).max():.4f} mm; largest difference of pins and middle "
            f"{ours.gap(theirs).max() / LENGTH:.2g} of the length"
        )
    else:
        print(exudyn_missing())
    print(image)
    return 0


if __name__ == "__main__":
    sys.exit(main())
