#!/usr/bin/env python3
"""Three elastic links under a rigid bar: how a load is shared where joints are redundant (Wojtyra, EUROMECH 524).

With rigid links the reactions are not determined; with elastic ones they are those of three springs. The equilibrium is
found at once, and is not stable: the load stands on hinged links. Draws parallelogram.png.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from common import THEIRS, Curve, Floats, Panel, draw, parse

import morembs
from morembs.dynamics.multibody import (
    Equilibrium,
    FlexibleBody,
    PointLoad,
    RevoluteJoint,
    RigidBody,
    System,
    equilibrium,
    ground,
    rotation,
)

MESH = Path(__file__).resolve().parents[1] / "data" / "small_meshes" / "beam.msh"
PLACES, LOAD = (0.0, 0.5, 1.0), 1000.0  # m, N
YOUNG, DENSITY = 2e9, 1200.0
LENGTH = 0.5


def link(young: float) -> morembs.FloatingFrame:
    """A link along x in its floating frame, with two modes."""
    mesh = morembs.read_mesh(MESH)
    model = morembs.assemble(mesh, [morembs.isotropic(set="all", young=young, poisson=0.3, density=DENSITY)])
    ends = [morembs.make_interface(model, name=name, nodes=mesh.nodes.sets[name]) for name in ("ROOT", "TIP")]
    with morembs.Problem(model, ends) as problem:
        reduced = morembs.CraigBampton(modes=2).reduce(problem)
        return morembs.floating_frame(problem, reduced)


def on_springs(stiffness: Sequence[float]) -> Floats:
    """Forces (3,) of springs below a rigid bar that is loaded above the first."""
    k, x = np.array(stiffness), np.array(PLACES)
    sums = np.array([[k.sum(), k @ x], [k @ x, k @ x**2]])
    sinking, turning = np.linalg.solve(sums, [LOAD, LOAD * PLACES[0]])
    return np.asarray(k * (sinking + turning * x))


def stand(links: Sequence[morembs.FloatingFrame | None]) -> tuple[Equilibrium, Floats]:
    """The equilibrium, and the vertical forces (3,) of the ground on the links, of which None is a rigid one."""
    system, up = System(), rotation((0, 1, 0), -math.pi / 2)
    markers = {f"joint {i}": (x - 0.5, 0, 0) for i, x in enumerate(PLACES)}
    bar = system.add(RigidBody(2.0, (0.01, 0.2, 0.2), position=(0.5, 0, LENGTH), markers=markers, name="bar"))
    joints = []
    for i, (x, frame) in enumerate(zip(PLACES, links, strict=True)):
        foot = np.array([x, 0.0, 0.0])
        if frame is None:
            at, ends = (x, 0.0, LENGTH / 2), {"ROOT": (0, 0, -LENGTH / 2), "TIP": (0, 0, LENGTH / 2)}
            body = system.add(RigidBody(0.9, (0.02, 0.02, 1e-4), position=at, markers=ends, name=f"link {i}"))
        else:
            at = foot - up @ frame.markers["ROOT"].point
            body = system.add(FlexibleBody(frame, name=f"link {i}", rotation=up, position=at))
        joints.append(system.add(RevoluteJoint(ground.marker_at(foot), body.marker("ROOT"), axis=(0, 1, 0))))
        system.add(RevoluteJoint(body.marker("TIP"), bar.marker(f"joint {i}"), axis=(0, 1, 0)))
    system.add(PointLoad(bar.marker("joint 0"), force=(0, 0, -LOAD)))
    still = equilibrium(system)
    return still, np.array([still.result.reaction(joint)[0, 2] for joint in joints])


def main(arguments: Sequence[str] | None = None) -> int:
    options = parse(arguments, __doc__, __file__)
    stiff, soft = link(YOUNG), link(YOUNG / 10)
    ratios = np.geomspace(0.1, 1.0, 3 if options.quick else 9)
    print("soft link   reactions in N                        springs, largest gap   grows by")
    for which in range(3):
        still, forces = stand([soft if i == which else stiff for i in range(3)])
        gap = np.abs(forces - on_springs([0.1 if i == which else 1.0 for i in range(3)])).max()
        words = "  ".join(f"{force:10.4f}" for force in forces)
        print(f"{which + 1:9d}   {words}   {gap:.1e} N              {still.linear.growth:.3f} /s")
    print("rigid links   what is said")
    for count in (3, 2, 1):
        try:
            forces = stand([None] * count + [stiff] * (3 - count))[1]
            print(f"{count:11d}   {'  '.join(f'{force:.3f}' for force in forces)} N")
        except morembs.MorembsError as error:
            print(f"{count:11d}   {error}")
    shares = np.array([stand([stiff, stiff, link(ratio * YOUNG)])[1] for ratio in ratios])
    exact = np.array([on_springs([1.0, 1.0, ratio]) for ratio in ratios])
    curves = [Curve(ratios, shares[:, i], f"link {i + 1}", f"C{i}") for i in range(3)]
    curves += [Curve(ratios, exact[:, i], "" if i else "springs", THEIRS, "o") for i in range(3)]
    panel = Panel("Share of the load", "stiffness of the third link, part of that of the others", "N", curves)
    draw(options.folder / "parallelogram.png", "Three elastic links under a rigid bar", [panel])
    return 0


if __name__ == "__main__":
    sys.exit(main())
