"""Which node and direction each row of an export of CalculiX is.

CalculiX writes label and direction, but nodes of expanded shells and beams carry the label of their parent, and nodes
that it made for itself one beyond the deck. What such rows are is told by rigid motion R, which K leaves free of force:
with R known on rows k, K_uu R_u = -K_uk R_k gives it on the rows u. A displacement at x has the row [e, -x~ e], a
rotation [0, e], a mode inside an element or across a section zero.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as sla
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.model import rigid_motion
from morembs.model.fe_model import SCALAR

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# How near R_u must come to that of a place or motion, of 1 for displacements, and of lengths of the model.
NEAR = 1e-5
# Residual of rigid motion against what cancels above which an assignment is wrong.
STRAINED = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Expanded:
    """What CalculiX made of shells and beams: places of the ``nodes`` (n,) by their internal numbers, ascending, in
    ``xyz`` (n, 3), and the ``parent`` (n,) label of each. ``knots`` are labels of parents that have dofs of their own,
    displacements and rotations, which all that they became follows."""

    nodes: Ints
    xyz: Floats
    parent: Ints
    knots: Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class RowMap:
    """``owner`` (N,): the label of a deck node, or minus the internal number of an expanded node, or 0 for rows of
    neither; ``component`` (N,) 0..6; ``group`` (N,) which rows belong to one internal node; ``place`` (N, 3)."""

    owner: Ints
    component: Ints
    group: Ints
    place: Floats


def groups_of(label: Ints, direction: Ints) -> Ints:
    """Number (N,) of the internal node of each row: a new one begins where the label changes or directions restart."""
    new = np.ones(len(label), dtype=bool)
    new[1:] = (np.diff(label) != 0) | (np.diff(direction) <= 0)
    return np.cumsum(new) - 1


def map_rows(
    K: sp.csr_array, label: Ints, direction: Ints, xyz: Floats, *, expanded: Expanded | None,
    turning: Mapping[int, int], unplaced: Ints,
) -> RowMap:  # fmt: skip
    """Node and component of each row of ``K`` (N, N).

    Args:
        label, direction: (N,) as CalculiX writes them, directions 1..3.
        xyz: (n, 3) of the deck's nodes; label i + 1 is row i.
        expanded: nodes of shells and beams, None without such.
        turning: label of a node whose displacements are rotations -> the node that turns.
        unplaced: labels of deck nodes that no element has, so that their dofs may mean anything.

    Raises:
        InputError: rows that rigid motion does not explain.
    """
    group = groups_of(label, direction)
    first = np.flatnonzero(np.diff(group, prepend=-1))
    count = len(xyz)
    parents = set() if expanded is None else set(expanded.parent.tolist()) - set(expanded.knots.tolist())
    of_group = label[first]
    owner = np.zeros(len(first), dtype=np.int64)
    known = np.zeros(len(first), dtype=bool)
    full = np.bincount(group) == 3
    # Nodes of the deck come first, in ascending order; an expanded node may carry the same label.
    ascending = (of_group <= count) & (np.diff(of_group, prepend=0) > 0)
    prefix = np.cumprod(ascending).astype(bool)
    doubtful = set(unplaced.tolist()) | set(turning)
    for g in np.flatnonzero(of_group <= count):
        if prefix[g] and of_group[g] not in parents:
            owner[g], known[g] = of_group[g], of_group[g] not in doubtful
    if expanded is not None:
        _by_count(of_group, prefix, full, expanded, owner, known)
    place = np.zeros((len(label), 3))
    component = direction - 1
    by_group = np.full((len(first), 3), np.nan)
    by_group[owner > 0] = xyz[owner[owner > 0] - 1]
    if expanded is not None:
        at = np.searchsorted(expanded.nodes, -owner[owner < 0])
        by_group[owner < 0] = expanded.xyz[at]
    place = by_group[group]
    if known.all():
        return RowMap(owner=owner[group], component=component, group=group, place=place)
    return _solved(K, of_group, direction, group, owner, known, place, xyz, expanded, turning)


def _by_count(
    of_group: Ints, prefix: NDArray[np.bool_], full: NDArray[np.bool_], expanded: Expanded, owner: Ints,
    known: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Labels of which all expanded nodes are there, whole: these, in ascending order."""
    order = np.argsort(expanded.parent, kind="stable")
    start = np.searchsorted(expanded.parent[order], np.arange(expanded.parent.max(initial=0) + 2))
    by_label = np.argsort(of_group, kind="stable")
    edges = np.flatnonzero(np.diff(of_group[by_label], prepend=-1))
    for own in np.split(by_label, edges[1:]):
        parent = of_group[own[0]]
        if parent + 1 >= len(start):
            continue
        nodes = expanded.nodes[order[start[parent] : start[parent + 1]]]
        if not len(nodes) or not full[own].all():
            continue
        if len(own) == len(nodes) + 1 and prefix[own[0]]:
            owner[own[0]], known[own[0]] = parent, True
            own = own[1:]
        if len(own) == len(nodes):
            owner[own], known[own] = -nodes, True


def _solved(
    K: sp.csr_array, of_group: Ints, direction: Ints, group: Ints, owner: Ints, known: NDArray[np.bool_], place: Floats,
    xyz: Floats, expanded: Expanded | None, turning: Mapping[int, int],
) -> RowMap:  # fmt: skip
    """The rest by rigid motion."""
    rows = known[group]
    center = xyz.mean(axis=0)
    length = float(np.abs(xyz - center).max()) or 1.0
    component = direction - 1
    R = np.zeros((len(group), 6))
    R[rows] = rigid_motion((place[rows] - center) / length, component[rows])
    R[~rows] = _motion(K, R, rows)
    component, place, owner_of_row = component.copy(), place.copy(), owner[group]
    taken: set[tuple[int, int]] = set()
    for g in np.flatnonzero(~known):
        own = np.flatnonzero(group == g) if len(group) < 1000 else np.arange(*np.searchsorted(group, [g, g + 1]))
        seen, axes = R[own], direction[own] - 1
        label = int(of_group[g])
        turned = np.zeros_like(seen)
        turned[np.arange(len(own)), 3 + axes] = 1.0 / length
        if np.abs(seen).max() < NEAR:
            component[own], owner_of_row[own] = SCALAR, 0
        elif np.abs(seen - turned).max() < NEAR / length or label in turning:
            component[own], owner_of_row[own] = axes + 3, turning.get(label, 0)
        else:
            candidates = _candidates(label, xyz, expanded)
            found = _nearest(seen, axes, candidates, center, length, taken)
            if found is None:
                raise InputError(
                    f"the rows of the export could not be assigned to nodes: rigid motion says nothing that fits for "
                    f"the node {label}; please report it with the files that --keep-files DIR leaves"
                )
            owner_of_row[own], place[own] = found
            taken |= {(found[0], int(axis)) for axis in axes}
    return RowMap(owner=owner_of_row, component=component, group=group, place=place)


def _candidates(label: int, xyz: Floats, expanded: Expanded | None) -> list[tuple[int, Floats]]:
    """Owners and places that rows of a label may have."""
    found: list[tuple[int, Floats]] = [(label, xyz[label - 1])] if label <= len(xyz) else []
    if expanded is not None:
        at = np.flatnonzero(expanded.parent == label)
        found += [(-int(expanded.nodes[i]), expanded.xyz[i]) for i in at]
    return found


def _nearest(
    seen: Floats, axes: Ints, candidates: list[tuple[int, Floats]], center: Floats, length: float,
    taken: set[tuple[int, int]],
) -> tuple[int, Floats] | None:  # fmt: skip
    """The candidate whose rigid motion the rows ``seen`` (k, 6) have, else a place of its own, which has owner 0."""
    best, least = None, NEAR
    for owner, place in candidates:
        if any((owner, int(axis)) in taken for axis in axes):
            continue
        off = float(np.abs(seen - rigid_motion(np.tile((place - center) / length, (len(axes), 1)), axes)).max())
        if off < least:
            best, least = (owner, place), off
    if best is not None or len(axes) < 3:
        return best
    # R[:, 3:] = -x~ has x in six of its entries.
    turn = seen[:, 3:]
    x = np.array([turn[1, 2] - turn[2, 1], turn[2, 0] - turn[0, 2], turn[0, 1] - turn[1, 0]]) / 2
    fits = np.abs(seen - rigid_motion(np.tile(x, (3, 1)), axes)).max() < NEAR
    return (0, x * length + center) if fits else None


def _motion(K: sp.csr_array, R: Floats, known: NDArray[np.bool_]) -> Floats:
    """Rigid motion (u, 6) on the other rows; where K leaves some of it open, the least."""
    rest = np.flatnonzero(~known)
    part = sp.csc_array(K[rest])
    right = -(part[:, np.flatnonzero(known)] @ R[known])
    inner = sp.csc_array(part[:, rest])
    size = np.sqrt(np.abs(inner.diagonal()))
    size[size == 0] = 1.0
    D = sp.diags_array(1.0 / size)
    scaled = sp.csc_array(D @ inner @ D)
    try:
        found = sla.splu(scaled).solve(right / size[:, None])
        if np.isfinite(found).all() and np.abs(found).max() < 1e8 * max(float(size.max()), 1.0):
            return np.asarray(found / size[:, None])
    except RuntimeError:
        pass
    columns = [sla.lsmr(scaled, column, atol=1e-14, btol=1e-14, conlim=1e12)[0] for column in (right / size[:, None]).T]
    return np.asarray(np.column_stack(columns) / size[:, None])


def strain(K: sp.csr_array, rows: RowMap) -> float:
    """Largest force under rigid motion, of the largest sum of what cancels in a row."""
    center = rows.place.mean(axis=0)
    length = float(np.abs(rows.place - center).max()) or 1.0
    R = rigid_motion((rows.place - center) / length, rows.component)
    R[(rows.component > 2) & (rows.component < SCALAR)] /= length
    terms = abs(K) @ np.abs(R)
    return float(np.abs(K @ R).max() / max(float(terms.max()), np.finfo(float).tiny))
