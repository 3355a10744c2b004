"""Rigid and average elements and equations of a model: which dofs follow which, and the interfaces of the elements.

A slave of a rigid element moves as u_s = u_m + theta_m x (x_s - x_m), its rotations as theta_m; the reference of an
average element moves as the mean of its nodes (``interface.averaging``); equations say it themselves. What a dof
follows may follow others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats, Ints
from morembs.fem import FEModel, rigid_motion
from morembs.fem.constraints import AverageElement, DependentDofs, Equations, RigidElement
from morembs.fem.interface import Average, Interface, Rigid, averaging
from morembs.importers.tolerances import TOL

ALL = (0, 1, 2, 3, 4, 5)


def dof_table(model: FEModel) -> Ints:
    """Dof (n, 7) of each node and component, -1 where there is none."""
    return model.dofs.table(len(model.nodes))


def dependent_dofs(
    model: FEModel, rigid: Sequence[RigidElement], average: Sequence[AverageElement], equations: Sequence[Equations]
) -> DependentDofs | None:
    """Dofs that depend on others through elements and equations, None without any.

    Raises:
        InputError: a dof that follows two of them, some that follow each other in a circle, average elements whose
            nodes lie on a line, or one of so many nodes that its loads would fill the matrices.
    """
    elements: list[RigidElement | AverageElement | Equations] = [*rigid, *average, *equations]
    if not elements:
        return None
    table, owner = dof_table(model), np.full(model.size, -1, dtype=np.int64)
    names = tuple(element.name for element in elements)
    rows, columns, values = [], [], []
    for number, element in enumerate(elements):
        if isinstance(element, RigidElement):
            dofs, at, weight = _rigid_rows(model, element, table)
            own = np.unique(dofs)
        elif isinstance(element, AverageElement):
            dofs, at, weight = _mean_rows(model, element, table)
            own = np.unique(dofs)
        else:
            own, weight = table[element.nodes, element.components], element.coefficients
            dofs, at = own[element.equation], table[element.term_nodes, element.term_components]
        _own(model, names, owner, own, number)
        rows.append(dofs)
        columns.append(at)
        values.append(weight)
    free = np.flatnonzero(owner < 0)
    data = np.concatenate([np.ones(len(free)), *values])
    where = (np.concatenate([free, *rows]), np.concatenate([free, *columns]))
    S = sp.csr_array(sp.coo_array((data, where), shape=(model.size, model.size)))
    S.eliminate_zeros()
    _refuse_circles(model, S, owner, names)
    return DependentDofs(S=_resolved(S, owner), owner=owner, names=names)


def _own(model: FEModel, names: Sequence[str], owner: Ints, dofs: Ints, number: int) -> None:
    """``dofs`` (n,) depend on the element ``number`` from now on.

    Raises:
        InputError: one is there twice, or follows another element already.
    """
    taken = dofs[owner[dofs] >= 0]
    first = owner[taken]
    owner[dofs] = number
    twice = np.sort(dofs)
    twice = twice[1:][twice[1:] == twice[:-1]]
    for dof in [*taken, *twice][:1]:
        pair = f"both {names[first[0]]!r} and {names[number]!r}" if len(first) else f"{names[number]!r} twice"
        raise InputError(
            f"{_dof_name(model, dof)} follows {pair}; a node can follow one element only, a dof one equation"
        )


def _dof_name(model: FEModel, dof: int) -> str:
    return f"component {model.dofs.component[dof]} of node {model.nodes.ids[model.dofs.node[dof]]}"


def _rigid_rows(model: FEModel, element: RigidElement, table: Ints) -> tuple[Ints, Ints, Floats]:
    """Rows, columns and values of the slaves' motion."""
    if element.master in element.slaves:
        raise InputError(f"rigid element {element.name!r} names its master among the slaves; leave it out of these")
    slaves = np.unique(element.slaves)
    dofs = table[slaves][:, list(element.components)]
    node = np.repeat(slaves, len(element.components))[dofs.ravel() >= 0]
    dofs = dofs.ravel()[dofs.ravel() >= 0]
    motion = rigid_motion(model.nodes.xyz[node] - model.nodes.xyz[element.master], model.dofs.component[dofs])
    return np.repeat(dofs, 6), np.tile(table[element.master, :6], len(dofs)), motion.ravel()


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
    if loaded and columns.size**2 > TOL.max_spread_entries:
        most = int(TOL.max_spread_entries**0.5) // 3
        raise InputError(
            f"the reference of average element {element.name!r} carries a mass or elements over {len(interface.nodes)} "
            f"nodes, which would fill the matrices; take at most {most} nodes, or a rigid element"
        )
    T = averaging(interface, model.nodes.xyz[interface.nodes])[list(element.components)]
    return np.repeat(dofs, columns.size), np.tile(columns.ravel(), len(dofs)), T.ravel()


def _refuse_circles(model: FEModel, S: sp.csr_array, owner: Ints, names: Sequence[str]) -> None:
    follows = np.flatnonzero(owner >= 0)
    among = S[follows][:, follows]
    if not among.nnz:
        return
    _, circle = connected_components(among, directed=True, connection="strong")
    stuck = np.flatnonzero((np.bincount(circle)[circle] > 1) | (among.diagonal() != 0))
    if len(stuck):
        dof = follows[stuck[0]]
        raise InputError(
            "rigid elements, average elements or equations follow each other in a circle: one of them is "
            f"{names[owner[dof]]!r} where it gives {_dof_name(model, dof)}"
        )


def _resolved(S: sp.csr_array, owner: Ints) -> sp.csr_array:
    """S with every dependent dof given by independent ones alone, where there are chains and no circles."""
    follows = owner >= 0
    while follows[S.indices].any():
        # Squares halve the chains each time.
        S = sp.csr_array(S @ S)
        S.eliminate_zeros()
    S.sort_indices()
    return S


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
        name=element.name,
        nodes=nodes,
        coupling=Average.name,
        point=model.nodes.xyz[element.reference].copy(),
        weights=weights,
        components=tuple(sorted(element.components)),
    )


def _offered(model: FEModel, element: RigidElement | AverageElement) -> Interface:
    """The interface that an element offers: the six motions of its master, or the mean motion of its nodes."""
    if isinstance(element, AverageElement):
        return _average_interface(model, element)
    return Interface(
        name=element.name,
        nodes=np.array([element.master]),
        coupling=Rigid.name,
        point=model.nodes.xyz[element.master].copy(),
        weights=np.ones(1),
        components=ALL,
    )


def interface_of_coupling(
    model: FEModel,
    text: str,
    *,
    name: str,
    coupling: str | None = None,
    point: Sequence[float] | None = None,
    components: Sequence[int] | None = None,
) -> Interface:
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
