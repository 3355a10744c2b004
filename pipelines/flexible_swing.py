#!/usr/bin/env python3
"""A flexible swing in two simulators: a thin steel strip, hung by one end, falls from the horizontal.

Reduces the strip by flexible_swing.toml, runs the body in morembs.dynamics.multibody and in Exudyn, and draws
flexible_swing.png. Both without geometric stiffening, which Exudyn does not have.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from common import THEIRS, Curve, Floats, Panel, difference, draw, make_body, parse

from morembs.dynamics.multibody import FlexibleBody, RevoluteJoint, System, ground, simulate
from morembs.exporters.exudyn_system import ExudynBody, ExudynSystem, exudyn_missing

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


def run_ours(strip: ExudynBody, end: float, step: float) -> tuple[Floats, Floats, Floats]:
    """Times, tip and its bending across the strip, in morembs.dynamics.multibody."""
    frame = strip.floating
    system = System(gravity=GRAVITY)
    body = system.add(FlexibleBody(frame, position=frame.origin, name="strip"))
    system.add(RevoluteJoint(ground.marker_at(), body.marker("hinge"), axis=(0, 1, 0)))
    result = simulate(system, end=end, step=step, rho=RHO)
    return result.time, result.position(body.marker("tip")), result.elastic(body) @ frame.markers["tip"].motion[2]


def run_theirs(strip: ExudynBody, end: float, step: float) -> Floats:
    """The tip in Exudyn."""
    system = ExudynSystem(gravity=GRAVITY)
    body = system.elastic(strip, position=strip.floating.origin)
    system.joint(system.at_ground(), system.at_interface(body, "hinge"), (1, 1, 1, 1, 0, 1))
    return system.solve(end=end, step=step, rho=RHO, watch=[system.at_interface(body, "tip")])[1][0]


def run(strip: ExudynBody, *, end: float = END, step: float = STEP) -> Swing:
    """Both simulators, with the same steps."""
    time, ours, bending = run_ours(strip, end, step)
    theirs = None if exudyn_missing() else run_theirs(strip, end, step)
    return Swing(time=time, ours=ours, theirs=theirs, bending=bending)


def picture(path: Path, swing: Swing) -> None:
    """Path of the tip, its bending and the difference."""
    height = [Curve(swing.time, swing.ours[:, 2], "morembs")]
    panels = [
        Panel("Height of the tip", "time, s", "m", height),
        Panel("Bending of the tip, seen from the hinge", "time, s", "mm", [Curve(swing.time, 1e3 * swing.bending)]),
    ]
    if swing.theirs is not None:
        height.append(Curve(swing.time, swing.theirs[:, 2], "Exudyn", THEIRS, "--"))
        panels.append(difference(swing.time, swing.gap, SIZE[0]))
    draw(path, "Flexible swing", panels)


def main(arguments: Sequence[str] | None = None) -> int:
    """Makes body and picture, prints the figures. Returns the exit code."""
    options = parse(arguments, "A flexible swing in morembs.dynamics.multibody and in Exudyn.", __file__)
    strip = make_body(Path(__file__).with_suffix(".toml"), options.folder, SIZE, CELLS)
    swing = run(strip, end=QUICK_END if options.quick else END)
    x, _, z = swing.ours[-1]
    print(f"swing of {strip.floating.count} elastic coordinates, {len(swing.time) - 1} steps of {STEP:g} s")
    print(f"tip at t = {swing.time[-1]:g} s: ({x:.7f}, {z:.7f}) m; largest bending {np.abs(swing.bending).max():.3g} m")
    if swing.theirs is not None:
        x, _, z = swing.theirs[-1]
        print(
            f"the same in Exudyn:  ({x:.7f}, {z:.7f}) m; largest difference "
            f"{swing.gap.max() / SIZE[0]:.2g} of the length"
        )
    else:
        print(f"{exudyn_missing()}. One simulator is shown alone.")
    picture(options.folder / "flexible_swing.png", swing)
    return 0


if __name__ == "__main__":
    sys.exit(main())
