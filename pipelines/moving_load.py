#!/usr/bin/env python3
"""A load crosses a simply supported beam: four modes and switched static modes against Fryba's solution.

Draws moving_load.png: dynamic factors over the speed, the bending moment under the load, and what a step costs when
the candidates or the degrees of freedom become ten times as many. Runs go to moving_load.npz, also unfinished ones.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from both_simulators import OURS, THEIRS, THIRD, Curve, Floats, Panel, draw, parse

from morembs.model import DofMap, FEModel, Nodes
from morembs.multibody import System
from morembs.multibody.linear_body import LinearBody
from morembs.multibody.result import Result
from morembs.multibody.sliding.body import SwitchingBody
from morembs.multibody.sliding.handler import SlidingSwitch, UnfinishedRunError, simulate_sliding
from morembs.multibody.sliding.loads import MovingLoad
from morembs.multibody.sliding.response import amplitudes, local_response, state_of
from morembs.problem import Problem
from morembs.reducers import ReducedModel, StaticModesSwitching
from morembs.reducers.switching_tables import Switching
from morembs.storage.safefile import replacing

MODES, ELEMENTS, STEPS = 4, 32, 1600
FACTORS = {0.1: 1.096, 0.25: 1.258, 0.5: 1.705, 0.617: 1.732, 0.75: 1.702}
SPEED = 0.25  # of the critical speed, for the moment
SIZES, TIMED, PER_NODE, ROUNDS = (40, 120, 400), 300, 12, 7


def hermite_beam(n: int) -> FEModel:
    """Beam of unit length, bending stiffness and mass per length in n elements, held at both ends."""
    h = 1.0 / n
    k = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                  [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h]]) / h**3  # fmt: skip
    m = h / 420 * np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h],
                            [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h * h, -22 * h, 4 * h * h]])  # fmt: skip
    dofs = 2 * np.arange(n)[:, None] + np.arange(4)
    rows, columns = np.repeat(dofs, 4, axis=1).ravel(), np.tile(dofs, (1, 4)).ravel()
    K, M = (sp.csr_array(sp.coo_array((np.tile(one.ravel(), n), (rows, columns)))) for one in (k, m))
    keep = np.setdiff1d(np.arange(2 * n + 2), [0, 2 * n])
    xyz = np.zeros((n + 1, 3))
    xyz[:, 0] = np.linspace(0, 1, n + 1)
    return FEModel(
        K=sp.csr_array(K[keep][:, keep]), M=sp.csr_array(M[keep][:, keep]),
        nodes=Nodes(ids=np.arange(1, n + 2), xyz=xyz, sets={"BEAM": np.arange(n + 1)}),
        dofs=DofMap(node=keep // 2, component=np.where(keep % 2, 5, 1)), source="simply supported beam",
    )  # fmt: skip


def reduce(model: FEModel, modes: int = MODES, band: int | None = None) -> tuple[ReducedModel, Switching]:
    """Modes of the beam, and static modes of deflection and rotation at all nodes."""
    reducer = StaticModesSwitching(
        base_options={"modes": modes}, candidates="set:BEAM", directions=[1, 5], band=band
    )
    with Problem(model) as problem:
        reduced = reducer.reduce(problem)
        return reduced, reducer.switching(problem, reduced)


@dataclass(frozen=True, kw_only=True, eq=False)
class Passage:
    """A run with its body, its switch, the speed in m/s and the processor time it took in s."""

    result: Result
    body: SwitchingBody
    switch: SlidingSwitch
    speed: float
    seconds: float


def cross(
    made: tuple[ReducedModel, Switching], speed: float, steps: int, *, variant: str = "quasi-static",
    start: float = 0.0, end: float = 1.0, keep: Path | None = None,
) -> Passage:  # fmt: skip
    """A unit load goes from ``start`` to ``end``. What there is of a run that fails goes to ``keep``."""
    reduced, its = made
    body = SwitchingBody(LinearBody(reduced.M, reduced.K), its, at=start, variant=variant)
    system, switch = System(), SlidingSwitch(body)
    system.add(body)
    system.add(MovingLoad(body.path(), position=lambda t: start + speed * t, force=(0.0, 1.0, 0.0)))
    duration, begin = (end - start) / speed, time.process_time()
    try:
        result = simulate_sliding(system, switch, end=duration, step=duration / steps)
    except UnfinishedRunError as error:
        if keep is not None and error.result is not None:
            write_run(keep, error.result)
        raise
    return Passage(result=result, body=body, switch=switch, speed=speed, seconds=time.process_time() - begin)


def write_run(path: Path, result: Result) -> None:
    """Times and configurations of a run, whole or not at all."""
    with replacing(path) as file:
        np.savez(file, time=result.time, x=np.concatenate([one.x for one in result.segments]))


def exact_deflection(t: Floats, v: float, x: float, terms: int = 200) -> Floats:
    """Deflection (s,) at x (Fryba 1999), as a part of the static one of mid-span."""
    k, alpha = np.arange(1, terms + 1)[:, None], v / np.pi
    shape = (np.sin(k * np.pi * v * t) - alpha / k * np.sin((k * np.pi) ** 2 * t)) / (k**2 * (k**2 - alpha**2))
    return np.asarray(48 * 2 / np.pi**4 * np.sum(shape * np.sin(k * np.pi * x), axis=0))


def exact_moment(t: float, v: float, terms: int = 4000) -> float:
    """Bending moment under the load, in units of load times length."""
    k, alpha = np.arange(1, terms + 1), v / np.pi
    s = np.sin(k * np.pi * v * t)
    return float(2 / np.pi**2 * np.sum((s - alpha / k * np.sin((k * np.pi) ** 2 * t)) * s / (k**2 - alpha**2)))


def moments(run: Passage, every: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Positions of the load, moments under it: exact, with static modes, with the modes alone."""
    its, n = run.body.switching, len(run.body.switching.node_ids) - 1
    all_, rows = np.arange(its.count), []
    moving = np.flatnonzero(~its.turns)
    at = np.concatenate((2 * its.node[moving], 2 * its.node[its.turns] + 1))
    order = np.concatenate((moving, np.flatnonzero(its.turns)))

    def of(u: Floats, s: float) -> float:
        e = min(int(s * n), n - 1)
        x, whole = s * n - e, np.zeros(2 * n + 2)
        whole[at] = u[order]
        bend = np.array([12 * x - 6, (6 * x - 4) / n, 6 - 12 * x, (6 * x - 2) / n]) * n**2
        return -float(bend @ whole[2 * e : 2 * e + 4])

    for segment in run.result.segments:
        for k in range(0, len(segment.time), every):
            state = state_of(segment, k)
            q, candidates, a = amplitudes(state, run.body)
            u, s = its.modes @ q + its.R(all_, candidates) @ a, run.speed * state.time
            rows.append((s, exact_moment(state.time, run.speed), of(u, s), of(its.modes @ q, s)))
    s_, exact, switched, alone = np.array(rows).T
    return s_, exact, switched, alone


def step_times(sizes: Sequence[int], timed: int, rounds: int = ROUNDS) -> tuple[Floats, Floats]:
    """Milliseconds per step over the number of elements, PER_NODE steps from node to node.

    First with all nodes as candidates, then with the 41 of the coarsest beam in every model.
    """
    made = []
    for n in sizes:
        model = hermite_beam(n)
        sets = {"BEAM": np.arange(0, n + 1, n // sizes[0])}
        few = replace(model, nodes=replace(model.nodes, sets=sets))
        made += [(reduce(model, band=12), 1.0 / n), (reduce(few, band=12), 1.0 / sizes[0])]
    found = np.full(len(made), np.inf)
    for _ in range(rounds):
        # The shortest of several runs, in turn: other programs only make them longer.
        for number, (one, spacing) in enumerate(made):
            steps = min(timed, round(0.9 / spacing * PER_NODE))
            run = cross(one, 0.5, steps, start=0.02, end=0.02 + steps * spacing / PER_NODE)
            found[number] = min(found[number], 1e3 * run.seconds / steps)
    return found[::2], found[1::2]


def picture(
    path: Path, factors: dict[float, float], run: Passage, found: tuple[Floats, Floats, Floats, Floats],
    sizes: Sequence[int], times: tuple[Floats, Floats],
) -> None:  # fmt: skip
    """All diagrams."""
    alpha = np.linspace(0.05, 0.9, 120)
    exact = [np.abs(exact_deflection(np.linspace(0, 1 / (a * np.pi), 600), a * np.pi, 0.5)).max() for a in alpha]
    s, want, switched, alone = found
    ratio = np.array(sizes) / sizes[0]
    draw(
        path, "A load crosses a simply supported beam",
        [
            Panel(
                title="Largest deflection of mid-span, as a multiple of the static one", x="speed / critical speed",
                y="dynamic factor",
                curves=[
                    Curve(x=alpha, y=np.array(exact), label="Fryba", color=THEIRS),
                    Curve(x=np.array(list(factors)), y=np.array(list(factors.values())), style="o",
                          label=f"{MODES} modes and static modes"),
                ],
            ),
            Panel(
                title=f"Bending moment under the load at {SPEED:g} of the critical speed", x="position of the load",
                y="moment / (load x length)",
                curves=[
                    Curve(x=s, y=want, label="Fryba", color=THEIRS),
                    Curve(x=s, y=alone, label=f"{MODES} modes alone", color=THIRD, width=1.0),
                    Curve(x=s, y=switched, label="with static modes", style="--"),
                ],
            ),
            Panel(
                title=f"Cost of a step ({PER_NODE} steps from node to node, switches included)",
                x=f"times {sizes[0]} elements", y="ms",
                curves=[
                    Curve(x=ratio, y=times[0], style="o-", label="all nodes are candidates", color=OURS),
                    Curve(x=ratio, y=times[1], style="s--", label=f"{sizes[0] + 1} candidates in all", color=THEIRS),
                    Curve(x=np.array([1.0]), y=np.zeros(1), color="white", width=0.0),
                ],
            ),
        ],
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs, draws and prints the figures. Returns the exit code."""
    options = parse(arguments, "A load crosses a simply supported beam: modes and switched static modes.")
    steps = STEPS // 2 if options.quick else STEPS
    file, made = options.folder / "moving_load.npz", reduce(hermite_beam(ELEMENTS))
    options.folder.mkdir(parents=True, exist_ok=True)
    factors = {}
    for alpha, want in FACTORS.items():
        run = cross(made, alpha * np.pi, steps, keep=file)
        middle = local_response(run.result, run.body, lambda t: 0.5).displacement[:, 1]
        factors[alpha] = float(48 * np.abs(middle).max())
        print(f"speed {alpha:g} of the critical one: dynamic factor {factors[alpha]:.4f} (Fryba {want:.3f})")
    run = cross(made, SPEED * np.pi, steps, keep=file)
    write_run(file, run.result)
    found = moments(run, 4)
    size = np.abs(found[1]).max()
    errors = [100 * np.abs(one - found[1]).max() / size for one in found[2:]]
    print(f"moment under the load: error {errors[0]:.2f} % with static modes, {errors[1]:.1f} % without")
    print(f"{len(run.switch.log)} switches, the first: nodes {run.switch.log[0].on} on, {run.switch.log[0].off} off")
    sizes, timed, rounds = (SIZES[:2], TIMED // 3, 2) if options.quick else (SIZES, TIMED, ROUNDS)
    times = step_times(sizes, timed, rounds)
    for what, values in zip(("all nodes are candidates", f"{sizes[0] + 1} candidates"), times, strict=True):
        listed = ", ".join(f"{t:.3f} ms with {n} elements" for n, t in zip(sizes, values, strict=True))
        print(f"cost of a step, {what}: {listed}")
    picture(options.folder / "moving_load.png", factors, run, found, sizes, times)
    print(options.folder / "moving_load.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
