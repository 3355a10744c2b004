"""Nodes of an interface: their dofs, and whether they determine the motion of a frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem import FEModel, rigid_motion
from morembs.fem.fe_model import Component
from morembs.fem.interface.base import Interface
from morembs.fem.tolerances import TOL

if TYPE_CHECKING:
    import scipy.sparse as sp


def displacement_dofs(model: FEModel, interface: Interface) -> Ints:
    """Dofs (3 ns,) x, y, z of the interface's nodes.

    Raises:
        InputError: a node lacks one.
    """
    dofs = model.dofs.of_nodes(interface.nodes)
    if (dofs < 0).any():
        bare = interface.nodes[(dofs < 0).any(axis=1)][0]
        raise InputError(
            f"interface {interface.name!r}: node {model.nodes.ids[bare]} has no dof for each of x, y and z; "
            "take other nodes"
        )
    return dofs.ravel()


def all_dofs(model: FEModel, interface: Interface) -> Ints:
    """All dofs of the interface's nodes, rotations too, but no scalars.

    Raises:
        InputError: a node lacks one of x, y and z.
    """
    displacements = displacement_dofs(model, interface)
    if model.dofs.component.max(initial=0) < 3:
        return displacements
    here = np.isin(model.dofs.node, interface.nodes)
    return np.flatnonzero(here & (model.dofs.component < Component.SCALAR))


def loads_on(model: FEModel, dofs: Ints, values: Floats) -> sp.csc_array:
    """Loads (N, m): column j puts ``values[j]`` (m, k) on the ``dofs`` (k,)."""
    import scipy.sparse as sp

    places = np.tile(dofs, len(values)), np.repeat(np.arange(len(values)), len(dofs))
    return sp.csc_array((values.ravel(), places), shape=(model.size, len(values)))


def frame_motion(xyz: Floats, point: Floats) -> Floats:
    """R_s (3 ns, 6): displacements of nodes under the motion of a frame at ``point``."""
    component = np.tile(np.arange(3), len(xyz))
    return rigid_motion(np.repeat(xyz - point, 3, axis=0), component)


def condition_of(arms: Floats, weights: Floats) -> float:
    """Condition of R_s' W R_s about the centroid for nodes at ``arms`` (ns, 3), scaled to one; inf for one point."""
    length = np.linalg.norm(arms, axis=1).max()
    if not length > 0:
        return np.inf
    R = frame_motion(arms / length, np.zeros(3))
    return float(np.linalg.cond(R.T @ (np.repeat(weights / np.abs(weights).sum(), 3)[:, None] * R)))


def refuse_collinear(interface: Interface, condition: float) -> None:
    """Refuse nodes that do not determine the rotations of their frame, by their ``condition``.

    Raises:
        InputError: in these cases.
    """
    if not condition < TOL.collinear_condition:
        count = len(interface.nodes)
        where = f"its {count} nodes lie on a line or in a point" if count > 1 else "it has one node"
        raise InputError(
            f"interface {interface.name!r}: {where}; "
            f"{interface.coupling} coupling needs at least three nodes that span a plane "
            '(take more nodes, or coupling = "direct")',
            kind="model",
            keyword="nodes",
        )
