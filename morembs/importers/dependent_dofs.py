"""Rigid and average elements and equations of a model: which dofs follow which, and the interfaces of the elements.

A slave of a rigid element moves as u_s = u_m + theta_m x (x_s - x_m), its rotations as theta_m; the reference of an
average element moves as the mean of its nodes (``interface.averaging``); equations say it themselves. What a dof
follows may follow others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats, Ints
from morembs.fem import FEModel, rigid_motion
from morembs.fem.constraints import AverageElement, DependentDofs, Equations, RigidElement
from morembs.fem.interface import Average, Interface, Rigid, average_matrix
from morembs.importers.tolerances import TOL

ALL = (0, 1, 2, 3, 4, 5)


def dof_table(model: FEModel) -> Ints:
    """Dof (n, 7) of each node and component, -1 where there is none."""
    return model.dofs.table(len(model.nodes))


@dataclass(frozen=True, eq=False)
class _Sums:
    """Motions that element ``number`` gives: that of dof ``own[row]`` (of r) is the sum of ``weight`` times that of the
    dof ``at``, over the entries (t,) of each row."""

    number: int
    own: Ints
    row: Ints
    at: Ints
    weight: Floats

    def choose(self, rows: NDArray[np.bool_]) -> _Sums:
        """Some of the rows."""
        kept = rows[self.row]
        number = np.cumsum(rows) - 1
        return _Sums(self.number, self.own[rows], number[self.row[kept]], self.at[kept], self.weight[kept])


def dependent_dofs(
    model: FEModel,
    rigid: Sequence[RigidElement],
    average: Sequence[AverageElement],
    equations: Sequence[Equations],
    warnings: list[str] | None = None,
) -> DependentDofs | None:
    """Dofs that depend on others through elements and equations, None without any.

    A dof may follow several of them: redundant ones are left out, by the rank of their terms on
    independent dofs, and the others are solved for further dofs, of which ``warnings`` are added.

    Raises:
        InputError: dofs that follow each other in a circle, average elements whose nodes lie on a line, or one of so
            many nodes that its loads would fill the matrices.
    """
    elements: list[RigidElement | AverageElement | Equations] = [*rigid, *average, *equations]
    if not elements:
        return None
    table, owner = dof_table(model), np.full(model.size, -1, dtype=np.int64)
    names = tuple(element.name for element in elements)
    first: list[_Sums] = []
    later: list[_Sums] = []
    for number, element in enumerate(elements):
        given = _sums(model, element, table, number)
        is_first = np.zeros(len(given.own), dtype=bool)
        is_first[np.unique(given.own, return_index=True)[1]] = True
        is_first &= owner[given.own] < 0
        first.append(given.choose(is_first))
        if not is_first.all():
            later.append(given.choose(~is_first))
        owner[first[-1].own] = number
    free = np.flatnonzero(owner < 0)
    data = np.concatenate([np.ones(len(free)), *(part.weight for part in first)])
    rows = np.concatenate([free, *(part.own[part.row] for part in first)])
    columns = np.concatenate([free, *(part.at for part in first)])
    S = sp.csr_array(sp.coo_array((data, (rows, columns)), shape=(model.size, model.size)))
    S.eliminate_zeros()
    _refuse_circles(model, S, owner, names)
    S = _resolve(S, owner)
    if later:
        S = _with_later(model, S, owner, later, names, [] if warnings is None else warnings)
    return DependentDofs(S=S, owner=owner, names=names)


def _sums(model: FEModel, element: RigidElement | AverageElement | Equations, table: Ints, number: int) -> _Sums:
    if isinstance(element, Equations):
        own, at = table[element.nodes, element.components], table[element.term_nodes, element.term_components]
        return _Sums(number, own, element.equation, at, element.coefficients)
    of = _rigid_rows if isinstance(element, RigidElement) else _mean_rows
    dofs, at, weight = of(model, element, table)  # type: ignore[arg-type]
    own, row = np.unique(dofs, return_inverse=True)
    return _Sums(number, own, row.ravel(), at, weight)


def _with_later(
    model: FEModel, S: sp.csr_array, owner: Ints, later: Sequence[_Sums], names: Sequence[str], warnings: list[str]
) -> sp.csr_array:
    """S where motions of dofs that follow something else already hold too; ``owner`` gets the dofs that follow them.

    Raises:
        InputError: so many that their reduced equations would fill the memory.
    """
    counts = np.array([len(part.own) for part in later])
    start = np.cumsum(counts) - counts
    rows = np.concatenate([np.arange(counts.sum()), *(part.row + a for part, a in zip(later, start, strict=True))])
    columns = np.concatenate([*(part.own for part in later), *(part.at for part in later)])
    values = np.concatenate([np.ones(counts.sum()), *(-part.weight for part in later)])
    residual = sp.csr_array(sp.coo_array((values, (rows, columns)), shape=(counts.sum(), model.size)))
    scale = abs(residual).max(axis=1).toarray().ravel()
    left = sp.csc_array(sp.diags_array(1.0 / scale) @ residual @ S)
    used = np.flatnonzero(np.diff(left.indptr))
    example, first = later[0].own[0], names[owner[later[0].own[0]]]
    both = f"{_dof_name(model, example)} follows both {first!r} and {names[later[0].number]!r}"
    if left.shape[0] * len(used) > TOL.max_spread_entries:
        raise InputError(
            f"{both}, as {left.shape[0]} dofs do, too many to be distinguished; leave one of the two out",
            kind="unsupported",
        )
    A = left[:, used].toarray()
    R, pivot = sl.qr(A, mode="r", pivoting=True)
    size = np.abs(np.diagonal(R)) if A.size else np.empty(0)
    rank = int(np.count_nonzero(size > TOL.dependent_pivot))
    if not rank:
        return S
    dependent, others = used[pivot[:rank]], used[pivot[rank:]]
    mix = -sl.solve_triangular(R[:rank, :rank], R[:rank, rank:])
    own = np.repeat([part.number for part in later], counts)
    # The last of the elements is named; which of them a dof follows is a choice among all of them.
    owner[dependent] = own[-1]
    keep = np.ones(model.size)
    keep[dependent] = 0.0
    i, j = np.nonzero(np.abs(mix) > TOL.no_part)
    more = sp.coo_array((mix[i, j], (dependent[i], others[j])), shape=S.shape)
    warnings.append(
        f"{both}; {rank} further motions follow, so that all of them hold (CalculiX leaves out the later ones) "
        "[over-constraint]"
    )
    S = sp.csr_array(S @ sp.csr_array(sp.diags_array(keep) + more))
    S.eliminate_zeros()
    S.sort_indices()
    return S


def _dof_name(model: FEModel, dof: int) -> str:
    return f"component {model.dofs.component[dof]} of node {model.nodes.ids[model.dofs.node[dof]]}"


def _rigid_rows(model: FEModel, element: RigidElement, table: Ints) -> tuple[Ints, Ints, Floats]:
    """Rows, columns and values of the slaves' motion."""
    if element.master in element.slaves:
        raise InputError(
            f"rigid element {element.name!r} names its master among the slaves; leave it out of these",
            kind="conflict",
            keyword="element",
        )
    slaves = np.unique(element.slaves)
    dofs = table[slaves][:, list(element.components)]
    node = np.repeat(slaves, len(element.components))[dofs.ravel() >= 0]
    dofs = dofs.ravel()[dofs.ravel() >= 0]
    motion = rigid_motion(model.nodes.xyz[node] - model.nodes.xyz[element.master], model.dofs.component[dofs])
    return np.repeat(dofs, 6), np.tile(table[element.master, :6], len(dofs)), motion.ravel()


def _mean_rows(model: FEModel, element: AverageElement, table: Ints) -> tuple[Ints, Ints, Floats]:
    """Rows, columns and values of the reference's motion."""
    if element.reference in element.nodes:
        raise InputError(
            f"average element {element.name!r} names its reference among its nodes; leave it out of these",
            kind="unsupported",
        )
    interface = _average_interface(model, element)
    columns = table[interface.nodes][:, :3]
    if (columns < 0).any():
        node = model.nodes.ids[interface.nodes[(columns < 0).any(axis=1)][0]]
        raise InputError(
            f"average element {element.name!r}: node {node} has no dof for each of x, y and z", kind="unsupported"
        )
    interface.kind.check(model, interface)
    dofs = table[element.reference][list(element.components)]
    loaded = any(A is not None and (np.diff(A.indptr)[dofs] > 0).any() for A in (model.K, model.M, model.D))
    if loaded and columns.size**2 > TOL.max_spread_entries:
        max_nodes = int(TOL.max_spread_entries**0.5) // 3
        raise InputError(
            f"the reference of average element {element.name!r} carries a mass or elements over {len(interface.nodes)} "
            f"nodes, which would fill the matrices; take at max_nodes {max_nodes} nodes, or a rigid element",
            kind="unsupported",
        )
    T = average_matrix(interface, model.nodes.xyz[interface.nodes])[list(element.components)]
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
            f"{names[owner[dof]]!r} where it gives {_dof_name(model, dof)}",
            kind="conflict",
            keyword="equation",
        )


def _resolve(S: sp.csr_array, owner: Ints) -> sp.csr_array:
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
        raise InputError(
            f"average element {element.name!r} needs one weight, zero or more, for each of its nodes",
            kind="missing",
            keyword="weights",
        )
    if not weights.sum() > 0:
        raise InputError(f"average element {element.name!r} has no nodes with a weight", kind="missing")
    return Interface(
        name=element.name,
        nodes=nodes,
        coupling=Average.name,
        point=model.nodes.xyz[element.reference].copy(),
        weights=weights,
        components=tuple(sorted(element.components)),
    )


def _offer(model: FEModel, element: RigidElement | AverageElement) -> Interface:
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
            f"interface {name!r}: the model has no coupling {wanted!r}; {nearest(wanted, model.couplings)}",
            kind="unknown",
            keyword="nodes",
        )
    interface = _offer(model, model.couplings[wanted])
    if coupling is not None and coupling != interface.coupling:
        raise InputError(
            f"interface {name!r}: coupling = {coupling!r} was given, but {wanted!r} of the model is "
            f"{interface.coupling!r}; leave the key out",
            keyword="coupling",
        )
    chosen = interface.components if components is None else tuple(sorted(set(components)))
    if not chosen or not set(chosen) <= set(interface.components):
        raise InputError(
            f"interface {name!r}: components = {list(components or [])} was given; the coupling {wanted!r} has "
            f"{', '.join(map(str, interface.components))}",
            keyword="components",
        )
    interface.kind.check(model, interface)
    origin = interface.point if point is None else np.asarray(point, dtype=float)
    return replace(interface, name=name, point=origin, components=chosen)
