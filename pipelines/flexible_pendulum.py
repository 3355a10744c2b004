#!/usr/bin/env python3
"""A very flexible rod, pinned at one end, falls from the horizontal: full beam and reduced members.

Draws flexible_pendulum.png: the paths of the tip and its errors over time. Four reduced models: linear shapes in the
frame of the chord, linear shapes with foreshortening of second order, and global modal parameterisation with the
membrane strain of beams or with tangent stiffness matrices alone. The gain of the parameterisation is the one over
foreshortened shapes, which need no nonlinear solves; linear shapes are no rival at such deflections.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from both_simulators import OURS, THEIRS, THIRD, Curve, Floats, Panel, draw, parse

from morembs.errors import MorembsError
from morembs.gmp import Formulation, ReducedMember
from morembs.nonlinear import FullMember, Mechanism, MechanismMotion, Member, PlanarBeam, Section, simulate

LENGTH, A, I, DENSITY, GRAVITY = 0.304, 7.854e-5, 4.909e-10, 2770.0, (0.0, -9.81)  # noqa: E741
ELEMENTS, END, STEP, QUICK_END = 24, 0.5, 5e-4, 0.15
# Ranges (rad) of the tables, at least 1.4 times what the full model does: per Young's modulus and number of members.
REACH = {3e6: {1: 0.83, 2: 0.56}, 1.5e7: {1: 0.26, 2: 0.18}, 1e6: {1: 1.3, 2: 0.75}}
NAMES: dict[Formulation, str] = {
    "linear": "linear shapes", "foreshortened": "foreshortened", "tangent": "GMP, tangent", "membrane": "GMP, membrane",
}  # fmt: skip


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


def table(end: float, moduli: Sequence[float]) -> dict[Case | float, Fall]:
    """Runs and prints all cases; full models are under their Young's modulus."""
    done: dict[Case | float, Fall] = {}
    print("E, Pa    members, modes  model            tip error / length: rms, largest   drift    offline, online s")
    for E in moduli:
        reference = done[E] = full(E, end=end)
        print(f"{E:<8.2g} {1:4d} {'':8} {'all coordinates':17} {'':33}{reference.drift:.1e} {reference.seconds:13.2f}")
        for members, modes in ((1, 3), (2, 2)):
            for formulation, name in NAMES.items():
                case = Case(E=E, members=members, modes=modes, formulation=formulation)
                line = f"{E:<8.2g} {members:4d} {modes:5d}    {name:17}"
                try:
                    one = reduced(case, end=end)
                except MorembsError as problem:
                    print(f"{line} fails: {problem}")
                    continue
                done[case] = one
                gap = error(one, reference)
                print(f"{line}       {rms(gap):8.5f} {gap.max():8.5f}         {one.drift:.1e} "
                      f"{one.offline:6.2f} {one.seconds:6.2f}")  # fmt: skip
                for warning in one.motion.warnings:
                    print(f"         warning: {warning}")
    return done


def panels(done: dict[Case | float, Fall], E: float) -> list[Panel]:
    """Paths of the tip and errors over time for one stiffness."""
    looks: dict[tuple[int, Formulation], tuple[str, str]] = {
        (1, "linear"): ("#9aa5b1", "-"), (1, "foreshortened"): (THIRD, "-"), (1, "membrane"): (OURS, "-"),
        (2, "foreshortened"): (THIRD, "--"), (2, "membrane"): (OURS, "--"),
    }  # fmt: skip
    reference = done[E]
    paths = [Curve(x=reference.tip[:, 0], y=reference.tip[:, 1], label="full model", color=THEIRS, width=3.5)]
    errors = []
    for case, one in done.items():
        if isinstance(case, float) or E != case.E or (case.members, case.formulation) not in looks:
            continue
        color, style = looks[case.members, case.formulation]
        label = f"{NAMES[case.formulation]}, {case.members} member{'s' * (case.members > 1)}"
        if case.members == 1:
            paths.append(Curve(x=one.tip[:, 0], y=one.tip[:, 1], label=label, color=color, width=1.2))
        gap = np.maximum(error(one, reference), 1e-7)
        errors.append(Curve(x=one.motion.times, y=gap, label=label, color=color, style=style, width=1.2))
    return [
        Panel(title=f"Path of the tip, E = {E:g} Pa", x="m", y="m", curves=paths),
        Panel(title="Error of the tip", x="time, s", y="part of the length", curves=errors, logarithmic=True),
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the table and draws the picture. Returns the exit code."""
    options = parse(arguments, "A very flexible pendulum: full beam and reduced members.")
    done = table(QUICK_END if options.quick else END, (3e6,) if options.quick else tuple(REACH))
    options.folder.mkdir(parents=True, exist_ok=True)
    image = options.folder / "flexible_pendulum.png"
    draw(image, "Very flexible pendulum", panels(done, 3e6))
    print(image)
    return 0


if __name__ == "__main__":
    sys.exit(main())
