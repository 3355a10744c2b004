"""How a reduced model compares with the full one: frequency response, and mode shapes to look at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from morembs.body import ElasticBody
from morembs.certificate.certify import Certificate
from morembs.certificate.response import full_response, reduced_response
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
    scale, ``frequencies_hz`` (k,).
    """

    body: str
    points: Floats
    triangles: Ints
    motion: Floats
    frequencies_hz: Floats


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
        bound={name: _steps(certificate) for name, certificate in known.items() if len(certificate.cells_hz)},
        measure=first.measure,
        # Of a tolerance in another measure a line would tell nothing.
        tolerance={
            body.name: float(str(body.recipe["tolerance"])) for body in bodies
            if body.name in known and body.recipe.get("measure") == first.measure and "tolerance" in body.recipe
        },
    )  # fmt: skip


def _steps(certificate: Certificate) -> Floats:
    """(2, 2 nc) ends of the cells and their limits by the measure of the certificate."""
    limit = certificate.cell_limit[:, MEASURES.index(certificate.measure)]
    return np.stack([certificate.cells_hz.ravel(), np.repeat(limit, 2)])


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
    )  # fmt: skip


def _triangles(faces: Mapping[str, Ints]) -> Ints:
    """Corner triangles (nt, 3) of faces; a quadrilateral gives two."""
    parts = [np.empty((0, 3), dtype=np.int64)]
    for kind, nodes in faces.items():
        parts.append(nodes[:, :3])
        if kind.startswith("quad"):
            parts.append(nodes[:, [0, 2, 3]])
    return np.concatenate(parts)
