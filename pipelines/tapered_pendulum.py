#!/usr/bin/env python3
"""A soft tapered plate, pinned at its wide end, falls from the horizontal: in morembs, and as an FMU in FMPy.

tapered_pendulum.toml reduces a mesh of plane elements, which is written here, by global modal parameterisation to its
end frames and two amplitudes. Draws tapered_pendulum.png: the paths of the tip, and how far they are apart. Without
FMPy (pip install fmpy) or a C compiler only the first is drawn.
"""

from __future__ import annotations

import importlib.util
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import meshio
import numpy as np
from common import OURS, THEIRS, Curve, Floats, Panel, difference, draw, parse

from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job
from morembs.dynamics.gmp import ReducedMember
from morembs.dynamics.gmp.export import export_member
from morembs.dynamics.gmp.stored import read_members
from morembs.dynamics.nonlinear import Mechanism, simulate
from morembs.exporters.fmu.compiler import compiler

LENGTH, WIDE, NARROW, GRAVITY = 0.3, 0.03, 0.01, -9.81
ELEMENTS, QUICK_ELEMENTS, END, QUICK_END, STEP = (24, 2), (12, 1), 0.3, 0.1, 1e-3


def write_mesh(path: Path, elements: tuple[int, int]) -> None:
    """Quadrangles of four nodes along the plate, whose height falls from WIDE to NARROW."""
    along, across = elements
    x, s = np.meshgrid(np.linspace(0, LENGTH, along + 1), np.linspace(-0.5, 0.5, across + 1))
    y = s * (WIDE + (NARROW - WIDE) * x / LENGTH)
    corner = (np.arange(across)[:, None] * (along + 1) + np.arange(along)).ravel()
    cells = np.column_stack((corner, corner + 1, corner + along + 2, corner + along + 1))
    meshio.Mesh(np.column_stack((x.ravel(), y.ravel(), 0 * x.ravel())), [("quad", cells)]).write(path, "gmsh22")


def fall(member: ReducedMember, end: float) -> tuple[Floats, Floats, float]:
    """Times (T,), path (T, 2) m of the tip and the drift of the energy per largest kinetic energy."""
    mechanism = Mechanism(gravity=(0.0, GRAVITY))
    tip = mechanism.point((member.length, 0))
    mechanism.add(member, mechanism.point((0, 0), fixed="xy"), tip)
    motion = simulate(mechanism, end=end, step=STEP / 4, rho=1.0)
    energy = motion.kinetic + motion.potential
    drift = float(np.abs(energy - energy[0]).max() / motion.kinetic.max())
    return motion.times[::4], motion.q[::4][:, tip.numbers], drift


def fall_as_fmu(file: Path, end: float) -> Floats | None:
    """The same path in FMPy, None where that is not here."""
    if importlib.util.find_spec("fmpy") is None or not compiler():
        return None
    from fmpy import simulate_fmu

    fmu = export_member(file, "fmu", options={"held": ["start.x", "start.y"]}).paths[0]
    tip = ["end.position.x", "end.position.y"]
    start = {"gravity.y": GRAVITY, "tolerance": 1e-9}
    found = simulate_fmu(
        str(fmu), stop_time=end, output_interval=STEP, fmi_type="CoSimulation", start_values=start, output=tip
    )
    return np.array([found[name] for name in tip]).T


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs both, prints the figures and draws the picture. Returns the exit code."""
    options = parse(arguments, "A soft tapered plate as a pendulum, in morembs and as an FMU.", __file__)
    end, job = QUICK_END if options.quick else END, options.folder / "tapered_pendulum.toml"
    if job.resolve() != Path(__file__).with_suffix(".toml").resolve():
        shutil.copyfile(Path(__file__).with_suffix(".toml"), job)
    write_mesh(job.with_suffix(".msh"), QUICK_ELEMENTS if options.quick else ELEMENTS)
    result = run_job(load_job(job))
    member = ReducedMember.of(read_members(result.job.output)["plate"])
    times, path, drift = fall(member, end)
    print(f"tip at t = {end:g} s: ({path[-1][0]:.5f}, {path[-1][1]:.5f}) m; drift of the energy {drift:.1e}")
    curves, panels = [Curve(*path.T, "morembs", OURS, width=3.5)], list[Panel]()
    other = fall_as_fmu(result.job.output, end)
    if other is not None:
        gap = np.linalg.norm(other - path, axis=1)
        print(f"FMU in FMPy: {gap.max() / LENGTH:.1e} of the length apart at most")
        curves.append(Curve(*other.T, "FMU in FMPy", THEIRS))
        panels.append(difference(times, gap, LENGTH))
    title = f"Path of the tip, {member.modes} modes"
    draw(options.folder / "tapered_pendulum.png", "Soft tapered pendulum", [Panel(title, "m", "m", curves), *panels])
    return 0


if __name__ == "__main__":
    sys.exit(main())
