"""``[certify]``: limits of the errors of the reductions at every frequency of a band."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from morembs.app.jobs.job import Job
from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.reduction import REDUCED
from morembs.app.jobs.stages.spin import SPINS
from morembs.app.jobs.stages.stage import JobStage, Result, Work
from morembs.app.jobs.stages.unreduced import PARTS
from morembs.reducers import ProblemSummary
from morembs.reducers.cost import response_seconds
from morembs.reducers.problem_summary import ShiftedFactorisations

if TYPE_CHECKING:
    from morembs.certificate.record import Certificate

CERTIFICATES: Result[Sequence[Certificate]] = Result("certificates")


class Certify(JobStage):
    """The certificates, against the unreduced parts of an assembly where they are known."""

    tables = ("certify",)
    needs = (PROBLEM, PARTS, REDUCED, SPINS)
    gives = (CERTIFICATES,)

    def is_asked(self, job: Job) -> bool:
        return certified_band(job) is not None

    def shifted(self, job: Job, facts: ProblemSummary) -> Mapping[str, Sequence[ShiftedFactorisations]]:
        given = job.tables.certify
        return {} if given is None else {"[certify]": facts.at_frequencies(given.points)}

    def followed_seconds(self, job: Job, facts: ProblemSummary) -> Mapping[str, float]:
        return {} if job.tables.certify is None else {"[certify]": response_seconds(facts.size, facts.inputs)}

    def computes_modes(self, job: Job) -> bool:
        return job.tables.certify is not None

    def run(self, work: Work) -> None:
        band, given, parts = certified_band(work.job), work.job.tables.certify, work.get(PARTS)
        if band is None:
            return
        # Not at the top: many jobs do without, and it takes a part of the memory of small ones.
        from morembs.certificate.certify import certify

        problem, reduced = work[PROBLEM], work[REDUCED]
        options = {} if given is None else given.values(but={"band_hz"})
        with work.watch.stage("certify"):
            against = problem if parts is None else parts.problem
            spanned = reduced if parts is None else [parts.expanded(body) for body in reduced]
            certificates = certify(against, spanned, band, **options)
        notes = () if parts is None else (parts.note,)
        work.give(CERTIFICATES, [replace(each, notes=(*notes, *each.notes)) for each in certificates])


def certified_band(job: Job) -> Sequence[float] | None:
    """The band of [certify], or the widest that a reduction was made for with a tolerance."""
    if job.tables.certify is not None:
        return job.tables.certify.band_hz
    bands = [band for reducer in job.reducers.values() if (band := reducer.certified_band) is not None]
    return (min(band[0] for band in bands), max(band[1] for band in bands)) if bands else None
