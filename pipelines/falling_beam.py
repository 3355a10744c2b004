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

from morembs.floating.frame import FloatingFrame, floating_frame
from morembs.interface import make_interface
from morembs.model import FEModel
from morembs.model.assembly import assemble
from morembs.model.grid import box_mesh
from morembs.model.material import isotropic
from morembs.multibody import (
    Contact,
    ContactResult,
    FlexibleBody,
    GridSurface,
    Marker,
    System,
    ground,
    simulate_contact,
)
from morembs.problem import Problem
from morembs.reducers import Modal

SIZE, CELLS = (0.6, 0.04, 0.01), (24, 2, 1)  # m: length, width, height
STOP = 0.2  # m from the left end
DROP = 0.05  # m from the underside to the stop
GRAVITY = (0.0, 0.0, -9.81)
MODES, END, STEP, RHO = 14, 0.16, 2e-5, 0.95
QUICK_END, QUICK_STEP = 0.106, 1e-4


@dataclass(frozen=True, eq=False)
class Fall:
    """The run, its contact, and the markers of both ends."""

    result: ContactResult
    contact: Contact
    ends: tuple[Marker, Marker]
    frame: FloatingFrame


def reduced_beam() -> tuple[FEModel, FloatingFrame, Floats]:
    """The beam from its mesh: model, floating frame, and shapes (nodes, 3, n) per elastic coordinate."""
    model = assemble(box_mesh(SIZE, CELLS), [isotropic(set="all", **STEEL)])
    x = model.nodes.xyz[:, 0]
    ends = [
        make_interface(model, name=name, nodes=np.flatnonzero(np.abs(x - at) < 1e-9), coupling="average")
        for name, at in (("left", 0.0), ("right", SIZE[0]))
    ]
    with Problem(model, ends) as problem:
        reduced = Modal(modes=MODES).reduce(problem)
        frame = floating_frame(problem, reduced)
        shapes = np.zeros((len(x), 3, frame.count))
        shapes[model.dofs.node, model.dofs.component] = reduced.V @ frame.elastic
    return model, frame, shapes


def underside(model: FEModel) -> np.ndarray:
    """(n, 3) rows of nodes on the underside, in a grid along and across the beam."""
    along, across = np.linspace(0, SIZE[0], CELLS[0] // 2 + 1), np.linspace(0, SIZE[1], 3)
    grid = np.stack(np.meshgrid(along, across, [0.0], indexing="ij"), axis=-1)[:, :, 0]
    return np.abs(grid[:, :, None] - model.nodes.xyz).max(axis=-1).argmin(axis=2)


def run(*, end: float = END, step: float = STEP) -> Fall:
    """The fall."""
    model, frame, shapes = reduced_beam()
    system = System(gravity=GRAVITY)
    start = frame.origin + np.array([0, -SIZE[1] / 2, DROP])
    beam = system.add(FlexibleBody(frame, position=start, name="beam"))
    rows = underside(model)
    local = model.nodes.xyz - frame.origin
    vertices = [beam.marker_at(local[i], shapes[i]) for i in rows.ravel()]
    skin = GridSurface(local[rows], flip=True, name="underside")
    on = beam.marker_at(np.zeros(3), np.zeros((3, frame.count)))
    contact = Contact([ground.marker_at((STOP, 0, 0), name="stop")], skin, on=on, vertices=vertices, name="stop")
    result = simulate_contact(system, [contact], end=end, step=step, rho=RHO)
    return Fall(result, contact, (beam.marker("left"), beam.marker("right")), frame)


def picture(path: Path, fall: Fall) -> None:
    """Heights of both ends, force and gap at the stop, energies."""
    result, t = fall.result, 1e3 * fall.result.time
    left, right = (1e3 * (result.position(m)[:, 2] - SIZE[2] / 2) for m in fall.ends)
    gap, force, energy = 1e3 * result.gap(fall.contact)[:, 0], result.force(fall.contact)[:, 0], result.balance()
    first, last = (1e3 * result.impacts[k].time for k in (0, -1))
    shown = (t >= first - 0.5) & (t <= last + 2)
    kept = energy.total - energy.potential[0]
    panels = [
        Panel("Height of the ends over the stop", "time, ms", "mm", [
            Curve(t, left, "left end"), Curve(t, right, "right end", THEIRS), Curve(t, gap, "gap at the stop", THIRD)]),
        Panel("Force of the stop, after the first touch", "time, ms", "N", [Curve(t[shown] - first, force[shown])]),
        Panel("Energy", "time, ms", "J", [
            Curve(t, kept, "kinetic and potential"),
            Curve(t, energy.total - energy.work - energy.potential[0], "with losses of impacts", THEIRS, "--")]),
    ]  # fmt: skip
    draw(path, "Flexible beam on a rigid stop", panels)


def main(arguments: Sequence[str] | None = None) -> int:
    """Draws the picture, prints the figures. Returns the exit code."""
    options = parse(arguments, "A flexible beam falls on a rigid stop.", __file__)
    fall = run(end=QUICK_END, step=QUICK_STEP) if options.quick else run()
    result, energy = fall.result, fall.result.balance()
    lost = np.abs(energy.total - energy.work - energy.total[0]).max() / (energy.potential[0] - energy.potential.min())
    print(f"beam of {fall.frame.count} elastic coordinates, {len(result.time)} moments, {len(result.impacts)} impacts")
    print(f"first touch at t = {result.impacts[0].time:.6f} s (fall: {np.sqrt(2 * DROP / 9.81):.6f} s)")
    print(f"largest force {result.force(fall.contact).max():.4g} N between impacts")
    print(f"complementarity {result.complementarity:.2g}, balance of energy {lost:.2g} of the fall")
    picture(options.folder / "falling_beam.png", fall)
    return 0


if __name__ == "__main__":
    sys.exit(main())
