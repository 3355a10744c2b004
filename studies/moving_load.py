"""The bending moment under a load that crosses a beam, with and without static modes, and what a step costs.

Draws moving_load_moment.png: the moment against Fryba's solution, and the time of a step when the candidates or the
degrees of freedom become ten times as many. The run goes to moving_load.npz, also where it is unfinished.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from common import OURS, THEIRS, THIRD, Curve, Floats, Panel, draw, hermite_beam, parse, write_run
from moving_load import ELEMENTS, MODES, STEPS, Passage, cross, reduce

from morembs.dynamics.multibody.sliding.response import amplitudes, state_of

SPEED = 0.25  # of the critical speed, for the moment
SIZES, TIMED, PER_NODE, ROUNDS = (40, 120, 400), 300, 12, 7
QUICK_TIMED = 20


def exact_moment(t: float, v: float, terms: int = 4000) -> float:
    """Bending moment under the load, in units of load times length."""
    k, alpha = np.arange(1, terms + 1), v / np.pi
    s = np.sin(k * np.pi * v * t)
    return float(2 / np.pi**2 * np.sum((s - alpha / k * np.sin((k * np.pi) ** 2 * t)) * s / (k**2 - alpha**2)))


def moments(run: Passage, every: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Positions of the load, moments under it: exact, with static modes, with the modes alone."""
    tables, n = run.body.switching, len(run.body.switching.node_ids) - 1
    all_, rows = np.arange(tables.count), []
    moving = np.flatnonzero(~tables.turns)
    at = np.concatenate((2 * tables.node[moving], 2 * tables.node[tables.turns] + 1))
    order = np.concatenate((moving, np.flatnonzero(tables.turns)))

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
            u, s = tables.modes @ q + tables.R(all_, candidates) @ a, run.speed * state.time
            rows.append((s, exact_moment(state.time, run.speed), of(u, s), of(tables.modes @ q, s)))
    s_, exact, switched, alone = np.array(rows).T
    return s_, exact, switched, alone


def step_times(sizes: Sequence[int], timed: int, rounds: int = ROUNDS) -> tuple[Floats, Floats]:
    """Milliseconds per step over the number of elements, PER_NODE steps from node to node.

    First with all nodes as candidates, then with the 41 of the coarsest beam in every model.
    """
    beams = []
    for n in sizes:
        model = hermite_beam(n)
        sets = {"BEAM": np.arange(0, n + 1, n // sizes[0])}
        few = replace(model, nodes=replace(model.nodes, sets=sets))
        beams += [(reduce(model, band=12), 1.0 / n), (reduce(few, band=12), 1.0 / sizes[0])]
    shortest = np.full(len(beams), np.inf)
    for _ in range(rounds):
        # The shortest of several runs, in turn: other programs only make them longer.
        for number, (beam, spacing) in enumerate(beams):
            steps = min(timed, round(0.9 / spacing * PER_NODE))
            run = cross(beam, 0.5, steps, start=0.02, end=0.02 + steps * spacing / PER_NODE)
            shortest[number] = min(shortest[number], 1e3 * run.seconds / steps)
    return shortest[::2], shortest[1::2]


def panels(
    moments: tuple[Floats, Floats, Floats, Floats], sizes: Sequence[int], times: tuple[Floats, Floats]
) -> list[Panel]:
    """Both diagrams."""
    s, want, switched, alone = moments
    ratio = np.array(sizes) / sizes[0]
    return [
        Panel(
            f"Bending moment under the load at {SPEED:g} of the critical speed",
            "position of the load",
            "moment / (load x length)",
            [
                Curve(s, want, "Fryba", THEIRS),
                Curve(s, alone, f"{MODES} modes alone", THIRD, width=1.0),
                Curve(s, switched, "with static modes", style="--"),
            ],
        ),
        Panel(
            f"Cost of a step ({PER_NODE} steps from node to node, switches included)",
            f"times {sizes[0]} elements",
            "ms",
            [
                Curve(ratio, times[0], "all nodes are candidates", OURS, "o-"),
                Curve(ratio, times[1], f"{sizes[0] + 1} candidates in all", THEIRS, "s--"),
                Curve(np.array([1.0]), np.zeros(1), color="white", width=0.0),
            ],
        ),
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs, draws and prints the figures. Returns the exit code."""
    options = parse(arguments, "The moment under a load that crosses a beam, and the cost of a step.", __file__)
    steps = STEPS // 2 if options.quick else STEPS
    file = options.folder / "moving_load.npz"
    run = cross(reduce(hermite_beam(ELEMENTS)), SPEED * np.pi, steps, keep=file)
    write_run(file, run.result)
    curves = moments(run, 4)
    size = np.abs(curves[1]).max()
    errors = [100 * np.abs(values - curves[1]).max() / size for values in curves[2:]]
    print(f"moment under the load: error {errors[0]:.2f} % with static modes, {errors[1]:.1f} % without")
    print(f"{len(run.switch.log)} switches, the first: nodes {run.switch.log[0].on} on, {run.switch.log[0].off} off")
    sizes, timed, rounds = (SIZES[:2], QUICK_TIMED, 1) if options.quick else (SIZES, TIMED, ROUNDS)
    times = step_times(sizes, timed, rounds)
    for what, values in zip(("all nodes are candidates", f"{sizes[0] + 1} candidates"), times, strict=True):
        listed = ", ".join(f"{t:.3f} ms with {n} elements" for n, t in zip(sizes, values, strict=True))
        print(f"cost of a step, {what}: {listed}")
    draw(options.folder / "moving_load_moment.png", "A load crosses a beam", panels(curves, sizes, times))
    return 0


if __name__ == "__main__":
    sys.exit(main())
