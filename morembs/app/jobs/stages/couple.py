"""``[[interface]]`` and ``[damping]``: the model with its interfaces, looked through before anything is factorised."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from morembs.app.jobs.job import Job
from morembs.app.jobs.stages.preflight import model_warnings, preflight
from morembs.app.jobs.stages.stage import MODEL, JobStage, Result, Work
from morembs.base.errors import InputError
from morembs.fem import FEModel
from morembs.fem.interface import Interface, make_interface, matrix_interface
from morembs.fem.selection import select_nodes
from morembs.importers.dependent_dofs import interface_of_coupling
from morembs.problem import Damping, Problem
from morembs.reducers import ProblemSummary

if TYPE_CHECKING:
    from morembs.parametric.terms import VariedModel

INTERFACES: Result[Sequence[Interface]] = Result("interfaces")
PROBLEM: Result[Problem] = Result("problem")
VARIED: Result[VariedModel] = Result("varied")


class Couple(JobStage):
    """The problem of the job, of nominal values where it has parameters."""

    tables = ("interface", "damping")
    needs = (MODEL, VARIED)
    gives = (INTERFACES, PROBLEM)

    def run(self, work: Work) -> None:
        job, model = work.job, work[MODEL]
        work.tell(*model_warnings(job, model, work.budget))
        with work.watch.stage("couple"):
            work.give(INTERFACES, interfaces_of(job, model))
            problem = coupled(work, model, work.get(VARIED))
            work.give(PROBLEM, problem)
            work.tell(*preflight(job, ProblemSummary.of(problem), problem.rigid.shape[1]), stored=False)


def coupled(work: Work, model: FEModel, varied: VariedModel | None) -> Problem:
    """The problem of ``model`` with the interfaces that are there."""
    job = work.job
    options: dict[str, Any] = {
        "damping": damping_of(job),
        "solver": work.solver,
        "budget": work.budget,
        "workers": job.tables.solver.workers,
    }
    if varied is None:
        return Problem(model, work[INTERFACES], **options)
    # Not at the top: most jobs have no parameters.
    from morembs.parametric.terms import AffineProblem

    return AffineProblem(varied, work[INTERFACES], model=model, output=job.output, **options)


def interfaces_of(job: Job, model: FEModel) -> list[Interface]:
    """The interfaces on the nodes of ``model``."""
    length = job.units.length
    interfaces = []
    for table in job.tables.interface:
        point = None if table.point is None else [length * value for value in table.point]
        if table.matrix is not None:
            interfaces.append(matrix_interface(model, name=table.name, matrix=table.matrix))
            continue
        # Without a matrix there are nodes: the schema sees to it.
        nodes = table.nodes or ""
        if nodes.startswith("coupling:"):
            coupling = table.coupling if "coupling" in table.given else None
            interfaces.append(
                interface_of_coupling(
                    model, nodes, name=table.name, coupling=coupling, point=point, components=table.components
                )
            )
            continue
        try:
            rows = select_nodes(model, nodes, length=length)
        except InputError as error:
            raise InputError(f"interface {table.name!r}: {error}") from error
        interfaces.append(
            make_interface(
                model, name=table.name, nodes=rows, coupling=table.coupling, point=point, components=table.components
            )
        )
    return interfaces


def damping_of(job: Job) -> Damping:
    """The damping with alpha in 1/s and beta in s; the frequencies of a table are in Hz whatever the unit of time."""
    given, time = job.tables.damping, job.units.time
    structural = given.structural or 0.0
    if given.rayleigh is not None:
        alpha, beta = given.rayleigh.alpha / time, given.rayleigh.beta * time
        return Damping(alpha=alpha, beta=beta, structural=structural)
    if isinstance(given.modal, str | list):
        return Damping(modal_table=given.modal, structural=structural)
    return Damping(modal=given.modal or 0.0, structural=structural)
