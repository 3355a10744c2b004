"""``[spin]``: matrices of a frame that turns with the body, for all speeds."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.durations import least_seconds
from morembs.app.jobs.stages.preload import PreloadTable
from morembs.app.jobs.stages.reduction import REDUCED
from morembs.app.jobs.stages.stage import JobStage, Result, Work
from morembs.app.jobs.tables import Job, JobTables, OptionalTable, Three
from morembs.base.arguments import refuse_out_of_range
from morembs.base.errors import InputError
from morembs.base.key_tables import declare_key
from morembs.base.limits import Finite, length, number
from morembs.body.floating.spin import ReducedSpin
from morembs.body.floating.spinning import Rotation, Spin, assemble_spin
from morembs.body.floating.spinning_modes import modes_over_speed, refuse_damping, with_spin
from morembs.reducers import ProblemSummary

SPIN: Result[Spin] = Result("spin")
SPINS: Result[Sequence[ReducedSpin | None]] = Result("spins")


@dataclass(frozen=True, kw_only=True)
class SpinTable(OptionalTable):
    """``[spin]``: matrices of a frame that turns with the body, for all speeds."""

    speed: Annotated[list[Finite], length("speeds such as [0, 100, 400] (rad/time)", 1, sys.maxsize)]
    axis: Three = declare_key("the direction of the axis, [x, y, z]")
    point: Three = declare_key("a point of the axis, [x, y, z]", [0.0, 0.0, 0.0])
    held: list[str] = declare_key("names of the interfaces at rest in the frame that turns", [])
    stress: bool = declare_key("true or false: the centrifugal stress stiffens", True)
    modes: Annotated[int, number("a count of complex modes", ge=1, le=1000)] = 12

    def refuse_conflicts(self) -> None:
        Rotation(axis=self.axis, point=self.point)


class SpinMatrices(JobStage):
    """The matrices of the full model that spins."""

    tables = (SpinTable,)
    needs = (PROBLEM,)
    gives = (SPIN,)
    step = "spin"

    def refuse_conflicts(self, tables: JobTables) -> None:
        if SpinTable.of(tables) is not None and PreloadTable.of(tables) is not None:
            raise InputError(
                "[preload] was given beside [spin], which has its own static stress; leave one out",
                kind="conflict",
                keyword="preload",
            )

    def is_asked(self, job: Job) -> bool:
        return SpinTable.of(job) is not None

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        """Refuse axes, supports, damping and reductions that do not spin."""
        rotation, _ = rotation_of(job)
        rotation.check(facts.model, [interface.name for interface in facts.interfaces])
        refuse_damping(facts.damping, rigid)
        for name, reducer in job.reducers.items():
            if reducer.two_sided:
                raise InputError(
                    f"[spin]: the body {name!r} comes from a two-sided reduction; spin needs a one-sided one",
                    kind="unsupported",
                    keyword="spin",
                )
        return ()

    def run(self, work: Work) -> None:
        spin = assemble_spin(work[PROBLEM], rotation_of(work.job)[0])
        work.tell(*spin.warnings)
        work.give(SPIN, spin)


class SpinModes(JobStage):
    """The reduced bodies with their matrices of spin, and with the modes over the speed."""

    tables = (SpinTable,)
    needs = (PROBLEM, SPIN, REDUCED)
    gives = (REDUCED, SPINS)
    step = "spin modes"

    def is_asked(self, job: Job) -> bool:
        return SpinTable.of(job) is not None

    def seconds(self, job: Job, facts: ProblemSummary, factor_entries: int) -> Mapping[str, float]:
        further = len(SpinTable.require(job).speed) - 1
        return {self.step: further * least_seconds(self.step, facts.size)}

    def run(self, work: Work) -> None:
        given, (_, speeds) = SpinTable.require(work.job), rotation_of(work.job)
        full = modes_over_speed(work[PROBLEM], work[SPIN], speeds, given.modes)
        reduced, spins = zip(*(with_spin(work[PROBLEM], body, work[SPIN], full) for body in work[REDUCED]), strict=True)
        work.give(REDUCED, reduced)
        work.give(SPINS, spins)


def rotation_of(job: Job) -> tuple[Rotation, list[float]]:
    """The axis of [spin] and the speeds in rad/s, of a job that has one."""
    given, units = SpinTable.require(job), job.units
    rotation = Rotation(
        axis=given.axis,
        point=[units.length * value for value in given.point],
        held=tuple(given.held),
        stress=given.stress,
    )
    speeds = [speed / units.time for speed in given.speed]
    refuse_out_of_range("[spin]: speed", speeds)
    return rotation, speeds
