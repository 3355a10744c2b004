#!/usr/bin/env python3
"""Eight balls of a bearing: the stiffness of one from a finite-element surface, and how they share a load (Zeischka).

A quarter of a ball is pressed into a steel block; the table of forces that comes out meets Hertz (1882) and goes into a
mechanism, whose equilibrium shares a radial load as Stribeck (1907) says. Draws bearing.png.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

import numpy as np
from common import OURS, STEEL, THEIRS, Curve, Floats, Panel, draw, parse

import morembs
from morembs.dynamics.multibody import (
    ContactElement,
    ContactTable,
    PointLoad,
    PowerLaw,
    PrismaticJoint,
    RigidBody,
    Sphere,
    System,
    contact_table,
    equilibrium,
    ground,
)
from morembs.fem import DofMap, FEModel
from morembs.fem.grid import grid_mesh

RADIUS, BLOCK, BALLS = 0.01, 0.012, 8  # m, m
YOUNG, POISSON = STEEL["young"], STEEL["poisson"]
HERTZ = PowerLaw(4 / 3 * YOUNG / (1 - POISSON**2) * math.sqrt(RADIUS))
# The block ends at its side: from there on a half space would yield by that much under a load on a point.
BEYOND = (1 + POISSON) * (3 - 2 * POISSON) / (2 * math.pi * YOUNG * BLOCK)  # m/N


def quarter(cell: float, cells: int, growth: float) -> FEModel:
    """A quarter of the block below the ball: planes of symmetry at x = 0 and y = 0, held below."""
    sizes = [cell] * cells
    while sum(sizes) < BLOCK:
        sizes.append(min(growth * sizes[-1], BLOCK - sum(sizes)))
    x = np.cumsum([0.0, *sizes])
    grid = np.stack(np.meshgrid(x, x, -x[::-1], indexing="ij"), axis=-1)
    model = morembs.assemble(grid_mesh(grid, "hex8"), [morembs.isotropic(set="all", **STEEL)])
    at, component = model.nodes.xyz[model.dofs.node], model.dofs.component
    on_plane = at[np.arange(len(at)), component] == 0
    free = np.flatnonzero(~((component < 2) & on_plane | np.isclose(at[:, 2], -BLOCK)))
    return FEModel(
        K=model.K[free][:, free],
        M=model.M[free][:, free],
        nodes=model.nodes,
        mesh=model.mesh,
        dofs=DofMap(node=model.dofs.node[free], component=component[free]),
    )


def pressed(cell: float, cells: int, growth: float, depth: Floats) -> ContactTable:
    """Force of the whole ball on a half space by its penetration."""
    patch = 1.01 * cell * cells
    with morembs.Problem(quarter(cell, cells, growth)) as problem:
        table = contact_table(
            problem,
            Sphere((0, 0, RADIUS), RADIUS),
            surface=f"box:0,0,-1e-9,{patch},{patch},1e-9",
            penetration=depth.tolist(),
            push=(0, 0, -1),
        )
    return ContactTable(depth, 4 * np.asarray(table.forces)).without(-BEYOND)


def loaded(table: ContactTable, load: float) -> tuple[float, Floats]:
    """How far the shaft moves under a radial load, and the forces of the balls."""
    system, still = System(), (np.zeros(6), np.zeros(6))
    # A first guess: contacts without penetration have no stiffness yet.
    shaft = system.add(RigidBody(1.0, (1, 1, 1), position=(5e-6, 0, 0), markers={"centre": (0, 0, 0)}))
    centre, ring = shaft.marker("centre"), ground.marker_at((0, 0, 0))
    system.add(PrismaticJoint(ring, centre, axis=(1, 0, 0)))
    balls = [
        system.add(
            ContactElement(centre, ring, stiffness=table, direction=(-math.cos(a), -math.sin(a), 0), name=f"{a:g}")
        )
        for a in 2 * np.pi * np.arange(BALLS) / BALLS
    ]
    system.add(PointLoad(centre, force=(load, 0, 0)))
    state = equilibrium(system).state
    places = [[state.assembly.place(m, state.x) for m in ball.markers] for ball in balls]
    forces = np.array([ball.force(0.0, at, still) for ball, at in zip(balls, places, strict=True)])
    return float(places[0][0].position[0]), forces


def main(arguments: Sequence[str] | None = None) -> int:
    options = parse(arguments, __doc__, __file__)
    mesh = (8e-5, 7, 1.6) if options.quick else (5e-5, 12, 1.45)
    depth = np.array([1.4e-5, 1.6e-5, 1.8e-5, 2.2e-5]) if options.quick else np.linspace(6e-6, 2.2e-5, 9)
    table = pressed(*mesh, depth)
    at, force = np.asarray(table.penetration), np.asarray(table.forces)
    ratio = force / np.array([HERTZ.force(d) for d in at])
    print("penetration, um   force, N   over Hertz")
    for row in zip(1e6 * at, force, ratio, strict=True):
        print("{:15.2f}   {:8.1f}   {:.4f}".format(*row))
    largest = float(1.8 * force[-1])
    loads = np.linspace(0.1, 1.0, 4 if options.quick else 10) * largest
    moved, shares = zip(*(loaded(table, load) for load in loads), strict=True)
    print(f"largest ball carries {shares[-1].max() / largest:.4f} of {largest:.0f} N; Stribeck: {4.37 / BALLS:.4f}")
    curve = np.linspace(0, at[-1], 50)
    panels = [
        Panel(
            "A ball on a steel block",
            "penetration, um",
            "N",
            [
                Curve(1e6 * curve, np.array([table.force(d) for d in curve]), "table", OURS),
                Curve(1e6 * at, np.array([HERTZ.force(d) for d in at]), "Hertz", THEIRS, "o"),
            ],
        ),
        Panel(
            "Balls under a radial load",
            "load, N",
            "N",
            [Curve(loads, np.array(shares)[:, k], f"{360 * k // BALLS} degrees", f"C{k}") for k in range(3)],
        ),
        Panel("Displacement of the shaft", "load, N", "um", [Curve(loads, 1e6 * np.array(moved))]),
    ]
    draw(options.folder / "bearing.png", "A bearing with eight balls", panels)
    return 0


if __name__ == "__main__":
    sys.exit(main())
