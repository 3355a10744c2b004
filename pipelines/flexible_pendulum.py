#!/usr/bin/env python3
"""A very flexible rod, pinned at one end, falls from the horizontal: full beam and reduced member.

The member is reduced by global modal parameterisation to its end frames and three amplitudes. Draws
flexible_pendulum.png: the paths of the tip and its errors over time. Other formulations, members and stiffnesses:
python -m studies.flexible_pendulum
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from common import THEIRS, Curve, Floats, Panel, draw, parse

from morembs.gmp import Formulation, ReducedMember
from morembs.nonlinear import FullMember, Mechanism, MechanismMotion, Member, PlanarBeam, Section, simulate

LENGTH, A, I, DENSITY, GRAVITY = 0.304, 7.854e-5, 4.909e-10, 2770.0, (0.0, -9.81)  # noqa: E741
ELEMENTS, END, STEP, QUICK_END = 24, 0.5, 5e-4, 0.15
# Ranges (rad) of the tables, at least 1.4 times what the full model does: per Young's modulus and number of members.
REACH = {3e6: {1: 0.83, 2: 0.56}, 1.5e7: {1: 0.26, 2: 0.18}, 1e6: {1: 1.3, 2: 0.75}}


@dataclass(frozen=True, kw_only=True)
class Case:
    """``members`` of the same length with ``modes`` bending modes each."""

    E: float
    members: int
    modes: int
    formulation: Formulation


@dataclass(frozen=True, kw_only=True, eq=False)
class Fall:
    """A run: motion, path of the tip (T, 2) m and the time in s that it took; offline: the making of the member."""

    motion: MechanismMotion
    tip: Floats
    seconds: float
    offline: float = 0.0

    @property
    def drift(self) -> float:
        """Largest change of the energy per largest kinetic energy."""
        energy = self.motion.kinetic + self.motion.potential
        return float(np.abs(energy - energy[0]).max() / self.motion.kinetic.max())


def rod(E: float, length: float, elements: int) -> PlanarBeam:
    """A part of the rod."""
    return PlanarBeam.straight(length, elements, Section.of(E=E, A=A, I=I, density=DENSITY))


def fall(member: Member, count: int, *, end: float, step: float, offline: float = 0.0) -> Fall:
    """``count`` equal members in a row; a member that leaves its tables goes on, which its motion then says."""
    mechanism = Mechanism(gravity=GRAVITY)
    points = [mechanism.point((LENGTH * k / count, 0), fixed="" if k else "xy") for k in range(count + 1)]
    angles = [mechanism.angle(0.0) for _ in points]
    for k in range(count):
        mechanism.add(member, points[k], points[k + 1], start=angles[k], end=angles[k + 1])
    begin = time.process_time()
    motion = simulate(mechanism, end=end, step=step, outside="continue")
    seconds = time.process_time() - begin
    return Fall(motion=motion, tip=motion.q[:, points[-1].numbers], seconds=seconds, offline=offline)


def full(E: float, *, end: float = END, step: float = STEP, elements: int = ELEMENTS) -> Fall:
    """All degrees of freedom."""
    return fall(FullMember(rod(E, LENGTH, elements)), 1, end=end, step=step)


def reduced(case: Case, *, end: float = END, step: float = STEP, elements: int = ELEMENTS) -> Fall:
    """The same mesh, reduced."""
    begin = time.process_time()
    member = ReducedMember(
        rod(case.E, LENGTH / case.members, elements // case.members), modes=case.modes,
        formulation=case.formulation, reach=REACH[case.E][case.members], points_per_angle=9,
    )  # fmt: skip
    return fall(member, case.members, end=end, step=step, offline=time.process_time() - begin)


def error(one: Fall, reference: Fall) -> Floats:
    """Distance (T,) of the tips, per length of the rod."""
    return np.linalg.norm(one.tip - reference.tip, axis=1) / LENGTH


def rms(values: Floats) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs both, prints the figures and draws the picture. Returns the exit code."""
    options = parse(arguments, "A very flexible pendulum: full beam and reduced member.", __file__)
    end, case = QUICK_END if options.quick else END, Case(E=3e6, members=1, modes=3, formulation="membrane")
    whole, member = full(case.E, end=end), reduced(case, end=end)
    gap = error(member, whole)
    print(f"tip at t = {end:g} s: ({member.tip[-1, 0]:.5f}, {member.tip[-1, 1]:.5f}) m, all coordinates "
          f"({whole.tip[-1, 0]:.5f}, {whole.tip[-1, 1]:.5f}) m; error / length {rms(gap):.5f} rms, {gap.max():.5f} at "
          f"most")  # fmt: skip
    print(f"drift of the energy {member.drift:.1e}; {member.offline:.2f} s offline, {member.seconds:.2f} s online, "
          f"all coordinates {whole.seconds:.2f} s")  # fmt: skip
    paths = [Curve(whole.tip[:, 0], whole.tip[:, 1], "all coordinates", THEIRS, width=3.5),
             Curve(member.tip[:, 0], member.tip[:, 1], "GMP, 3 modes", width=1.2)]  # fmt: skip
    draw(options.folder / "flexible_pendulum.png", "Very flexible pendulum", [
        Panel(f"Path of the tip, E = {case.E:g} Pa", "m", "m", paths),
        Panel("Error of the tip", "time, s", "part of the length",
              [Curve(member.motion.times, np.maximum(gap, 1e-7))], logarithmic=True),
    ])  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
