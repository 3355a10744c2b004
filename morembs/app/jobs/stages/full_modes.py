"""``[check]``: the free-free frequencies of the full model that bodies are compared with."""

from __future__ import annotations

from morembs.app.jobs.compare import know_frequencies
from morembs.app.jobs.job import Job
from morembs.app.jobs.stages.certificate import CERTIFICATES
from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.reduction import REDUCED
from morembs.app.jobs.stages.stage import JobStage, Result, Work
from morembs.app.jobs.stages.unreduced import PARTS

NOTES: Result[tuple[str, ...]] = Result("notes on full modes")


class FullModes(JobStage):
    """The full model, or the unreduced parts, with its lowest frequencies known."""

    tables = ("check",)
    needs = (PROBLEM, PARTS, REDUCED, CERTIFICATES)
    gives = (NOTES,)

    def is_asked(self, job: Job) -> bool:
        return bool(job.tables.check.full_modes)

    def computes_modes(self, job: Job) -> bool:
        return bool(job.tables.check.full_modes)

    def run(self, work: Work) -> None:
        check, parts = work.job.tables.check, work.get(PARTS)
        against = work[PROBLEM] if parts is None else parts.problem
        with work.watch.stage("compare"):
            insist = "full_modes" in check.given
            work.give(NOTES, know_frequencies(against, check.full_modes, insist=insist))
