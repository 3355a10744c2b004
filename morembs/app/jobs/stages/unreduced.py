"""``[[substructure]] job``: the unreduced parts of an assembly, coupled."""

from __future__ import annotations

from typing import TYPE_CHECKING

from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.parts import SubstructureTable
from morembs.app.jobs.stages.stage import JobStage, Result, Work
from morembs.app.jobs.tables import Job

if TYPE_CHECKING:
    from morembs.dynamics.assembly import Unreduced

PARTS: Result[Unreduced] = Result("parts")


class UnreducedParts(JobStage):
    """The unreduced parts, coupled, where the job names those that made its bodies."""

    tables = (SubstructureTable,)
    needs = (PROBLEM,)
    gives = (PARTS,)
    step = "couple parts"

    def is_asked(self, job: Job) -> bool:
        return any(table.job for table in SubstructureTable.of(job))

    def run(self, work: Work) -> None:
        # Not at the top: most jobs have a mesh.
        from morembs.dynamics.assembly import Unreduced

        work.give(PARTS, Unreduced(work[PROBLEM]))
