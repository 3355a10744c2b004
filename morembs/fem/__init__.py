"""The finite-element model: nodes, elements, materials, matrices and what each degree of freedom means."""

from morembs.fem.arrays import freeze, frozen_numbers
from morembs.fem.fe_model import DofMap, FEModel, rigid_motion, skew
from morembs.fem.mesh import ElementBlock, Mesh, Nodes
from morembs.fem.named_columns import NamedColumns

__all__ = [
    "DofMap",
    "ElementBlock",
    "FEModel",
    "Mesh",
    "NamedColumns",
    "Nodes",
    "freeze",
    "frozen_numbers",
    "rigid_motion",
    "skew",
]
