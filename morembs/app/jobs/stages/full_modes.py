"""``[check]``: the free-free frequencies of the full model that bodies are compared with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from morembs.app.jobs.compare import know_frequencies
from morembs.app.jobs.stages.certificate import CERTIFICATES
from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.reduction import REDUCED
from morembs.app.jobs.stages.stage import JobStage, Result, Work
from morembs.app.jobs.stages.unreduced import PARTS
from morembs.app.jobs.tables import Job, SingleTable
from morembs.base.limits import number
from morembs.reducers import ProblemSummary
from morembs.reducers.cost import mode_seconds

NOTES: Result[tuple[str, ...]] = Result("notes on full modes")


@dataclass(frozen=True, kw_only=True)
class CheckTable(SingleTable):
    """``[check]``: what the reduced bodies are compared with."""

    full_modes: Annotated[int, number("a count of free-free frequencies of the full model, 0 for none", ge=0)] = 10


class FullModes(JobStage):
    """The full model, or the unreduced parts, with its lowest frequencies known."""

    tables = (CheckTable,)
    needs = (PROBLEM, PARTS, REDUCED, CERTIFICATES)
    gives = (NOTES,)
    step = "compare"

    def is_asked(self, job: Job) -> bool:
        return bool(CheckTable.of(job).full_modes)

    def columns(self, job: Job, facts: ProblemSummary) -> int:
        return CheckTable.of(job).full_modes

    def seconds(self, job: Job, facts: ProblemSummary, factor_entries: int) -> Mapping[str, float]:
        return {self.step: mode_seconds(facts.size, CheckTable.of(job).full_modes, factor_entries)}

    def computes_modes(self, job: Job) -> bool:
        return True

    def run(self, work: Work) -> None:
        check, parts = CheckTable.of(work.job), work.get(PARTS)
        against = work[PROBLEM] if parts is None else parts.problem
        insist = "full_modes" in check.given
        work.give(NOTES, know_frequencies(against, check.full_modes, insist=insist))
