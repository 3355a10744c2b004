#!/usr/bin/env python3
"""A flexible steel beam falls flat on a rigid stop, off its middle, rebounds and turns.

The underside of the beam is a surface that bends with it; the stop is a point of the ground. Draws falling_beam.png
and prints the impacts, the impulse and the balance of energy.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from common import STEEL, THEIRS, THIRD, Curve, Floats, Panel, draw, parse

import morembs
from morembs.dynamics import multibody as mb
from morembs.fem.grid import box_mesh

SIZE, CELLS = (0.6, 0.04, 0.01), (24, 2, 1)  # m: length, width, height
STOP = 0.2  # m from the left end
DROP = 0.05  # m from the underside to the stop
GRAVITY = (0.0, 0.0, -9.81)
MODES, END, STEP, RHO = 14, 0.16, 2e-5, 0.95
QUICK_END, QUICK_STEP = 0.106, 2e-4


@dataclass(frozen=True, eq=False)
class Fall:
    """The run, its contact, and the beam."""

    result: mb.ContactResult
    contact: mb.Contact
    beam: mb.FlexibleBody


def reduced_beam() -> tuple[morembs.FEModel, morembs.FloatingFrame, Floats]:
    """The beam from its mesh: model, floating frame, and shapes (nodes, 3, n) per elastic coordinate."""
    model = morembs.assemble(box_mesh(SIZE, CELLS), [morembs.isotropic(set="all", **STEEL)])
    x = model.nodes.xyz[:, 0]
    ends = [
        morembs.make_interface(model, name=name, nodes=np.flatnonzero(np.abs(x - at) < 1e-9), coupling="average")
        for name, at in (("left", 0.0), ("right", SIZE[0]))
    ]
    with morembs.Problem(model, ends) as problem:
        reduced = morembs.Modal(modes=MODES).reduce(problem)
        frame = morembs.floating_frame(problem, reduced)
        shapes = np.zeros((len(x), 3, frame.count))
        shapes[model.dofs.node, model.dofs.component] = reduced.V @ frame.elastic
    return model, frame, shapes


def underside(model: morembs.FEModel) -> np.ndarray:
    """(n, 3) rows of nodes on the underside, in a grid along and across the beam."""
    along, across = np.linspace(0, SIZE[0], CELLS[0] // 2 + 1), np.linspace(0, SIZE[1], 3)
    grid = np.stack(np.meshgrid(along, across, [0.0], indexing="ij"), axis=-1)[:, :, 0]
    return np.abs(grid[:, :, None] - model.nodes.xyz).max(axis=-1).argmin(axis=2)


def run(*, end: float = END, step: float = STEP) -> Fall:
    """The fall: the stop is the point of contact, the underside is the surface."""
    model, frame, shapes = reduced_beam()
    system = mb.System(gravity=GRAVITY)
    start = frame.origin + np.array([0, -SIZE[1] / 2, DROP])
    beam = system.add(mb.FlexibleBody(frame, position=start, name="beam"))
    rows, local = underside(model), model.nodes.xyz - frame.origin
    vertices = [beam.marker_at(local[i], shapes[i]) for i in rows.ravel()]
    skin = mb.GridSurface(local[rows], flip=True, name="underside")
    on = beam.marker_at(np.zeros(3), np.zeros((3, frame.count)))
    stop = mb.ground.marker_at((STOP, 0, 0), name="stop")
    contact = mb.Contact([stop], skin, on=on, vertices=vertices, name="stop")
    return Fall(mb.simulate_contact(system, [contact], end=end, step=step, rho=RHO), contact, beam)


def picture(path: Path, fall: Fall) -> None:
    """Heights of both ends, force and gap at the stop, energies."""
    result, t = fall.result, 1e3 * fall.result.time
    left, right = (1e3 * (result.position(fall.beam.marker(end))[:, 2] - SIZE[2] / 2) for end in ("left", "right"))
    gap, force, energy = 1e3 * result.gap(fall.contact)[:, 0], result.force(fall.contact)[:, 0], result.balance()
    first, last = (1e3 * result.impacts[k].time for k in (0, -1))
    shown = (t >= first - 0.5) & (t <= last + 2)
    draw(
        path,
        "Flexible beam on a rigid stop",
        [
            Panel(
                "Height of the ends over the stop",
                "time, ms",
                "mm",
                [
                    Curve(t, left, "left end"),
                    Curve(t, right, "right end", THEIRS),
                    Curve(t, gap, "gap at the stop", THIRD),
                ],
            ),
            Panel("Force of the stop, after the first touch", "time, ms", "N", [Curve(t[shown] - first, force[shown])]),
            Panel(
                "Energy",
                "time, ms",
                "J",
                [
                    Curve(t, energy.total - energy.potential[0], "kinetic and potential"),
                    Curve(t, energy.total - energy.work - energy.potential[0], "with losses of impacts", THEIRS, "--"),
                ],
            ),
        ],
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Draws the picture, prints the figures. Returns the exit code."""
    options = parse(arguments, "A flexible beam falls on a rigid stop.", __file__)
    fall = run(end=QUICK_END, step=QUICK_STEP) if options.quick else run()
    result, energy, n = fall.result, fall.result.balance(), fall.beam.frame.count
    lost = np.abs(energy.total - energy.work - energy.total[0]).max() / (energy.potential[0] - energy.potential.min())
    print(f"beam of {n} elastic coordinates, {len(result.time)} time points, {len(result.impacts)} impacts")
    print(f"first touch at t = {result.impacts[0].time:.6f} s (fall: {np.sqrt(2 * DROP / 9.81):.6f} s)")
    print(f"largest force {result.force(fall.contact).max():.4g} N between impacts")
    print(f"complementarity {result.complementarity:.2g}, balance of energy {lost:.2g} of the fall")
    picture(options.folder / "falling_beam.png", fall)
    return 0


if __name__ == "__main__":
    sys.exit(main())
