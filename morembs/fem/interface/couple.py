"""All interfaces of a model as matrices; rigid elements that came with the model are eliminated here too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem import FEModel, rigid_motion
from morembs.fem.constraints import DependentDofs
from morembs.fem.fe_model import refuse_complex, refuse_unsymmetric
from morembs.fem.interface.base import SIX, Elimination, Interface

if TYPE_CHECKING:
    import scipy.sparse as sp


@dataclass(frozen=True, kw_only=True, eq=False)
class Coupling:
    """All interfaces of a model as matrices.

    ``T`` (N, Nc) FE dofs from coupled dofs (FE dofs without dependent ones, which are ``kept``, then six per rigid
    frame);
    ``B`` (Nc, m) inputs, one column per exposed interface degree of freedom, and also outputs as ``B'``;
    ``R`` (Nc, 6) geometric rigid-body modes with rotations about ``pole`` (3,), a point amid the nodes, so
    that a body far from the origin loses no digits; ``columns`` interface name -> its columns of B.
    ``frames`` (Nc, 6 k) as B, with all six degrees of freedom of every interface that has a frame, whichever it
    exposes; ``frame_columns`` interface name -> its columns of that.
    """

    T: sp.csr_array
    kept: Ints
    B: sp.csc_array
    R: Floats
    pole: Floats
    columns: dict[str, slice]
    frames: sp.csc_array
    frame_columns: dict[str, slice]


def couple(model: FEModel, interfaces: Sequence[Interface]) -> Coupling:
    """Matrices of all interfaces.

    Raises:
        InputError: two interfaces of one name, rigid or direct interfaces that share nodes, or one on nodes that
            follow a rigid element of the model; complex matrices, or K and M that are not symmetric.
    """
    import scipy.sparse as sp

    refuse_complex(model)
    refuse_unsymmetric(model)
    _refuse_shared(model, interfaces)
    if model.dependent is not None:
        for interface in interfaces:
            if interface.kind.exclusive:
                _refuse_dependent(model, model.dependent, interface)
    attached = {interface.name: interface.kind.attach(model, interface) for interface in interfaces}
    eliminated = {name: elimination for name, elimination in attached.items() if isinstance(elimination, Elimination)}
    T, kept = _transformation(model, list(eliminated.values()))
    masters, at = {}, len(kept)
    for name, elimination in eliminated.items():
        masters[name] = at + np.arange(len(elimination.components))
        at += len(elimination.components)
    pole = model.nodes.xyz.mean(axis=0)
    R = np.zeros((T.shape[1], 6))
    R[: len(kept)] = rigid_motion(model.nodes.xyz[model.dofs.node] - pole, model.dofs.component)[kept]
    point = {interface.name: interface.point for interface in interfaces}
    for name, elimination in eliminated.items():
        arms = np.tile(point[name] - pole, (len(elimination.components), 1))
        R[masters[name]] = rigid_motion(arms, np.array(elimination.components))

    def block(interface: Interface, attachment: Elimination | sp.csc_array) -> sp.csc_array:
        if not isinstance(attachment, Elimination):
            return sp.csc_array(T.T @ attachment)
        rows = masters[interface.name][[attachment.components.index(component) for component in interface.components]]
        data = (np.ones(len(rows)), (rows, np.arange(len(rows))))
        return sp.csc_array(data, shape=(T.shape[1], len(rows)))

    B, columns = _beside([(i.name, block(i, attached[i.name])) for i in interfaces], T.shape[1])
    framed = [replace(i, components=SIX) for i in interfaces if i.kind.framed]
    whole = [(i.name, block(i, eliminated.get(i.name) or i.kind.attach(model, i))) for i in framed]
    frames, frame_columns = _beside(whole, T.shape[1])
    return Coupling(T=T, kept=kept, B=B, R=R, pole=pole, columns=columns, frames=frames, frame_columns=frame_columns)


def _transformation(model: FEModel, eliminated: Sequence[Elimination]) -> tuple[sp.csr_array, Ints]:
    """T (N, Nc), and the dofs that are kept, which come first in Nc; the new ones follow in the order given."""
    import scipy.sparse as sp

    slave = np.zeros(model.size, dtype=bool)
    for elimination in eliminated:
        slave[elimination.dofs] = True
    if model.dependent is not None:
        slave |= model.dependent.owner >= 0
    kept = np.flatnonzero(~slave)
    size = len(kept)
    rows, cols, values = [kept], [np.arange(size)], [np.ones(size)]
    for elimination in eliminated:
        count = len(elimination.components)
        rows.append(np.repeat(elimination.dofs, count))
        cols.append(np.tile(size + np.arange(count), len(elimination.dofs)))
        values.append(elimination.motion.ravel())
        size += count
    data = (np.concatenate(values), (np.concatenate(rows), np.concatenate(cols)))
    T = sp.csr_array(sp.coo_array(data, shape=(model.size, size)))
    if model.dependent is not None:
        T = sp.csr_array(model.dependent.S @ T)
    T.eliminate_zeros()
    return T, kept


def _beside(blocks: Sequence[tuple[str, sp.csc_array]], size: int) -> tuple[sp.csc_array, dict[str, slice]]:
    """Blocks (size, m_i) side by side, and the columns of each by name."""
    import scipy.sparse as sp

    columns, at = {}, 0
    for name, block in blocks:
        columns[name] = slice(at, at + block.shape[1])
        at += block.shape[1]
    return sp.csc_array(sp.hstack([block for _, block in blocks])) if blocks else sp.csc_array((size, 0)), columns


def _refuse_dependent(model: FEModel, dependent: DependentDofs, interface: Interface) -> None:
    dofs = np.flatnonzero(np.isin(model.dofs.node, interface.nodes))
    bad = dofs[dependent.owner[dofs] >= 0]
    if len(bad):
        name = dependent.names[dependent.owner[bad[0]]]
        own = f'nodes = "coupling:{name}", ' if name in model.couplings else ""
        raise InputError(
            f"interface {interface.name!r}: node {model.nodes.ids[model.dofs.node[bad[0]]]} follows "
            f"{'the element' if own else 'equations'} {name!r} of the model; take {own}other nodes, or coupling = "
            '"average"',
            kind="model",
            keyword="nodes",
        )


def _refuse_shared(model: FEModel, interfaces: Sequence[Interface]) -> None:
    owner: dict[int, Interface] = {}
    names: set[str] = set()
    for interface in interfaces:
        if interface.name in names:
            raise InputError(
                f"two interfaces are named {interface.name!r}; give each its own name", kind="conflict", keyword="name"
            )
        names.add(interface.name)
        if not interface.kind.exclusive:
            continue
        for row in interface.nodes.tolist():
            if row in owner:
                other = owner[row]
                raise InputError(
                    f"the {other.coupling} interface {other.name!r} and the {interface.coupling} interface "
                    f"{interface.name!r} share node {model.nodes.ids[row]}; a node can belong to one of them only "
                    '(leave it out of one, or take coupling = "average")',
                    kind="conflict",
                    keyword="nodes",
                )
            owner[row] = interface
