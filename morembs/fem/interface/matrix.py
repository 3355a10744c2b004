"""Generalised forces: columns of the input matrix B of a model, or rows of its output matrix C, as an interface."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats, Ints
from morembs.fem import FEModel
from morembs.fem.fe_model import Component
from morembs.fem.interface.base import CouplingKind, Interface

if TYPE_CHECKING:
    import scipy.sparse as sp


class Matrix(CouplingKind):
    """One degree of freedom for each column: the motion that its generalised force does work on."""

    name: ClassVar[str] = "matrix"
    framed: ClassVar[bool] = False
    carries: ClassVar[bool] = False
    exclusive: ClassVar[bool] = False

    def attach(self, model: FEModel, interface: Interface) -> sp.csc_array:
        import scipy.sparse as sp

        return sp.csc_array(sp.hstack([_column(model, interface.name, key) for key in interface.forces]))

    def available(self, model: FEModel, name: str, nodes: Ints) -> tuple[int, ...]:
        raise InputError(
            f'interface {name!r}: coupling = "matrix" was given with nodes; expected matrix = "B:NAME" in their place '
            "(matrix_interface in Python)",
            kind="conflict",
            keyword="coupling",
        )

    def columns(self, interface: Interface) -> tuple[Ints, Ints]:
        count = len(interface.forces)
        return np.full(count, Component.SCALAR), np.full(count, -1)

    def scale(self, interface: Interface, length: float) -> Floats:
        return np.ones(len(interface.forces))


def matrix_interface(model: FEModel, *, name: str, matrix: str) -> Interface:
    """Interface with one generalised force for each column of B, or row of C, that ``matrix`` names.

    A force q_j in N loads the dofs with b_j q_j, and its degree of freedom is the motion b_j' u in m; for a row c_i of
    C these are c_i' q_i and the output c_i u. With columns of B and rows of C as interfaces of one problem, C G B is a
    block of its transfer function, which reduction and certificate follow whole.

    Args:
        matrix: "B" or "C" for all of the model's ``inputs`` or ``outputs``, or some of them: "B:left,right", "C:tip".

    Raises:
        InputError: the model has no such matrix or column, or a column without any load.

    >>> B = np.zeros((model.size, 1))
    >>> B[-1] = 1.0
    >>> driven = from_matrices(model.K, model.M, B=B, nodes=nodes, names={"B": ["drive"]})
    >>> matrix_interface(driven, name="drive", matrix="B:drive").forces
    ('B:drive',)
    """
    role, _, wanted = matrix.partition(":")
    held = {"B": model.inputs, "C": model.outputs}
    if role not in held:
        raise InputError(
            f'interface {name!r}: matrix = {matrix!r} was given; expected "B:NAME", "C:NAME", "B" or "C"',
            keyword="matrix",
        )
    columns = held[role]
    if columns is None:
        raise InputError(
            f"interface {name!r}: {model.source or 'the model'} has no {role}; give it at the import "
            f"(--set {role}=NAME, {role} of from_matrices)",
            kind="missing",
        )
    chosen = [word.strip() for word in wanted.split(",")] if wanted else list(columns.names)
    for word in chosen:
        if chosen.count(word) > 1:
            raise InputError(
                f"interface {name!r}: {role}:{word} was given twice; give each column once", kind="conflict"
            )
    forces = tuple(f"{role}:{word}" for word in chosen)
    loads = [_column(model, name, key) for key in forces]
    for key, load in zip(forces, loads, strict=True):
        if not load.nnz:
            raise InputError(f"interface {name!r}: {key} has no entry, so that it loads nothing; leave it out")
    nodes = np.unique(model.dofs.node[np.concatenate([load.indices for load in loads])])
    return Interface(
        name=name,
        nodes=nodes,
        coupling=Matrix.name,
        point=model.nodes.xyz[nodes].mean(axis=0),
        weights=np.ones(len(nodes)),
        components=(Component.SCALAR,) * len(forces),
        forces=forces,
    )


def _column(model: FEModel, interface: str, key: str) -> sp.csc_array:
    """The column (N, 1) of a generalised force "B:NAME" or "C:NAME"."""
    role, _, word = key.partition(":")
    columns = model.inputs if role == "B" else model.outputs
    names = () if columns is None else columns.names
    if columns is None or word not in names:
        raise InputError(
            f"interface {interface!r}: {role} of the model has no column {word!r}; {nearest(word, names)}",
            kind="unknown",
        )
    at = names.index(word)
    return columns.matrix[:, [at]]
