"""A very flexible pendulum over formulations, members and stiffnesses: full beam and reduced members.

Draws flexible_pendulum_formulations.png: the paths of the tip and its errors over time. Four reduced models: linear
shapes in the frame of the chord, linear shapes with foreshortening of second order, and global modal parameterisation
with the membrane strain of beams or with tangent stiffness matrices alone. The gain of the parameterisation is the one
over foreshortened shapes, which need no nonlinear solves; linear shapes are no rival at such deflections.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from common import OURS, THEIRS, THIRD, Curve, Panel, draw, parse
from flexible_pendulum import ELEMENTS, END, LENGTH, STEP, Fall, fall, rms, rod

from morembs.base.errors import MorembsError
from morembs.dynamics.gmp import Formulation, ReducedMember
from morembs.dynamics.nonlinear import FullMember

# Ranges (rad) of the tables, at least 1.4 times what the full model does: per Young's modulus and number of members.
REACH = {3e6: {1: 0.83, 2: 0.56}, 1.5e7: {1: 0.26, 2: 0.18}, 1e6: {1: 1.3, 2: 0.75}}
NAMES: dict[Formulation, str] = {
    "linear": "linear shapes",
    "foreshortened": "foreshortened",
    "tangent": "GMP, tangent",
    "membrane": "GMP, membrane",
}


@dataclass(frozen=True, kw_only=True)
class Case:
    """``members`` of the same length with ``modes`` bending modes each."""

    E: float
    members: int
    modes: int
    formulation: Formulation


def full(E: float, *, end: float = END, step: float = STEP, elements: int = ELEMENTS) -> Fall:
    """All degrees of freedom."""
    return fall(FullMember(rod(E, elements=elements)), end=end, step=step)


def reduced(case: Case, *, end: float = END, step: float = STEP, elements: int = ELEMENTS) -> Fall:
    """The same mesh, reduced."""
    begin = time.process_time()
    member = ReducedMember(
        rod(case.E, LENGTH / case.members, elements // case.members),
        modes=case.modes,
        formulation=case.formulation,
        reach=REACH[case.E][case.members],
        points_per_angle=9,
    )
    return fall(member, case.members, end=end, step=step, offline=time.process_time() - begin)


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
                    run = reduced(case, end=end)
                except MorembsError as problem:
                    print(f"{line} fails: {problem}")
                    continue
                done[case] = run
                gap = run.error(reference)
                print(
                    f"{line}       {rms(gap):8.5f} {gap.max():8.5f}         {run.drift:.1e} "
                    f"{run.offline:6.2f} {run.seconds:6.2f}"
                )
                for warning in run.motion.warnings:
                    print(f"         warning: {warning}")
    return done


def panels(done: dict[Case | float, Fall], E: float) -> list[Panel]:
    """Paths of the tip and errors over time for one stiffness."""
    looks: dict[tuple[int, Formulation], tuple[str, str]] = {
        (1, "linear"): ("#9aa5b1", "-"),
        (1, "foreshortened"): (THIRD, "-"),
        (1, "membrane"): (OURS, "-"),
        (2, "foreshortened"): (THIRD, "--"),
        (2, "membrane"): (OURS, "--"),
    }
    reference = done[E]
    paths = [Curve(x=reference.tip[:, 0], y=reference.tip[:, 1], label="full model", color=THEIRS, width=3.5)]
    errors = []
    for case, run in done.items():
        if isinstance(case, float) or E != case.E or (case.members, case.formulation) not in looks:
            continue
        color, style = looks[case.members, case.formulation]
        label = f"{NAMES[case.formulation]}, {case.members} member{'s' * (case.members > 1)}"
        if case.members == 1:
            paths.append(Curve(x=run.tip[:, 0], y=run.tip[:, 1], label=label, color=color, width=1.2))
        gap = np.maximum(run.error(reference), 1e-7)
        errors.append(Curve(x=run.motion.times, y=gap, label=label, color=color, style=style, width=1.2))
    return [
        Panel(title=f"Path of the tip, E = {E:g} Pa", x="m", y="m", curves=paths),
        Panel(title="Error of the tip", x="time, s", y="part of the length", curves=errors, logarithmic=True),
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the table and draws the picture. Returns the exit code."""
    options = parse(arguments, "A very flexible pendulum: full beam and reduced members.", __file__)
    done = table(0.05, (3e6,)) if options.quick else table(END, tuple(REACH))
    draw(options.folder / "flexible_pendulum_formulations.png", "Very flexible pendulum", panels(done, 3e6))
    return 0


if __name__ == "__main__":
    sys.exit(main())
