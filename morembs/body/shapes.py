"""Mode shapes to look at: of a model with its reduction, or of a body."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from morembs.base.summary import summarised
from morembs.base.types import Floats, Ints
from morembs.base.units import eigenvalue_in_hz
from morembs.body.tolerances import TOL
from morembs.body.vtkhdf_series import Grid, View
from morembs.fem import ElementBlock, Mesh, Nodes
from morembs.fem.elements import FACES, TYPES
from morembs.fem.surface import seen_faces
from morembs.fem.viewer.skin import triangles_of
from morembs.problem import Problem
from morembs.reducers.base import ReducedModel


@summarised
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


def mode_shapes(problem: Problem, reduced: ReducedModel) -> Shapes | None:
    """The lowest elastic eigenmodes of ``reduced`` on the skin; None if it has none, or the model no elements."""
    mesh = problem.model.mesh
    values, Y = reduced.modes()
    shown = slice(reduced.rigid_count, reduced.rigid_count + TOL.drawn_modes)
    if mesh is None or not len(values[shown]):
        return None
    triangles = triangles_of(seen_faces(mesh))[0]
    rows = np.unique(triangles)
    dofs = problem.model.dofs.of_nodes(rows).ravel()
    motion = problem.coupling.T[dofs] @ (reduced.V @ Y[:, shown])
    return Shapes(
        body=reduced.name,
        points=mesh.nodes.xyz[rows],
        triangles=np.searchsorted(rows, triangles),
        motion=motion.T.reshape(-1, len(rows), 3),
        frequencies_hz=eigenvalue_in_hz(values[shown]),
        interfaces={interface.name: interface.point for interface in problem.interfaces},
    )


def shapes_on(view: View) -> Shapes | None:
    """The modes of a view on the faces of its cells; None if there are neither modes nor faces."""
    triangles = triangles_of(faces_of(view.grid))[0]
    if not len(triangles) or not len(view.motion):
        return None
    rows, renumbered = np.unique(triangles, return_inverse=True)
    return Shapes(
        body=view.body,
        points=view.grid.points[rows],
        triangles=renumbered.reshape(-1, 3),
        motion=view.motion[:, rows],
        frequencies_hz=view.frequencies_hz,
        interfaces=view.interfaces,
    )


def faces_of(grid: Grid) -> dict[str, Ints]:
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
        for name, outer in seen_faces(Mesh(nodes=nodes, blocks=tuple(blocks))).items():
            faces.setdefault(name, []).append(outer)
    return {name: np.concatenate(parts) for name, parts in faces.items()}
