"""The part that a model and all of its bodies describe: mass, nodes, interfaces. SI units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy.sparse as sp

from morembs.base.arguments import check_value
from morembs.base.errors import InputError
from morembs.base.limits import one_of
from morembs.base.summary import summarised
from morembs.base.types import Floats, Ints
from morembs.body.vtkhdf import VTK_VERTEX, CellBlock
from morembs.body.vtkhdf_series import Grid
from morembs.fem import FEModel, Nodes
from morembs.fem.elements import FACES, TYPES
from morembs.fem.interface import Interface
from morembs.fem.surface import outer_faces
from morembs.problem import Problem

NODE_CHOICES = ("all", "skin", "interfaces")


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """What all reductions of one model share.

    ``mass`` kg; ``center_of_mass`` (3,) m; ``inertia`` (3, 3) kg m2 about the centre of mass along the
    model's axes. ``nodes`` are the chosen nodes, ``cells`` the mesh between them, ``transformation``
    (3 n, Nc) gives their displacements (x, y, z of the first node, of the second, ...) from the coupled
    dofs. ``interfaces`` keep rows of the full model; ``node_ids`` its labels of all nodes, ``warnings`` its
    differences from its source.
    """

    mass: float
    center_of_mass: Floats
    inertia: Floats
    nodes: Nodes
    cells: tuple[CellBlock, ...]
    transformation: sp.csr_array
    interfaces: tuple[Interface, ...]
    columns: Mapping[str, slice]
    node_ids: Ints
    source: str = ""
    warnings: tuple[str, ...] = ()

    def _facts(self) -> dict[str, object]:
        return {
            "mass": f"{self.mass:.4g} kg",
            "centre of mass": self.center_of_mass,
            "nodes": len(self.nodes),
            "interfaces": [each.name for each in self.interfaces],
            "source": self.source,
        }

    def outline(self) -> tuple[Grid, Ints, dict[str, Floats]]:
        """The cells as VTK keeps them, labels (n,) of their nodes, and points (3,) of the interfaces by name."""
        sizes = [np.full(len(cells.connectivity), cells.connectivity.shape[1]) for cells in self.cells]
        types = [np.full(len(cells.connectivity), cells.vtk, dtype=np.uint8) for cells in self.cells]
        links = [cells.connectivity.ravel() for cells in self.cells]
        grid = Grid(
            points=self.nodes.xyz,
            connectivity=np.concatenate([np.zeros(0, dtype=np.int64), *links]),
            offsets=np.cumsum(np.concatenate([[0], *sizes]), dtype=np.int64),
            types=np.concatenate([np.zeros(0, dtype=np.uint8), *types]),
        )
        return grid, self.nodes.ids, {interface.name: interface.point for interface in self.interfaces}


def input_columns(
    interfaces: Sequence[Interface], columns: Mapping[str, slice], node_ids: Ints
) -> tuple[Ints, Ints, Ints]:
    """Of each column of an input matrix (m,) the position of its interface, its motion 0..5 (6: of a generalised force)
    and the label of its node (-1: a frame, or none), from the ``columns`` of each interface and all labels."""
    count = sum(some.stop - some.start for some in columns.values())
    index, component, node = (np.full(count, -1, dtype=np.int64) for _ in range(3))
    for number, interface in enumerate(interfaces):
        some, (exposed, rows) = columns[interface.name], interface.kind.columns(interface)
        index[some], component[some] = number, exposed
        node[some] = np.where(rows < 0, -1, node_ids[rows])
    return index, component, node


def make_part(problem: Problem, nodes: str = "all") -> Part:
    """Collect the data that all bodies of a problem share: nodes, mass, interfaces and source.

    Args:
        problem: the full model.
        nodes: nodes whose displacements the bodies store: "all", "skin" (nodes on free faces) or "interfaces".

    Raises:
        InputError: unknown choice, or skin of a model without elements.

    >>> make_part(problem, "skin")
    Part: mass 7.85 kg; centre of mass [0.2, 0.025, 0.025]; nodes 20; interfaces LEFT, RIGHT; source bar
    """
    model = problem.model
    rows, cells = _choose_nodes(model, problem.interfaces, nodes)
    dofs = model.dofs.of_nodes(rows).ravel()
    held = sp.csr_array(problem.coupling.T)
    picked = held[np.maximum(dofs, 0)]
    if (dofs < 0).any():
        # A node without some displacement (a matrix model) stays still along it.
        picked = sp.csr_array(sp.diags_array((dofs >= 0).astype(float)) @ picked)
    mass, center, inertia = problem.mass_properties
    chosen = Nodes(ids=model.nodes.ids[rows], xyz=model.nodes.xyz[rows])
    return Part(
        mass=mass,
        center_of_mass=center,
        inertia=inertia,
        nodes=chosen,
        cells=cells,
        transformation=picked,
        interfaces=problem.interfaces,
        columns=problem.coupling.columns,
        node_ids=model.nodes.ids,
        source=model.source,
        warnings=model.warnings,
    )


def _choose_nodes(model: FEModel, interfaces: Sequence[Interface], nodes: str) -> tuple[Ints, tuple[CellBlock, ...]]:
    """Rows of the chosen nodes and the cells between them, renumbered."""
    check_value("nodes", nodes, Annotated[str, one_of(*NODE_CHOICES)])
    touched = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *(i.nodes for i in interfaces)]))
    if nodes == "interfaces" or model.mesh is None:
        if nodes == "skin":
            raise InputError(
                'nodes = "skin" needs elements; this model has matrices only, take "all" or "interfaces"',
                kind="unsupported",
                keyword="nodes",
            )
        rows = touched if nodes == "interfaces" else np.arange(len(model.nodes))
        points = CellBlock(vtk=VTK_VERTEX, connectivity=np.arange(len(rows))[:, None])
        return rows, (points,) if len(rows) else ()
    if nodes == "skin":
        faces = {kind: f for kind, f in outer_faces(model.mesh).items() if len(f)}
        rows = np.unique(np.concatenate([touched, *(f.ravel() for f in faces.values())]))
        typed = [(FACES[kind].vtk, f) for kind, f in faces.items()]
    else:
        rows = np.arange(len(model.nodes))
        typed = [(TYPES[block.type].vtk, block.nodes) for block in model.mesh.blocks]
    local = np.full(len(model.nodes), -1, dtype=np.int64)
    local[rows] = np.arange(len(rows))
    return rows, tuple(CellBlock(vtk=vtk, connectivity=local[c]) for vtk, c in typed)
