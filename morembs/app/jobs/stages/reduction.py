"""``[[reduce]]``: one reduced model for each table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from morembs.app.jobs.job import Job
from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.stage import JobStage, Result, Work
from morembs.app.jobs.tolerances import TOL
from morembs.base.errors import InputError, SolverError
from morembs.base.progress import duration_words
from morembs.reducers import ProblemSummary, Reducer
from morembs.reducers.base import ReducedModel
from morembs.reducers.cost import mode_seconds
from morembs.reducers.problem_summary import ShiftedFactorisations
from morembs.responses.direct import why_no_response

REDUCED: Result[Sequence[ReducedModel]] = Result("reduced")


class Reduction(JobStage):
    """The factorisation, and the reductions of the job."""

    tables = ("reduce",)
    needs = (PROBLEM,)
    gives = (REDUCED,)

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        """Ask every reduction, and the comparison of their responses, whether it can be made."""
        key = next((key for key in ("certify", "response") if getattr(job.tables, key) is not None), "")
        if key == "certify" and not facts.inputs:
            raise InputError(
                "[certify] compares interface degrees of freedom, and there are none; add at least one [[interface]]"
            )
        if key and facts.inputs > TOL.max_interface_dofs:
            raise InputError(
                f"[{key}] compares the responses of all interface degrees of freedom, {facts.inputs} x {facts.inputs} "
                f"at each frequency, and at most {TOL.max_interface_dofs} fit; leave [{key}] out, or take rigid or "
                "average couplings"
            )
        for name, reducer in reducers_of(job).items():
            if facts.inputs > TOL.max_interface_dofs and reducer.follows_responses:
                raise InputError(
                    f"[[reduce]] {name!r}: method = {reducer.method!r} follows the responses to each of {facts.inputs} "
                    f"interface degrees of freedom, and at most {TOL.max_interface_dofs} fit; take craig-bampton with "
                    "interface_up_to_hz, or rigid or average couplings"
                )
            reason = reducer.why_not(facts)
            if reason:
                raise InputError(f"[[reduce]] {name!r}: {reason}")
        reason = why_no_response(facts.damping, facts.own_damping, facts.size)
        if key and reason:
            raise InputError(f"[{key}]: {reason}")
        return tuple(_many_modes(job, facts.size))

    def shifted(self, job: Job, facts: ProblemSummary) -> Mapping[str, Sequence[ShiftedFactorisations]]:
        return {f"[[reduce]] {name!r}": reducer.shifted(facts) for name, reducer in job.reducers.items()}

    def followed_seconds(self, job: Job, facts: ProblemSummary) -> Mapping[str, float]:
        return {
            repr(name): reducer.seconds(facts) or 0.0
            for name, reducer in job.reducers.items()
            if reducer.follows_responses
        }

    def computes_modes(self, job: Job) -> bool:
        return any(reducer.computes_modes for reducer in job.reducers.values())

    def run(self, work: Work) -> None:
        problem, reduced = work[PROBLEM], list[ReducedModel]()
        with work.watch.stage("factorise"):
            if work.counts_modes:
                problem.require_room_for_modes()
            _ = problem.statics
        for name, reducer in reducers_of(work.job).items():
            with work.watch.stage(f"reduce {name}"):
                try:
                    reduced.append(reducer.reduce(problem, name=name))
                except (InputError, SolverError) as error:
                    if type(error) not in (InputError, SolverError):
                        raise
                    raise type(error)(f"[[reduce]] {name!r}: {error}") from error
        work.give(REDUCED, reduced)


def reducers_of(job: Job) -> dict[str, Reducer]:
    """Name -> reducer, selections of nodes in the declared units."""
    return {name: reducer.in_units(job.units.length) for name, reducer in job.reducers.items()}


def _many_modes(job: Job, size: int) -> list[str]:
    warnings = []
    for name, reducer in job.reducers.items():
        modes = reducer.mode_count
        if size > TOL.small_model_dofs and modes > min(TOL.many_modes_part * size, TOL.many_modes):
            took = duration_words(mode_seconds(size, modes, 0))
            warnings.append(
                f"[[reduce]] {name!r}: modes = {modes:,} of {size:,} dofs are many; to find them takes about {took} at "
                "the speed of this machine now, within a factor of three; ask for tens to a few hundred, or give "
                "up_to_hz two to three times the highest frequency of interest"
            )
    return warnings
