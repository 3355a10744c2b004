#!/usr/bin/env python3
"""A very flexible rod, pinned at one end, falls from the horizontal: full beam and reduced member.

flexible_pendulum.toml reduces it by global modal parameterisation to its end frames and three amplitudes. Draws
flexible_pendulum.png: the paths of the tip and its errors over time. Other formulations, members and stiffnesses:
python -m studies.flexible_pendulum
"""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from common import THEIRS, Curve, Floats, Panel, draw, parse

from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job
from morembs.dynamics.gmp import ReducedMember
from morembs.dynamics.gmp.stored import read_members
from morembs.dynamics.nonlinear import FullMember, Mechanism, MechanismMotion, Member, PlanarBeam, Section, simulate

LENGTH, A, I, DENSITY, GRAVITY = 0.304, 7.854e-5, 4.909e-10, 2770.0, (0.0, -9.81)  # noqa: E741
E = 3e6  # Pa, as in the job
ELEMENTS, END, STEP, QUICK_END = 24, 0.5, 5e-4, 0.15


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

    def error(self, reference: Fall) -> Floats:
        """Distance (T,) of the tip to that of another run, per length of the rod."""
        return np.linalg.norm(self.tip - reference.tip, axis=1) / LENGTH


def rod(E: float, length: float = LENGTH, elements: int = ELEMENTS) -> PlanarBeam:
    """The rod, or a part of it."""
    return PlanarBeam.straight(length, elements, Section.of(E=E, A=A, I=I, density=DENSITY))


def fall(member: Member, count: int = 1, *, end: float = END, step: float = STEP, offline: float = 0.0) -> Fall:
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


def from_job(job: Path, folder: Path) -> tuple[ReducedMember, float]:
    """The member of a job, copied to ``folder``, from the file that it writes, and the seconds that it took."""
    toml = folder / job.name
    if folder.resolve() != job.resolve().parent:
        shutil.copyfile(job, toml)
    result = run_job(load_job(toml))
    return ReducedMember.of(read_members(result.job.output)["rod"]), sum(stage.seconds for stage in result.stages)


def rms(values: Floats) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs both, prints the figures and draws the picture. Returns the exit code."""
    options = parse(arguments, "A very flexible pendulum: full beam and reduced member.", __file__)
    end = QUICK_END if options.quick else END
    full = fall(FullMember(rod(E)), end=end)
    member, offline = from_job(Path(__file__).with_suffix(".toml"), options.folder)
    reduced = fall(member, end=end, offline=offline)
    error, (x, y), (full_x, full_y) = reduced.error(full), reduced.tip[-1], full.tip[-1]
    print(
        f"tip at t = {end:g} s: ({x:.5f}, {y:.5f}) m, all coordinates ({full_x:.5f}, {full_y:.5f}) m; "
        f"error / length {rms(error):.5f} rms, {error.max():.5f} at most"
    )
    print(
        f"drift of the energy {reduced.drift:.1e}; {reduced.offline:.2f} s offline, {reduced.seconds:.2f} s online, "
        f"all coordinates {full.seconds:.2f} s"
    )
    draw(
        options.folder / "flexible_pendulum.png",
        "Very flexible pendulum",
        [
            Panel(
                f"Path of the tip, E = {E:g} Pa",
                "m",
                "m",
                [
                    Curve(*full.tip.T, "all coordinates", THEIRS, width=3.5),
                    Curve(*reduced.tip.T, f"GMP, {member.modes} modes", width=1.2),
                ],
            ),
            Panel(
                "Error of the tip",
                "time, s",
                "part of the length",
                [Curve(reduced.motion.times, np.maximum(error, 1e-7))],
                logarithmic=True,
            ),
        ],
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
