"""Rigid coupling (RBE2): nodes follow the frame, u_s = R_s z; their dofs are eliminated, rotations too."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from morembs.base.types import Floats, Ints
from morembs.fem import FEModel, rigid_motion
from morembs.fem.interface.base import CouplingKind, Elimination, Interface
from morembs.fem.interface.nodes import all_dofs, condition_of, loads_on, refuse_collinear

if TYPE_CHECKING:
    import scipy.sparse as sp


class Rigid(CouplingKind):
    """Six degrees of freedom of the frame take the place of the dofs of its nodes.

    A single node that turns keeps its dofs: the frame is the node itself, seen from another point.
    """

    name: ClassVar[str] = "rigid"
    also_called: ClassVar[tuple[str, ...]] = ("rbe2", "kinematic", "mpc")
    framed: ClassVar[bool] = True
    carries: ClassVar[bool] = True
    exclusive: ClassVar[bool] = True
    large_rotations: ClassVar[bool] = True

    def attach(self, model: FEModel, interface: Interface) -> Elimination | sp.csc_array:
        if len(interface.nodes) == 1:
            return _single_node(model, interface)
        dofs = all_dofs(model, interface)
        arms = model.nodes.xyz[model.dofs.node[dofs]] - interface.point
        return Elimination(dofs=dofs, motion=rigid_motion(arms, model.dofs.component[dofs]))

    def check(self, model: FEModel, interface: Interface) -> None:
        xyz = model.nodes.xyz[interface.nodes]
        arms = xyz - xyz.mean(axis=0)
        turning = model.dofs.turning[np.isin(model.dofs.node, interface.nodes)]
        if not turning.any():
            refuse_collinear(interface, condition_of(arms, np.ones(len(arms))))
            return
        # Nodes that turn with the frame determine it alone.
        length = np.linalg.norm(arms, axis=1).max()
        dofs = all_dofs(model, interface)
        at = np.searchsorted(interface.nodes, model.dofs.node[dofs])
        R = rigid_motion(arms[at] / max(length, np.finfo(float).tiny), model.dofs.component[dofs])
        refuse_collinear(interface, float(np.linalg.cond(R.T @ R / len(R))))

    def nodal_forces(self, model: FEModel, interface: Interface) -> None:
        return None

    def rotation(self, model: FEModel, interface: Interface) -> tuple[Floats, Ints]:
        # Six dofs of a rigid patch tell its rotation.
        # Not at the top: whoever shows a file asks for the names of couplings, and needs no solver.
        from morembs.linalg.statics import support_dofs

        xyz, dofs = model.nodes.xyz[interface.nodes], model.dofs.of_nodes(interface.nodes).ravel()
        size = float(np.ptp(xyz, axis=0).max())
        R = rigid_motion(np.repeat(xyz - xyz.mean(axis=0), 3, axis=0) / size, np.tile(np.arange(3), len(xyz)))
        rows = support_dofs(R)
        return np.asarray(np.linalg.inv(R[rows])[3:] / size, dtype=np.float64), dofs[rows]


def _single_node(model: FEModel, interface: Interface) -> sp.csc_array:
    """Loads (N, m) on the six dofs of the one node: z = R^-1 u."""
    wanted = list(interface.components)
    dofs = all_dofs(model, interface)
    dofs = dofs[np.argsort(model.dofs.component[dofs])]
    away = interface.point - model.nodes.xyz[interface.nodes[0]]
    motion = rigid_motion(np.tile(away, (6, 1)), np.arange(6))[wanted]
    return loads_on(model, dofs, motion)
