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
from typing import Any

import numpy as np
from common import OURS, THEIRS, THIRD, Curve, Floats, Panel, difference, draw, make_body, parse

from morembs.exporters.exudyn_system import ExudynBody, ExudynSystem, exudyn_missing
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
FAR_END, POINTS = (CRANK + LENGTH, 0, 0), ("crank_pin", "middle", "wrist_pin")
# How crank and rod start.
SPIN: dict[str, Any] = {"angular_velocity": (0, 0, SPEED)}
SWEEP: dict[str, Any] = {
    "position": (CRANK, 0, 0), "velocity": (0, SPEED * CRANK, 0), "angular_velocity": (0, 0, -SPEED * CRANK / LENGTH),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
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


def run_ours(made: ExudynBody, end: float, step: float, *, stiffening: bool = False) -> Motions:
    """The mechanism in morembs.multibody."""
    system, axle = System(), ground.marker_at()
    crank = system.add(RigidBody(
        CRANK_MASS, CRANK_INERTIA, name="crank", **SPIN, markers={"axle": (0, 0, 0), "pin": (CRANK, 0, 0)}))
    rod = system.add(FlexibleBody(made.floating, stiffening=stiffening, name="rod", **SWEEP))
    slider = system.add(RigidBody(
        SLIDER_MASS, SLIDER_INERTIA, position=FAR_END, name="slider", markers={"pin": (0, 0, 0)}))  # fmt: skip
    system.add(RevoluteJoint(axle, crank.marker("axle"), axis=AXIS))
    system.add(DrivenAngle(axle, crank.marker("axle"), axis=AXIS, motion=Motion.steady(SPEED)))
    system.add(RevoluteJoint(crank.marker("pin"), rod.marker("crank_pin"), axis=AXIS))
    system.add(SphericalJoint(rod.marker("wrist_pin"), slider.marker("pin")))
    system.add(PrismaticJoint(ground.marker_at(FAR_END), slider.marker("pin"), axis=(1, 0, 0)))
    result = simulate(system, end=end, step=step, rho=RHO)
    return Motions(result.time, *(result.position(rod.marker(name)) for name in POINTS))


def run_theirs(made: ExudynBody, end: float, step: float) -> Motions:
    """The mechanism in Exudyn."""
    system = ExudynSystem()
    crank = system.rigid(CRANK_MASS, CRANK_INERTIA, position=(0, 0, 0), **SPIN)
    rod = system.elastic(made, **SWEEP)
    slider = system.rigid(SLIDER_MASS, SLIDER_INERTIA, position=FAR_END)
    pin, middle, wrist = (system.at_interface(rod, name) for name in POINTS)
    system.joint(system.at_ground(), system.at_body(crank), (1, 1, 1, 1, 1, 0))
    system.drive(crank, axis=2, speed=SPEED)
    system.joint(system.at_body(crank, (CRANK, 0, 0)), pin, (1, 1, 1, 1, 1, 0))
    system.joint(wrist, system.at_body(slider), (1, 1, 1, 0, 0, 0))
    system.joint(system.at_ground(FAR_END), system.at_body(slider), (0, 1, 1, 1, 1, 1))
    time, places = system.solve(end=end, step=step, rho=RHO, watch=[pin, middle, wrist])
    return Motions(time, *places)


def picture(path: Path, ours: Motions, stiff: Motions, theirs: Motions | None) -> None:
    """Deflection of the rod, motion of the slider and the difference of both simulators."""
    runs = [(ours, "morembs", OURS, "-")]
    if theirs is not None:
        runs.append((theirs, "Exudyn", THEIRS, "--"))
    runs.append((stiff, "morembs with geometric stiffening", THIRD, ":"))
    turns = "turns of the crank"
    shown = [
        [Curve(SPEED * run.time / (2 * math.pi), scale * getattr(run, value), *look) for run, *look in runs]
        for value, scale in (("deflection", 1e3), ("lead", 1e6))
    ]
    panels = [
        Panel("Middle of the rod off the line of its pins", turns, "mm", shown[0]),
        Panel("Slider ahead of that of a rigid rod", turns, "µm", shown[1]),
    ]
    if theirs is not None:
        panels.append(difference(ours.time, ours.gap(theirs), LENGTH))
    draw(path, "Slider-crank with a flexible connecting rod", panels)


def main(arguments: Sequence[str] | None = None) -> int:
    """Makes body and picture, prints the figures. Returns the exit code."""
    options = parse(arguments, "A slider-crank with a flexible rod in morembs.multibody and in Exudyn.", __file__)
    made = make_body(Path(__file__).with_suffix(".toml"), options.folder, SIZE, CELLS)
    end = TURN / 4 if options.quick else 2 * TURN
    ours, stiff = (run_ours(made, end, STEP, stiffening=stiffening) for stiffening in (False, True))
    theirs = None if exudyn_missing() else run_theirs(made, end, STEP)
    largest = np.abs(ours.deflection).max()
    print(f"rod of {made.floating.count} elastic coordinates, {len(ours.time) - 1} steps of {STEP:.3g} s")
    print(f"largest deflection {1e3 * largest:.4f} mm ({largest / LENGTH:.2%} of the length)")
    print(f"with geometric stiffening {1e3 * np.abs(stiff.deflection).max():.4f} mm")
    if theirs is not None:
        print(f"in Exudyn {1e3 * np.abs(theirs.deflection).max():.4f} mm; largest difference of pins and middle "
              f"{ours.gap(theirs).max() / LENGTH:.2g} of the length")  # fmt: skip
    else:
        print(f"{exudyn_missing()}. One simulator is shown alone.")
    picture(options.folder / "slider_crank.png", ours, stiff, theirs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
