"""A slider-crank with a rod that bends by an eighth of its length: all degrees of freedom, and three reductions.

Draws flexible_slider_crank.png: deflection of the middle of the rod and its errors. Models: full (240 exact beam
elements; on a coarser mesh checked against those of Exudyn), linear component modes in the frame of the chord, the
same with foreshortening of second order, and global modal parameterisation; at nominal and 100 times the stiffness.
No gravity; the slider has 0.01 kg. Times are those of this package; compiled codes are faster with all models.
"""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from common import OURS, THEIRS, THIRD, Curve, ExudynBeams, Floats, Panel, draw, parse

from morembs.dynamics.gmp import Formulation, ReducedMember
from morembs.dynamics.nonlinear import FullMember, Mechanism, MechanismMotion, Member, PlanarBeam, Section, simulate
from morembs.exporters.exudyn_system import exudyn_missing

CRANK, ROD, A, I, DENSITY, SLIDER = 0.152, 0.304, 7.854e-5, 4.909e-10, 2770.0, 0.01  # noqa: E741
E_CRANK, E_ROD = 2e7, 2e6  # Pa, nominal
ELEMENTS, END, STEP = (80, 160), 1.0, 1e-3
CHECKED = (16, 32)
QUICK_ELEMENTS, QUICK_END = (6, 12), 0.1
REACH_CRANK, REACH_ROD, POINTS = 0.3, 0.7, 7
# Formulation, modes of crank and rod.
MODELS: dict[str, tuple[Formulation, tuple[int, int]]] = {
    "linear, 10 modes": ("linear", (10, 10)),
    "foreshortened": ("foreshortened", (2, 3)),
    "GMP": ("membrane", (2, 3)),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """Slider (T,) m and deflection (T,) m of the middle of the rod across its chord, and times in s."""

    time: Floats
    slider: Floats
    deflection: Floats
    coordinates: int
    step: float
    offline: float = 0.0
    motion: MechanismMotion | None = None

    def errors(self, reference: Run) -> tuple[float, float]:
        """Root mean square of the deflection per largest deflection, and of the slider per stroke."""
        gaps = self.deflection - reference.deflection, self.slider - reference.slider
        sizes = np.abs(reference.deflection).max(), np.ptp(reference.slider)
        first, second = (float(np.sqrt(np.mean(gap**2)) / size) for gap, size in zip(gaps, sizes, strict=True))
        return first, second


def torque(t: float) -> float:
    """On the crank, N m."""
    return 0.01 * (1 - float(np.exp(-t / 0.167))) if t <= 0.7 else 0.0


def bars(factor: float, elements: tuple[int, int]) -> tuple[PlanarBeam, PlanarBeam]:
    """Crank and rod, at ``factor`` times the stiffness."""
    crank, rod = (
        PlanarBeam.straight(length, count, Section.of(E=factor * E, A=A, I=I, density=DENSITY))
        for length, count, E in ((CRANK, elements[0], E_CRANK), (ROD, elements[1], E_ROD))
    )
    return crank, rod


def across(first: Floats, middle: Floats, last: Floats) -> Floats:
    """Deflection (T,) of points (T, 2) across the chord."""
    chord, arm = last - first, middle - first
    return np.asarray((chord[:, 0] * arm[:, 1] - chord[:, 1] * arm[:, 0]) / np.linalg.norm(chord, axis=1))


def run(crank: Member, rod: Member, *, end: float, step: float, offline: float = 0.0, rho: float = 0.9) -> Run:
    """Both members from the straight position at rest."""
    mechanism = Mechanism()
    a, b = mechanism.point((0, 0), fixed="xy"), mechanism.point((CRANK, 0))
    c, turn = mechanism.point((CRANK + ROD, 0), fixed="y"), mechanism.angle(0.0)
    mechanism.add(crank, a, b, start=turn)
    mechanism.add(rod, b, c)
    mechanism.mass(c, SLIDER)
    mechanism.torque(turn, torque)
    begin = time.process_time()
    motion = simulate(mechanism, end=end, step=step, rho=rho)
    seconds = time.process_time() - begin
    nodes = rod.nodes(motion.x[1]).reshape(-1, 3, len(motion.times))[:, :2]
    first, middle, last = (nodes[k].T for k in (0, len(nodes) // 2, -1))
    return Run(
        time=motion.times,
        slider=motion.q[:, c.numbers[0]],
        deflection=across(first, middle, last),
        coordinates=mechanism.size,
        step=seconds / (len(motion.times) - 1),
        offline=offline,
        motion=motion,
    )


def full(factor: float = 1.0, *, elements: tuple[int, int] = ELEMENTS, end: float = END, step: float = STEP) -> Run:
    """All degrees of freedom."""
    crank, rod = bars(factor, elements)
    return run(FullMember(crank), FullMember(rod), end=end, step=step)


def reduced(
    name: str, factor: float = 1.0, *, elements: tuple[int, int] = ELEMENTS, end: float = END, step: float = STEP
) -> Run:
    """One of ``MODELS``, with one member for the crank and one for the rod."""
    formulation, modes = MODELS[name]
    begin = time.process_time()
    crank, rod = (
        ReducedMember(bar, modes=count, formulation=formulation, reach=reach, points_per_angle=POINTS)
        for bar, count, reach in zip(bars(factor, elements), modes, (REACH_CRANK, REACH_ROD), strict=True)
    )
    return run(crank, rod, end=end, step=step, offline=time.process_time() - begin)


def exudyn(factor: float = 1.0, *, elements: tuple[int, int] = ELEMENTS, end: float = END, step: float = STEP) -> Run:
    """All degrees of freedom in Exudyn: its geometrically exact beams of two nodes."""
    beams, (crank_section, rod_section) = ExudynBeams(), (bar.section for bar in bars(factor, (1, 1)))
    crank = beams.bar((0, 0), CRANK, elements[0], crank_section)
    rod = beams.bar((CRANK, 0), ROD, elements[1], rod_section)
    beams.hold(crank[0], (0, 1))
    beams.hold(rod[-1], (1,))
    beams.join(crank[-1], rod[0])
    beams.mass(rod[-1], SLIDER)
    beams.turn(crank[0], torque)
    times, points, seconds = beams.solve(end, step, 0.9, [rod[0], rod[len(rod) // 2], rod[-1]])
    first, middle, last = points
    return Run(
        time=times,
        slider=last[:, 0],
        deflection=across(first, middle, last),
        coordinates=3 * (sum(elements) + 2) + 2,
        step=seconds,
    )


def compare(factor: float, *, elements: tuple[int, int], end: float) -> dict[str, Run]:
    """Runs and prints all models at one stiffness."""
    done = {"full": full(factor, elements=elements, end=end)}
    reference = done["full"]
    for name in MODELS:
        done[name] = reduced(name, factor, elements=elements, end=end)
    largest = np.abs(reference.deflection).max() / ROD
    print(f"{factor:g} times the stiffness, {sum(elements)} elements: largest deflection {largest:.4f} of the rod")
    print("                    coordinates   rms error: deflection, slider   ms per step (gain)      offline, s")
    for name, run in done.items():
        deflection, slider = run.errors(reference)
        print(
            f"  {name:18} {run.coordinates:8d}       {deflection:12.5f}  {slider:12.6f}   {1e3 * run.step:10.3f} "
            f"({reference.step / run.step:5.1f}) {run.offline:12.2f}"
        )
        for warning in run.motion.warnings if run.motion else ():
            print(f"    warning: {warning}")
    return done


def check(elements: tuple[int, int], end: float) -> None:
    """Prints how far the full model is from that of Exudyn on the same mesh, at nominal stiffness.

    A coarse mesh: with 240 elements Newton's method of Exudyn 1.13 ends above the differences that are sought here.
    """
    if exudyn_missing():
        print(f"{exudyn_missing()}. One simulator is shown alone.")
        return
    ours, theirs = (model(elements=elements, end=end) for model in (full, exudyn))
    deflection, slider = theirs.errors(ours)
    version = importlib.import_module("exudyn").__version__
    print(
        f"Exudyn {version}, {sum(elements)} elements: rms difference of deflection {deflection:.5f}, "
        f"slider {slider:.6f}; {1e3 * theirs.step:.3f} ms per step, here {1e3 * ours.step:.3f}"
    )


def large(steps: int = 50) -> None:
    """Prints what a step of the full model costs with four times the elements; that of reduced ones is the same."""
    elements = 4 * ELEMENTS[0], 4 * ELEMENTS[1]
    whole = full(elements=elements, end=steps * STEP)
    other = reduced("GMP", elements=elements, end=steps * STEP)
    print(
        f"{sum(elements)} elements: full {1e3 * whole.step:.3f} ms per step, GMP {1e3 * other.step:.3f} "
        f"({whole.step / other.step:.1f}), offline {other.offline:.2f} s"
    )


def panels(soft: dict[str, Run], stiff: dict[str, Run]) -> list[Panel]:
    """Deflection at nominal stiffness, the errors, the deflection at 100 times the stiffness."""
    colors = dict(zip(MODELS, ("#9aa5b1", THIRD, OURS), strict=True))
    reference = soft["full"]
    shown, errors = [Curve(x=reference.time, y=reference.deflection / ROD, label="full", color=THEIRS, width=3.5)], []
    hard = [Curve(x=stiff["full"].time, y=stiff["full"].deflection / ROD, label="full", color=THEIRS, width=3.5)]
    for name, color in colors.items():
        run = soft[name]
        shown.append(Curve(x=run.time, y=run.deflection / ROD, label=name, color=color, width=1.2))
        hard.append(Curve(x=stiff[name].time, y=stiff[name].deflection / ROD, label=name, color=color, width=1.0))
        gap = np.maximum(np.abs(run.deflection - reference.deflection) / np.abs(reference.deflection).max(), 1e-7)
        errors.append(Curve(x=run.time, y=gap, label=name, color=color, width=1.2))
    part = "part of the length"
    return [
        Panel(title="Deflection of the middle of the rod, nominal stiffness", x="time, s", y=part, curves=shown),
        Panel(title="Its error", x="time, s", y="part of the largest", curves=errors, logarithmic=True),
        Panel(title="Deflection with 100 times the stiffness", x="time, s", y=part, curves=hard),
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints both comparisons and draws the picture. Returns the exit code."""
    options = parse(arguments, "A slider-crank with a very flexible rod.", __file__)
    elements, end = (QUICK_ELEMENTS, QUICK_END) if options.quick else (ELEMENTS, END)
    stiff, soft = (compare(factor, elements=elements, end=end) for factor in (100.0, 1.0))
    check(elements if options.quick else CHECKED, end)
    if not options.quick:
        large()
    draw(options.folder / "flexible_slider_crank.png", "Slider-crank with a very flexible rod", panels(soft, stiff))
    return 0


if __name__ == "__main__":
    sys.exit(main())
