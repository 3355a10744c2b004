#!/usr/bin/env python3
"""A load crosses a simply supported beam: four modes and switched static modes against Fryba's solution.

Draws moving_load.png: dynamic factors over the speed. A run that fails leaves what there is of it in moving_load.npz.
What the static modes are worth near the load, and what they cost: python -m studies.moving_load
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from common import THEIRS, Curve, Floats, Panel, draw, hermite_beam, parse, simulate_kept

from morembs import FEModel, Problem, ReducedModel, StaticModesSwitching
from morembs.dynamics.multibody import (
    LinearBody,
    MovingLoad,
    Result,
    SlidingSwitch,
    SwitchingBody,
    System,
    local_response,
)
from morembs.responses.static_mode_tables import StaticModeTables

MODES, ELEMENTS, STEPS = 4, 32, 1600
FACTORS = {0.1: 1.096, 0.25: 1.258, 0.5: 1.705, 0.617: 1.732, 0.75: 1.702}


def reduce(model: FEModel, modes: int = MODES, band: int | None = None) -> tuple[ReducedModel, StaticModeTables]:
    """Modes of the beam, and static modes of deflection and rotation at all nodes."""
    reducer = StaticModesSwitching(base_options={"modes": modes}, candidates="set:BEAM", directions=[1, 5], band=band)
    with Problem(model) as problem:
        reduced = reducer.reduce(problem)
        return reduced, reducer.tabulate_static_modes(problem, reduced)


@dataclass(frozen=True, kw_only=True, eq=False)
class Passage:
    """A run with its body, its switch, the speed in m/s and the processor time it took in s."""

    result: Result
    body: SwitchingBody
    switch: SlidingSwitch
    speed: float
    seconds: float


def cross(
    beam: tuple[ReducedModel, StaticModeTables],
    speed: float,
    steps: int,
    *,
    variant: str = "quasi-static",
    start: float = 0.0,
    end: float = 1.0,
    keep: Path | None = None,
) -> Passage:
    """A unit load goes from ``start`` to ``end``. What there is of a run that fails goes to ``keep``."""
    reduced, tables = beam
    body = SwitchingBody(LinearBody(reduced.M, reduced.K), tables, at=start, variant=variant)
    system, switch = System(), SlidingSwitch(body)
    system.add(body)
    system.add(MovingLoad(body.path(), position=lambda t: start + speed * t, force=(0.0, 1.0, 0.0)))
    duration, begin = (end - start) / speed, time.process_time()
    result = simulate_kept(system, switch, duration, duration / steps, keep)
    return Passage(result=result, body=body, switch=switch, speed=speed, seconds=time.process_time() - begin)


def exact_deflection(t: Floats, v: float, x: float, terms: int = 200) -> Floats:
    """Deflection (s,) at x (Fryba 1999), as a part of the static one of mid-span."""
    k, alpha = np.arange(1, terms + 1)[:, None], v / np.pi
    shape = (np.sin(k * np.pi * v * t) - alpha / k * np.sin((k * np.pi) ** 2 * t)) / (k**2 * (k**2 - alpha**2))
    return np.asarray(48 * 2 / np.pi**4 * np.sum(shape * np.sin(k * np.pi * x), axis=0))


def dynamic_factor(run: Passage) -> float:
    """Largest deflection of mid-span, as a multiple of the static one."""
    middle = local_response(run.result, run.body, lambda t: 0.5).displacement[:, 1]
    return float(48 * np.abs(middle).max())


def exact_factor(v: float) -> float:
    """The same of Fryba's solution at the speed ``v``."""
    return float(np.abs(exact_deflection(np.linspace(0, 1 / v, 600), v, 0.5)).max())


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs, draws and prints the figures. Returns the exit code."""
    options = parse(arguments, "A load crosses a simply supported beam: modes and switched static modes.", __file__)
    beam, steps = reduce(hermite_beam(ELEMENTS)), STEPS // 2 if options.quick else STEPS
    factors = {}
    for alpha, want in FACTORS.items():
        run = cross(beam, alpha * np.pi, steps, keep=options.folder / "moving_load.npz")
        factors[alpha] = dynamic_factor(run)
        print(f"speed {alpha:g} of the critical one: dynamic factor {factors[alpha]:.4f} (Fryba {want:.3f})")
    speeds, ours = np.array(list(factors.items())).T
    alphas = np.linspace(0.05, 0.9, 120)
    curves = [
        Curve(alphas, np.array([exact_factor(alpha * np.pi) for alpha in alphas]), "Fryba", THEIRS),
        Curve(speeds, ours, f"{MODES} modes and static modes", style="o"),
    ]
    title = "Largest deflection of mid-span, as a multiple of the static one"
    panel = Panel(title, "speed / critical speed", "dynamic factor", curves)
    draw(options.folder / "moving_load.png", "A load crosses a simply supported beam", [panel])
    return 0


if __name__ == "__main__":
    sys.exit(main())
