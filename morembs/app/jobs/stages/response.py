"""``[response]``: frequency responses of the full and the reduced model; the picture has one without it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from morembs.app.jobs.compare import FrequencyResponse, certified_response, frequency_response
from morembs.app.jobs.job import Job
from morembs.app.jobs.stages.body import BODIES
from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.stage import JobStage, Result, Work
from morembs.app.jobs.stages.unreduced import PARTS
from morembs.app.jobs.tolerances import TOL
from morembs.base.types import Floats
from morembs.body import Body
from morembs.reducers import ProblemSummary
from morembs.reducers.cost import response_seconds
from morembs.reducers.problem_summary import ShiftedFactorisations

RESPONSE: Result[FrequencyResponse] = Result("response")


class Response(JobStage):
    """The response that certificates were made with, or one of its own where it is asked for or drawn."""

    tables = ("response", "output")
    needs = (PROBLEM, PARTS, BODIES)
    gives = (RESPONSE,)

    def shifted(self, job: Job, facts: ProblemSummary) -> Mapping[str, Sequence[ShiftedFactorisations]]:
        given = job.tables.response
        if given is not None:
            return {"[response]": facts.at_frequencies(given.points)}
        drawn = job.picture is not None and job.tables.certify is None and facts.inputs
        return {"the picture": facts.at_frequencies(TOL.picture_points)} if drawn else {}

    def followed_seconds(self, job: Job, facts: ProblemSummary) -> Mapping[str, float]:
        return {} if job.tables.response is None else {"[response]": response_seconds(facts.size, facts.inputs)}

    def run(self, work: Work) -> None:
        job, problem, bodies, parts = work.job, work[PROBLEM], work[BODIES], work.get(PARTS)
        response = certified_response(problem, bodies)
        drawn = job.picture is not None and 0 < problem.B.shape[1] <= TOL.max_interface_dofs
        if job.tables.response is not None or (response is None and drawn):
            with work.watch.stage("response"):
                against = problem if parts is None else parts.problem
                response = frequency_response(against, bodies, _band(job, bodies[0]))
        if response is not None:
            work.give(RESPONSE, response)


def _band(job: Job, body: Body) -> Floats:
    given = job.tables.response
    if given is not None:
        return np.geomspace(given.from_hz, given.to_hz, given.points)
    known = body.frequencies_hz if body.full_frequencies_hz is None else body.full_frequencies_hz
    elastic = known[known > 0][: max(job.tables.check.full_modes, 1)]
    return np.geomspace(TOL.picture_band[0] * elastic[0], TOL.picture_band[1] * elastic[-1], TOL.picture_points)
