"""``[[interface]]`` and ``[damping]``: the model with its interfaces, looked through before anything is factorised."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from morembs.app.jobs.solver import SolverTable
from morembs.app.jobs.stages.preflight import model_warnings, preflight
from morembs.app.jobs.stages.stage import MODEL, JobStage, Result, Results, Work
from morembs.app.jobs.tables import Job, RepeatedTable, SingleTable, Three
from morembs.base.errors import InputError
from morembs.base.key_tables import Table, declare_key
from morembs.base.limits import DampingRatio, Finite, NotNegative, number, text
from morembs.fem import FEModel, Mesh
from morembs.fem.interface import COUPLINGS, Interface, make_interface, matrix_interface
from morembs.fem.selection import select_nodes
from morembs.importers.dependent_dofs import interface_of_coupling
from morembs.problem import Damping, Problem
from morembs.problem.damping import modal_steps
from morembs.reducers import ProblemSummary

if TYPE_CHECKING:
    from morembs.parametric.terms import VariedModel

INTERFACES: Result[Sequence[Interface]] = Result("interfaces")
PROBLEM: Result[Problem] = Result("problem")
VARIED: Result[VariedModel] = Result("varied")


@dataclass(frozen=True, kw_only=True)
class InterfaceTable(RepeatedTable):
    """``[[interface]]``: where other bodies touch the part."""

    name: Annotated[str, text("a name without slashes", r"^[^/\s.\x00-\x1f][^/\x00-\x1f]*$", longest=100)]
    nodes: str | None = declare_key('a selection of nodes such as "set:BIGEND"', None)
    matrix: str | None = declare_key(
        'in place of nodes, columns of B or rows of C such as "B:drive", "C:tip,base" or "B"', None
    )
    coupling: str = declare_key(
        "one of " + ", ".join(repr(name) for name in COUPLINGS.own if name != "matrix"), "rigid"
    )
    point: Three | None = declare_key("the origin of the interface, [x, y, z]", None)
    components: list[int] | None = declare_key("some of [0, 1, 2, 3, 4, 5]", None)

    def refuse_conflicts(self) -> None:
        if self.nodes is None and self.matrix is None:
            raise InputError(
                'nodes is missing; expected a selection of nodes such as "set:BIGEND"', kind="missing", keyword="nodes"
            )
        if self.matrix is not None:
            beside = {"nodes", "coupling", "point", "components"} & self.given
            if beside:
                raise InputError(
                    f"matrix and {min(beside)} were both given; columns of a matrix say all, leave it out",
                    kind="conflict",
                )


@dataclass(frozen=True, kw_only=True)
class RayleighTable(Table):
    """D = alpha M + beta K, in the declared unit of time."""

    alpha: Annotated[float, number("a number, zero or more (1/time)", ge=0)] = 0.0
    beta: Annotated[float, number("a number, zero or more (time)", ge=0)] = 0.0


@dataclass(frozen=True, kw_only=True)
class DampingTable(SingleTable):
    """``[damping]``: Rayleigh or modal damping, structural damping with either."""

    rayleigh: RayleighTable | None = declare_key("a table { alpha = ..., beta = ... }", None)
    modal: DampingRatio | str | list[list[Finite]] | None = declare_key(
        "a part of critical damping from 0 to 1, such as 0.02 for 2 percent, or a table [[0, ratio], "
        '[frequency_hz, ratio], ...], or a named table such as "adams"',
        None,
    )
    structural: NotNegative | None = declare_key("a loss factor, zero or more, for the frequency domain only", None)

    def refuse_conflicts(self) -> None:
        if isinstance(self.modal, str | list):
            modal_steps(self.modal)
        if self.rayleigh is not None and self.modal is not None:
            raise InputError("rayleigh and modal were both given; choose one", kind="conflict", keyword="rayleigh")


class Couple(JobStage):
    """The problem of the job, of nominal values where it has parameters."""

    tables = (InterfaceTable, DampingTable)
    needs = (MODEL, VARIED)
    gives = (INTERFACES, PROBLEM)
    tells = (MODEL, INTERFACES)
    step = "couple"

    def prepare(self, job: Job) -> None:
        damping_of(job)

    def run(self, work: Work) -> None:
        job, model = work.job, work[MODEL]
        work.tell(*model_warnings(job, model))
        work.give(INTERFACES, interfaces_of(job, model))
        problem = make_problem(work, model, work.get(VARIED))
        work.give(PROBLEM, problem)
        work.tell(*preflight(job, ProblemSummary.of(problem), problem.rigid.shape[1]), stored=False)

    def document(self, job: Job, results: Results) -> Mapping[str, Any]:
        model = results[MODEL]
        return {
            "nodes": len(model.nodes),
            "elements": count_elements(model.mesh),
            "dofs": model.size,
            "interfaces": [interface.name for interface in results[INTERFACES]],
        }


def make_problem(work: Work, model: FEModel, varied: VariedModel | None) -> Problem:
    """The problem of ``model`` with the interfaces that are there."""
    job = work.job
    options: dict[str, Any] = {
        "damping": damping_of(job),
        "solver": work.solver,
        "workers": SolverTable.of(job).workers,
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
    for table in InterfaceTable.of(job):
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
            raise error.restate(f"interface {table.name!r}: {error}") from error
        interfaces.append(
            make_interface(
                model, name=table.name, nodes=rows, coupling=table.coupling, point=point, components=table.components
            )
        )
    return interfaces


def damping_of(job: Job) -> Damping:
    """The damping with alpha in 1/s and beta in s; the frequencies of a table are in Hz whatever the unit of time."""
    given, time = DampingTable.of(job), job.units.time
    structural = given.structural or 0.0
    if given.rayleigh is not None:
        alpha, beta = given.rayleigh.alpha / time, given.rayleigh.beta * time
        return Damping(alpha=alpha, beta=beta, structural=structural)
    if isinstance(given.modal, str | list):
        return Damping(modal_table=given.modal, structural=structural)
    return Damping(modal=given.modal or 0.0, structural=structural)


def count_elements(mesh: Mesh | None) -> int:
    """Number of elements of all types, none without a mesh."""
    return sum(len(block.ids) for block in mesh.blocks) if mesh is not None else 0
