#!/usr/bin/env python3
"""A connecting rod in its mechanism: what stress, force and frequency owe to thickness, moduli and density.

The rod of design_study.toml, with moduli of two halves, density and depth of the shank, in a slider-crank under the
force of a cylinder. One run with sensitivities gives the derivatives of the largest stress of the shank and of the
largest force at the crank pin; central differences of whole runs confirm them. Then one step towards less stress at no
more mass and no lower frequency (Tromme, Bruels, Emonds-Alt et al. 2013). Draws rod_design.png.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from common import THEIRS, Curve, Floats, Panel, draw, parse
from design_study import MESH, prepare
from scipy.optimize import linprog

import morembs
from morembs import multibody as mb
from morembs.floating.parametric import frame_terms
from morembs.jobs.inputs import materials_of
from morembs.jobs.job import Job
from morembs.jobs.parameters import varied_of
from morembs.model.stress_operator import stress_operator, von_mises
from morembs.parametric.model import parametric_model
from morembs.parametric.terms import AffineProblem
from morembs.problem.damping import Damping

CRANK, SPEED, SLIDER, FORCE = 0.04, 250.0, 0.6, 12e3  # m, rad/s, kg, N
TURN, AXIS, STEPS = 2 * np.pi / SPEED, (0, 0, 1), 600
TRUST = 0.25  # of the box, for one step of the design


class Rod:
    """The rod for all values of its parameters, in one basis of modes and static responses at some of them."""

    def __init__(self, job: Job) -> None:
        mesh = morembs.read_mesh(MESH, "mm-t-s")
        self.varied, x = varied_of(job, mesh, materials_of(job)), mesh.nodes.xyz[:, 0]
        self.box, self.shank = self.varied.box, np.flatnonzero((x > 0.05) & (x < 0.125))
        ends = [morembs.make_interface(self.varied.model(self.box.nominal), name=name, nodes=mesh.nodes.sets[nodes])
                for name, nodes in (("crank_pin", "BIGEND"), ("wrist_pin", "SMALLEND"))]  # fmt: skip
        self.chord = ends[1].point - ends[0].point
        self.frame = {"kind": "chord", "interfaces": ("crank_pin", "wrist_pin"), "origin": ends[0].point}
        with AffineProblem(self.varied, ends, damping=Damping(beta=5e-6)) as problem:
            columns = [problem.rigid_terms.reshape(problem.K.shape[0], -1)]
            for thicker in (-0.2, 0.0, 0.2):
                with problem.at(self.box.point({"t": thicker})) as there:
                    columns += [there.elastic_modes(count=4).vectors, there.elastic.flexibility(there.B.toarray())]
            X = np.hstack(columns)
            X = X[:, X.any(axis=0)]
            Q, R = np.linalg.qr(X / np.linalg.norm(X, axis=0))
            V = Q[:, np.abs(np.diag(R)) > 1e-7]
            self.model, self.terms = parametric_model(problem, V), frame_terms(problem, V)
            self.shapes = problem.coupling.T @ V

    def stress(self, p: Floats, Y: Floats, nodes: Floats) -> Floats:
        """(6 points, n): stress at nodes of the model at ``p`` for the frame of shapes ``Y``."""
        elastic = self.terms.frame(self.model.at(p), shapes=Y, **self.frame).elastic
        return stress_operator(self.varied.model(p), nodes).stress(self.shapes @ elastic)

    def run(self, p: Floats, steps: int, names: Sequence[str] = ()) -> tuple[mb.Result, mb.FlexibleBody, mb.Constraint]:
        """One turn from the dead centre at the crank, and its sensitivities."""
        at, axle = self.model.at(p), mb.ground.marker_at()
        slopes = self.terms.derivatives(at, **self.frame) if names else None
        turn, far = SPEED * CRANK / self.chord[0], self.chord - [CRANK, 0, 0]
        system = mb.System()
        crank = system.add(mb.RigidBody(
            2.0, (1e-3, 1e-3, 2e-3), name="crank", angular_velocity=(0, 0, SPEED),
            markers={"axle": (0, 0, 0), "pin": (-CRANK, 0, 0)}))
        rod = system.add(mb.FlexibleBody(
            self.terms.frame(at, **self.frame), name="rod", derivatives=slopes, position=(-CRANK, 0, 0),
            velocity=(0, -SPEED * CRANK, 0), angular_velocity=(0, 0, turn)))
        slider = system.add(mb.RigidBody(
            SLIDER, (1e-4, 1e-4, 1e-4), position=far, velocity=(-turn * self.chord[1], 0, 0), name="slider",
            markers={"pin": (0, 0, 0)}))  # fmt: skip
        system.add(mb.RevoluteJoint(axle, crank.marker("axle"), axis=AXIS))
        system.add(mb.DrivenAngle(axle, crank.marker("axle"), axis=AXIS, motion=mb.Motion.steady(SPEED)))
        pin = system.add(mb.RevoluteJoint(crank.marker("pin"), rod.marker("crank_pin"), axis=AXIS))
        system.add(mb.SphericalJoint(rod.marker("wrist_pin"), slider.marker("pin")))
        system.add(mb.PrismaticJoint(mb.ground.marker_at(far), slider.marker("pin"), axis=(1, 0, 0)))
        system.add(mb.PointLoad(slider.marker("pin"), force=lambda t: (-FORCE * max(-np.cos(SPEED * t), 0) ** 4, 0, 0)))
        result = mb.simulate(system, end=TURN, step=TURN / steps, sensitivities=list(names))
        return result, rod, pin

    def goals(self, p: Floats, steps: int) -> tuple[Floats, Floats, tuple[int, int]]:
        """Largest stress, largest force at the crank pin, first frequency; stress over time, its step and node."""
        result, rod, pin = self.run(p, steps)
        S = self.stress(p, self.model.at(p).Y[:, 6:], self.shank)
        stress = von_mises((result.elastic(rod) @ S.T).reshape(len(result.time), -1, 6))
        when, where = np.unravel_index(stress.argmax(), stress.shape)
        force = np.linalg.norm(result.reaction(pin)[:, :3], axis=1).max()
        return np.array([stress.max(), force, self.model.at(p).frequencies_hz[0]]), stress, (int(when), int(where))

    def slopes(self, p: Floats, steps: int, when: int, node: int) -> Floats:
        """(3, P): derivatives of the goals, of which the stress is largest at one step and node."""
        names, at, width = self.box.names, self.model.at(p), self.box.high - self.box.low
        result, rod, pin = self.run(p, steps, [f"rod.{name}" for name in names])
        Y, force, columns = at.Y[:, 6:], result.reaction(pin)[:, :3], []
        S, strongest = self.stress(p, Y, np.array([node])), np.linalg.norm(force, axis=1).argmax()
        for j, (name, df) in enumerate(at.sensitivity(1).frequencies_hz.items()):
            slope, h = result.sensitivity(f"rod.{name}"), 1e-3 * width[j] * np.eye(len(names))[j]
            dS = (self.stress(p + h, Y, np.array([node])) - self.stress(p - h, Y, np.array([node]))) / (2 * h[j])
            tensor, change = S @ result.elastic(rod)[when], slope.stress(rod, S, dS)[when, 0] * 1e-6 * width[j]
            by_stress = (von_mises(tensor + change) - von_mises(tensor - change)) / (2e-6 * width[j])
            by_force = force[strongest] @ slope.reaction(pin)[strongest, :3] / np.linalg.norm(force[strongest])
            columns.append([float(by_stress), float(by_force), float(df[0])])
        return np.array(columns).T


def main(arguments: Sequence[str] | None = None) -> int:
    options = parse(arguments, __doc__, __file__)
    rod, steps = Rod(prepare(options.folder)), 120 if options.quick else STEPS
    p, width, names = rod.box.nominal, rod.box.high - rod.box.low, rod.box.names
    start = time.process_time()
    goals, stress, (when, where) = rod.goals(p, steps)
    once = time.process_time() - start
    slopes = width * rod.slopes(p, steps, when, int(rod.shank[where]))
    cost = (time.process_time() - start - once) / once
    print(f"largest stress {goals[0] / 1e6:.3f} MPa, force {goals[1]:.2f} N, first frequency {goals[2]:.3f} Hz")
    print("derivatives over the box, and what differences of whole runs differ by:")
    for j, name in enumerate(names):
        h = 2e-3 * width * np.eye(len(names))[j]
        by = (rod.goals(p + h, steps)[0] - rod.goals(p - h, steps)[0]) / 4e-3
        gaps = np.abs(slopes[:, j] - by) / np.maximum(np.abs(by), 1e-9 * goals)
        print(f"{name:8} {slopes[0, j] / 1e6:11.5f} MPa {gaps[0]:.1e} {slopes[1, j]:11.4f} N {gaps[1]:.1e} "
              f"{slopes[2, j]:10.4f} Hz {gaps[2]:.1e}")  # fmt: skip
    along = rod.model.rigid[:, 0, 0]
    mass = np.array([along @ dM @ along for dM in rod.model.derivatives(p)[1]]) * width
    room = [(max(-TRUST, (a - x) / w), min(TRUST, (b - x) / w))
            for a, b, x, w in zip(rod.box.low, rod.box.high, p, width, strict=True)]  # fmt: skip
    move = linprog(slopes[0], A_ub=[mass, -slopes[2]], b_ub=[0, 0], bounds=room).x
    better, changed, _ = rod.goals(p + move * width, steps)
    print(f"{len(names)} derivatives took {cost:.2f} of a run and its stresses")
    print(f"a step {', '.join(f'{n} {m:+.3f}' for n, m in zip(names, move, strict=True))} of the box: "
          f"{(goals[0] + slopes[0] @ move) / 1e6:.3f} MPa expected, {better[0] / 1e6:.3f} MPa come")  # fmt: skip
    turns = np.linspace(0, 1, len(stress))
    draw(options.folder / "rod_design.png", "Stress of a connecting rod, and what it owes to its parameters", [
        Panel("Largest stress of the shank", "turns of the crank", "MPa", [
            Curve(turns, stress.max(axis=1) / 1e6, "nominal"),
            Curve(turns, changed.max(axis=1) / 1e6, "after one step", THEIRS)]),
        Panel("Its derivatives over the box", ", ".join(names), "MPa",
              [Curve(np.arange(len(names)), slopes[0] / 1e6, style="o")])])  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
