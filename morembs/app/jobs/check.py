"""Checks a job and forecasts its cost without assembling or factorising anything."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from morembs.app.jobs.equations import equations_of_motion
from morembs.app.jobs.files import prepare_output
from morembs.app.jobs.solver import SolverTable, budget_of, solver_of
from morembs.app.jobs.stages.couple import count_elements, damping_of, interfaces_of
from morembs.app.jobs.stages.durations import known_seconds, stage_seconds
from morembs.app.jobs.stages.forecast import (
    Cost,
    forecast_cost,
    least_memory,
    outline_model,
    require_room,
    require_room_of_mesh,
)
from morembs.app.jobs.stages.model import materials_of, mesh_of
from morembs.app.jobs.stages.preflight import collect_factorisations, model_warnings, preflight
from morembs.app.jobs.stages.stage import JobForecast, computes_modes, select_stages
from morembs.app.jobs.tables import Job
from morembs.app.jobs.tolerances import TOL
from morembs.base import progress
from morembs.base.memory import available_bytes, resident_bytes
from morembs.base.progress import Progress, listening
from morembs.base.scratch import free_bytes
from morembs.base.types import Floats, Ints
from morembs.fem import FEModel, Mesh, rigid_motion
from morembs.fem.assembly import check_mesh, stiffness_pattern
from morembs.fem.elements import TYPES
from morembs.fem.fe_model import MATRICES
from morembs.fem.interface import Interface, couple
from morembs.linalg.sparse.solver import LinearSolver
from morembs.linalg.sparse.threads import limit_threads
from morembs.problem import Problem
from morembs.problem.rigid_motions import need_factor
from morembs.reducers import ProblemSummary
from morembs.responses.massless import without_mass_perhaps
from morembs.storage.contents import keeping_ledger


@keeping_ledger()
def check_job(job: Job, progress: Progress | None = None) -> JobForecast:
    """Check everything that can be checked without a factorisation, and forecast the cost.

    Peak memory: the stiffness pattern and its triangle; the budget of the job is kept here too.

    Raises:
        MorembsError: what ``run_job`` would refuse too.
    """
    with listening(progress):
        return _check(job)


@dataclass(frozen=True, kw_only=True)
class _Outline:
    """A model before anything is factorised: ``K`` its stiffness, or the pattern of it, ``T`` its coupling."""

    facts: ProblemSummary
    K: sp.csr_array
    T: sp.csr_array
    rigid_modes: int
    stiffness_nonzeros: int
    mass_nonzeros: int
    matrices_bytes: int
    warnings: tuple[str, ...]


def _check(job: Job) -> JobForecast:
    start = resident_bytes()
    prepare_output(job)
    solver = solver_of(job)
    for stage in select_stages(job):
        stage.prepare(job)
    for stage in select_stages(job):
        if (known := stage.forecast(job)) is not None:
            return known
    progress.stage("read")
    with limit_threads(SolverTable.of(job).threads), budget_of(job, solver):
        given = next(filter(None, (stage.matrices(job) for stage in select_stages(job))), None)
        outline = _of_mesh(job, solver, start) if given is None else _of_matrices(job, given, solver, start)
        progress.stage("analyse")
        facts, model = outline.facts, outline.facts.model
        cost = forecast_cost(
            outline.K,
            outline.T,
            max(stage.columns(job, facts) for stage in select_stages(job)),
            solver,
            start,
            computes_modes(job),
            list(collect_factorisations(job, facts).values()),
            SolverTable.of(job).workers,
        )
        times = known_seconds(job, facts, cost.plan.factor_entries)
    x, y, z = np.ptp(model.nodes.xyz, axis=0).tolist()
    return JobForecast(
        **cost.forecast_fields(),
        nodes=len(model.nodes),
        elements=count_elements(model.mesh),
        dofs=model.size,
        coupled_dofs=outline.T.shape[1],
        rigid_modes=outline.rigid_modes,
        stiffness_nonzeros=outline.stiffness_nonzeros,
        mass_nonzeros=outline.mass_nonzeros,
        matrices_bytes=outline.matrices_bytes,
        extent=(x, y, z),
        interface_nodes={interface.name: len(interface.nodes) for interface in facts.interfaces},
        reduction_seconds={name: times[f"reduce {name}"] for name in job.reducers if f"reduce {name}" in times},
        seconds=stage_seconds(job, facts, cost, times),
        witness_bytes=sum(stage.witness_bytes(job, facts) for stage in select_stages(job)),
        warnings=(*outline.warnings, *_warnings(cost, solver.scratch)),
    )


def _of_mesh(job: Job, solver: LinearSolver, start: int) -> _Outline:
    """The outline of a mesh, which is not assembled."""
    mesh, materials = mesh_of(job), materials_of(job)
    progress.stage("check elements")
    require_room_of_mesh(job, mesh, materials, solver, start, computes_modes(job))
    graph = check_mesh(mesh, materials)
    for stage in select_stages(job):
        stage.check_mesh(job, mesh)
    progress.stage("check interfaces")
    model = outline_model(job, mesh, materials)
    warnings = model_warnings(job, model)
    interfaces = interfaces_of(job, model)
    coupling = couple(model, interfaces)
    facts = ProblemSummary(model=model, interfaces=interfaces, coupling=coupling, damping=damping_of(job))
    warnings += preflight(job, facts, 6)
    progress.stage("check connections")
    rigid = rigid_modes(mesh, [i for i in interfaces if i.kind.carries])
    if rigid > 6:
        # The matrices decide, which are not there.
        warnings += (
            f"the mesh has {rigid} rigid-body modes where one free body has 6: unconnected parts, or parts that touch "
            "in a node or an edge only; a reduction is refused unless each is held; merge coincident nodes, or reduce "
            "the parts one by one",
        )
    return _Outline(
        facts=facts,
        K=stiffness_pattern(graph),
        T=abs(coupling.T),
        rigid_modes=rigid,
        # Blocks of 3 x 3 entries of K; M couples equal components alone.
        stiffness_nonzeros=9 * graph.nnz,
        mass_nonzeros=3 * graph.nnz,
        matrices_bytes=12 * 12 * graph.nnz,
        warnings=warnings,
    )


def _of_matrices(job: Job, model: FEModel, solver: LinearSolver, start: int) -> _Outline:
    """The outline of a model whose matrices are there."""
    modes = computes_modes(job)
    require_room(job, start, model.size, modes, lambda: least_memory(job, model, solver, start, modes))
    progress.stage("examine")
    model = equations_of_motion(job, model)
    warnings = model_warnings(job, model)
    with Problem(model, interfaces_of(job, model), solver=solver, damping=damping_of(job)) as problem:
        facts, T = ProblemSummary.of(problem), problem.coupling.T
        # Nothing is factorised here.
        rigid = 0 if need_factor(model, problem.K) else problem.rigid.shape[1]
        warnings += without_mass_perhaps(problem)
    warnings += preflight(job, facts, rigid)
    # Coordinates that are rigid motions have no stiffness; what holds them while it is factorised has an entry.
    held = sp.diags_array((model.K.diagonal() == 0).astype(float))
    matrices = [A for name in MATRICES if (A := getattr(model, name)) is not None]
    return _Outline(
        facts=facts,
        K=sp.csr_array(model.K + held) if held.data.any() else model.K,
        T=T,
        rigid_modes=rigid,
        stiffness_nonzeros=model.K.nnz,
        mass_nonzeros=model.M.nnz,
        matrices_bytes=sum(A.data.nbytes + A.indices.nbytes for A in matrices),
        warnings=warnings,
    )


def _warnings(cost: Cost, scratch: Path | None) -> tuple[str, ...]:
    """What may go wrong on this machine."""
    warnings = []
    available = available_bytes()
    needed = cost.forecast_fields()["all_processes_bytes"]
    if needed > available:
        warnings.append(
            f"{needed / 1e9:.1f} GB of memory are forecast and {available / 1e9:.1f} GB are free; give [solver] a "
            "memory budget and a scratch folder"
        )
    if cost.plan.disk > (free := free_bytes(scratch)):
        warnings.append(
            f"the factor needs {cost.plan.disk / 1e9:.1f} GB of scratch, {free / 1e9:.1f} GB are free; give "
            "another folder"
        )
    return tuple(warnings)


def rigid_modes(mesh: Mesh, frames: list[Interface]) -> int:
    """Number of motions free of strain: 6 for one sound free body.

    Elements that share faces, and nodes held by one rigid interface, move together as a piece. Pieces that
    share nodes move alike there: 6 unknowns for each piece, 3 equations for each shared node, and what the
    equations leave is the answer. Beyond ``TOL.max_searched_pieces`` pieces only whole unconnected parts are counted.
    """
    pieces = _pieces(mesh)
    count = max(int(p.max(initial=-1)) for p in pieces) + 1
    pairs = []
    for block, own in zip(mesh.blocks, pieces, strict=True):
        pairs.append(np.stack([np.repeat(own, block.nodes.shape[1]), block.nodes.ravel()]))
    for number, frame in enumerate(frames):
        pairs.append(np.stack([np.full(len(frame.nodes), count + number), frame.nodes]))
    count += len(frames)
    piece, node = np.unique(np.concatenate(pairs, axis=1), axis=1)
    if count == 1:
        return 6
    shape = (count, len(mesh.nodes))
    C = sp.csr_array((np.ones(len(piece), dtype=np.int32), (piece, node)), shape=shape)
    if count > TOL.max_searched_pieces:
        parts, _ = connected_components(C @ C.T, directed=False)
        return 6 * int(parts)
    return 6 * count - _shared_rank(mesh.nodes.xyz, C)


def _shared_rank(xyz: Floats, C: sp.csr_array) -> int:
    """Rank of the equations that make pieces (rows of C) move alike at the nodes (columns) they share."""
    count = C.shape[0]
    by_node = C.tocsc()
    shared = np.flatnonzero(np.diff(by_node.indptr) > 1)
    centre = xyz.mean(axis=0)
    size = max(float(np.abs(xyz - centre).max()), np.finfo(float).tiny)
    gram = np.zeros((6 * count, 6 * count))
    for at in shared:
        R = rigid_motion(np.tile((xyz[at] - centre) / size, (3, 1)), np.arange(3))
        first, *others = by_node.indices[by_node.indptr[at] : by_node.indptr[at + 1]]
        for other in others:
            row = np.zeros((3, 6 * count))
            row[:, 6 * first : 6 * first + 6], row[:, 6 * other : 6 * other + 6] = R, -R
            gram += row.T @ row
    values = np.linalg.eigvalsh(gram)
    return int((values > TOL.independent_motion * max(values[-1], np.finfo(float).tiny)).sum())


def _pieces(mesh: Mesh) -> list[Ints]:
    """For each block the piece that each element belongs to; elements of a piece share faces."""
    keys, owners, first = [], [], 0
    for block in mesh.blocks:
        elements = np.arange(first, first + len(block.ids))
        for corners in TYPES[block.type].faces:
            # Three corners tell faces apart, for a quadrilateral the three lowest.
            keys.append(np.sort(block.nodes[:, list(corners)], axis=1)[:, :3])
            owners.append(elements)
        first += len(block.ids)
    key, owner = np.concatenate(keys), np.concatenate(owners)
    order = np.lexsort(key.T)
    key, owner = key[order], owner[order]
    same = np.flatnonzero((key[1:] == key[:-1]).all(axis=1))
    links = sp.csr_array((np.ones(len(same), dtype=np.int8), (owner[same], owner[same + 1])), shape=(first, first))
    _, label = connected_components(links, directed=False)
    ends = np.cumsum([len(block.ids) for block in mesh.blocks])
    return [np.asarray(part, dtype=np.int64) for part in np.split(label, ends[:-1])]
