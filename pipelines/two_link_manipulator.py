#!/usr/bin/env python3
"""A flexible two-link manipulator in the modes of its initial configuration (Aarts, EUROMECH 524).

Joints turn by third-order functions within 0.5 s; links and masses are those of Schiehlen and Leister (1991). The end
angles of all elements against their chords are the coordinates, the equations are nonlinear, and the modes of the
first instant serve for the whole motion. Independent reference: geometrically exact beams in absolute coordinates.
Draws two_link_manipulator.png.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from common import OURS, THEIRS, THIRD, Curve, Floats, Panel, draw, parse

from morembs.dynamics.nonlinear import Chain, FullMember, Link, Mechanism, PlanarBeam, Section, simulate

LENGTHS, AREAS, MOMENTS, MASSES = (0.545, 0.675), (9.0e-4, 4.0e-4), (1.69e-8, 3.33e-9), (1.0, 3.0)
SECTIONS = [Section.of(E=7.3e10, A=A, I=moment, density=2700.0) for A, moment in zip(AREAS, MOMENTS, strict=True)]
START, TURN = np.radians((-15.0, -15.0)), np.radians((30.0, 45.0))  # of both joints
MOVE, END, RHO = 0.5, 0.7, 0.9
STEP, QUICK_STEP, COARSE = 5e-4, 2e-3, 4e-3


def cubic(t: float) -> float:
    """From 0 to 1 within MOVE; it starts with an acceleration."""
    s = min(t / MOVE, 1.0)
    return s * s * (3 - 2 * s)


def arm(elements: int) -> Chain:
    links = zip(LENGTHS, SECTIONS, MASSES, strict=True)
    return Chain([Link(length=n, section=s, elements=elements, tip=mass) for n, s, mass in links])


def deflection(times: Floats, tip: Floats) -> Floats:
    """Distance (T,) of the tip (2, T) from that of the rigid arm, across its second link."""
    turned = np.array([cubic(t) for t in times])
    a, b = np.cumsum(START[:, None] + TURN[:, None] * turned, axis=0)
    rigid = [LENGTHS[0] * f(a) + LENGTHS[1] * f(b) for f in (np.cos, np.sin)]
    return np.asarray(np.sum((tip - rigid) * [-np.sin(b), np.cos(b)], axis=0))


def move(chain: Chain, step: float) -> tuple[Floats, Floats, float]:
    """Times (T,), the tip (2, T), ms per step."""
    mechanism = Mechanism()
    mechanism.chain(chain, [mechanism.drive(a, lambda t, d=d: d * cubic(t)) for a, d in zip(START, TURN, strict=True)])
    begin = time.process_time()
    motion = simulate(mechanism, end=END, step=step, rho=RHO)
    seconds = time.process_time() - begin
    return motion.times, chain.nodes(motion.x[0])[-1], 1e3 * seconds / (len(motion.times) - 1)


def exact_beams(elements: int, step: float) -> tuple[Floats, Floats]:
    """The same of geometrically exact beams, which hardly stretch and shear and have no rotary inertia."""
    stiff = [replace(s, EA=100 * s.EA, GA=100 * s.GA, rotary=0.0) for s in SECTIONS]
    beams = [FullMember(PlanarBeam.straight(n, elements, s)) for n, s in zip(LENGTHS, stiff, strict=True)]
    mechanism, (a, b) = Mechanism(), np.cumsum(START)
    elbow = LENGTHS[0] * np.array([np.cos(a), np.sin(a)])
    points = [mechanism.point(p) for p in (elbow, elbow + LENGTHS[1] * np.array([np.cos(b), np.sin(b)]))]
    shoulder = mechanism.drive(a, lambda t: TURN[0] * cubic(t))
    outer = mechanism.angle(a)
    joint = mechanism.drive(b, lambda t: TURN[1] * cubic(t), seen_from=outer)
    mechanism.add(beams[0], mechanism.point((0, 0), fixed="xy"), points[0], start=shoulder, end=outer)
    mechanism.add(beams[1], *points, start=joint)
    for point, mass in zip(points, MASSES, strict=True):
        mechanism.mass(point, mass)
    motion = simulate(mechanism, end=END, step=step, rho=RHO)
    return motion.times, motion.q[:, points[1].numbers].T


def main(arguments: Sequence[str] | None = None) -> int:
    options = parse(arguments, __doc__, __file__)
    step, elements = (QUICK_STEP, 6) if options.quick else (STEP, 10)
    full = arm(3)
    squares, V = full.modes(START)
    before, after = (np.sqrt(s) / (2 * np.pi) for s in (squares, full.modes(START + TURN)[0]))
    print(f"start {before[0]:.4f}, {before[1]:.3f} .. {before[-1]:.0f} Hz, end {after[0]:.4f}, {after[1]:.3f} Hz")
    times, tip, cost = move(full, step)
    across = deflection(times, tip)
    k, most = tip[1].argmax(), np.abs(across).max()
    print(f"largest y {tip[1, k]:.5f} m at {times[k]:.4f} s, largest deflection {most:.5f} m, {cost:.2f} ms per step")
    curves = [Curve(times, 1e3 * across, f"{len(squares)} end angles", THEIRS, width=3.5)]
    errors = []
    print("modes   largest explicit step, s   tip, m    part of the deflection   ms per step")
    for modes, color in ((1, "#9aa5b1"), (2, OURS), (3, THIRD)):
        _, other, cost = move(Chain(full.links, V[:, :modes]), step)
        w = deflection(times, other)
        gap, name = np.linalg.norm(other - tip, axis=0), f"{modes} mode{'s' * (modes > 1)}"
        print(
            f"{modes:5d}   {2 / np.sqrt(squares[modes - 1]):24.2g}   {gap.max():.2e}   "
            f"{np.abs(w - across).max() / most:22.2e}   {cost:11.2f}"
        )
        curves.append(Curve(times, 1e3 * w, name, color, width=1.2))
        errors.append(Curve(times, np.maximum(gap, 1e-10), name, color, width=1.2))
    print(f"all     {2 / np.sqrt(squares[-1]):24.2g}")
    for words, chain in ((f"{len(squares)} end angles", full), ("2 modes", Chain(full.links, V[:, :2]))):
        coarse, other, _ = move(chain, COARSE)
        gap = np.linalg.norm(other - [np.interp(coarse, times, p) for p in tip], axis=0).max()
        print(f"{words}, steps of {COARSE:g} s: tip within {gap:.1e} m: longer steps gain nothing")
    exact = np.abs(deflection(*exact_beams(elements, step)) - deflection(*move(arm(elements), step)[:2])).max()
    print(f"{elements} elements per link differ from geometrically exact beams by {exact / most:.1e} of the deflection")
    draw(
        options.folder / "two_link_manipulator.png",
        "Two-link manipulator",
        [
            Panel("Deflection across the second link", "time, s", "mm", curves),
            Panel(f"Tip, against {len(squares)} end angles", "time, s", "m", errors, logarithmic=True),
        ],
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
