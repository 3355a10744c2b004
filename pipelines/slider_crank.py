#!/usr/bin/env python3
"""A slider-crank with a flexible connecting rod in two simulators, morembs.dynamics.multibody and Exudyn.

Reduces the rod by slider_crank.toml and turns the crank at constant speed from the stretched position, without gravity.
Draws slider_crank.png: both without geometric stiffening, which Exudyn does not have, and what it changes. The rod has
a spherical joint at the slider; a revolute one would constrain again, through its stiffness, what that at the pin does.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from common import OURS, THEIRS, THIRD, Curve, Floats, Panel, difference, draw, make_body, parse

from morembs.dynamics import multibody as mb
from morembs.exporters.exudyn_system import ExudynBody, ExudynSystem, exudyn_missing

SIZE, CELLS = (0.3, 0.006, 0.008), (20, 1, 1)  # m: length, height in the plane of motion, width
CRANK, LENGTH, SPEED, AXIS = 0.15, SIZE[0], 150.0, (0.0, 0.0, 1.0)  # m, m, rad/s
CRANK_MASS, CRANK_INERTIA = 0.5, (1e-4, 1e-3, 1e-3)
SLIDER_MASS, SLIDER_INERTIA = 0.05, (1e-5, 1e-5, 1e-5)
TURN = 2 * np.pi / SPEED
STEP, RHO = TURN / 1600, 0.9
FAR_END, POINTS = (CRANK + LENGTH, 0, 0), ("crank_pin", "middle", "wrist_pin")
SPIN = {"angular_velocity": (0, 0, SPEED)}
SWEEP = {
    "position": (CRANK, 0, 0),
    "velocity": (0, SPEED * CRANK, 0),
    "angular_velocity": (0, 0, -SPEED * CRANK / LENGTH),
}


@dataclass(frozen=True, eq=False)
class Run:
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

    def gap(self, other: Run) -> Floats:
        """(s,) m: the largest distance of the three points to those of another run."""
        ours, theirs = (np.array([run.pin, run.middle, run.wrist]) for run in (self, other))
        return np.linalg.norm(ours - theirs, axis=2).max(axis=0)


def run_ours(source: ExudynBody, end: float, step: float, *, stiffening: bool = False) -> Run:
    """The mechanism in morembs.dynamics.multibody."""
    system, axle = mb.System(), mb.ground.marker_at()
    crank = system.add(
        mb.RigidBody(CRANK_MASS, CRANK_INERTIA, name="crank", **SPIN, markers={"axle": (0, 0, 0), "pin": (CRANK, 0, 0)})
    )
    rod = system.add(mb.FlexibleBody(source.floating, stiffening=stiffening, name="rod", **SWEEP))
    slider = system.add(
        mb.RigidBody(SLIDER_MASS, SLIDER_INERTIA, position=FAR_END, name="slider", markers={"pin": (0, 0, 0)})
    )
    system.add(mb.RevoluteJoint(axle, crank.marker("axle"), axis=AXIS))
    system.add(mb.DrivenAngle(axle, crank.marker("axle"), axis=AXIS, motion=mb.Motion.steady(SPEED)))
    system.add(mb.RevoluteJoint(crank.marker("pin"), rod.marker("crank_pin"), axis=AXIS))
    system.add(mb.SphericalJoint(rod.marker("wrist_pin"), slider.marker("pin")))
    system.add(mb.PrismaticJoint(mb.ground.marker_at(FAR_END), slider.marker("pin"), axis=(1, 0, 0)))
    result = mb.simulate(system, end=end, step=step, rho=RHO)
    return Run(result.time, *(result.position(rod.marker(name)) for name in POINTS))


def run_theirs(source: ExudynBody, end: float, step: float) -> Run:
    """The mechanism in Exudyn."""
    system = ExudynSystem()
    crank = system.rigid(CRANK_MASS, CRANK_INERTIA, position=(0, 0, 0), **SPIN)
    rod = system.elastic(source, **SWEEP)
    slider = system.rigid(SLIDER_MASS, SLIDER_INERTIA, position=FAR_END)
    pin, middle, wrist = (system.at_interface(rod, name) for name in POINTS)
    system.joint(system.at_ground(), system.at_body(crank), (1, 1, 1, 1, 1, 0))
    system.drive(crank, axis=2, speed=SPEED)
    system.joint(system.at_body(crank, (CRANK, 0, 0)), pin, (1, 1, 1, 1, 1, 0))
    system.joint(wrist, system.at_body(slider), (1, 1, 1, 0, 0, 0))
    system.joint(system.at_ground(FAR_END), system.at_body(slider), (0, 1, 1, 1, 1, 1))
    time, points = system.solve(end=end, step=step, rho=RHO, watch=[pin, middle, wrist])
    return Run(time, *points)


def main(arguments: Sequence[str] | None = None) -> int:
    options = parse(
        arguments, "A slider-crank with a flexible rod in morembs.dynamics.multibody and in Exudyn.", __file__
    )
    source = make_body(Path(__file__).with_suffix(".toml"), options.folder, SIZE, CELLS)
    end = TURN / 4 if options.quick else 2 * TURN
    ours, stiff = (run_ours(source, end, STEP, stiffening=stiffening) for stiffening in (False, True))
    theirs = None if exudyn_missing() else run_theirs(source, end, STEP)
    runs, gap = [(ours, "morembs", OURS, "-"), (stiff, "morembs with geometric stiffening", THIRD, ":")], []
    largest, with_stiffening = (1e3 * np.abs(run.deflection).max() for run in (ours, stiff))
    print(f"rod of {source.floating.count} elastic coordinates, {len(ours.time) - 1} steps of {STEP:.3g} s")
    print(f"largest deflection {largest:.4f} mm ({1e-3 * largest / LENGTH:.2%} of the length)")
    print(f"with geometric stiffening {with_stiffening:.4f} mm. {exudyn_missing()}")
    if theirs is not None:
        print(
            f"in Exudyn {1e3 * np.abs(theirs.deflection).max():.4f} mm; largest difference of pins and middle "
            f"{ours.gap(theirs).max() / LENGTH:.2g} of the length"
        )
        runs.insert(1, (theirs, "Exudyn", THEIRS, "--"))
        gap = [difference(ours.time, ours.gap(theirs), LENGTH)]
    deflection = [Curve(run.time / TURN, 1e3 * run.deflection, *look) for run, *look in runs]
    lead = [Curve(run.time / TURN, 1e6 * run.lead, *look) for run, *look in runs]
    draw(
        options.folder / "slider_crank.png",
        "Slider-crank with a flexible connecting rod",
        [
            Panel("Middle of the rod off the line of its pins", "turns of the crank", "mm", deflection),
            Panel("Slider ahead of that of a rigid rod", "turns of the crank", "µm", lead),
            *gap,
        ],
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
