"""Interfaces: where other bodies touch the part, and how its nodes follow a frame; the table lists the couplings."""

from __future__ import annotations

from morembs.fem.interface.average import Average, average_matrix
from morembs.fem.interface.base import COUPLINGS, CouplingKind, Elimination, Interface, coupling_kind
from morembs.fem.interface.couple import Coupling, couple
from morembs.fem.interface.direct import Direct
from morembs.fem.interface.make import make_interface
from morembs.fem.interface.matrix import Matrix, matrix_interface
from morembs.fem.interface.rigid import Rigid

# One line for each kind.
_ALL: tuple[type[CouplingKind], ...] = (Rigid, Average, Direct, Matrix)
COUPLINGS.take({kind.name: kind() for kind in _ALL})

__all__ = [
    "COUPLINGS",
    "Average",
    "Coupling",
    "CouplingKind",
    "Direct",
    "Elimination",
    "Interface",
    "Matrix",
    "Rigid",
    "average_matrix",
    "couple",
    "coupling_kind",
    "make_interface",
    "matrix_interface",
]
