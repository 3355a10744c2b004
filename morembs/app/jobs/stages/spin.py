"""``[spin]``: matrices of a frame that turns with the body, for all speeds."""

from __future__ import annotations

from collections.abc import Sequence

from morembs.app.jobs.job import Job
from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.reduction import REDUCED
from morembs.app.jobs.stages.stage import JobStage, Result, Work
from morembs.base.arguments import refuse_out_of_range
from morembs.base.errors import InputError
from morembs.body.floating.spin import ReducedSpin
from morembs.body.floating.spinning import Rotation, Spin, spinning
from morembs.body.floating.spinning_modes import modes_over_speed, refuse_damping, with_spin
from morembs.reducers import ProblemSummary

SPIN: Result[Spin] = Result("spin")
SPINS: Result[Sequence[ReducedSpin | None]] = Result("spins")


class SpinMatrices(JobStage):
    """The matrices of the full model that spins."""

    tables = ("spin",)
    needs = (PROBLEM,)
    gives = (SPIN,)

    def is_asked(self, job: Job) -> bool:
        return job.tables.spin is not None

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        """Refuse axes, supports, damping and reductions that do not spin."""
        rotation, _ = rotation_of(job)
        rotation.check(facts.model, [interface.name for interface in facts.interfaces])
        refuse_damping(facts.damping, rigid)
        for name, reducer in job.reducers.items():
            if reducer.two_sided:
                raise InputError(
                    f"[spin]: the body {name!r} comes from a two-sided reduction; spin needs a one-sided one"
                )
        return ()

    def run(self, work: Work) -> None:
        with work.watch.stage("spin"):
            spin = spinning(work[PROBLEM], rotation_of(work.job)[0])
        work.tell(*spin.warnings)
        work.give(SPIN, spin)


class SpinModes(JobStage):
    """The reduced bodies with their matrices of spin, and with the modes over the speed."""

    tables = ("spin",)
    needs = (PROBLEM, SPIN, REDUCED)
    gives = (REDUCED, SPINS)

    def is_asked(self, job: Job) -> bool:
        return job.tables.spin is not None

    def run(self, work: Work) -> None:
        given = work.job.tables.spin
        if given is None:
            return
        _, speeds = rotation_of(work.job)
        with work.watch.stage("spin modes"):
            full = modes_over_speed(work[PROBLEM], work[SPIN], speeds, given.modes)
            reduced, spins = zip(
                *(with_spin(work[PROBLEM], body, work[SPIN], full) for body in work[REDUCED]), strict=True
            )
        work.give(REDUCED, reduced)
        work.give(SPINS, spins)


def rotation_of(job: Job) -> tuple[Rotation, list[float]]:
    """The axis of [spin] and the speeds in rad/s, of a job that has one."""
    given, units = job.tables.spin, job.units
    if given is None:
        raise InputError("the job has no table [spin]; add one")
    rotation = Rotation(
        axis=given.axis,
        point=[units.length * value for value in given.point],
        held=tuple(given.held),
        stress=given.stress,
    )
    speeds = [speed / units.time for speed in given.speed]
    refuse_out_of_range("[spin]: speed", speeds)
    return rotation, speeds
