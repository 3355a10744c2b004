"""Springs, dashpots and masses by direction: entries between a few dofs, added to K, M and D."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.base.units import Units
from morembs.fem import FEModel
from morembs.importers.dependent_dofs import dof_table
from morembs.importers.imported import DiscreteElement
from morembs.importers.tolerances import TOL


def si_discrete(element: DiscreteElement, units: Units) -> DiscreteElement:
    """The element in SI units: N/m, kg or Ns/m, of rotations per rad.

    Raises:
        InputError: values that are not finite numbers.
    """
    if not np.isfinite(element.values).all():
        raise InputError(f"{element.name!r} has values that are not finite; mend the file")
    factor = {"K": units.stiffness, "M": units.mass, "D": units.mass / units.time}[element.matrix]
    weight = np.where(element.components > 2, units.length, 1.0)
    return replace(element, values=factor * element.values * np.outer(weight, weight))


def spring(name: str, matrix: str, ends: Sequence[tuple[int, Floats]], value: float) -> DiscreteElement:
    """The element value * a a' on the dofs where a is not zero.

    Args:
        ends: for each node its row, and its part (6,) of a: of SPRING2 +1 at one end and -1 at the other.
    """
    nodes = np.concatenate([np.full(int((part != 0).sum()), node) for node, part in ends])
    components = np.concatenate([np.flatnonzero(part) for _, part in ends])
    a = np.concatenate([part[part != 0] for _, part in ends])
    return DiscreteElement(name=name, matrix=matrix, nodes=nodes, components=components, values=value * np.outer(a, a))


def with_discrete(model: FEModel, elements: Sequence[DiscreteElement]) -> tuple[FEModel, tuple[str, ...]]:
    """The model with the elements in K, M and D, and notes.

    Rotations that a node of solids lacks take no moment: springs between them are condensed (K_ee - K_ef K_ff^+ K_fe).

    Raises:
        InputError: a mass or damper on a rotation that its node does not have, or a spring that would not
            resist some displacement because of that.
    """
    if not elements:
        return model, ()
    table, notes = dof_table(model), tuple[str, ...]()
    free = [bool((table[e.nodes, e.components] < 0).any()) for e in elements]
    floating = [element for element, loose in zip(elements, free, strict=True) if loose]
    plain = [element for element, loose in zip(elements, free, strict=True) if not loose]
    for element in floating:
        if element.matrix != "K":
            raise InputError(
                f"{element.name!r} acts on rotations of node {model.nodes.ids[element.nodes[0]]}, which it does not "
                "have (a solid has none); couple the node by a rigid element",
                kind="unsupported",
            )
    if floating:
        plain += _condense(floating, table, model)
        notes = (f"{len(floating)} springs act on rotations of solids, which have none: these rotations are free.",)
    matrices: dict[str, sp.csr_array | None] = {"K": model.K, "M": model.M, "D": model.D}
    for name in matrices:
        own = [element for element in plain if element.matrix == name]
        if own:
            dofs = [table[element.nodes, element.components] for element in own]
            rows = np.concatenate([np.repeat(d, len(d)) for d in dofs])
            columns = np.concatenate([np.tile(d, len(d)) for d in dofs])
            values = np.concatenate([element.values.ravel() for element in own])
            added = sp.csr_array(sp.coo_array((values, (rows, columns)), shape=model.K.shape))
            given = matrices[name]
            matrices[name] = added if given is None else sp.csr_array(given + added)
    return replace(model, K=matrices["K"], M=matrices["M"], D=matrices["D"]), notes


def _condense(elements: Sequence[DiscreteElement], table: Ints, model: FEModel) -> list[DiscreteElement]:
    """The springs; springs that share rotations without a dof become one each, without these rotations."""
    width = table.shape[1]
    codes = [width * element.nodes + element.components for element in elements]
    loose = np.unique(np.concatenate([code[table.ravel()[code] < 0] for code in codes]))
    at = [np.searchsorted(loose, code[table.ravel()[code] < 0]) for code in codes]
    which = np.repeat(np.arange(len(elements)), [len(rows) for rows in at])
    touch = sp.csr_array((np.ones(len(which)), (which, np.concatenate(at))), shape=(len(elements), len(loose)))
    groups = connected_components(touch @ touch.T, directed=False)[1]
    condensed = []
    for group in range(int(groups.max()) + 1):
        members = np.flatnonzero(groups == group).tolist()
        own = np.unique(np.concatenate([codes[i] for i in members]))
        A = np.zeros((len(own), len(own)))
        for i in members:
            rows = np.searchsorted(own, codes[i])
            np.add.at(A, (rows[:, None], rows[None, :]), elements[i].values)
        kept = table.ravel()[own] >= 0
        inner = A[np.ix_(kept, ~kept)] @ np.linalg.pinv(A[np.ix_(~kept, ~kept)], hermitian=True)
        values = A[np.ix_(kept, kept)] - inner @ A[np.ix_(~kept, kept)]
        name = elements[members[0]].name
        nodes, components = own[kept] // width, own[kept] % width
        moving = np.ix_(components < 3, components < 3)
        before, after = A[np.ix_(kept, kept)][moving], values[moving]
        tiny = TOL.no_stiffness * np.abs(before).max(initial=0.0)
        if np.linalg.matrix_rank(after, tiny) < np.linalg.matrix_rank(before, tiny):
            label = model.nodes.ids[own[~kept][0] // width]
            raise InputError(
                f"{name!r} acts across the distance of its ends, which must turn with it, and node {label} of "
                "solids has no rotations; couple its ends by rigid elements, or put them at one place",
                kind="model",
                keyword="springs",
            )
        condensed.append(DiscreteElement(name=name, matrix="K", nodes=nodes, components=components, values=values))
    return condensed
