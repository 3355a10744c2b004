"""The model of a job: read from its model file, or assembled from its mesh, within the budget."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from morembs.budget import Budget
from morembs.errors import InputError
from morembs.jobs.forecast import least_memory, require_room_of_mesh
from morembs.jobs.inputs import flows_of, matrices_of, mesh_of
from morembs.jobs.job import Job
from morembs.jobs.preflight import require_room
from morembs.linalg.sparse.solver import LinearSolver
from morembs.model import FEModel
from morembs.model.assembly import assemble
from morembs.model.fe_model import split_unsymmetric
from morembs.model.material import Material
from morembs.model.tubes import conveying
from morembs.problem import Problem
from morembs.progress import Stopwatch

# Part of a rigid motion by which neighbours move apart as a tube turns; round-off of translations is far below.
TURNED = 1e-9

if TYPE_CHECKING:
    from morembs.parametric.terms import VariedModel


def model_of(
    job: Job, solver: LinearSolver, materials: Sequence[Material], budget: Budget, start: int, watch: Stopwatch
) -> tuple[FEModel, VariedModel | None]:
    """The model of the job, from its model file or assembled from its mesh, and what its parameters make of it."""
    asked, progress = job.tables.model, watch.progress
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
            from morembs.jobs.parameters import varied_of

            varied = varied_of(job, mesh, materials, budget, progress)
            return varied.model(varied.box.nominal, budget), varied
        model = assemble(mesh, materials, mass_integration=asked.mass_integration, budget=budget, progress=progress)
        return model, None


def equations_of_motion(job: Job, model: FEModel) -> FEModel:
    """The ``model`` of the file with what the job makes of its skew parts, and with the fluid that flows through it."""
    model = _without_skew_parts(model, job.tables.model.unsymmetric)
    flows = flows_of(job, model)
    still = model
    for path, flow in flows:
        model = conveying(model, path, flow)
    # Paths are checked by then.
    _refuse_loose_tubes(still, [path for path, flow in flows if flow.mass_flow])
    return model


def _refuse_loose_tubes(model: FEModel, paths: Sequence[NDArray[np.int64]]) -> None:
    """Refuse tubes that nothing keeps from turning in ``model``, which is without the flow.

    Raises:
        InputError: as said.
    """
    if not paths:
        return
    with Problem(model) as problem:
        rigid = np.vstack([problem.rigid, np.zeros((1, problem.rigid.shape[1]))])
    # Dofs that are not there are at rest, the last row.
    places = rigid[model.dofs.table(len(model.nodes))[:, :3]]
    for path in paths:
        turned = np.abs(np.diff(places[path], axis=0)).max(initial=0.0)
        if turned > TURNED * np.abs(places).max(initial=0.0):
            raise InputError(
                "[[flow]]: nothing keeps the tube from turning as a whole, and the pull of the fluid, which keeps its "
                "direction, would turn it; hold it in the model at one end or more"
            )


def _without_skew_parts(model: FEModel, unsymmetric: str) -> FEModel:
    """``model`` with the skew parts of K and D in N and G, or without them where they are to be dropped."""
    if unsymmetric == "refuse":
        return model
    parts = split_unsymmetric(model)
    return parts if unsymmetric == "split" else replace(parts, G=model.G, N=model.N)
