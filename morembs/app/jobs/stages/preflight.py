"""What is refused or warned of before a job factorises: one pass for ``check`` and for ``reduce``."""

from __future__ import annotations

from morembs.app.jobs.stages.stage import select_stages
from morembs.app.jobs.tables import Job, ModelTable
from morembs.app.jobs.tolerances import TOL
from morembs.base.errors import InputError
from morembs.base.progress import duration_words
from morembs.body.diagnostics.warnings import examined_mesh, list_warnings
from morembs.fem import FEModel
from morembs.importers.model_file import is_model_file
from morembs.reducers import ProblemSummary
from morembs.reducers.problem_summary import ShiftedFactorisations
from morembs.responses.direct import why_no_response


def model_warnings(job: Job, model: FEModel) -> tuple[str, ...]:
    """Warnings about the model of ``job``: about its units where it is meshed, about its matrices where they came.

    Raises:
        InputError: matrices that no reduction takes.
    """
    table = ModelTable.of(job)
    if table.mesh is None:
        files = table.with_paths(job.resolve).files if table.brings_matrices else ()
        # A model file is in SI units, whatever those of its origin were.
        return list_warnings(model, declared=None if not files or any(map(is_model_file, files)) else job.units)
    return examined_mesh(model, job.units)


def preflight(job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
    """Warnings about what the reductions of ``job`` will cost; ``rigid`` is the number of rigid-body motions.

    Raises:
        InputError: a model that ``reduce`` would refuse after the factorisation, as far as that is known before.
    """
    warnings = [warning for stage in select_stages(job) for warning in stage.check(job, facts, rigid)]
    return (*_many_motions(job, facts), *warnings)


def refuse_responses(key: str, facts: ProblemSummary) -> None:
    """Refuse to compare the responses of all interface degrees of freedom, as the table ``key`` asks.

    Raises:
        InputError: there are too many, or the damping allows none.
    """
    if facts.inputs > TOL.max_interface_dofs:
        raise InputError(
            f"[{key}] compares the responses of all interface degrees of freedom, {facts.inputs} x {facts.inputs} "
            f"at each frequency, and at most {TOL.max_interface_dofs} fit; leave [{key}] out, or take rigid or "
            "average couplings",
            kind="unsupported",
            keyword=key,
        )
    reason = why_no_response(facts.damping, facts.own_damping, facts.size)
    if reason:
        raise InputError(f"[{key}]: {reason}")


def collect_factorisations(job: Job, facts: ProblemSummary) -> dict[str, ShiftedFactorisations]:
    """What is factorised beside K, by the words for what asks for it."""
    return {
        words: each
        for stage in select_stages(job)
        for words, found in stage.plan_factorisations(job, facts).items()
        for each in found
    }


def _many_motions(job: Job, facts: ProblemSummary) -> list[str]:
    if facts.inputs <= TOL.many_interface_dofs:
        return []
    took = {words: took for stage in select_stages(job) for words, took in stage.followed_seconds(job, facts).items()}
    if not took:
        return []
    words = ", ".join(f"{name} about {duration_words(seconds)}" for name, seconds in took.items())
    return [
        f"the responses to all {facts.inputs} interface degrees of freedom are followed, which takes long: {words} at "
        "the speed of this machine now, within a factor of three. Give the interface a rigid or average coupling (6 "
        'degrees of freedom), or take method = "craig-bampton" with interface_up_to_hz and no [certify]'
    ]
