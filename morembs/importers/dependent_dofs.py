"""Rigid and average elements of a model: which dofs follow which, and the interfaces that they offer.

A slave of a rigid element moves as u_s = u_m + theta_m x (x_s - x_m), its rotations as theta_m; the reference of an
average element moves as the mean of its nodes (``interface.averaging``). A master may follow another element.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.errors import InputError, nearest
from morembs.interface import Average, Interface, Rigid, averaging
from morembs.model import FEModel, rigid_motion
from morembs.model.constraints import AverageElement, DependentDofs, RigidElement

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
ALL = (0, 1, 2, 3, 4, 5)
# Entries that a reference with stiffness or mass of its own may spread over its nodes.
MOST_SPREAD = 50_000_000


def dof_table(model: FEModel) -> Ints:
    """Dof (n, 6) of each node and component, -1 where there is none."""
    return model.dofs.table(len(model.nodes))


def dependent_dofs(
    model: FEModel, rigid: Sequence[RigidElement], average: Sequence[AverageElement]
) -> DependentDofs | None:
    """Dofs that depend on others through the elements, None without any.

    Raises:
        InputError: a dof that follows two elements, elements that follow each other in a circle, average elements
            whose nodes lie on a line, or one of so many nodes that its loads would fill the matrices.
    """
    if not rigid and not average:
        return None
    table, owner = dof_table(model), np.full(model.size, -1, dtype=np.int64)
    elements: list[RigidElement | AverageElement] = [*rigid, *average]
    names = tuple(element.name for element in elements)
    rows, columns, values = [], [], []
    for number, element in enumerate(elements):
        if isinstance(element, RigidElement):
            dofs, at, weight = _rigid_rows(model, element, table)
        else:
            dofs, at, weight = _mean_rows(model, element, table)
        own = np.unique(dofs)
        if (owner[own] >= 0).any():
            dof = own[owner[own] >= 0][0]
            raise InputError(
                f"component {model.dofs.component[dof]} of node {model.nodes.ids[model.dofs.node[dof]]} follows both "
                f"{names[owner[dof]]!r} and {element.name!r}; a node can follow one element only"
            )
        owner[own] = number
        rows.append(dofs)
        columns.append(at)
        values.append(weight)
    free = np.flatnonzero(owner < 0)
    data = np.concatenate([np.ones(len(free)), *values])
    where = (np.concatenate([free, *rows]), np.concatenate([free, *columns]))
    S = sp.csr_array(sp.coo_array((data, where), shape=(model.size, model.size)))
    S.eliminate_zeros()
    return DependentDofs(S=_resolved(S, owner, names), owner=owner, names=names)


def _rigid_rows(model: FEModel, element: RigidElement, table: Ints) -> tuple[Ints, Ints, Floats]:
    """Rows, columns and values of the slaves' motion."""
    if element.master in element.slaves:
        raise InputError(f"rigid element {element.name!r} names its master among the slaves; leave it out of these")
    slaves = np.unique(element.slaves)
    dofs = table[slaves][:, list(element.components)]
    node = np.repeat(slaves, len(element.components))[dofs.ravel() >= 0]
    dofs = dofs.ravel()[dofs.ravel() >= 0]
    motion = rigid_motion(model.nodes.xyz[node] - model.nodes.xyz[element.master], model.dofs.component[dofs])
    return np.repeat(dofs, 6), np.tile(table[element.master], len(dofs)), motion.ravel()


def _mean_rows(model: FEModel, element: AverageElement, table: Ints) -> tuple[Ints, Ints, Floats]:
    """Rows, columns and values of the reference's motion."""
    if element.reference in element.nodes:
        raise InputError(f"average element {element.name!r} names its reference among its nodes; leave it out of these")
    interface = _average_interface(model, element)
    columns = table[interface.nodes][:, :3]
    if (columns < 0).any():
        node = model.nodes.ids[interface.nodes[(columns < 0).any(axis=1)][0]]
        raise InputError(f"average element {element.name!r}: node {node} has no dof for each of x, y and z")
    interface.kind.check(model, interface)
    dofs = table[element.reference][list(element.components)]
    loaded = any(A is not None and (np.diff(A.indptr)[dofs] > 0).any() for A in (model.K, model.M, model.D))
    if loaded and columns.size**2 > MOST_SPREAD:
        raise InputError(
            f"the reference of average element {element.name!r} carries a mass or elements over {len(interface.nodes)} "
            f"nodes, which would fill the matrices; take at most {int(MOST_SPREAD**0.5) // 3} nodes, or a rigid element"
        )
    T = averaging(interface, model.nodes.xyz[interface.nodes])[list(element.components)]
    return np.repeat(dofs, columns.size), np.tile(columns.ravel(), len(dofs)), T.ravel()


def _resolved(S: sp.csr_array, owner: Ints, names: tuple[str, ...]) -> sp.csr_array:
    """S with every dependent dof given by independent ones alone, where masters follow other elements."""
    follows = owner >= 0
    step = S
    for _ in range(len(names) + 1):
        row = np.repeat(np.arange(S.shape[0]), np.diff(S.indptr))
        pending = follows[S.indices]
        if not pending.any():
            S.sort_indices()
            return S
        stuck = row[pending][0]
        S = sp.csr_array(S @ step)
        S.eliminate_zeros()
    raise InputError(
        f"rigid or average elements follow each other in a circle ({names[owner[stuck]]!r} is one of them)"
    )


def _average_interface(model: FEModel, element: AverageElement) -> Interface:
    nodes, index = np.unique(element.nodes, return_inverse=True)
    weights = np.zeros(len(nodes))
    if len(element.weights) == len(element.nodes):
        np.add.at(weights, index, element.weights)
    if len(element.weights) != len(element.nodes) or not np.isfinite(weights).all() or weights.min(initial=0.0) < 0:
        raise InputError(f"average element {element.name!r} needs one weight, zero or more, for each of its nodes")
    if not weights.sum() > 0:
        raise InputError(f"average element {element.name!r} has no nodes with a weight")
    return Interface(
        name=element.name, nodes=nodes, coupling=Average.name, point=model.nodes.xyz[element.reference].copy(),
        weights=weights, components=tuple(sorted(element.components)),
    )  # fmt: skip


def _offered(model: FEModel, element: RigidElement | AverageElement) -> Interface:
    """The interface that an element offers: the six motions of its master, or the mean motion of its nodes."""
    if isinstance(element, AverageElement):
        return _average_interface(model, element)
    return Interface(
        name=element.name, nodes=np.array([element.master]), coupling=Rigid.name,
        point=model.nodes.xyz[element.master].copy(), weights=np.ones(1), components=ALL,
    )  # fmt: skip


def interface_of_coupling(
    model: FEModel, text: str, *, name: str, coupling: str | None = None, point: Sequence[float] | None = None,
    components: Sequence[int] | None = None,
) -> Interface:  # fmt: skip
    """The interface ``name`` on ``text`` = "coupling:NAME", with the point of that coupling.

    Args:
        coupling: None, or what the coupling is anyway.
        point: in m; None for that of the coupling.

    Raises:
        InputError: no such coupling, one of another kind, or components that it does not have.
    """
    wanted = text.removeprefix("coupling:")
    if wanted not in model.couplings:
        raise InputError(
            f"interface {name!r}: the model has no coupling {wanted!r}; {nearest(wanted, model.couplings)}"
        )
    interface = _offered(model, model.couplings[wanted])
    if coupling is not None and coupling != interface.coupling:
        raise InputError(
            f"interface {name!r}: coupling = {coupling!r} was given, but {wanted!r} of the model is "
            f"{interface.coupling!r}; leave the key out"
        )
    chosen = interface.components if components is None else tuple(sorted(set(components)))
    if not chosen or not set(chosen) <= set(interface.components):
        raise InputError(
            f"interface {name!r}: components = {list(components or [])} was given; the coupling {wanted!r} has "
            f"{', '.join(map(str, interface.components))}"
        )
    interface.kind.check(model, interface)
    origin = interface.point if point is None else np.asarray(point, dtype=float)
    return replace(interface, name=name, point=origin, components=chosen)
