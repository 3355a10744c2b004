"""``[response]``: frequency responses of the full and the reduced model; the picture has one without it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from morembs.app.jobs.compare import FrequencyResponse, certified_response, frequency_response
from morembs.app.jobs.stages.certificate import CertifyTable, certified_band
from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.full_modes import CheckTable
from morembs.app.jobs.stages.preflight import refuse_responses
from morembs.app.jobs.stages.stage import BODIES, JobStage, Result, Results, Work
from morembs.app.jobs.stages.unreduced import PARTS
from morembs.app.jobs.tables import CurvePoints, Job, OptionalTable, OutputTable
from morembs.app.jobs.tolerances import TOL
from morembs.app.report.sections import Place, Section
from morembs.base.errors import InputError
from morembs.base.limits import number
from morembs.base.tolerances import TOL as BASE
from morembs.base.types import Floats
from morembs.body import Body
from morembs.reducers import ProblemSummary
from morembs.reducers.cost import response_seconds
from morembs.reducers.problem_summary import ShiftedFactorisations
from morembs.responses.tolerances import TOL as RESPONSES

_LOWEST_HZ = RESPONSES.least_upper_hz
ResponseHertz = Annotated[
    float, number(f"a frequency in Hz from {_LOWEST_HZ:g} to {BASE.largest_hz:g}", gt=_LOWEST_HZ, lt=BASE.largest_hz)
]
RESPONSE: Result[FrequencyResponse] = Result("response")


@dataclass(frozen=True, kw_only=True)
class ResponseTable(OptionalTable):
    """``[response]``: frequency response of the full and the reduced model at logarithmic steps."""

    from_hz: ResponseHertz
    to_hz: ResponseHertz
    points: CurvePoints = 200

    def refuse_conflicts(self) -> None:
        if self.to_hz <= self.from_hz:
            raise InputError(f"from_hz = {self.from_hz:g} must lie below to_hz = {self.to_hz:g}", keyword="from_hz")


class Response(JobStage):
    """The response that certificates were made with, or one of its own where it is asked for or drawn."""

    tables = (ResponseTable, OutputTable)
    needs = (PROBLEM, PARTS, BODIES)
    gives = (RESPONSE,)
    tells = (RESPONSE,)
    steps = ("response",)

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        """Refuse responses that are too many to compare."""
        if ResponseTable.of(job) is not None:
            refuse_responses("response", facts)
        return ()

    def plan_factorisations(self, job: Job, facts: ProblemSummary) -> Mapping[str, Sequence[ShiftedFactorisations]]:
        given = ResponseTable.of(job)
        if given is not None:
            return {"[response]": facts.at_frequencies(given.points)}
        drawn = job.picture is not None and CertifyTable.of(job) is None and facts.inputs
        return {"the picture": facts.at_frequencies(TOL.picture_points)} if drawn else {}

    def followed_seconds(self, job: Job, facts: ProblemSummary) -> Mapping[str, float]:
        return {} if ResponseTable.of(job) is None else {"[response]": response_seconds(facts.size, facts.inputs)}

    def seconds(self, job: Job, facts: ProblemSummary, factor_entries: int) -> Mapping[str, float]:
        return {name: response_seconds(facts.size, facts.inputs, factor_entries) for name in self.named_steps(job)}

    def named_steps(self, job: Job) -> Sequence[str]:
        # A picture shows the responses of the certificates where there are any.
        drawn = job.picture is not None and certified_band(job) is None
        return self.steps if ResponseTable.of(job) is not None or drawn else ()

    def run(self, work: Work) -> None:
        job, problem, bodies, parts = work.job, work[PROBLEM], work[BODIES], work.get(PARTS)
        response = certified_response(bodies, problem.length)
        drawn = job.picture is not None and 0 < problem.B.shape[1] <= TOL.max_interface_dofs
        if ResponseTable.of(job) is not None or (response is None and drawn):
            with work.watch.stage("response"):
                against = problem if parts is None else parts.problem
                response = frequency_response(against, bodies, _band(job, bodies[0]))
        if response is not None:
            work.give(RESPONSE, response)

    def document(self, job: Job, results: Results) -> Mapping[str, Any]:
        response = results.get(RESPONSE)
        if response is None:
            return {}
        body, hz = results[BODIES][0], response.frequencies_hz
        low = hz <= TOL.quasistatic_part * _elastic(body)[:1].sum()
        errors = {
            name: {
                "largest_response_error": float(error.max()),
                "median_response_error": float(np.median(error)),
                "quasistatic_response_error": float(error[low].max()) if low.any() else None,
            }
            for name, error in response.error.items()
        }
        damped = bool(body.reduced.D.any() or body.reduced.structural)
        return {"response_band_hz": hz[[0, -1]].tolist(), "response_damped": damped, "bodies": errors}

    def sections(self, document: Mapping[str, Any]) -> Sequence[Section]:
        bodies = document["bodies"]
        if "response_band_hz" not in document or any(body["certificate"] for body in bodies.values()):
            return ()
        low, high = document["response_band_hz"]
        lines = [
            f"{name}: relative error of the frequency response at most {body['largest_response_error']:.2e} from "
            f"{low:,.6g} to {high:,.6g} Hz (median {body['median_response_error']:.1e}{_quasistatic(body)})"
            for name, body in bodies.items()
        ]
        largest = max(body["largest_response_error"] for body in bodies.values())
        if largest > TOL.large_error and not document["response_damped"]:
            lines.append(
                "  the largest errors lie at resonances: without damping their peaks are infinite, and a peak that "
                "moves by 0.1 % is wrong by more than all of it; look at the other two numbers, or give the job "
                "[damping], such as modal = 0.01"
            )
        return [Section(place=Place.REMARKS, lines=lines)]


def _quasistatic(body: Mapping[str, Any]) -> str:
    """The error well below the first resonance, where such frequencies were compared."""
    error = body["quasistatic_response_error"]
    return "" if error is None else f", below half the first resonance {error:.1e}"


def _band(job: Job, body: Body) -> Floats:
    given = ResponseTable.of(job)
    if given is not None:
        return np.geomspace(given.from_hz, given.to_hz, given.points)
    elastic = _elastic(body)[: max(CheckTable.of(job).full_modes, 1)]
    return np.geomspace(TOL.picture_band[0] * elastic[0], TOL.picture_band[1] * elastic[-1], TOL.picture_points)


def _elastic(body: Body) -> Floats:
    """Frequencies of elastic modes, of the full model where they are known."""
    known = body.frequencies_hz if body.full_frequencies_hz is None else body.full_frequencies_hz
    return known[known > 0]
