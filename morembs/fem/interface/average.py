"""Average coupling (RBE3): the frame follows the mean motion of its nodes, z = T u_s, T = (R_s' W R_s)^-1 R_s' W.

It adds no stiffness; forces and moments spread over the nodes with the weights W.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from morembs.base.types import Floats
from morembs.fem import FEModel, skew
from morembs.fem.interface.base import CouplingKind, Interface
from morembs.fem.interface.nodes import condition_of, displacement_dofs, frame_motion, loads_on, refuse_collinear

if TYPE_CHECKING:
    import scipy.sparse as sp


class Average(CouplingKind):
    """Six degrees of freedom of a frame, weighted means of the displacements of its nodes."""

    name: ClassVar[str] = "average"
    also_called: ClassVar[tuple[str, ...]] = ("rbe3", "distributing", "mean")
    framed: ClassVar[bool] = True
    carries: ClassVar[bool] = False
    exclusive: ClassVar[bool] = False
    weighted: ClassVar[bool] = True
    large_rotations: ClassVar[bool] = True

    def attach(self, model: FEModel, interface: Interface) -> sp.csc_array:
        wanted = list(interface.components)
        dofs = displacement_dofs(model, interface)
        average = average_matrix(interface, model.nodes.xyz[interface.nodes])[wanted]
        return loads_on(model, dofs, average)

    def check(self, model: FEModel, interface: Interface) -> None:
        xyz = model.nodes.xyz[interface.nodes]
        refuse_collinear(interface, condition_of(xyz - xyz.mean(axis=0), interface.weights))


def average_matrix(interface: Interface, xyz: Floats) -> Floats:
    """T (6, 3 ns) of the average coupling for node coordinates ``xyz`` (ns, 3): z = T u_s."""
    w = interface.weights / interface.weights.sum()
    # About the centroid, where translations and rotations separate, then carried to the point.
    center = w @ xyz
    arms = xyz - center
    length = float(np.linalg.norm(arms, axis=1).max())
    scale = np.array([1.0, 1.0, 1.0, length, length, length])
    R = frame_motion(xyz, center) / scale
    WR = np.repeat(w, 3)[:, None] * R
    carry = np.eye(6)
    carry[:3, 3:] = -skew(interface.point - center)
    return np.asarray(carry @ (np.linalg.solve(R.T @ WR, WR.T) / scale[:, None]))
