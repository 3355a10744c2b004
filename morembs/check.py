"""Checks a job and forecasts its size without assembling or factorising anything.

The forecast of the factor comes from measured nested-dissection factors of quadratic tetrahedra in compact
bodies: entries = 24 N^(4/3) (measured 18.6 to 26.2 times N^(4/3) from 26 thousand to 2 million dofs; a slender
body needs about half), 11 bytes each in memory, 35 % of that out of core. SuperLU stores 5.7 times as many.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from morembs.elements import TYPES
from morembs.errors import InputError
from morembs.fem import check_mesh
from morembs.importers import read_mesh
from morembs.interface import Interface, couple
from morembs.job import Job
from morembs.model import DofMap, FEModel, Mesh, rigid_motion
from morembs.progress import SILENT, Progress
from morembs.run import (
    count_elements,
    damping_of,
    interfaces_of,
    materials_of,
    prepare_output,
    refuse_reductions_that_do_not_fit,
    solver_of,
    units_of,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
ENTRIES = 24.0
BYTES_PER_ENTRY = 11.0
OUT_OF_CORE = 0.35
FILL = {"superlu": 5.7}
BYTES_PER_NONZERO = 12
# Bytes of all dense columns (basis, Krylov spaces of modes and response) against those of the basis, measured.
COPIES = 12
# More pieces than this are not searched for hinges.
MANY_PIECES = 300


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """What a job will need. Bytes are rough: a compact body is assumed, a slender one needs a
    third or less for its factor. ``extent`` (3,) in m."""

    solver: str
    nodes: int
    elements: int
    dofs: int
    coupled_dofs: int
    rigid_modes: int
    stiffness_nonzeros: int
    mass_nonzeros: int
    matrices_bytes: int
    factor_entries: int
    factor_bytes: int
    factor_out_of_core_bytes: int
    columns_bytes: int
    total_bytes: int
    extent: tuple[float, float, float]
    interface_nodes: dict[str, int]
    warnings: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """The fields as plain values."""
        return {**asdict(self), "warnings": list(self.warnings)}


def check_job(job: Job, progress: Progress = SILENT) -> Forecast:
    """Check everything that can be checked without a factorisation, and forecast the cost.

    Raises:
        MorembsError: what ``run_job`` would refuse too.
    """
    prepare_output(job)
    solver, materials = solver_of(job), materials_of(job)
    damping_of(job)
    progress.stage("read")
    mesh = read_mesh(job.resolve(job.tables.model.mesh), units_of(job))
    progress.stage("check elements")
    graph = check_mesh(mesh, materials, progress)
    progress.stage("check interfaces")
    size = 3 * len(mesh.nodes)
    empty = sp.csr_array((size, size))
    dofs = DofMap.translations(len(mesh.nodes))
    model = FEModel(K=empty, M=empty, nodes=mesh.nodes, dofs=dofs, mesh=mesh, source=mesh.source)
    interfaces = interfaces_of(job, model)
    coupling = couple(model, interfaces)
    coupled = coupling.T.shape[1]
    refuse_reductions_that_do_not_fit(job, coupled, coupling.B.shape[1])
    progress.stage("check connections")
    rigid = rigid_modes(mesh, [i for i in interfaces if i.coupling == "rigid"])
    if rigid > 6:
        raise InputError(
            f"the model has {rigid} rigid-body modes where one free body has 6: unconnected parts, or parts that "
            "touch in a node or an edge only; merge coincident nodes, or reduce the parts one by one"
        )
    columns = coupling.B.shape[1] + job.tables.check.full_modes
    columns += max(getattr(reducer, "modes", None) or 0 for reducer in job.reducers.values())
    return _forecast(job, mesh, graph.nnz, coupled, rigid, columns, solver.name, interfaces)


def _forecast(
    job: Job, mesh: Mesh, graph: int, coupled: int, rigid: int, columns: int, solver: str,
    interfaces: Sequence[Interface],
) -> Forecast:  # fmt: skip
    entries = int(FILL.get(solver, 1.0) * ENTRIES * coupled ** (4 / 3))
    # K and M of the model, and again in coupled dofs where interfaces are rigid.
    copies = 1 + any(interface.coupling == "rigid" for interface in interfaces)
    matrices = copies * BYTES_PER_NONZERO * 12 * graph
    factor = int(BYTES_PER_ENTRY * entries)
    out_of_core = factor if solver == "superlu" else int(OUT_OF_CORE * factor)
    dense = COPIES * 8 * coupled * columns
    held = factor if job.memory is None else min(factor, max(job.memory, out_of_core))
    warnings = []
    if job.memory is not None and factor > job.memory and solver != "superlu":
        warnings.append(
            f"the factors may exceed the budget of {job.tables.solver.memory} and then go into the scratch folder"
        )
    x, y, z = np.ptp(mesh.nodes.xyz, axis=0).tolist()
    return Forecast(
        solver=solver, nodes=len(mesh.nodes), elements=count_elements(mesh), dofs=3 * len(mesh.nodes),
        coupled_dofs=coupled, rigid_modes=rigid, stiffness_nonzeros=9 * graph, mass_nonzeros=3 * graph,
        matrices_bytes=matrices, factor_entries=entries, factor_bytes=factor,
        factor_out_of_core_bytes=out_of_core, columns_bytes=dense,
        total_bytes=matrices + held + dense, extent=(x, y, z),
        interface_nodes={interface.name: len(interface.nodes) for interface in interfaces}, warnings=tuple(warnings),
    )  # fmt: skip


def rigid_modes(mesh: Mesh, frames: list[Interface]) -> int:
    """Number of motions free of strain: 6 for one sound free body.

    Elements that share faces, and nodes held by one rigid interface, move together as a piece. Pieces that
    share nodes move alike there: 6 unknowns for each piece, 3 equations for each shared node, and what the
    equations leave is the answer. Beyond ``MANY_PIECES`` pieces only whole unconnected parts are counted.
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
    if count > MANY_PIECES:
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
    return int((values > 1e-10 * max(values[-1], np.finfo(float).tiny)).sum())


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
