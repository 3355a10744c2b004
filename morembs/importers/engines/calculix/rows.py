"""Which node and direction each row of an export of CalculiX is.

CalculiX writes label and direction, but nodes of expanded shells and beams carry the label of their parent, and nodes
that it made for itself one beyond the deck. Rigid motion R identifies such rows, which K leaves free of force:
with R known on rows k, K_uu R_u = -K_uk R_k gives it on the rows u. A displacement at x has the row [e, -x~ e], a
rotation [0, e], a mode inside an element or across a section zero.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as sla
from numpy.typing import NDArray

from morembs.base.types import Bools, Floats, Ints
from morembs.fem import rigid_motion
from morembs.fem.fe_model import Component
from morembs.importers.tolerances import TOL


@dataclass(frozen=True, kw_only=True, eq=False)
class Expanded:
    """What CalculiX made of shells and beams: places of the ``nodes`` (n,) by their internal numbers, ascending, in
    ``xyz`` (n, 3), and the ``parent`` (n,) label of each. ``knots`` are labels of parents that have dofs of their own,
    displacements and rotations, which all that they became follows; ``hinges`` those of trusses and membranes alone,
    which keep their displacements beside those of the expanded nodes."""

    nodes: Ints
    xyz: Floats
    parent: Ints
    knots: Ints
    hinges: Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class RowMap:
    """``owner`` (N,): the label of a deck node, or minus the internal number of an expanded node, or 0 for rows of
    neither; ``component`` (N,) 0..6; ``group`` (N,) which rows belong to one internal node; ``place`` (N, 3).
    ``change`` T (N, N), where it is not None, gives the dofs of CalculiX from those of this map, u = T q."""

    owner: Ints
    component: Ints
    group: Ints
    place: Floats
    change: sp.csr_array | None = None


def groups_of(label: Ints, direction: Ints) -> Ints:
    """Number (N,) of the internal node of each row: a new one begins where the label changes or directions restart."""
    new = np.ones(len(label), dtype=bool)
    new[1:] = (np.diff(label) != 0) | (np.diff(direction) <= 0)
    return np.cumsum(new) - 1


def map_rows(
    K: sp.csr_array,
    label: Ints,
    direction: Ints,
    xyz: Floats,
    *,
    expanded: Expanded | None,
    turning: Mapping[int, int],
    unplaced: Ints,
    bodies: int,
    held: bool,
) -> RowMap:
    """Node and component of each row of ``K`` (N, N).

    Args:
        label, direction: (N,) as CalculiX writes them, directions 1..3.
        xyz: (n, 3) of the deck's nodes; label i + 1 is row i.
        expanded: nodes of shells and beams, None without such.
        turning: label of a node whose displacements are rotations -> the node that turns.
        unplaced: labels of deck nodes that no element has, so that their dofs may mean anything.
        bodies: how many rigid bodies and couplings have a rotation node that CalculiX makes.
        held: whether the deck holds nodes, so that rigid motion tells nothing of expanded nodes there.
    """
    group = groups_of(label, direction)
    first = np.flatnonzero(np.diff(group, prepend=-1))
    count = len(xyz)
    own = set() if expanded is None else {*expanded.knots.tolist(), *expanded.hinges.tolist()}
    parents = set() if expanded is None else set(expanded.parent.tolist()) - own
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
        _by_count(of_group, prefix, full, expanded, owner, known, surely=True)
        if held:
            _by_count(of_group, prefix, full, expanded, owner, known, surely=False)
    by_group = np.full((len(first), 3), np.nan)
    by_group[owner > 0] = xyz[owner[owner > 0] - 1]
    if expanded is not None:
        by_group[owner < 0] = expanded.xyz[np.searchsorted(expanded.nodes, -owner[owner < 0])]
    given = RowMap(owner=owner[group], component=direction - 1, group=group, place=by_group[group])
    if known.all():
        return given
    extra = np.flatnonzero(of_group > count)
    knots = 0 if expanded is None else len(expanded.knots)
    turns = {int(of_group[g]) for g in [*extra[:bodies], *extra[bodies : bodies + 2 * knots : 2]]} | set(turning)
    center = xyz.mean(axis=0)
    length = float(np.abs(xyz - center).max()) or 1.0
    return _Solved(K, given, known, turns, of_group, center, length).map(xyz, expanded, turning)


def _by_count(
    of_group: Ints, prefix: Bools, full: Bools, expanded: Expanded, owner: Ints, known: Bools, *, surely: bool
) -> None:
    """Labels of which all expanded nodes are there, whole: these, in ascending order; not ``surely`` also others."""
    order = np.argsort(expanded.parent, kind="stable")
    start = np.searchsorted(expanded.parent[order], np.arange(expanded.parent.max(initial=0) + 2))
    by_label = np.argsort(of_group, kind="stable")
    edges = np.flatnonzero(np.diff(of_group[by_label], prepend=-1))
    hinges = set(expanded.hinges.tolist())
    for own in np.split(by_label, edges[1:]):
        parent = of_group[own[0]]
        if parent + 1 >= len(start):
            continue
        nodes = expanded.nodes[order[start[parent] : start[parent + 1]]]
        if parent in hinges:
            own = own[owner[own] == 0]
        if surely and not full[own].all():
            continue
        if len(own) == len(nodes) + 1 and prefix[own[0]]:
            owner[own[0]], known[own[0]] = parent, True
            own = own[1:]
        if len(own) == len(nodes) or not surely:
            # Where some follow, they are the first.
            own = own[owner[own] == 0][: len(nodes)]
            owner[own], known[own] = -nodes[len(nodes) - len(own) :], True


class _Solved:
    """The rest by rigid motion, where it tells them; ``turns`` are labels that are rotations where it leaves that open
    (the axis of a straight beam)."""

    def __init__(
        self,
        K: sp.csr_array,
        given: RowMap,
        known: Bools,
        turns: set[int],
        of_group: Ints,
        center: Floats,
        length: float,
    ) -> None:
        self.K, self.given, self.known, self.of_group = K, given, known, of_group
        self.center, self.length = center, length
        self.owner, self.component, self.place = given.owner.copy(), given.component.copy(), given.place.copy()
        self.edges = np.searchsorted(given.group, np.arange(len(of_group) + 1))
        self.R = np.zeros((len(self.owner), 6))
        rows = known[given.group]
        self.R[rows] = rigid_motion((self.place[rows] - center) / length, self.component[rows])
        likely = np.flatnonzero(~rows & np.isin(of_group[given.group], list(turns)))
        self.R[likely, 3 + self.component[likely]] = 1.0 / length

    def map(self, xyz: Floats, expanded: Expanded | None, turning: Mapping[int, int]) -> RowMap:
        """Rows identified by their rigid motion; unexplained ones relative to others."""
        self._expect(xyz, expanded, turning)
        rows = self.known[self.given.group]
        self.R[~rows] = _motion(self.K, self.R, rows)
        exact, untold = self.R.copy(), list[int]()
        taken: set[tuple[int, int]] = set()
        # Modes inside elements and across sections, most of all: they stay where they are.
        least = TOL.near_motion * min(1.0, 1.0 / self.length)
        resting = np.maximum.reduceat(np.abs(self.R).max(axis=1), self.edges[:-1]) < least
        rows = (resting & ~self.known)[self.given.group]
        self.owner[rows], self.component[rows], self.place[rows], exact[rows] = 0, Component.SCALAR, self.center, 0.0
        for g in np.flatnonzero(~self.known & ~resting):
            own = slice(self.edges[g], self.edges[g + 1])
            label, axes = int(self.of_group[g]), self.given.component[own]
            what = self._owner_of_motion(
                self.R[own], axes, _candidates(label, xyz, expanded), taken, turns=label in turning
            )
            if what is None:
                untold.append(int(g))
                continue
            owner, place, components = what
            self.owner[own], self.place[own], self.component[own] = owner, place, components
            if label in turning:
                self.owner[own] = turning[label]
            taken |= {(owner, int(c)) for c in components if owner}
            exact[own] = rigid_motion(np.tile((place - self.center) / self.length, (len(axes), 1)), components)
            exact[own] /= np.where((components > 2) & (components < Component.SCALAR), self.length, 1.0)[:, None]
        force = np.abs(self.K @ exact).max(axis=1)
        wrong = force > TOL.told_residual * (abs(self.K) @ np.abs(exact)).max(axis=1)
        bad = np.unique(self.given.group[wrong & ~self.known[self.given.group]])
        rest = np.union1d(np.array(untold, dtype=np.int64), bad)
        change = self._relative(rest) if len(rest) else None
        return replace(self.given, owner=self.owner, component=self.component, place=self.place, change=change)

    def _expect(self, xyz: Floats, expanded: Expanded | None, turning: Mapping[int, int]) -> None:
        """Rigid motion of expanded nodes where K leaves it open: the first nodes of a label follow, the others stay."""
        open_groups = np.flatnonzero(~self.known & (self.of_group <= len(xyz)))
        groups_of: dict[int, list[int]] = {}
        for g in open_groups.tolist():
            if int(self.of_group[g]) not in turning:
                groups_of.setdefault(int(self.of_group[g]), []).append(g)
        for label, groups in groups_of.items():
            places = _candidates(label, xyz, expanded)[-len(groups) :]
            for g, (_, place) in zip(groups[-len(places) :], places, strict=True):
                own = slice(self.edges[g], self.edges[g + 1])
                axes = self.given.component[own]
                at = np.tile((place - self.center) / self.length, (len(axes), 1))
                self.R[own] = rigid_motion(at, axes)

    def _owner_of_motion(
        self,
        motions: Floats,
        axes: Ints,
        candidates: list[tuple[int, Floats]],
        taken: set[tuple[int, int]],
        *,
        turns: bool,
    ) -> tuple[int, Floats, Ints] | None:
        """Owner, place and components of rows with the rigid motion ``motions`` (k, 6)."""
        nowhere = np.full(3, np.nan)
        turned = np.eye(3)[axes]
        best, least = None, TOL.near_motion
        if turns or (
            np.abs(motions[:, :3]).max() < least and np.abs(motions[:, 3:] * self.length - turned).max() < least
        ):
            return 0, nowhere, axes + 3
        for owner, place in candidates:
            if any((owner, int(axis)) in taken for axis in axes):
                continue
            at = np.tile((place - self.center) / self.length, (len(axes), 1))
            off = float(np.abs(motions - rigid_motion(at, axes)).max())
            if off < least:
                best, least = (owner, place, axes), off
        return best

    def _relative(self, groups: Ints) -> sp.csr_array:
        """T (N, N) with u = T q: the rows of ``groups`` become scalars, their motion beside a sum of nearby dofs.

        Nothing is lost: q = u - W u_k has the same frequencies, and W R_k = R_u makes its rigid motion zero.
        """
        size = self.K.shape[0]
        inside = np.zeros(size, dtype=bool)
        for g in groups.tolist():
            inside[self.edges[g] : self.edges[g + 1]] = True
        is_mapped = ~inside & (self.component < Component.SCALAR)
        rows, columns, values = [np.arange(size)], [np.arange(size)], [np.ones(size)]
        for g in groups.tolist():
            own = np.arange(self.edges[g], self.edges[g + 1])
            self.component[own], self.owner[own], self.place[own] = Component.SCALAR, 0, self.center
            near = own
            for _ in range(TOL.followed_rings):
                near = np.unique(self.K[near].indices)
                ground = near[is_mapped[near]]
                given, wanted = self.R[ground].T, self.R[own].T
                W = np.linalg.lstsq(given, wanted, rcond=TOL.dependent_followed)[0].T if len(ground) else None
                if W is not None and np.abs(W @ self.R[ground] - self.R[own]).max() < TOL.followed_error:
                    break
            if W is None:
                continue
            rows.append(np.repeat(own, len(ground)))
            columns.append(np.tile(ground, len(own)))
            values.append(W.ravel())
        data = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
        return sp.csr_array(sp.coo_array(data, shape=(size, size)))


def _candidates(label: int, xyz: Floats, expanded: Expanded | None) -> list[tuple[int, Floats]]:
    """Owners and places that rows of a label may have."""
    candidates: list[tuple[int, Floats]] = [(label, xyz[label - 1])] if label <= len(xyz) else []
    if expanded is not None:
        at = np.flatnonzero(expanded.parent == label)
        candidates += [(-int(expanded.nodes[i]), expanded.xyz[i]) for i in at]
    return candidates


def _motion(K: sp.csr_array, R: Floats, known: NDArray[np.bool_]) -> Floats:
    """Rigid motion (u, 6) on the other rows; what K leaves open of it stays as it is in ``R``.

    The proximal point iteration (Rockafellar 1976) on the scaled K_uu, which may be singular.
    """
    rest = np.flatnonzero(~known)
    part = sp.csc_array(K[rest])
    inner = sp.csc_array(part[:, rest])
    size = np.sqrt(np.abs(inner.diagonal()))[:, None]
    size[size == 0] = 1.0
    D = sp.diags_array(1.0 / size[:, 0])
    scaled = sp.csc_array(D @ inner @ D)
    right = -(part[:, np.flatnonzero(known)] @ R[known]) / size
    factor = sla.splu(sp.csc_array(scaled + TOL.proximal_shift * sp.eye_array(len(rest), format="csc")))
    motion = R[rest] * size
    for _ in range(TOL.proximal_steps):
        step = factor.solve(right - scaled @ motion)
        motion = motion + step
        if np.abs(step).max() < TOL.settled_motion * np.abs(motion).max():
            break
    return np.asarray(motion / size)


def strain(K: sp.csr_array, rows: RowMap) -> float:
    """Largest force under rigid motion, of the largest sum of what cancels in a row."""
    center = rows.place.mean(axis=0)
    length = float(np.abs(rows.place - center).max()) or 1.0
    R = rigid_motion((rows.place - center) / length, rows.component)
    R[(rows.component > 2) & (rows.component < Component.SCALAR)] /= length
    terms = abs(K) @ np.abs(R)
    return float(np.abs(K @ R).max() / max(float(terms.max()), np.finfo(float).tiny))
