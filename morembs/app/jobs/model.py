"""The model of a job: read from its model file, or assembled from its mesh, within the budget."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from morembs.app.jobs.equations import equations_of_motion
from morembs.app.jobs.forecast import least_memory, require_room_of_mesh
from morembs.app.jobs.inputs import mesh_of
from morembs.app.jobs.job import Job
from morembs.app.jobs.preflight import require_room
from morembs.base.budget import Budget
from morembs.base.progress import Stopwatch
from morembs.fem import FEModel
from morembs.fem.assembly import assemble
from morembs.fem.material import Material
from morembs.importers.model_file import read_model
from morembs.linalg.sparse.solver import LinearSolver

if TYPE_CHECKING:
    from morembs.parametric.terms import VariedModel


def model_of(
    job: Job, solver: LinearSolver, materials: Sequence[Material], budget: Budget, start: int, watch: Stopwatch
) -> tuple[FEModel, VariedModel | None]:
    """The model of the job, from its model file or assembled from its mesh, and what its parameters make of it."""
    asked = job.tables.model
    if asked.mesh is None:
        with watch.stage("read"):
            model = matrices_of(job, budget)
        require_room(job, start, model.size, lambda: least_memory(job, model, solver, start))
        return equations_of_motion(job, model), None
    with watch.stage("read"):
        mesh = mesh_of(job)
    require_room_of_mesh(job, mesh, materials, solver, start)
    with watch.stage("assemble"):
        if job.tables.parameter:
            # Not at the top: most jobs have no parameters.
            from morembs.app.jobs.parameters import varied_of

            varied = varied_of(job, mesh, materials, budget)
            return varied.model(varied.box.nominal, budget), varied
        model = assemble(mesh, materials, mass_integration=asked.mass_integration, budget=budget)
        return model, None


def matrices_of(job: Job, budget: Budget) -> FEModel:
    """The model of a job without a mesh, whose matrices are ready: of a model file, or of bodies."""
    if job.tables.model.file is not None:
        return read_model(job.resolve(job.tables.model.file), budget=budget)
    # Not at the top: most jobs have a mesh.
    from morembs.app.jobs.assembly import assembly_of

    return assembly_of(job, budget)
