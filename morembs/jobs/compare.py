"""How a reduced model compares with the full one: frequency response, and mode shapes to look at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morembs.body import ElasticBody
from morembs.body.stored import StoredBodies
from morembs.body.vtkhdf_series import Grid, read_grid, stored_modes
from morembs.certificate.response import full_response, reduced_response
from morembs.model import ElementBlock, Mesh, Nodes
from morembs.model.elements import FACES, TYPES
from morembs.model.surface import outer_faces
from morembs.problem import Problem
from morembs.progress import SILENT, Progress
from morembs.reducers.base import ReducedModel
from morembs.responses.measures import MEASURES

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
SHOWN_MODES = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class FrequencyResponse:
    """Size of the elastic transfer function from interface forces to interface degrees of freedom.

    ``full`` (nf,) Frobenius norm of H in m/N at ``frequencies_hz`` (nf,); for each body ``reduced`` (nf,)
    its own norm and ``error`` (nf,) the norm of the difference over that of the full model, ``bound`` (2, n) steps of
    frequencies in Hz and of the upper limit of the error between them by ``measure``, where there is one, ``tolerance``
    the limit that was asked for. Rotations and moments are scaled with the radius of gyration ``length`` in m, so that
    all entries have one unit.
    """

    frequencies_hz: Floats
    full: Floats
    reduced: Mapping[str, Floats]
    error: Mapping[str, Floats]
    bound: Mapping[str, Floats] = field(default_factory=dict)
    measure: str = "pointwise"
    tolerance: Mapping[str, float] = field(default_factory=dict)
    length: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Shapes:
    """Elastic eigenmodes of a reduced body on the skin of the model.

    ``points`` (n, 3) in m, ``triangles`` (nt, 3) rows of them, ``motion`` (k, n, 3) displacements of any
    scale, ``frequencies_hz`` (k,); ``interfaces`` their points (3,) in m by name.
    """

    body: str
    points: Floats
    triangles: Ints
    motion: Floats
    frequencies_hz: Floats
    interfaces: Mapping[str, Floats] = field(default_factory=dict)


def recommended(limits: Mapping[str, float | None]) -> str:
    """Of the limits of the errors of some bodies the name of the smallest, the first where none is known."""
    known = {name: limit for name, limit in limits.items() if limit is not None}
    return min(known, key=lambda name: known[name]) if known else next(iter(limits))


def frequency_response(
    problem: Problem, bodies: Sequence[ElasticBody], frequencies_hz: Floats, progress: Progress = SILENT
) -> FrequencyResponse:
    """Full against reduced response at ``frequencies_hz`` (nf,)."""
    omega = 2 * np.pi * frequencies_hz
    size = np.outer(problem.motion_scale, problem.motion_scale)
    full = full_response(problem, omega, progress=progress) * size
    norm = np.linalg.norm(full, axis=(1, 2))
    reduced, error = {}, {}
    for body in bodies:
        H = reduced_response(body.reduced, omega) * size
        reduced[body.name] = np.linalg.norm(H, axis=(1, 2))
        error[body.name] = np.linalg.norm(H - full, axis=(1, 2)) / norm
    return FrequencyResponse(
        frequencies_hz=frequencies_hz, full=norm, reduced=reduced, error=error, length=problem.length
    )


def certified_response(problem: Problem, bodies: Sequence[ElasticBody]) -> FrequencyResponse | None:
    """The response that certificates were made with; None if no body has one."""
    known = {body.name: body.certificate for body in bodies if body.certificate is not None}
    if not known:
        return None
    first = next(iter(known.values()))
    return FrequencyResponse(
        frequencies_hz=first.frequencies_hz, full=first.full, length=problem.length,
        reduced={name: certificate.reduced for name, certificate in known.items()},
        error={name: certificate.error for name, certificate in known.items()},
        bound={
            name: _steps(certificate.cells_hz, certificate.cell_limit, certificate.measure)
            for name, certificate in known.items() if len(certificate.cells_hz)
        },
        measure=first.measure,
        # Of a tolerance in another measure a line would tell nothing.
        tolerance={
            body.name: float(str(body.recipe["tolerance"])) for body in bodies
            if body.name in known and body.recipe.get("measure") == first.measure and "tolerance" in body.recipe
        },
    )  # fmt: skip


def _steps(cells_hz: Floats, limit: Floats, measure: str) -> Floats:
    """(2, 2 nc) ends of the cells and their limits by the measure of the certificate."""
    return np.stack([cells_hz.ravel(), np.repeat(limit[:, MEASURES.index(measure)], 2)])


def mode_shapes(problem: Problem, reduced: ReducedModel) -> Shapes | None:
    """The lowest elastic eigenmodes of ``reduced`` on the skin; None if it has none, or the model no elements."""
    mesh = problem.model.mesh
    values, Y = reduced.modes()
    shown = slice(reduced.rigid_count, reduced.rigid_count + SHOWN_MODES)
    if mesh is None or not len(values[shown]):
        return None
    triangles = _triangles(outer_faces(mesh))
    rows = np.unique(triangles)
    dofs = problem.model.dofs.of_nodes(rows).ravel()
    motion = problem.coupling.T[dofs] @ (reduced.V @ Y[:, shown])
    return Shapes(
        body=reduced.name, points=mesh.nodes.xyz[rows], triangles=np.searchsorted(rows, triangles),
        motion=motion.T.reshape(-1, len(rows), 3), frequencies_hz=np.sqrt(np.maximum(values[shown], 0)) / (2 * np.pi),
        interfaces={interface.name: interface.point for interface in problem.interfaces},
    )  # fmt: skip


def stored_shapes(path: Path, stored: StoredBodies, body: str) -> Shapes | None:
    """The same of a body file; None if it keeps no cells or no shapes."""
    grid = read_grid(path) if len(stored.node_ids) else None
    motion = stored_modes(path, body, SHOWN_MODES)
    triangles = np.empty((0, 3), dtype=np.int64) if grid is None else _triangles(_faces(grid))
    if grid is None or not len(triangles) or not len(motion):
        return None
    rows, renumbered = np.unique(triangles, return_inverse=True)
    own = stored.bodies[body]
    return Shapes(
        body=body, points=grid.points[rows], triangles=renumbered.reshape(-1, 3), motion=motion[:, rows],
        frequencies_hz=own.frequencies_hz[own.rigid_count :][: len(motion)],
        interfaces={name: interface.point for name, interface in stored.interfaces.items()},
    )  # fmt: skip


def stored_response(stored: StoredBodies) -> FrequencyResponse | None:
    """The response that the certificates of a body file were made with, None without one."""
    known = {name: body.certificate for name, body in stored.bodies.items() if body.certificate is not None}
    if not known:
        return None
    first = next(iter(known.values()))
    return FrequencyResponse(
        frequencies_hz=first["frequencies_hz"], full=first["full"], length=float("nan"),
        reduced={name: values["reduced"] for name, values in known.items()},
        error={name: values["error"] for name, values in known.items()},
        bound={
            name: _steps(values["cells_hz"], values["cell_limit"], str(values["measure"]))
            for name, values in known.items() if "cell_limit" in values
        },
        measure=str(first.get("measure", "pointwise")),
    )  # fmt: skip


def _faces(grid: Grid) -> dict[str, Ints]:
    """The outer faces of the cells of a body file, which are faces themselves or solids."""
    faces: dict[str, list[Ints]] = {}
    blocks = []
    for vtk in np.unique(grid.types):
        cells = np.flatnonzero(grid.types == vtk)
        size = int(grid.offsets[cells[0] + 1] - grid.offsets[cells[0]])
        nodes = grid.connectivity[grid.offsets[cells][:, None] + np.arange(size)]
        for name, kind in FACES.items():
            if kind.vtk == vtk:
                faces.setdefault(name, []).append(nodes)
        blocks += [ElementBlock(type=name, nodes=nodes, ids=cells) for name, kind in TYPES.items() if kind.vtk == vtk]
    if blocks:
        nodes = Nodes(ids=np.arange(len(grid.points)), xyz=grid.points)
        for name, outer in outer_faces(Mesh(nodes=nodes, blocks=tuple(blocks))).items():
            faces.setdefault(name, []).append(outer)
    return {name: np.concatenate(parts) for name, parts in faces.items()}


# Corners of the triangles that a face is drawn with, by the number of its nodes in VTK order.
_DRAWN = {
    3: ((0, 1, 2),),
    4: ((0, 1, 2), (0, 2, 3)),
    6: ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),
    8: ((0, 4, 7), (4, 1, 5), (5, 2, 6), (6, 3, 7), (4, 5, 7), (5, 6, 7)),
}


def _triangles(faces: Mapping[str, Ints]) -> Ints:
    """Triangles (nt, 3) of faces, through their middle nodes too."""
    parts = [np.empty((0, 3), dtype=np.int64)]
    for nodes in faces.values():
        parts += [nodes[:, corners] for corners in _DRAWN[min(nodes.shape[1], 8)]]
    return np.concatenate(parts)
