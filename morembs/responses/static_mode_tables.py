"""Static modes of many candidate loads of which few act at a time (Heirman, Tamarozzi and Desmet 2011).

u = V eta + Psi_A a: V is the constant basis, Psi_A the static modes of the active candidates A. A static mode is what
V leaves out of the static answer to a unit load b_i at one candidate, psi_i = (G - V K_r^-1 V') b_i. It is K-orthogonal
to V, and psi_i' K psi_j = b_i' psi_j = R_ij: the table R is both their stiffness and their displacements at all
candidates, so that no static mode itself is needed online.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.summary import summarised
from morembs.base.types import Floats, Ints, Reals
from morembs.fem import freeze
from morembs.responses.tolerances import TOL
from morembs.storage.table import dataset

KINDS = ("path", "surface")
INTERPOLATIONS = ("catmull-rom", "linear")
_STRESS = "where stress is wanted"


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class StaticModeTables:
    """Tables of c candidate dofs on nc nodes that complement a constant basis of n coordinates.

    ``kind`` "path" (nodes in the order in which a load passes them) or "surface". ``node_ids`` (nc,) labels, ``xyz``
    (nc, 3) m in the model. Candidate i is dof of node ``node[i]`` (ascending places in ``node_ids``) along the unit
    vector ``direction[i]``, a rotation where ``turns[i]``. ``modes`` (c, n) rows of V at the candidates;
    ``stiffness`` and ``mass`` (w + 1, c) are bands of R = Psi' K Psi and Q = Psi' M Psi, entry [k, j] that of
    candidates j - k and j; w = c - 1 holds all pairs. ``coupling`` (n, c) is V' M Psi, zero where V is spanned by
    eigenmodes. ``weight`` (n, 3) and ``static_weight`` (c, 3) are loads of V and Psi under unit accelerations of
    gravity. ``stress`` (nc, 6, n) Pa at the nodes per coordinate of V and ``static_stress`` (nc, 6, b) Pa per unit
    load of the b candidates from ``stress_first[p]`` on, where asked for; components xx, yy, zz, xy, yz, zx.
    """

    kind: str = dataset("text", "", "path: loads slide from node to node; surface: any of them may be loaded")
    node_ids: Ints = dataset("whole", "nc", "labels of the candidate nodes, in the order of the path")
    xyz: Floats = dataset("later", "nc 3", "positions of these nodes in the model", "m")
    node: Ints = dataset("whole", "c", "per candidate: place of its node in node_ids, ascending", largest="nc-1")
    direction: Floats = dataset("later", "c 3", "per candidate: unit vector of the load")
    modes: Floats = dataset("later", "c n", "row i: displacement along candidate i per unit of each coordinate")
    stiffness: Floats = dataset(
        "later", "w c", "band of R = Psi' K Psi: entry [k, j] of candidates j - k and j; displacements per load", "m/N"
    )
    mass: Floats = dataset("later", "w c", "band of Q = Psi' M Psi, as stiffness", "kg m2/N2")
    coupling: Floats = dataset("later", "n c", "V' M Psi; zero where eigenmodes span the basis")
    weight: Floats = dataset("later", "n 3", "load on the coordinates under unit gravity along x, y, z")
    static_weight: Floats = dataset("later", "c 3", "the same on the static modes")
    turns: NDArray[np.bool_] = dataset("flag", "c", "per candidate: 1 for a moment and rotation, 0 for a force")
    stress: Reals | None = dataset(
        "later",
        "nc 6 n",
        "[p, c, l]: stress c (xx, yy, zz, xy, yz, zx) at node p per unit of coordinate l",
        "Pa",
        default=None,
        when=_STRESS,
    )
    static_stress: Reals | None = dataset(
        "later",
        "nc 6 b",
        "[p, c, k]: the same per unit load of candidate stress_first[p] + k",
        "Pa/N",
        default=None,
        when=_STRESS,
    )
    stress_first: Ints | None = dataset(
        "whole", "nc", "first candidate in static_stress, per node", default=None, when=_STRESS
    )
    notes: Mapping[str, object] = dataset("json", "", "what was found on the way, as JSON", default_factory=dict)

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                object.__setattr__(self, name, freeze(value))
        c, n = self.modes.shape
        band = len(self.stiffness)
        shapes = {
            "xyz": (len(self.node_ids), 3),
            "node": (c,),
            "direction": (c, 3),
            "turns": (c,),
            "stiffness": (band, c),
            "mass": (band, c),
            "coupling": (n, c),
            "weight": (n, 3),
            "static_weight": (c, 3),
        }
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise InputError(
                    f"switching: {name} has the shape {getattr(self, name).shape}; expected {shape}", keyword=name
                )
        if (np.diff(self.node) < 0).any():
            raise InputError("switching: candidates must come node by node, in the order of their nodes")

    @property
    def count(self) -> int:
        """Number c of candidates."""
        return len(self.node)

    @cached_property
    def starts(self) -> Ints:
        """(nc + 1,) first candidate of each node."""
        return np.searchsorted(self.node, np.arange(len(self.node_ids) + 1)).astype(np.int64)

    def of_nodes(self, first: int, count: int) -> Ints:
        """Candidates of ``count`` nodes from ``first`` on."""
        return np.arange(self.starts[first], self.starts[first + count], dtype=np.int64)

    def _pairs(self, table: Floats, rows: Ints, columns: Ints) -> Floats:
        i, j = rows[:, None], columns[None, :]
        offsets = np.abs(i - j)
        if offsets.size and offsets.max() >= len(table):
            a, b = (int(x) for x in np.unravel_index(int(offsets.argmax()), offsets.shape))
            first, second = (int(self.node_ids[self.node[k]]) for k in (rows[a], columns[b]))
            raise InputError(
                f"the static modes of nodes {first} and {second} were asked for together, but the table "
                f"holds pairs of up to {len(table) - 1} candidates apart; reduce again with a larger band or none",
                keyword="band",
            )
        return np.asarray(table[offsets, np.maximum(i, j)])

    def R(self, rows: Ints, columns: Ints | None = None) -> Floats:
        """Psi' K Psi of candidates ``rows`` and ``columns`` (by default the same), m/N.

        Raises:
            InputError: a pair that the band does not hold.
        """
        return self._pairs(self.stiffness, rows, rows if columns is None else columns)

    def Q(self, rows: Ints, columns: Ints | None = None) -> Floats:
        """Psi' M Psi, as ``R``."""
        return self._pairs(self.mass, rows, rows if columns is None else columns)

    def stress_at(self, node: int, coordinates: Floats, candidates: Ints, loads: Floats) -> Floats:
        """Stress (6,) in Pa at place ``node`` for ``coordinates`` (n,) of V and loads (k,) N of ``candidates``.

        Raises:
            InputError: no stress was stored, or not for a candidate so far away.
        """
        if self.stress is None or self.static_stress is None or self.stress_first is None:
            raise InputError("this switching data holds no stress; reduce again with stress = true")
        at = candidates - self.stress_first[node]
        acts = loads != 0
        if (acts & ((at < 0) | (at >= self.static_stress.shape[2]))).any():
            raise InputError(
                f"stress at node {self.node_ids[node]} was asked for under a load that is further away than the band "
                "holds; reduce again with a larger band or none"
            )
        smooth = self.stress[node].astype(np.float64) @ coordinates
        return np.asarray(smooth + self.static_stress[node][:, at[acts]].astype(np.float64) @ loads[acts])

    @cached_property
    def s(self) -> Floats:
        """(nc,) m: positions of the nodes along the path, chord by chord from the first."""
        steps = np.linalg.norm(np.diff(self.xyz, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def length(self) -> float:
        """Length of the path in m."""
        return float(self.s[-1])

    def interval(self, s: float) -> int:
        """Place i of the node with s_i <= s < s_i+1; the first or last interval outside the path."""
        return min(max(int(self.s.searchsorted(s, side="right")) - 1, 0), len(self.s) - 2)

    def curve(self, s: float, interpolation: str = "catmull-rom", interval: int | None = None) -> Curve:
        """How the path at ``s`` (m) follows its nodes; ``interval`` goes on with the polynomial of that one.

        With rotations among the candidates displacements follow Hermite's cubics of the node rotations.
        """
        i = self.interval(s) if interval is None else interval
        span = self._spans.get((i, interpolation))
        if span is None:
            if self.kind != "path" or len(self.s) < 2:
                raise InputError('these candidates are no path; reduce with kind = "path" and two nodes or more')
            if len(self._spans) > TOL.kept_intervals:
                self._spans.clear()
            span = self._spans[i, interpolation] = _span(self, i, interpolation)
        x = (s - float(self.s[i])) / span.length
        value, rate = _linear(x) if interpolation == "linear" else _hermite(x)
        return Curve(span, value, rate / span.length)

    @cached_property
    def _spans(self) -> dict[tuple[int, str], Span]:
        return {}


def _linear(x: float) -> tuple[Floats, Floats]:
    return np.array([1 - x, 0.0, x, 0.0]), np.array([-1.0, 0.0, 1.0, 0.0])


def _hermite(x: float) -> tuple[Floats, Floats]:
    """Hermite's cubics on 0..1 and their derivatives: value and slope at 0, value and slope at 1."""
    value = np.array([(1 + 2 * x) * (1 - x) ** 2, x * (1 - x) ** 2, x * x * (3 - 2 * x), x * x * (x - 1)])
    rate = np.array([6 * x * (x - 1), (1 - x) * (1 - 3 * x), 6 * x * (1 - x), x * (3 * x - 2)])
    return value, rate


@dataclass(frozen=True, eq=False)
class Span:
    """One interval of a path: weights ``base`` (4, .) of ``nodes``: value and slope (times ``length``) at its ends."""

    switching: StaticModeTables
    interval: int
    length: float
    nodes: Ints
    base: Floats

    @cached_property
    def points(self) -> Floats:
        """(4, 3) of the undeformed path."""
        return np.asarray(self.base @ self.switching.xyz[self.nodes])

    @cached_property
    def _rows(self) -> dict[tuple[int, int], Floats]:
        return {}

    def rows(self, candidates: Ints) -> Floats:
        """(4, 3, k) of the displacement for a run of ``candidates``; zero for candidates that it does not depend on."""
        key = (int(candidates[0]), len(candidates)) if len(candidates) else (0, 0)
        rows = self._rows.get(key)
        if rows is None:
            if len(self._rows) > TOL.kept_intervals:
                self._rows.clear()
            rows = self._rows[key] = self._of(candidates)
        return rows

    def _of(self, candidates: Ints) -> Floats:
        tables = self.switching
        rows = np.zeros((4, 3, len(candidates)))
        node = tables.node[candidates]
        if not tables.turns.any():
            near = np.flatnonzero((node >= self.nodes[0]) & (node <= self.nodes[-1]))
            weights = self.base[:, node[near] - self.nodes[0]]
            rows[:, :, near] = weights[:, None, :] * tables.direction[candidates[near]].T
            return rows
        along = tables.xyz[self.interval + 1] - tables.xyz[self.interval]
        for column in np.flatnonzero((node == self.interval) | (node == self.interval + 1)):
            j, end = candidates[column], int(node[column]) - self.interval
            if tables.turns[j]:
                # The slope that a small rotation gives the path, times the length of the interval.
                rows[2 * end + 1, :, column] = np.cross(tables.direction[j], along)
            else:
                rows[2 * end, :, column] = tables.direction[j]
        return rows


def _span(tables: StaticModeTables, i: int, interpolation: str) -> Span:
    length = float(tables.s[i + 1] - tables.s[i])
    if interpolation == "linear":
        base = np.zeros((4, 2))
        base[0, 0] = base[2, 1] = 1.0
        return Span(tables, i, length, np.array([i, i + 1]), base)
    low, high = max(i - 1, 0), min(i + 2, len(tables.s) - 1)
    base = np.zeros((4, high + 1 - low))
    base[0, i - low] = base[2, i + 1 - low] = 1.0
    for row, j in ((1, i), (3, i + 1)):
        a, b = max(j - 1, low), min(j + 1, high)
        base[row, b - low], base[row, a - low] = np.array([length, -length]) / (tables.s[b] - tables.s[a])
    return Span(tables, i, length, np.arange(low, high + 1), base)


@dataclass(frozen=True, eq=False)
class Curve:
    """The path at one place: weights ``value`` (4,) of its span and their derivatives ``rate`` by s."""

    span: Span
    value: Floats
    rate: Floats

    @property
    def point(self) -> Floats:
        """(3,) m, undeformed, in the model."""
        return np.asarray(self.value @ self.span.points)

    @property
    def tangent(self) -> Floats:
        """(3,) derivative of the undeformed point by s."""
        return np.asarray(self.rate @ self.span.points)

    def rows(self, candidates: Ints, derivative: bool = False) -> Floats:
        """(3, k): displacement of the path here per unit displacement of each candidate, or its derivative by s.

        ``candidates`` follow each other; candidates that the place does not depend on give zero.
        """
        table = self.span.rows(candidates)
        weights = self.rate if derivative else self.value
        return np.asarray((weights @ table.reshape(4, -1)).reshape(3, -1))


@dataclass(frozen=True, eq=False)
class ActiveSet:
    """Static modes of some ``candidates`` (k,), turned to r coordinates z: a = ``Y`` z (k, r).

    Y' R Y = diag(``omega``^2) with omega in rad/s and Y' Q Y = 1. Directions of no stiffness or mass are left out.
    """

    candidates: Ints
    Y: Floats
    omega: Floats

    @property
    def rank(self) -> int:
        """Number r of coordinates."""
        return len(self.omega)


def active_set(tables: StaticModeTables, candidates: Ints) -> ActiveSet:
    """Coordinates of the static modes of ``candidates``.

    Raises:
        InputError: nothing is left of them: the constant basis holds these loads already, or the candidates do not
            move at all.
    """
    R, Q = tables.R(candidates), tables.Q(candidates)
    size = np.sqrt(np.maximum(np.diag(R), 0.0))
    # Forces are measured against forces and moments against moments, so that units do not matter.
    turns = tables.turns[candidates]
    largest = [float(np.max(tables.stiffness[0, tables.turns == kind], initial=0.0)) for kind in (False, True)]
    alive = size > np.sqrt(TOL.active_set_rank * np.where(turns, largest[1], largest[0]))
    if not alive.any():
        named = ", ".join(str(int(k)) for k in np.unique(tables.node_ids[tables.node[candidates]]))
        raise InputError(
            f"the active set at nodes {named} has lost its rank: the constant basis gives the static answer to these "
            "loads already, or the nodes are held; take other candidates or fewer modes",
            kind="conflict",
        )
    D = np.where(alive, 1.0 / np.where(alive, size, 1.0), 0.0)
    values, U = np.linalg.eigh(D[:, None] * R * D)
    good = values > TOL.active_set_rank * values[-1]
    # Unit strain energy, then modes of the mass: what has none would be infinitely fast.
    X = D[:, None] * U[:, good] / np.sqrt(values[good])
    inverse, W = np.linalg.eigh(X.T @ Q @ X)
    heavy = inverse > TOL.active_set_rank * inverse[-1]
    omega = 1.0 / np.sqrt(inverse[heavy])
    return ActiveSet(candidates, np.asarray((X @ W[:, heavy]) * omega), omega)
