"""A rotating beam in two simulators: the frequency of its flapping, with and without geometric stiffening.

A blade is clamped to a shaft that turns at constant speed W about z, its root on the axis. Beam theory gives
w(W)^2 = w(0)^2 + c W^2 with c = 1.193 for the first flap mode (out of the plane of rotation; Southwell and Gough 1921)
and c = 0.193 for the first lag mode. Reduces the blade by rotating_beam.toml and finds c in two ways:

- by linearisation: the elastic equations of morembs.dynamics.multibody about steady spin (linear in the elastic
  coordinates and their rates), as an eigenvalue problem;
- by simulation: the blade, set off in its first flap shape, swings in morembs.dynamics.multibody and in Exudyn;
  the frequency comes from the zeros of the tip's motion.

Exudyn has no geometric stiffening: it shows what is wrong without. The picture is rotating_beam.png.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy.linalg as sl
from common import OURS, THEIRS, THIRD, Curve, Floats, Panel, draw, make_body, parse

from morembs.dynamics.multibody import DrivenAngle, FlexibleBody, Motion, RevoluteJoint, System, ground, simulate
from morembs.exporters.exudyn_system import ExudynBody, ExudynSystem, exudyn_missing

SIZE, CELLS = (1.0, 0.03, 0.01), (40, 1, 2)  # m: length, width in the plane of rotation (lag), height (flap)
FLAP, LAG = 2, 1  # axes
SOUTHWELL = {FLAP: 1.193, LAG: 0.193}
# Speeds as parts of the first flap frequency at rest.
SPEEDS, SIMULATED = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8), (0.4, 0.8)
STEP, RHO, PERIODS = 5e-4, 0.95, 8
SWING = 1e-4  # m, of the tip


def linearised(blade: ExudynBody, speed: float, axis: int, *, stiffening: bool) -> float:
    """Lowest frequency (rad/s) of the modes that move the tip along ``axis``, about steady spin."""
    frame = blade.floating
    body = FlexibleBody(frame, angular_velocity=(0, 0, speed), stiffening=stiffening)
    x, v = body.start()
    n, still = frame.count, np.zeros(3)

    def rows(q: Floats, rate: Floats) -> Floats:
        # The root is on the axis and turns steadily, so that the frame has no acceleration.
        state, velocity = np.concatenate((x[:12], q)), np.concatenate((v[:6], rate))
        return body.dynamics(0.0, state, velocity, still)[1][6:]

    eye, none = np.eye(n), np.zeros(n)
    steady = rows(none, none)
    K = np.stack([rows(e, none) - steady for e in eye], axis=1)
    G = np.stack([rows(none, e) - steady for e in eye], axis=1)
    values, vectors = sl.eig(np.block([[np.zeros((n, n)), eye], [-K, -G]]), sl.block_diag(eye, frame.integrals.Me))
    tip = np.abs(frame.markers["tip"].motion[:3] @ vectors[:n])
    moving = (tip[axis] > 0.9 * np.linalg.norm(tip, axis=0)) & (values.imag > 0)
    return float(values[moving].imag.min())


def first_flap(blade: ExudynBody) -> Floats:
    """(n,) elastic coordinates of the first flap shape at rest, the tip off by ``SWING``."""
    frame = blade.floating
    _, Y = sl.eigh(frame.Ke, frame.integrals.Me)
    tip = frame.markers["tip"].motion[:3] @ Y
    flap = int(np.flatnonzero(np.abs(tip[FLAP]) > 0.9 * np.linalg.norm(tip, axis=0))[0])
    return np.asarray(Y[:, flap] * SWING / tip[FLAP, flap])


def frequency(time: Floats, z: Floats) -> float:
    """Frequency (rad/s) of a swing about zero, from its upward zeros."""
    up = np.flatnonzero((z[:-1] < 0) & (z[1:] >= 0))
    zeros = time[up] - z[up] * np.diff(time)[up] / (z[up + 1] - z[up])
    return float(2 * math.pi * (len(zeros) - 1) / (zeros[-1] - zeros[0]))


def in_ours(source: ExudynBody, speed: float, end: float, *, stiffening: bool) -> tuple[Floats, Floats]:
    """Times and flapping of the tip in morembs.dynamics.multibody."""
    frame = source.floating
    system = System()
    blade = system.add(
        FlexibleBody(
            frame,
            position=frame.origin,
            angular_velocity=(0, 0, speed),
            elastic=first_flap(source),
            stiffening=stiffening,
            name="blade",
        )
    )
    shaft = ground.marker_at()
    system.add(RevoluteJoint(shaft, blade.marker("root"), axis=(0, 0, 1)))
    system.add(DrivenAngle(shaft, blade.marker("root"), axis=(0, 0, 1), motion=Motion.steady(speed)))
    result = simulate(system, end=end, step=STEP, rho=RHO)
    return result.time, result.position(blade.marker("tip"))[:, FLAP]


def in_theirs(source: ExudynBody, speed: float, end: float) -> tuple[Floats, Floats]:
    """Times and flapping of the tip in Exudyn."""
    system = ExudynSystem()
    start = {"angular_velocity": (0, 0, speed), "elastic": first_flap(source)}
    blade = system.elastic(source, position=source.floating.origin, **start)
    system.joint(system.at_ground(), system.at_interface(blade, "root"), (1, 1, 1, 1, 1, 0))
    system.drive(blade, axis=2, speed=speed)
    time, (tip,) = system.solve(end=end, step=STEP, rho=RHO, watch=[system.at_interface(blade, "tip")])
    return time, tip[:, FLAP]


def coefficients(blade: ExudynBody, axis: int, *, stiffening: bool) -> Floats:
    """c at each of ``SPEEDS``, by linearisation."""
    rest = linearised(blade, 0.0, axis, stiffening=stiffening)
    speeds = np.array(SPEEDS) * linearised(blade, 0.0, FLAP, stiffening=stiffening)
    frequencies = np.array([linearised(blade, speed, axis, stiffening=stiffening) for speed in speeds])
    return np.asarray((frequencies**2 - rest**2) / speeds**2)


def simulated(blade: ExudynBody, parts: Sequence[float] = SIMULATED, periods: int = PERIODS) -> dict[str, Floats]:
    """c of the first flap mode at speeds that are ``parts`` of the frequency at rest, by simulation."""
    rest = linearised(blade, 0.0, FLAP, stiffening=False)
    speeds, end = np.array(parts) * rest, periods * 2 * math.pi / rest
    at_rest = frequency(*in_ours(blade, 0.0, end, stiffening=False))
    runs = {"with stiffening": True, "without": False}
    measured = {
        f"morembs {name}": [frequency(*in_ours(blade, speed, end, stiffening=s)) for speed in speeds]
        for name, s in runs.items()
    }
    if not exudyn_missing():
        measured["Exudyn"] = [frequency(*in_theirs(blade, speed, end)) for speed in speeds]
    return {name: (np.array(frequencies) ** 2 - at_rest**2) / speeds**2 for name, frequencies in measured.items()}


def picture(
    path: Path,
    blade: ExudynBody,
    lines: dict[tuple[int, bool], Floats],
    parts: Sequence[float],
    dots: dict[str, Floats],
) -> None:
    """Coefficients of flap and lag over the speed, and the flap frequency that follows from them."""
    speeds, few = np.array(SPEEDS), np.array(parts)
    x = "speed, as a part of the first flap frequency at rest"
    looks = {"morembs with stiffening": (OURS, "o"), "morembs without": (THIRD, "s"), "Exudyn": (THEIRS, "x")}
    kinds = ((True, "with stiffening, linearised", OURS), (False, "without, linearised", THIRD))
    panels = []
    for axis, words in ((FLAP, "flap (out of the plane of rotation)"), (LAG, "lag (in the plane)")):
        curves = [Curve(speeds, lines[axis, s], name, color) for s, name, color in kinds]
        curves.append(Curve(speeds, np.full(len(speeds), SOUTHWELL[axis]), "beam theory", "#202020", ":"))
        if axis == FLAP:
            curves += [Curve(few, c, f"{name}, simulated", *looks[name]) for name, c in dots.items()]
        panels.append(Panel(f"Southwell coefficient, first {words}", x, "c", curves))
    rest = linearised(blade, 0.0, FLAP, stiffening=True) / (2 * math.pi)
    curves = [Curve(speeds, rest * np.sqrt(1 + lines[FLAP, s] * speeds**2), name, color) for s, name, color in kinds]
    panels.append(Panel("First flap frequency", x, "Hz", curves))
    draw(path, "Rotating beam", panels)


def main(arguments: Sequence[str] | None = None) -> int:
    """Makes body and picture, prints the figures. Returns the exit code."""
    options = parse(arguments, "A rotating beam with and without geometric stiffening.", __file__)
    blade = make_body(Path(__file__).with_suffix(".toml"), options.folder, SIZE, CELLS)
    lines = {(axis, s): coefficients(blade, axis, stiffening=s) for axis in (FLAP, LAG) for s in (True, False)}
    parts = SIMULATED[-1:] if options.quick else SIMULATED
    dots = simulated(blade, parts, 3 if options.quick else PERIODS)
    for axis, name in ((FLAP, "flap"), (LAG, "lag")):
        right, wrong = lines[axis, True], lines[axis, False]
        print(
            f"{name}, linearised: c = {right.min():.4f} to {right.max():.4f} with stiffening, {wrong.min():.4f} to "
            f"{wrong.max():.4f} without; beam theory {SOUTHWELL[axis]}"
        )
    for name, c in dots.items():
        print(f"flap, simulated, {name}: c = {', '.join(f'{value:.4f}' for value in c)}")
    if exudyn_missing():
        print(f"{exudyn_missing()}. One simulator is shown alone.")
    picture(options.folder / "rotating_beam.png", blade, lines, parts, dots)
    return 0


if __name__ == "__main__":
    sys.exit(main())
