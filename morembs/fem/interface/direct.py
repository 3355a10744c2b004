"""Direct coupling: the dofs of the nodes themselves, displacements and, where there are any, rotations."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.fem import FEModel
from morembs.fem.fe_model import Component
from morembs.fem.interface.base import CouplingKind, Interface

if TYPE_CHECKING:
    import scipy.sparse as sp


class Direct(CouplingKind):
    """The components of each node, node after node."""

    name: ClassVar[str] = "direct"
    also_called: ClassVar[tuple[str, ...]] = ("nodes", "none")
    framed: ClassVar[bool] = False
    carries: ClassVar[bool] = False
    exclusive: ClassVar[bool] = True
    large_rotations: ClassVar[bool] = True

    def attach(self, model: FEModel, interface: Interface) -> sp.csc_array:
        import scipy.sparse as sp

        dofs = model.dofs.table(len(model.nodes))[interface.nodes][:, list(interface.components)]
        if (dofs < 0).any():
            node, component = np.argwhere(dofs < 0)[0]
            raise InputError(
                f"interface {interface.name!r}: node {model.nodes.ids[interface.nodes[node]]} has no dof for the "
                f"component {interface.components[component]}; take other nodes or components"
            )
        data = (np.ones(dofs.size), (dofs.ravel(), np.arange(dofs.size)))
        return sp.csc_array(data, shape=(model.size, dofs.size))

    def available(self, model: FEModel, name: str, nodes: Ints) -> tuple[int, ...]:
        """Components that all nodes have."""
        count = (model.dofs.table(len(model.nodes))[nodes, : Component.SCALAR] >= 0).sum(axis=0)
        common = tuple(np.flatnonzero(count == len(nodes)).tolist())
        if not common:
            raise InputError(f"interface {name!r}: its nodes have no dof in common; take other nodes")
        return common

    def columns(self, interface: Interface) -> tuple[Ints, Ints]:
        nodes, components = interface.nodes, np.array(interface.components)
        return np.tile(components, len(nodes)), np.repeat(nodes, len(components))
