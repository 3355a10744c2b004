"""Nodes and dofs of matrices: what their file says of them, or what has to be assumed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from morembs.base.errors import InputError
from morembs.fem import DofMap, Nodes
from morembs.fem.fe_model import Component
from morembs.fem.mesh import refuse_far
from morembs.importers.imported import Imported


def nodes_and_dofs(imported: Imported, size: int) -> tuple[Nodes, DofMap, tuple[str, ...]]:
    """Nodes and dofs of matrices of ``size`` rows, with what had to be assumed.

    Raises:
        InputError: dofs without nodes, nodes without places, or dofs that do not fit.
    """
    source = imported.source
    notes: tuple[str, ...] = ()
    nodes = imported.nodes or (imported.mesh.nodes if imported.mesh is not None else None)
    dofs = imported.dofs
    if nodes is None and dofs is not None:
        raise InputError(
            f"{source} says which nodes its rows belong to but not where these are; give a mesh (--nodes)",
            kind="unsupported",
        )
    if nodes is None:
        places = np.zeros((size, 3))
        nodes = Nodes(ids=np.arange(1, size + 1), xyz=places)
        dofs = DofMap(node=np.arange(size), component=np.zeros(size, dtype=np.int64))
        return (
            nodes,
            dofs,
            (
                "the file has no nodes: every dof became a node of its own at the origin that moves along x, so that "
                "mass properties and rigid-body motion mean nothing; give the nodes of a mesh (--nodes) for a body in space",  # noqa: E501
            ),
        )
    if dofs is None:
        if size != 3 * len(nodes):
            raise InputError(
                f"{source} has matrices of {size} rows and {len(nodes)} nodes; expected {3 * len(nodes)} rows (x, y, z "
                "of each node), or a table of node and dof for each row (--dofs)",
                kind="conflict",
                keyword="nodes",
            )
        dofs = DofMap.translations(len(nodes))
        notes = (f"rows were taken as x, y, z of {len(nodes)} nodes in their order; the file does not say so",)
    _check_dofs(dofs, nodes, size, source)
    nodes = _with_places_of_scalars(nodes, dofs)
    if not np.isfinite(nodes.xyz).all():
        raise InputError(
            f"{source} has nodes without coordinates; give them in a mesh with the same labels (--nodes)",
            kind="unsupported",
        )
    refuse_far(nodes, source)
    return nodes, dofs, notes


def _with_places_of_scalars(nodes: Nodes, dofs: DofMap) -> Nodes:
    """Nodes that hold scalars alone are put amid the others, where they change no extent."""
    if len(dofs) == 0 or dofs.component.max() < Component.SCALAR:
        return nodes
    placed = np.zeros(len(nodes), dtype=bool)
    placed[dofs.node[dofs.component < Component.SCALAR]] = True
    bare = ~placed & ~np.isfinite(nodes.xyz).all(axis=1)
    xyz = nodes.xyz.copy()
    xyz[bare] = nodes.xyz[placed].mean(axis=0) if placed.any() else 0.0
    return replace(nodes, xyz=xyz)


def _check_dofs(dofs: DofMap, nodes: Nodes, size: int, source: str) -> None:
    """Refuse a map that does not fit.

    Raises:
        InputError: another length than ``size``, nodes or components that do not exist, or a dof named twice.
    """
    if len(dofs) != size or len(dofs.component) != size:
        raise InputError(
            f"{source}: {len(dofs)} dofs are named for matrices of {size} rows; expected one for each", kind="conflict"
        )
    if size and not (dofs.node.min() >= 0 and dofs.node.max() < len(nodes)):
        raise InputError(
            f"{source}: a row belongs to a node that does not exist; write the file again",
            kind="unknown",
            keyword="node",
        )
    if size and not (dofs.component.min() >= 0 and dofs.component.max() <= Component.SCALAR):
        raise InputError(
            f"{source}: components of dofs run from {dofs.component.min()} to {dofs.component.max()}; expected 0 to 6"
        )
    twice = dofs.twice()
    if len(twice):
        node = nodes.ids[twice[0] // 6]
        raise InputError(
            f"{source}: two rows belong to component {twice[0] % 6} of node {node}; expected one",
            kind="conflict",
            keyword="component",
        )
