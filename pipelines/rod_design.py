#!/usr/bin/env python3
"""A connecting rod in its mechanism: what stress, force and frequency owe to thickness, moduli and density.

Derivatives of the largest stress and force in a slider-crank from one run, against central differences of whole runs;
then one step towards less stress at no more mass and no lower frequency. Draws rod_design.png.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from common import THEIRS, Curve, Floats, Panel, draw, parse
from design_study import MESH, prepare
from scipy.linalg import qr
from scipy.optimize import linprog

import morembs
from morembs.app.jobs.stages.model import materials_of
from morembs.app.jobs.stages.parameters import build_varied_model
from morembs.app.jobs.tables import Job
from morembs.body.floating.parametric import frame_terms
from morembs.dynamics import multibody as mb
from morembs.fem.stress_operator import stress_operator, von_mises, von_mises_slope
from morembs.parametric.model import parametric_model
from morembs.parametric.terms import AffineProblem
from morembs.problem.damping import Damping

CRANK, SPEED, SLIDER, FORCE, TRUST = 0.04, 250.0, 0.6, 12e3, 0.25  # m, rad/s, kg, N, part of the box in one step
TURN, ENDS = 2 * np.pi / SPEED, ("BIGEND", "SMALLEND")


class Rod:
    """The rod of design_study.toml for all values, in one basis of modes and static responses at some of them."""

    def __init__(self, job: Job, steps: int) -> None:
        mesh = morembs.read_mesh(MESH, "mm-t-s")
        self.varied, x = build_varied_model(job, mesh, materials_of(job)), mesh.nodes.xyz[:, 0]
        self.box, self.shank = self.varied.box, np.flatnonzero((x > 0.05) & (x < 0.125))
        self.ranges, self.steps = np.diag(self.box.high - self.box.low), steps
        nominal = self.varied.model(self.box.nominal)
        ends = [morembs.make_interface(nominal, name=name, nodes=mesh.nodes.sets[name]) for name in ENDS]
        self.chord = ends[1].point - ends[0].point
        self.frame = {"kind": "chord", "interfaces": ENDS, "origin": ends[0].point}
        with AffineProblem(self.varied, ends, damping=Damping(beta=5e-6)) as problem:
            columns = [problem.rigid_terms.reshape(problem.K.shape[0], -1)]
            for t in (-0.2, 0.0, 0.2):
                with problem.at(self.box.point({"t": t})) as there:
                    columns += [there.elastic_modes(count=4).vectors, there.free_free.flexibility(there.B.toarray())]
            X = np.hstack(columns)
            Q, R, _ = qr(X / np.maximum(np.linalg.norm(X, axis=0), 1e-300), mode="economic", pivoting=True)
            V = Q[:, np.abs(np.diag(R)) > 1e-9]
            self.model, self.terms = parametric_model(problem, V), frame_terms(problem, V)
            self.shapes = problem.coupling.T @ V

    def stress(self, p: Floats, Y: Floats, nodes: Floats) -> Floats:
        """(6 points, n): stresses at nodes of the model at ``p``, in the frame of the shapes ``Y``."""
        elastic = self.terms.frame(self.model.at(p), shapes=Y, **self.frame).elastic
        return stress_operator(self.varied.model(p), nodes).stress(self.shapes @ elastic)

    def run(self, p: Floats, sensitivities: bool) -> tuple[mb.Result, mb.FlexibleBody, mb.Constraint]:
        """One turn from the inner dead centre."""
        at, axle, far, fast = self.model.at(p), mb.ground.marker_at(), self.chord - [CRANK, 0, 0], SPEED * CRANK
        slopes = self.terms.derivatives(at, **self.frame) if sensitivities else None
        spin, system, motion = fast / self.chord[0], mb.System(), mb.Motion.steady(SPEED)
        crank = system.add(
            mb.RigidBody(
                2.0,
                (1e-3, 1e-3, 2e-3),
                name="crank",
                angular_velocity=(0, 0, SPEED),
                markers={"axle": (0, 0, 0), "pin": (-CRANK, 0, 0)},
            )
        )
        rod = system.add(
            mb.FlexibleBody(
                self.terms.frame(at, **self.frame),
                name="rod",
                derivatives=slopes,
                position=(-CRANK, 0, 0),
                velocity=(0, -fast, 0),
                angular_velocity=(0, 0, spin),
            )
        )
        slider = system.add(
            mb.RigidBody(
                SLIDER,
                (1e-4, 1e-4, 1e-4),
                position=far,
                markers={"pin": (0, 0, 0)},
                velocity=(-spin * self.chord[1], 0, 0),
                name="slider",
            )
        )
        system.add(mb.RevoluteJoint(axle, crank.marker("axle")))
        system.add(mb.DrivenAngle(axle, crank.marker("axle"), motion=motion))
        pin = system.add(mb.RevoluteJoint(crank.marker("pin"), rod.marker("BIGEND")))
        system.add(mb.SphericalJoint(rod.marker("SMALLEND"), slider.marker("pin")))
        system.add(mb.PrismaticJoint(mb.ground.marker_at(far), slider.marker("pin"), axis=(1, 0, 0)))
        system.add(mb.PointLoad(slider.marker("pin"), force=lambda t: (-FORCE * max(-np.cos(SPEED * t), 0) ** 4, 0, 0)))
        return mb.simulate(system, end=TURN, step=TURN / self.steps, sensitivities=sensitivities), rod, pin

    def goals(self, p: Floats) -> tuple[Floats, Floats]:
        """Largest stress, largest force, first frequency; and von Mises stress (steps, nodes) of the shank."""
        (result, rod, pin), at = self.run(p, False), self.model.at(p)
        stress = von_mises(result.stress(rod, self.stress(p, at.Y[:, 6:], self.shank)))
        force = np.linalg.norm(result.reaction(pin)[:, :3], axis=1)
        return np.array([stress.max(), force.max(), at.frequencies_hz[0]]), stress

    def slopes(self, p: Floats, stress: Floats) -> Floats:
        """(3, P): derivatives of the goals over the box; where and when the largest come is known."""
        (result, rod, pin), at, columns = self.run(p, True), self.model.at(p), []
        when, where = np.unravel_index(stress.argmax(), stress.shape)
        force, node, Y = result.reaction(pin)[:, :3], self.shank[where : where + 1], at.Y[:, 6:]
        late, S = np.linalg.norm(force, axis=1).argmax(), self.stress(p, Y, node)
        for (name, df), step in zip(at.sensitivity(1).frequencies_hz.items(), 1e-3 * self.ranges, strict=True):
            slope, width = result.sensitivity(f"rod.{name}"), 1e3 * step.sum()
            dS = (self.stress(p + step, Y, node) - self.stress(p - step, Y, node)) / (2 * step.sum())
            by_stress = von_mises_slope(result.stress(rod, S), slope.stress(rod, S, dS))[when, 0]
            by_force = force[late] @ slope.reaction(pin)[late, :3] / np.linalg.norm(force[late])
            columns.append([width * by_stress, width * by_force, width * df[0]])
        return np.array(columns).T


def main(arguments: Sequence[str] | None = None) -> int:
    options = parse(arguments, __doc__, __file__)
    rod = Rod(prepare(options.folder), 120 if options.quick else 600)
    p, names = rod.box.nominal, rod.box.names
    goals, stress = rod.goals(p)
    slopes = rod.slopes(p, stress)
    print(f"stress {goals[0] / 1e6:.3f} MPa, force {goals[1]:.2f} N, frequency {goals[2]:.3f} Hz")
    print("slope over the range of each parameter, and its relative gap to central differences of whole runs:")
    for j, step in enumerate(2e-3 * rod.ranges):
        by = (rod.goals(p + step)[0] - rod.goals(p - step)[0]) / 4e-3
        each = zip(slopes[:, j] / [1e6, 1, 1], np.abs(slopes[:, j] / by - 1), ("MPa", "N", "Hz"), strict=True)
        print(f"{names[j]:8}" + "".join(f"{value:12.4f} {unit} {gap:.1e}" for value, gap, unit in each))
    mass = rod.ranges @ rod.model.law_M.derivative(p).T @ rod.terms.mass
    move = linprog(slopes[0], A_ub=[mass, -slopes[2]], b_ub=[0, 0], bounds=(-TRUST, TRUST)).x
    better, changed = rod.goals(p + move @ rod.ranges)
    print(
        "one step over the box: " + ", ".join(f"{n} {m:+.3f}" for n, m in zip(names, move, strict=True)),
        f"\nits stress: {(goals[0] + slopes[0] @ move) / 1e6:.3f} MPa expected, {better[0] / 1e6:.3f} MPa in the run",
    )
    curves = [
        Curve(np.linspace(0, 1, len(values)), values.max(axis=1) / 1e6, *look)
        for values, *look in ((stress, "nominal"), (changed, "after one step", THEIRS))
    ]
    panel = Panel("Largest stress of the shank", "turns of the crank", "MPa", curves)
    draw(options.folder / "rod_design.png", "A connecting rod before and after one step of its design", [panel])
    return 0


if __name__ == "__main__":
    sys.exit(main())
