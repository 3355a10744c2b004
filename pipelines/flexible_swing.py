#!/usr/bin/env python3
"""A flexible swing in two simulators: a thin steel strip, hung by one end, falls from the horizontal.

Reduces the strip by flexible_swing.toml, runs the body in morembs.multibody and in Exudyn, and draws
flexible_swing.png. Both without geometric stiffening, which Exudyn does not have.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from both_simulators import (
    OURS,
    THEIRS,
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

from morembs.multibody import FlexibleBody, RevoluteJoint, System, ground, simulate

SIZE, CELLS = (1.0, 0.04, 0.008), (20, 1, 1)  # m: length, width, height
GRAVITY = (0.0, 0.0, -9.81)
END, STEP, RHO = 1.0, 1.25e-4, 0.9
QUICK_END = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class Swing:
    """Times (s,), the tip (s, 3) m of both simulators (None without Exudyn) and the bending of the tip (s,) m."""

    time: Floats
    ours: Floats
    theirs: Floats | None
    bending: Floats

    @property
    def gap(self) -> Floats:
        """(s,) m between the tips of both simulators."""
        return np.linalg.norm(self.ours - self.theirs, axis=1)


def run_ours(made: Made, end: float, step: float) -> tuple[Floats, Floats, Floats]:
    """Times, tip and its bending across the strip, in morembs.multibody."""
    frame = made.body.floating
    system = System(gravity=GRAVITY)
    strip = system.add(FlexibleBody(frame, position=frame.origin, name="strip"))
    system.add(RevoluteJoint(ground.marker_at(), strip.marker("hinge"), axis=(0, 1, 0)))
    result = simulate(system, end=end, step=step, rho=RHO)
    return result.time, result.position(strip.marker("tip")), result.elastic(strip) @ frame.markers["tip"].motion[2]


def run_theirs(made: Made, end: float, step: float) -> Floats:
    """The tip in Exudyn."""
    system = ExudynSystem(gravity=GRAVITY)
    strip = system.elastic(made, position=made.body.floating.origin)
    system.joint(system.at_ground(), system.at_interface(strip, made, "hinge"), (1, 1, 1, 1, 0, 1))
    system.watch(system.at_interface(strip, made, "tip"))
    return system.solve(end=end, step=step, rho=RHO)[1][0]


def run(made: Made, *, end: float = END, step: float = STEP) -> Swing:
    """Both simulators, with the same steps."""
    time, ours, bending = run_ours(made, end, step)
    theirs = None if exudyn_missing() else run_theirs(made, end, step)
    return Swing(time=time, ours=ours, theirs=theirs, bending=bending)


def picture(path: Path, swing: Swing) -> None:
    """Path of the tip, its bending and the difference."""
    height = [Curve(x=swing.time, y=swing.ours[:, 2], label="morembs")]
    if swing.theirs is not None:
        height.append(Curve(x=swing.time, y=swing.theirs[:, 2], label="Exudyn", color=THEIRS, style="--"))
    panels = [
        Panel(title="Height of the tip", x="time, s", y="m", curves=height),
        Panel(
            title="Bending of the tip, seen from the hinge", x="time, s", y="mm",
            curves=[Curve(x=swing.time, y=1e3 * swing.bending, color=OURS)],
        ),
    ]  # fmt: skip
    if swing.theirs is not None:
        panels.append(difference(swing.time, swing.gap, SIZE[0]))
    draw(path, "Flexible swing", panels)


def main(arguments: Sequence[str] | None = None) -> int:
    """Makes body and picture, prints the figures. Returns the exit code."""
    options = parse(arguments, "A flexible swing in morembs.multibody and in Exudyn.")
    made = make_body(options.folder, "flexible_swing", SIZE, CELLS)
    swing = run(made, end=QUICK_END if options.quick else END)
    image = options.folder / "flexible_swing.png"
    picture(image, swing)
    x, _, z = swing.ours[-1]
    print(f"swing of {made.body.floating.count} elastic coordinates, {len(swing.time) - 1} steps of {STEP:g} s")
    print(f"tip at t = {swing.time[-1]:g} s: ({x:.7f}, {z:.7f}) m; largest bending {np.abs(swing.bending).max():.3g} m")
    if swing.theirs is not None:
        x, _, z = swing.theirs[-1]
        print(f"the same in Exudyn:  ({x:.7f}, {z:.7f}) m; largest difference "
              f"{swing.gap.max() / SIZE[0]:.2g} of the length")  # fmt: skip
    else:
        print(exudyn_missing())
    print(image)
    return 0


if __name__ == "__main__":
    sys.exit(main())
