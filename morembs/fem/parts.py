"""The parts of a model that nothing joins, each a model of its own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.fem.constraints import DependentDofs, Equations
from morembs.fem.fe_model import MATRICES, DofMap, FEModel
from morembs.fem.mesh import Mesh, Nodes


def parts_of(model: FEModel) -> list[FEModel]:
    """Models of the parts between which there are no entries, elements, constraints or equations, the largest first.

    Nodes without dofs, which belong to no part, are in none. Peak memory: the matrices once more.

    Raises:
        InputError: a model with inputs or outputs, which are of the whole.
    """
    if model.inputs is not None or model.outputs is not None:
        raise InputError(f"{model.source} has inputs or outputs, which are of the whole model; it cannot be split")
    part = _parts(model)
    of_dof = part[model.dofs.node]
    count = np.bincount(of_dof)
    order = np.argsort(-count, kind="stable")[: np.count_nonzero(count)]
    if len(order) < 2:
        return [model]
    return [
        _part(model, np.flatnonzero(part == number), np.flatnonzero(of_dof == number), f"part {i} of {len(order)}")
        for i, number in enumerate(order.tolist(), start=1)
    ]


def _parts(model: FEModel) -> Ints:
    """The number of the part (n,) of each node."""
    ends: list[tuple[Ints, Ints]] = []
    follows = None if model.dependent is None else model.dependent.S
    for A in (*(getattr(model, name) for name in MATRICES), follows):
        if A is not None:
            full = sp.coo_array(A)
            ends.append((model.dofs.node[full.row[full.data != 0]], model.dofs.node[full.col[full.data != 0]]))
    for block in () if model.mesh is None else model.mesh.blocks:
        ends.append((np.repeat(block.nodes[:, 0], block.nodes.shape[1]), block.nodes.ravel()))
    for rigid in model.rigid:
        ends.append((np.full(len(rigid.slaves), rigid.master), rigid.slaves))
    one, two = (np.concatenate([pair[i] for pair in ends]) for i in (0, 1))
    links = sp.coo_array((np.ones(len(one), dtype=bool), (one, two)), shape=(len(model.nodes),) * 2)
    return np.asarray(connected_components(sp.csr_array(links), directed=False)[1], dtype=np.int64)


def _part(model: FEModel, nodes: Ints, dofs: Ints, which: str) -> FEModel:
    """The model on some ``nodes`` and ``dofs`` (both ascending), between which and others there is nothing."""
    row = np.full(len(model.nodes), -1, dtype=np.int64)
    row[nodes] = np.arange(len(nodes))
    given = {name: A for name in MATRICES if (A := getattr(model, name)) is not None}
    matrices: dict[str, Any] = {name: sp.csr_array(A[dofs][:, dofs]) for name, A in given.items()}
    mesh = None if model.mesh is None else _mesh(model.mesh, nodes, row)
    sets = {} if mesh is None else mesh.element_sets
    dependent = model.dependent
    if dependent is not None:
        dependent = DependentDofs(
            S=sp.csr_array(dependent.S[dofs][:, dofs]), owner=dependent.owner[dofs], names=dependent.names
        )
    return replace(
        model,
        **matrices,
        nodes=_nodes(model.nodes, nodes, row),
        mesh=mesh,
        dependent=dependent,
        dofs=DofMap(node=row[model.dofs.node[dofs]], component=model.dofs.component[dofs]),
        materials=tuple(material for material in model.materials if material.set == "all" or material.set in sets),
        source=f"{model.source} ({which})",
        rigid=tuple(
            replace(e, master=int(row[e.master]), slaves=row[e.slaves]) for e in model.rigid if row[e.master] >= 0
        ),
        average=tuple(
            replace(e, reference=int(row[e.reference]), nodes=row[e.nodes])
            for e in model.average
            if row[e.reference] >= 0
        ),
        equations=tuple(own for e in model.equations if len(own := _equations(e, row))),
    )


def _nodes(nodes: Nodes, kept: Ints, row: Ints) -> Nodes:
    own = {name: row[rows][row[rows] >= 0] for name, rows in nodes.sets.items()}
    sets = {name: rows for name, rows in own.items() if len(rows)}
    return Nodes(ids=nodes.ids[kept], xyz=nodes.xyz[kept], sets=sets)


def _mesh(mesh: Mesh, nodes: Ints, row: Ints) -> Mesh | None:
    """The elements on the ``nodes``, whose first ones are those of the mesh; None without any."""
    own = [np.flatnonzero(row[block.nodes[:, 0]] >= 0) for block in mesh.blocks]
    blocks = [
        replace(block, nodes=row[block.nodes[rows]], ids=block.ids[rows])
        for block, rows in zip(mesh.blocks, own, strict=True)
        if len(rows)
    ]
    if not blocks:
        return None
    sets = {}
    for name, members in mesh.element_sets.items():
        picked = tuple(
            np.searchsorted(rows, given[np.isin(given, rows)])
            for given, rows in zip(members, own, strict=True)
            if len(rows)
        )
        if any(len(given) for given in picked):
            sets[name] = picked
    return replace(
        mesh, nodes=_nodes(mesh.nodes, nodes[nodes < len(mesh.nodes)], row), blocks=tuple(blocks), element_sets=sets
    )


def _equations(given: Equations, row: Ints) -> Equations:
    """Those of the equations whose dofs are on the nodes that have a ``row``."""
    chosen = row[given.nodes] >= 0
    terms = np.repeat(chosen, np.diff(given.offsets))
    return replace(
        given,
        nodes=row[given.nodes[chosen]],
        components=given.components[chosen],
        offsets=np.concatenate([[0], np.cumsum(np.diff(given.offsets)[chosen])]),
        term_nodes=row[given.term_nodes[terms]],
        term_components=given.term_components[terms],
        coefficients=given.coefficients[terms],
    )
