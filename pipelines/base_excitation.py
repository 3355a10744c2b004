#!/usr/bin/env python3
"""A mast of two slender beams with two masses on a base that moves to and fro (Zahariev, EUROMECH 524).

Large deflections: all degrees of freedom against members that are divided, and against Exudyn where that is installed.
A small amplitude is compared with the linear state space of the mast, whose input is the acceleration of its base.
Draws base_excitation.png.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from functools import partial

import numpy as np
import scipy.sparse as sp
from common import OURS, THEIRS, THIRD, Curve, ExudynBeams, Floats, Panel, draw, parse
from scipy.signal import lsim

import morembs
from morembs.dynamics.gmp import divided_member
from morembs.dynamics.nonlinear import FullMember, Mechanism, PlanarBeam, Section, simulate
from morembs.exporters.exudyn_system import exudyn_missing
from morembs.fem import DofMap, FEModel, Nodes

LENGTH, ELEMENTS, MASSES = 0.5, 12, (0.1, 0.05)  # m and elements of each beam, kg at their upper ends
SECTION = Section.of(E=7e10, A=20e-3 * 1.5e-3, I=20e-3 * 1.5e-3**3 / 12, density=2700.0)
AMPLITUDE, PERIOD, SMALL, SPAN = 0.15, 0.5, 1e-4, 0.2  # m, s, m, s
END, QUICK_END, STEP, QUICK_STEP, RHO = 1.0, 0.3, 1e-3, 2e-3, 0.9


def base(t: float, amplitude: float = AMPLITUDE) -> tuple[float, float]:
    """The motion of the base (m), smooth enough to leave out modes that steps do not resolve."""
    return 0.0, amplitude * float(np.sin(np.pi * t / PERIOD)) ** 6


def shake(pieces: int, amplitude: float, end: float, step: float) -> tuple[Floats, Floats, int, float]:
    """Times (T,), tip (T, 2), coordinates and ms per step; no ``pieces``: all degrees of freedom."""
    beam, mechanism = PlanarBeam.straight(LENGTH, ELEMENTS, SECTION), Mechanism()
    foot = mechanism.point((0, 0), motion=lambda t: base(t, amplitude))
    low, high = mechanism.point((LENGTH, 0)), mechanism.point((2 * LENGTH, 0))
    clamped, between = mechanism.angle(0.0, fixed=True), mechanism.angle(0.0)
    member = divided_member(beam, pieces, modes=1, formulation="membrane") if pieces else FullMember(beam)
    add = partial(mechanism.add, member) if isinstance(member, FullMember) else partial(member.add, mechanism)
    add(foot, low, start=clamped, end=between)
    add(low, high, start=between)
    for point, mass in zip((low, high), MASSES, strict=True):
        mechanism.mass(point, mass)
    begin = time.process_time()
    motion = simulate(mechanism, end=end, step=step, rho=RHO)
    cost = 1e3 * (time.process_time() - begin) / (len(motion.times) - 1)
    return motion.times, motion.q[:, high.numbers], mechanism.size, cost


def exudyn(end: float, step: float) -> Floats:
    """The tip (T, 2) with the geometrically exact beams of Exudyn, which are of lower order: four times as many."""
    beams = ExudynBeams()
    low, high = (beams.bar((k * LENGTH, 0), LENGTH, 4 * ELEMENTS, SECTION) for k in range(2))
    beams.join(low[-1], high[0], (0, 1, 2))
    beams.hold(low[0], (0, 2))
    beams.hold(low[0], (1,), lambda t: base(t)[1])
    for node, mass in zip((low[-1], high[-1]), MASSES, strict=True):
        beams.mass(node, mass)
    return beams.solve(end, step, RHO, [high[-1]], floor=1e-6)[1][0]


def linear(times: Floats, amplitude: float) -> Floats:
    """Deflection (T,) of the tip across the mast by its state space."""
    beam = PlanarBeam.straight(2 * LENGTH, 2 * ELEMENTS, SECTION)
    across = np.setdiff1d(np.arange(beam.size), np.arange(0, beam.size, 3))
    masses, nodes = np.zeros(beam.size), beam.reference.reshape(-1, 3)
    masses[[3 * ELEMENTS + 1, 6 * ELEMENTS + 1]] = MASSES
    M = beam.M + sp.diags_array(masses)
    model = FEModel(
        K=sp.csr_array(beam.tangent(beam.reference)[across][:, across]),
        M=sp.csr_array(M[across][:, across]),
        nodes=Nodes(ids=np.arange(1, len(nodes) + 1), xyz=nodes),
        dofs=DofMap(node=across // 3, component=np.where(across % 3 == 1, 1, 5)),
    )
    ends = [
        morembs.make_interface(model, name=name, nodes=np.array([node]), coupling="direct")
        for name, node in (("base", 0), ("tip", len(nodes) - 1))
    ]
    with morembs.Problem(model, ends) as problem:
        reduced = morembs.Modal(modes=model.size - 2).reduce(problem)
        body = morembs.elastic_body(problem, reduced, morembs.make_part(problem, nodes="interfaces"))
    space = morembs.state_space(body, ["base:acceleration:y"], ["tip:displacement:y"], held=["base:rz"])
    fine = np.linspace(0, times[-1], 20 * (len(times) - 1) + 1)
    s = np.sin(np.pi * fine / PERIOD)
    acceleration = amplitude * (np.pi / PERIOD) ** 2 * (30 * s**4 - 36 * s**6)
    y = lsim((space.A, space.B, space.C, space.D), acceleration, fine)[1]
    return np.asarray(np.ravel(y)[::20])


def main(arguments: Sequence[str] | None = None) -> int:
    options = parse(arguments, __doc__, __file__)
    end, step = (QUICK_END, QUICK_STEP) if options.quick else (END, STEP)
    times, full, size, cost = shake(0, AMPLITUDE, end, step)
    deflection, gaps = full[:, 1] - [base(t)[1] for t in times], []
    print(f"all {size} coordinates: up to {np.abs(deflection).max():.4f} m from the base, {cost:.2f} ms per step")
    for pieces, color in ((1, THIRD), (2, OURS)):
        _, tip, size, cost = shake(pieces, AMPLITUDE, end, step)
        gap, words = np.linalg.norm(tip - full, axis=1), f"{pieces} of one mode per beam"
        print(f"{words}, {size} coordinates: tip within {gap.max():.2e} m, {cost:.2f} ms per step")
        gaps.append(Curve(times, np.maximum(gap, 1e-9), words, color, width=1.2))
    if not exudyn_missing():
        gap = np.linalg.norm(exudyn(end, step) - full, axis=1)
        print(f"in Exudyn: tip within {gap.max():.2e} m")
        gaps.append(Curve(times, np.maximum(gap, 1e-9), "Exudyn", THEIRS, "--"))
    # The error of the steps, of second order, is taken out.
    coarse, fine = (shake(0, SMALL, SPAN, h)[1][:: round(2e-3 / h), 1] for h in (2e-3, 1e-3))
    exact = linear(np.arange(len(coarse)) * 2e-3, SMALL)
    gap = np.abs((4 * fine - coarse) / 3 - exact).max() / np.abs(exact).max()
    print(f"amplitude {SMALL:g} m: {gap:.1e} of the linear response apart")
    draw(
        options.folder / "base_excitation.png",
        "Mast on a moving base",
        [
            Panel("Tip against the base, across the mast", "time, s", "m", [Curve(times, deflection)]),
            Panel("Distance from all coordinates", "time, s", "m", gaps, logarithmic=True),
        ],
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
