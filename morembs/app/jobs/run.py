"""Runs a job: mesh file to body file, every stage measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from morembs.app.jobs.compare import (
    FrequencyResponse,
    certified_response,
    frequency_response,
    know_frequencies,
    recommended,
)
from morembs.app.jobs.inputs import (
    MOST_INTERFACE_DOFS,
    body_options,
    budget_of,
    certified_band,
    damping_of,
    interfaces_of,
    materials_of,
    preload_of,
    prepare_output,
    reducers_of,
    rotation_of,
    solver_of,
    wants_modes,
)
from morembs.app.jobs.job import Job
from morembs.app.jobs.model import model_of
from morembs.app.jobs.preflight import BAND_POINTS, model_warnings, preflight
from morembs.base.budget import Budget
from morembs.base.errors import InputError, SolverError
from morembs.base.memory import PeakMemory, resident_bytes
from morembs.base.progress import Progress, Stage, Stopwatch, listening
from morembs.base.summary import summarised
from morembs.base.types import Floats
from morembs.body import Body, make_part
from morembs.body.build import BodyOptions, build_body
from morembs.body.delivery_check import delivered_warnings
from morembs.body.file import write_body
from morembs.body.floating.preload import preloaded
from morembs.body.floating.spin import ReducedSpin
from morembs.body.floating.spinning import Spin, spinning
from morembs.body.floating.spinning_modes import modes_over_speed, with_spin
from morembs.body.shapes import Shapes, mode_shapes
from morembs.fem import FEModel, Mesh
from morembs.fem.material import Material
from morembs.linalg.sparse.solver import FactorStats, LinearSolver
from morembs.linalg.sparse.threads import limit_threads
from morembs.problem import Problem
from morembs.reducers import Facts
from morembs.reducers.base import ReducedModel
from morembs.storage.contents import Content, keeping_ledger

if TYPE_CHECKING:
    from morembs.certificate.certify import Certificate
    from morembs.dynamics.assembly import Unreduced
    from morembs.fem.interface import Interface
    from morembs.parametric.terms import VariedModel

# Band of the picture where no [response] asks for one: parts of the lowest and of the highest known mode.
BAND = (0.2, 1.1)


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class JobResult:
    """A finished job: what it made and what it cost. ``dofs`` counts those of the finite-element model,
    ``peak_memory_bytes`` is the peak resident memory of the process during the job, ``factor`` the cost of the one
    factorisation and ``choice`` says why this solver made it; ``warnings`` are sentences about the model and the
    bodies; ``inputs`` what was in each file that the model was read from, by the name that was opened."""

    job: Job
    nodes: int
    elements: int
    dofs: int
    bodies: tuple[Body, ...]
    factor: FactorStats
    choice: str
    stages: tuple[Stage, ...]
    peak_memory_bytes: int
    response: FrequencyResponse | None = None
    shapes: Shapes | None = None
    warnings: tuple[str, ...] = ()
    inputs: Mapping[str, Content] = field(default_factory=dict)

    def _facts(self) -> dict[str, object]:
        return {
            "job": self.job.path.name,
            "dofs": self.dofs,
            "solver": self.solver,
            "bodies": ", ".join(f"{body.name} (order {body.reduced.order})" for body in self.bodies),
            "seconds": sum(stage.seconds for stage in self.stages),
            "warnings": len(self.warnings) or None,
        }

    @property
    def solver(self) -> str:
        """Name of the solver that made the factor."""
        return self.factor.backend


def unheard(_: str) -> None:
    """The default for warnings: they are in the result too."""


@keeping_ledger()
def run_job(job: Job, progress: Progress | None = None, warn: Callable[[str], None] = unheard) -> JobResult:
    """Reduce the model of ``job`` and write its body file and picture.

    ``warn`` hears each warning about the model and the cost of its reductions before the long work begins.

    Raises:
        MorembsError: input that cannot be used, a singular model, or a result that cannot be written.
    """
    start = resident_bytes()
    prepare_output(job)
    solver, materials = solver_of(job), materials_of(job)
    with (
        listening(progress),
        limit_threads(job.tables.solver.threads),
        budget_of(job, solver) as budget,
        PeakMemory() as memory,
    ):
        return _run(job, solver, materials, budget, start, Stopwatch(memory), warn)


def _run(
    job: Job,
    solver: LinearSolver,
    materials: Sequence[Material],
    budget: Budget,
    start: int,
    watch: Stopwatch,
    warn: Callable[[str], None],
) -> JobResult:
    with keeping_ledger() as ledger:
        model, varied = model_of(job, solver, materials, budget, start, watch)
        inputs = ledger.contents()
    warnings = of_model = model_warnings(job, model, budget)
    for warning in warnings:
        warn(warning)
    with watch.stage("couple"):
        interfaces = interfaces_of(job, model)
        workers = job.tables.solver.workers
        problem = _coupled(job, model, varied, interfaces, solver=solver, budget=budget, workers=workers)
        costs = preflight(job, Facts.of(problem), problem.rigid.shape[1])
        for warning in costs:
            warn(warning)
        warnings += costs
    preload, preload_notes = preload_of(job), {}
    if preload is not None:
        with watch.stage("preload"), problem:
            found = preloaded(problem, preload)
            preload_notes = dict(found.notes)
            if varied is None:
                model = found.model
            else:
                # Not at the top: most jobs have no parameters.
                from morembs.app.jobs.parameters import stressed

                varied = stressed(varied, model, preload, found)
                model = varied.model(varied.box.nominal, budget)
            problem = _coupled(job, model, varied, interfaces, solver=solver, budget=budget, workers=workers)
    with problem, _unreduced(job, problem, watch) as parts:
        rotation = rotation_of(job)
        spin = None
        if rotation is not None:
            with watch.stage("spin"):
                spin = spinning(problem, rotation[0])
            for warning in spin.warnings:
                warn(warning)
            warnings += spin.warnings
        bodies, notes = _reduce(job, problem, parts, body_options(job), spin, watch)
        delivered = delivered_warnings(bodies)
        warnings += (*delivered, *notes)
        response = certified_response(problem, bodies)
        if job.tables.response is not None or (
            response is None and job.picture is not None and interfaces and problem.B.shape[1] <= MOST_INTERFACE_DOFS
        ):
            with watch.stage("response"):
                against = problem if parts is None else parts.problem
                response = frequency_response(against, bodies, _band(job, bodies[0]))
        shapes = mode_shapes(problem, _shown(bodies).reduced) if job.picture is not None else None
        factor = problem.statics.factor.stats
        analysis = problem.statics.factor.analysis
    with watch.stage("write"):
        provenance = _provenance(job, inputs, factor, watch)
        write_body(
            job.output,
            bodies,
            recipe=_recipe(job, model) | preload_notes,
            provenance=provenance,
            warnings=(*of_model, *(() if spin is None else spin.warnings), *delivered),
        )
        _write_state_space(job, bodies)
        if varied is not None:
            # Not at the top: most jobs have no parameters.
            from morembs.parametric.steps import clear_steps

            clear_steps(job.output)
    if job.picture is not None:
        from morembs.app.jobs.picture import draw

        with watch.stage("draw"):
            draw(job.picture, bodies, shapes, response)
    return JobResult(
        job=job,
        nodes=len(model.nodes),
        elements=count_elements(model.mesh),
        dofs=model.size,
        bodies=bodies,
        factor=factor,
        choice=analysis.choice if analysis else "",
        stages=tuple(watch.stages),
        peak_memory_bytes=watch.peak_memory_bytes,
        response=response,
        shapes=shapes,
        warnings=warnings,
        inputs=inputs,
    )


def _write_state_space(job: Job, bodies: Sequence[Body]) -> None:
    """The file that [state_space] asks for."""
    asked = job.tables.state_space
    if asked is None or job.state_space is None:
        return
    # Not at the top: most jobs do without.
    from morembs.exporters.state_space import state_space
    from morembs.exporters.state_space_files import write_state_space

    body = _shown(bodies) if asked.body is None else next(each for each in bodies if each.name == asked.body)
    system = state_space(body, asked.inputs, asked.outputs, held=asked.held)
    write_state_space(job.state_space, system if asked.step is None else system.discrete(asked.step))


def _coupled(
    job: Job, model: FEModel, varied: VariedModel | None, interfaces: Sequence[Interface], **options: Any
) -> Problem:
    """The problem of the job, of nominal values where it has parameters."""
    damping = damping_of(job)
    if varied is None:
        return Problem(model, interfaces, damping=damping, **options)
    # Not at the top: most jobs have no parameters.
    from morembs.parametric.terms import AffineProblem

    return AffineProblem(varied, interfaces, damping=damping, model=model, output=job.output, **options)


def _unreduced(job: Job, problem: Problem, watch: Stopwatch) -> AbstractContextManager[Unreduced | None]:
    """The unreduced parts of an assembly, coupled, where the job names those that made its bodies."""
    if not any(table.job for table in job.tables.substructure):
        return nullcontext()
    # Not at the top: most jobs have a mesh.
    from morembs.dynamics.assembly import Unreduced

    with watch.stage("couple"):
        return Unreduced(problem)


def _reduce(
    job: Job, problem: Problem, parts: Unreduced | None, wanted: BodyOptions, spin: Spin | None, watch: Stopwatch
) -> tuple[tuple[Body, ...], tuple[str, ...]]:
    """One body for each reduction, compared with free-free frequencies of the full model, and notes on that.

    The full model is ``problem``, or the unreduced parts where they are known.
    """
    with watch.stage("factorise"):
        if wants_modes(job):
            problem.require_room_for_modes()
        _ = problem.statics
    reduced: list[ReducedModel] = []
    for name, reducer in reducers_of(job).items():
        with watch.stage(f"reduce {name}"):
            try:
                reduced.append(reducer.reduce(problem, name=name))
            except (InputError, SolverError) as error:
                if type(error) not in (InputError, SolverError):
                    raise
                raise type(error)(f"[[reduce]] {name!r}: {error}") from error
    spins: list[ReducedSpin | None] = [None] * len(reduced)
    if spin is not None and job.tables.spin is not None:
        _, speeds = rotation_of(job) or (None, [])
        with watch.stage("spin modes"):
            full = modes_over_speed(problem, spin, speeds, job.tables.spin.modes)
            reduced, spins = map(list, zip(*(with_spin(problem, body, spin, full) for body in reduced), strict=True))
    certificates: Sequence[Certificate | None] = [None] * len(reduced)
    against = problem if parts is None else parts.problem
    band = certified_band(job)
    if band is not None:
        # Not at the top: many jobs do without, and it takes a part of the memory of small ones.
        from morembs.certificate.certify import certify

        with watch.stage("certify"):
            given = job.tables.certify
            options = {} if given is None else given.values(but={"band_hz"})
            spanned = reduced if parts is None else [parts.expanded(body) for body in reduced]
            certificates = certify(against, spanned, band, **options)
            if parts is not None:
                certificates = [replace(each, notes=(parts.note, *each.notes)) for each in certificates]
    check, notes = job.tables.check, tuple[str, ...]()
    with watch.stage("compare") if check.full_modes else nullcontext():
        notes = know_frequencies(against, check.full_modes, insist="full_modes" in check.given)
    bodies = _delivered(job, problem, reduced, certificates, spins, wanted, watch)
    return tuple(replace(body, full_frequencies_hz=against.known_frequencies_hz()) for body in bodies), notes


def _delivered(
    job: Job,
    problem: Problem,
    reduced: Sequence[ReducedModel],
    certificates: Sequence[Certificate | None],
    spins: Sequence[ReducedSpin | None],
    wanted: BodyOptions,
    watch: Stopwatch,
) -> tuple[Body, ...]:
    """The bodies with all that goes into their file."""
    part = make_part(problem, job.tables.output.nodes)
    with watch.stage("deliver"):
        operator = wanted.stress.operator(problem) if wanted.stress is not None else None
        bodies = []
        for body, certificate, spin, reducer in zip(
            reduced, certificates, spins, reducers_of(job).values(), strict=True
        ):
            switching = reducer.switching(problem, body)
            variation = reducer.variation(problem, body)
            bodies.append(
                build_body(
                    problem,
                    body,
                    part,
                    wanted,
                    certificate=certificate,
                    operator=operator,
                    switching=switching,
                    variation=variation,
                    spin=spin,
                )
            )
        return tuple(bodies)


def _shown(bodies: Sequence[Body]) -> Body:
    """The body that is recommended, whose modes are drawn."""
    limits = {body.name: None if body.certificate is None else body.certificate.limit.upper for body in bodies}
    return next(body for body in bodies if body.name == recommended(limits))


def count_elements(mesh: Mesh | None) -> int:
    """Number of elements of all types, none without a mesh."""
    return sum(len(block.ids) for block in mesh.blocks) if mesh is not None else 0


def _band(job: Job, body: Body) -> Floats:
    given = job.tables.response
    if given is not None:
        return np.geomspace(given.from_hz, given.to_hz, given.points)
    known = body.frequencies_hz if body.full_frequencies_hz is None else body.full_frequencies_hz
    elastic = known[known > 0][: max(job.tables.check.full_modes, 1)]
    return np.geomspace(BAND[0] * elastic[0], BAND[1] * elastic[-1], BAND_POINTS)


def _recipe(job: Job, model: FEModel) -> dict[str, object]:
    """What was asked for and of what: the same for the same input."""
    asked = job.tables.values(without_none=True, but={"output", "solver"})
    return {**asked, "dofs": model.size, "source": model.source}


def _provenance(job: Job, inputs: Mapping[str, Content], factor: FactorStats, watch: Stopwatch) -> dict[str, object]:
    return {
        "job": job.text,
        "changes": list(job.changes) or None,
        "inputs": [
            {"file": name, "target": content.target, "sha256": content.sha256} for name, content in inputs.items()
        ],
        "solver": factor.backend,
        "factor": asdict(factor),
        "seconds": {stage.name: stage.seconds for stage in watch.stages},
        "peak_memory_bytes": {stage.name: stage.peak_memory_bytes for stage in watch.stages},
        "job_peak_memory_bytes": watch.peak_memory_bytes,
    }
