"""Runs a job: mesh file to body file, every stage measured."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morembs.band import POINTS, band_frequencies
from morembs.body import ElasticBody, make_part
from morembs.budget import Budget
from morembs.certify import Certificate, certify
from morembs.compare import FrequencyResponse, Shapes, certified_response, frequency_response, mode_shapes
from morembs.delivery import Delivery, StressOptions, deliver
from morembs.errors import InputError, SolverError
from morembs.examination import examined
from morembs.fem import assemble
from morembs.followers import interface_of_coupling
from morembs.importers import read_mesh
from morembs.interface import Interface, make_interface
from morembs.job import Job
from morembs.linalg.select import select_solver
from morembs.linalg.solver import FactorStats, LinearSolver
from morembs.linalg.threads import limit_threads
from morembs.material import Material, isotropic, orthotropic
from morembs.model import FEModel, Mesh
from morembs.model_file import read_model
from morembs.picture import draw
from morembs.preload import Preload, preloaded
from morembs.problem import Damping, Problem
from morembs.progress import SILENT, Progress, Stage, Stopwatch
from morembs.reducers import Automatic, CraigBampton, FreeInterface, Modal
from morembs.reducers.base import ReducedModel
from morembs.schema import MaterialTable
from morembs.selection import select_nodes
from morembs.stiffening import Envelope
from morembs.storage import check_writable, write_body
from morembs.units import Units, parse_units

log = logging.getLogger(__name__)
Floats = NDArray[np.float64]
# Band of the picture where no [response] asks for one: parts of the lowest and of the highest known mode.
BAND = (0.2, 1.1)
BAND_POINTS = 400
# Reductions that compute modes.
WITH_MODES = (Automatic, CraigBampton, FreeInterface, Modal)
# Reductions that follow the responses to all interface motions at once, and how many of these make sense.
WITH_RESPONSES = ("auto", "gramian", "balanced-truncation", "irka")
MOST_MOTIONS = 500


@dataclass(frozen=True, kw_only=True, eq=False)
class JobResult:
    """A finished job: what it made and what it cost. ``dofs`` counts those of the finite-element model,
    ``factor`` is the cost of the one factorisation and ``choice`` says why this solver made it."""

    job: Job
    nodes: int
    elements: int
    dofs: int
    bodies: tuple[ElasticBody, ...]
    factor: FactorStats
    choice: str
    stages: tuple[Stage, ...]
    response: FrequencyResponse | None = None
    shapes: Shapes | None = None

    @property
    def solver(self) -> str:
        """Name of the solver that made the factor."""
        return self.factor.backend


def run_job(job: Job, progress: Progress = SILENT) -> JobResult:
    """Reduce the model of ``job`` and write its body file and picture.

    Raises:
        MorembsError: input that cannot be used, a singular model, or a result that cannot be written.
    """
    watch = Stopwatch(progress)
    prepare_output(job)
    solver, materials = solver_of(job), materials_of(job)
    with limit_threads(job.tables.solver.threads), Budget(solver.memory, solver.scratch) as budget:
        return _run(job, solver, materials, budget, watch)


def _run(job: Job, solver: LinearSolver, materials: Sequence[Material], budget: Budget, watch: Stopwatch) -> JobResult:
    progress = watch.progress
    model = _read(job, materials, budget, watch)
    with watch.stage("couple"):
        interfaces = interfaces_of(job, model)
        problem = Problem(model, interfaces, solver=solver, damping=damping_of(job), budget=budget, progress=progress)
        wanted = delivery_of(job)
        wanted.check(problem)
    preload, preload_notes = preload_of(job), {}
    if preload is not None:
        with watch.stage("preload"), problem:
            stressed = preloaded(problem, preload, progress)
            model, preload_notes = stressed.model, dict(stressed.notes)
            problem = Problem(
                model, interfaces, solver=solver, damping=problem.damping, budget=budget, progress=progress
            )
    with problem:
        bodies = _reduce(job, problem, wanted, watch)
        response = certified_response(problem, bodies)
        if job.tables.response is not None or (
            response is None and job.picture is not None and interfaces and problem.B.shape[1] <= MOST_MOTIONS
        ):
            with watch.stage("response"):
                response = frequency_response(problem, bodies, _band(job, bodies[0]), progress)
        shapes = mode_shapes(problem, bodies[0].reduced) if job.picture is not None else None
        factor = problem.statics.factor.stats
        analysis = problem.statics.factor.analysis
    with watch.stage("write"):
        provenance = _provenance(job, factor, watch.stages)
        write_body(
            job.output, bodies, recipe=_recipe(job, model) | preload_notes, provenance=provenance, progress=progress
        )
    if job.picture is not None:
        with watch.stage("draw"):
            draw(job.picture, bodies, shapes, response)
    return JobResult(
        job=job, nodes=len(model.nodes), elements=count_elements(model.mesh), dofs=model.size, bodies=bodies,
        factor=factor, choice=analysis.choice if analysis else "", stages=tuple(watch.stages), response=response,
        shapes=shapes,
    )  # fmt: skip


def _read(job: Job, materials: Sequence[Material], budget: Budget, watch: Stopwatch) -> FEModel:
    """The model of the job, from its model file or assembled from its mesh, examined."""
    asked, progress = job.tables.model, watch.progress
    if asked.file is not None:
        with watch.stage("read"):
            model: FEModel = read_model(job.resolve(asked.file), budget=budget)
            _examine(model, budget)
        return model
    with watch.stage("read"):
        mesh = read_mesh(source_of(job), units_of(job))
    with watch.stage("assemble"):
        model = assemble(mesh, materials, mass_integration=asked.mass_integration, budget=budget, progress=progress)
        _examine(model, budget)
    return model


def _examine(model: FEModel, budget: Budget) -> None:
    for warning in examined(model, budget=budget):
        log.warning("%s", warning)


def source_of(job: Job) -> Path:
    """The mesh or model file."""
    return job.resolve(job.tables.model.file or job.tables.model.mesh or "")


def _reduce(job: Job, problem: Problem, wanted: Delivery, watch: Stopwatch) -> tuple[ElasticBody, ...]:
    """One body for each reduction, and the free-free frequencies of the full model to compare with."""
    size = problem.K.shape[0]
    refuse_reductions_that_do_not_fit(job, size, problem.B.shape[1])
    count = min(job.tables.check.full_modes, size - problem.rigid.shape[1])
    with watch.stage("factorise"):
        if wants_modes(job):
            problem.require_room_for_modes()
        _ = problem.statics
    if count:
        with watch.stage("solve modes"):
            problem.elastic_modes(count=count)
    reduced = []
    for name, reducer in job.reducers.items():
        with watch.stage(f"reduce {name}"):
            try:
                reduced.append(reducer.reduce(problem, name=name, progress=watch.progress))
            except (InputError, SolverError) as error:
                if type(error) not in (InputError, SolverError):
                    raise
                raise type(error)(f"[[reduce]] {name!r}: {error}") from error
    certificates: Sequence[Certificate | None] = [None] * len(reduced)
    band = _certified_band(job)
    if band is not None:
        with watch.stage("certify"):
            given = job.tables.certify
            frequencies = band_frequencies(problem, band, POINTS if given is None else given.points)
            certificates = certify(
                problem, reduced, frequencies, bound=given is None or given.bound, progress=watch.progress
            )
    return _delivered(job, problem, reduced, certificates, wanted, watch)


def _delivered(
    job: Job, problem: Problem, reduced: Sequence[ReducedModel], certificates: Sequence[Certificate | None],
    wanted: Delivery, watch: Stopwatch,
) -> tuple[ElasticBody, ...]:  # fmt: skip
    """The bodies with all that goes into their file."""
    part, progress = make_part(problem, job.tables.output.nodes), watch.progress
    with watch.stage("deliver"):
        operator = wanted.stress.operator(problem, progress) if wanted.stress is not None else None
        return tuple(
            deliver(problem, one, part, wanted, certificate=its, operator=operator, progress=progress)
            for one, its in zip(reduced, certificates, strict=True)
        )


def _certified_band(job: Job) -> Sequence[float] | None:
    """The band of [certify], or the widest that a reduction was made for with a tolerance."""
    if job.tables.certify is not None:
        return job.tables.certify.band_hz
    bands = [reducer.band_hz for reducer in job.reducers.values() if isinstance(reducer, Automatic)]
    return (min(band[0] for band in bands), max(band[1] for band in bands)) if bands else None


def wants_modes(job: Job) -> bool:
    """Whether any modes are computed, and so counted."""
    wanted = bool(job.tables.check.full_modes) or job.tables.certify is not None
    return wanted or any(isinstance(reducer, WITH_MODES) for reducer in job.reducers.values())


def units_of(job: Job) -> Units:
    """The declared units."""
    given = job.tables.model.units
    return parse_units(given if isinstance(given, str) else given.model_dump())


def materials_of(job: Job) -> list[Material]:
    """The materials in SI units."""
    units = units_of(job)
    return [_material(table, units) for table in job.tables.material]


def _material(table: MaterialTable, units: Units) -> Material:
    density = table.density * units.density
    if isinstance(table.young, list) and isinstance(table.poisson, list) and table.shear is not None:
        E1, E2, E3 = (value * units.stress for value in table.young)
        nu12, nu13, nu23 = table.poisson
        G12, G13, G23 = (value * units.stress for value in table.shear)
        return orthotropic(
            set=table.set, young=(E1, E2, E3), poisson=(nu12, nu13, nu23), shear=(G12, G13, G23),
            density=density, axes=None if table.axes is None else np.array(table.axes),
        )  # fmt: skip
    if isinstance(table.young, list) or isinstance(table.poisson, list):
        raise InputError(f"material of set {table.set!r}: young and poisson must be one number each")
    return isotropic(set=table.set, young=table.young * units.stress, poisson=table.poisson, density=density)


def interfaces_of(job: Job, model: FEModel) -> list[Interface]:
    """The interfaces on the nodes of ``model``."""
    length = units_of(job).length
    found = []
    for table in job.tables.interface:
        point = None if table.point is None else [length * value for value in table.point]
        if table.nodes.startswith("coupling:"):
            coupling = table.coupling if "coupling" in table.model_fields_set else None
            found.append(
                interface_of_coupling(
                    model, table.nodes, name=table.name, coupling=coupling, point=point, components=table.components
                )
            )
            continue
        try:
            rows = select_nodes(model, table.nodes, length=length)
        except InputError as error:
            raise InputError(f"interface {table.name!r}: {error}") from error
        found.append(
            make_interface(
                model, name=table.name, nodes=rows, coupling=table.coupling, point=point,
                components=table.components,
            )
        )  # fmt: skip
    return found


def damping_of(job: Job) -> Damping:
    """The damping with alpha in 1/s and beta in s; the frequencies of a table are in Hz whatever the unit of time."""
    given, time = job.tables.damping, units_of(job).time
    structural = given.structural or 0.0
    if given.rayleigh is not None:
        alpha, beta = given.rayleigh.alpha / time, given.rayleigh.beta * time
        return Damping(alpha=alpha, beta=beta, structural=structural)
    if isinstance(given.modal, str | list):
        return Damping(modal_table=given.modal, structural=structural)
    return Damping(modal=given.modal or 0.0, structural=structural)


def delivery_of(job: Job) -> Delivery:
    """What every body of the job carries, in SI units."""
    units, tables = units_of(job), job.tables
    given, origin = tables.envelope, tables.frame.origin
    envelope = None
    if given is not None:
        force = units.mass * units.length / units.time**2
        scale = {
            "acceleration": units.length / units.time**2, "angular_acceleration": units.time**-2,
            "speed": 1 / units.time, "force": force, "moment": force * units.length,
        }  # fmt: skip
        values = given.model_dump(exclude_none=True)
        envelope = Envelope(**{name: value * scale[name] for name, value in values.items()})
    stiffened = tables.stiffening
    stress = tables.stress
    return Delivery(
        kind=tables.frame.kind, interfaces=tuple(tables.frame.interfaces), envelope=envelope,
        origin=None if origin == "center-of-mass" else [units.length * float(x) for x in origin or (0, 0, 0)],
        stiffening=None if stiffened is None else replace(envelope or Envelope(), share=stiffened.share),
        stress=None if stress is None else StressOptions(
            nodes=stress.nodes, single=stress.single, correction=stress.correction, length=units.length
        ),
    )  # fmt: skip


def preload_of(job: Job) -> Preload | None:
    """The preload in SI units, None without one."""
    given, units = job.tables.preload, units_of(job)
    if given is None:
        return None
    force, acceleration = units.mass * units.length / units.time**2, units.length / units.time**2
    scale = [force] * 3 + [force * units.length] * 3
    return Preload(
        wrench={name: [value * s for value, s in zip(f, scale, strict=True)] for name, f in given.wrench.items()},
        speed=given.speed / units.time, axis=given.axis, point=[units.length * value for value in given.point],
        acceleration=[acceleration * value for value in given.acceleration], held=tuple(given.held),
        follows=tuple(given.follows),
    )  # fmt: skip


def solver_of(job: Job) -> LinearSolver:
    """The solver with its budget and scratch folder."""
    given = job.tables.solver
    scratch = None if given.scratch is None else job.resolve(given.scratch)
    if scratch is not None and not scratch.is_dir():
        raise InputError(f"[solver]: scratch = {given.scratch!r} is not a folder; make it, or leave the key out")
    return select_solver(given.name, memory=job.memory, scratch=scratch)


def prepare_output(job: Job) -> None:
    """Check before any work that the results can be written."""
    inputs = {"the job file": job.path, "the mesh" if job.tables.model.mesh else "the model file": source_of(job)}
    results = {"[output] path": job.output, **({} if job.picture is None else {"[output] picture": job.picture})}
    for name, path in results.items():
        for other, taken in inputs.items():
            if path.resolve() == taken.resolve():
                raise InputError(f"{name} = {str(path)!r} would overwrite {other}; give it a name of its own")
        check_writable(path)
        inputs[name] = path


def refuse_reductions_that_do_not_fit(job: Job, size: int, inputs: int) -> None:
    """Check options against a model of ``size`` coupled dofs and ``inputs`` interface motions.

    Raises:
        InputError: one does.
    """
    if not inputs and job.tables.certify is not None:
        raise InputError("[certify] compares motions of interfaces, and there are none; add at least one [[interface]]")
    for table, asked in (("certify", job.tables.certify), ("response", job.tables.response)):
        if asked is not None and inputs > MOST_MOTIONS:
            raise InputError(
                f"[{table}] compares the responses of all interface motions, {inputs} x {inputs} at each frequency, "
                f"and at most {MOST_MOTIONS} motions fit; leave [{table}] out, or take rigid or average couplings"
            )
    for name, reducer in job.reducers.items():
        modes = getattr(reducer, "modes", None)
        if modes is not None and modes > size:
            raise InputError(
                f"[[reduce]] {name!r}: modes = {modes} was given, but the coupled model has only {size} degrees of "
                "freedom; ask for fewer modes"
            )
        if not inputs and (reducer.method != "modal" or getattr(reducer, "interfaces", "") == "fixed"):
            raise InputError(
                f"[[reduce]] {name!r}: method = {reducer.method!r} needs interfaces; add at least one [[interface]], "
                'or take method = "modal"'
            )
        few = isinstance(reducer, CraigBampton) and reducer.reduces_interfaces
        if inputs > MOST_MOTIONS and reducer.method in WITH_RESPONSES:
            raise InputError(
                f"[[reduce]] {name!r}: method = {reducer.method!r} follows the responses to each of {inputs} interface "
                f"motions, and at most {MOST_MOTIONS} fit; take craig-bampton with interface_up_to_hz, or rigid or "
                "average couplings"
            )
        if few and (getattr(reducer, "interface_modes", None) or 0) > inputs:
            raise InputError(
                f"[[reduce]] {name!r}: interface_modes = {getattr(reducer, 'interface_modes', 0)} was given, but there "
                f"are only {inputs} interface motions; ask for fewer"
            )
        if modes is not None and not few and getattr(reducer, "inertia_modes", False) and modes < inputs:
            raise InputError(
                f"[[reduce]] {name!r}: modes = {modes} was given with inertia_modes; expected at least {inputs}, one "
                "for each interface motion"
            )


def count_elements(mesh: Mesh | None) -> int:
    """Number of elements of all types, none without a mesh."""
    return sum(len(block.ids) for block in mesh.blocks) if mesh is not None else 0


def _band(job: Job, body: ElasticBody) -> Floats:
    given = job.tables.response
    if given is not None:
        return np.geomspace(given.from_hz, given.to_hz, given.points)
    known = body.frequencies_hz if body.full_frequencies_hz is None else body.full_frequencies_hz
    elastic = known[known > 0][: max(job.tables.check.full_modes, 1)]
    return np.geomspace(BAND[0] * elastic[0], BAND[1] * elastic[-1], BAND_POINTS)


def _recipe(job: Job, model: FEModel) -> dict[str, object]:
    """What was asked for and of what: the same for the same input."""
    asked = job.tables.model_dump(exclude_none=True, exclude={"output", "solver"})
    return {**asked, "dofs": model.size, "source": model.source}


def _provenance(job: Job, factor: FactorStats, stages: Sequence[Stage]) -> dict[str, object]:
    return {
        "job": job.text,
        "solver": factor.backend,
        "factor": asdict(factor),
        "seconds": {stage.name: stage.seconds for stage in stages},
        "peak_memory_bytes": {stage.name: stage.peak_memory_bytes for stage in stages},
    }
