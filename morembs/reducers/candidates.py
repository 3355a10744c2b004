"""Candidate loads of static modes: which dofs, in which order, along which directions."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem import DofMap, FEModel
from morembs.fem.interface import Interface
from morembs.fem.selection import select_nodes
from morembs.fem.stress_operator import StressOperator, stress_operator
from morembs.fem.surface import outer_faces
from morembs.problem import Problem
from morembs.reducers.tolerances import TOL

NORMALS = "normals"


class Candidates:
    """Candidate dofs of a model: ``rows`` of their nodes, ``node``, ``direction``, ``turns`` and ``loads`` (N, c).

    ``nodes`` is a selection in units of ``length`` m; ``directions`` are components 0..5, or "normals".

    Raises:
        InputError: nothing selected, nodes on an interface, a path with gaps, directions that no node has.
    """

    def __init__(
        self,
        model: FEModel,
        interfaces: Sequence[Interface],
        nodes: str,
        directions: list[int] | str,
        *,
        kind: str,
        band: int | None,
        length: float,
    ) -> None:
        self.model, self.kind, self.band = model, kind, band
        try:
            rows = select_nodes(model, nodes, length=length)
        except InputError as error:
            raise error.restate(f"candidates: {error}") from error
        self._refuse_interfaces(rows, interfaces)
        if kind == "path":
            rows = rows[chain(model.nodes.xyz[rows], model.nodes.ids[rows])]
        self.rows = rows
        table = model.dofs.table(len(model.nodes))
        if isinstance(directions, str):
            self._along_normals(table)
        else:
            self._along_axes(table, list(directions))

    def _refuse_interfaces(self, rows: Ints, interfaces: Sequence[Interface]) -> None:
        for interface in interfaces:
            shared = np.intersect1d(rows, interface.nodes) if interface.kind.exclusive else rows[:0]
            if len(shared):
                raise InputError(
                    f"candidates: {len(shared)} of {len(rows)} nodes, such as node "
                    f"{self.model.nodes.ids[shared[0]]}, belong to the interface {interface.name!r}, which "
                    "carries loads already; leave them out of the candidates",
                    kind="conflict",
                )

    def _along_axes(self, table: Ints, components: list[int]) -> None:
        dofs = table[self.rows][:, components]
        there = np.asarray(dofs >= 0)
        lost = [k for column, k in enumerate(components) if not there[:, column].any()]
        if lost:
            raise InputError(
                f"directions = {components} was given, but no candidate node has the component {lost[0]}",
                keyword="directions",
            )
        self.node, which = np.nonzero(there)
        component = np.array(components)[which]
        self.direction, self.turns = np.eye(3)[component % 3], component > 2
        columns = np.arange(len(which))
        data = (np.ones(len(which)), (dofs[there], columns))
        self.loads = sp.csc_array(data, shape=(self.model.size, len(which)))

    def _along_normals(self, table: Ints) -> None:
        model = self.model
        if model.mesh is None:
            raise InputError(
                'directions = "normals" needs elements; this model has matrices only, take components',
                kind="unsupported",
                keyword="directions",
            )
        normal = vertex_normals(model)[self.rows]
        bare = np.linalg.norm(normal, axis=1) == 0
        if bare.any() or (table[self.rows, :3] < 0).any():
            bad = bare | (table[self.rows, :3] < 0).any(axis=1)
            raise InputError(
                f'directions = "normals": node {model.nodes.ids[self.rows[bad][0]]} is not on the free surface of the '
                "model; leave it out of the candidates",
                keyword="directions",
            )
        self.node, self.direction = np.arange(len(self.rows)), normal
        self.turns = np.zeros(len(self.rows), dtype=bool)
        data = (normal.ravel(), (table[self.rows, :3].ravel(), np.repeat(self.node, 3)))
        self.loads = sp.csc_array(data, shape=(model.size, len(self.rows)))

    @property
    def count(self) -> int:
        """Number of candidates."""
        return len(self.node)

    def width(self) -> int:
        """Largest distance of two candidates in the band."""
        band, nodes = self.band, len(self.rows)
        if band is None or band >= nodes:
            return self.count - 1
        starts = np.searchsorted(self.node, np.arange(nodes + 1))
        return int(max(starts[band + 1 :] - 1 - starts[: nodes - band]))

    def stress_rows(self, problem: Problem, operator: StressOperator | None) -> Callable[[Floats], Floats]:
        """Stress (nc, 6, k) at the nodes of the path for displacements (Nc, k) in coupled dofs."""
        rows = self.rows
        at_nodes = operator if operator is not None else _operator(problem, rows)
        order = np.argsort(at_nodes.nodes, kind="stable")
        at = np.searchsorted(at_nodes.nodes[order], rows)
        covered = at_nodes.nodes[order][np.minimum(at, len(order) - 1)] == rows
        if not covered.all():
            raise InputError(
                f"stress: node {problem.model.nodes.ids[rows[~covered][0]]} is not among those of the stress"
            )
        if len(np.unique(at_nodes.nodes)) < len(at_nodes.nodes):
            raise InputError("stress: materials meet at a candidate node; leave such nodes out, or leave stress out")
        place, model = order[at], problem.model
        into = np.flatnonzero(model.dofs.component < 3)
        target = 3 * model.dofs.node[into] + model.dofs.component[into]

        def stress(X: Floats) -> Floats:
            u = np.zeros((3 * len(model.nodes), X.shape[1]))
            u[target] = (problem.coupling.T @ X)[into]
            return at_nodes.stress(u).reshape(len(at_nodes.nodes), 6, -1)[place]

        return stress


def _operator(problem: Problem, rows: Ints) -> StressOperator:
    model = problem.model
    if model.mesh is None or not model.materials:
        raise InputError(
            "stress needs elements and their materials, and this model has matrices only; leave it out",
            kind="unsupported",
        )
    # A model that is held lacks dofs; the operator needs elements and materials only.
    N = 3 * len(model.nodes)
    empty = sp.csr_array((N, N))
    model_of_parts = FEModel(
        K=empty,
        M=empty,
        nodes=model.nodes,
        dofs=DofMap.translations(len(model.nodes)),
        mesh=model.mesh,
        materials=model.materials,
    )
    with problem.budget.in_use():
        return stress_operator(model_of_parts, rows)


def chain(xyz: Floats, ids: Ints) -> Ints:
    """Order (n,) of points along an open line, from the end of smallest coordinates: each next is the nearest left.

    Raises:
        InputError: less than two points, or points that do not lie on one line without gaps.
    """
    n = len(xyz)
    if n < 2:
        raise InputError(f'candidates: {n} node was given; a path needs two or more (or take kind = "surface")')
    order = _walk(xyz, _walk(xyz, 0)[-1])
    along = xyz[order[-1]] - xyz[order[0]]
    if along[np.argmax(np.abs(along) > TOL.no_component * np.linalg.norm(along))] < 0:
        order = order[::-1]
    steps = np.linalg.norm(np.diff(xyz[order], axis=0), axis=1)
    if steps.min() <= TOL.same_place * max(float(np.median(steps)), np.finfo(float).tiny):
        k = int(steps.argmin())
        raise InputError(f"candidates: nodes {ids[order[k]]} and {ids[order[k + 1]]} of the path lie in one point")
    beside = np.maximum(np.append(steps[1:], 0.0), np.insert(steps[:-1], 0, 0.0))
    far = np.flatnonzero((steps > TOL.path_gap * beside) & (beside > 0))
    if len(far):
        k = int(far[steps[far].argmax()])
        raise InputError(
            f"candidates: the path jumps by {steps[k]:.4g} m from node {ids[order[k]]} to node {ids[order[k + 1]]}, "
            f'where {beside[k]:.4g} m is usual; select the nodes of one line, or take kind = "surface"'
        )
    _refuse_rows(xyz[order], ids[order], steps)
    return order


def _refuse_rows(xyz: Floats, ids: Ints, steps: Floats) -> None:
    """Refuse points that lie as close as neighbours without following each other: rings, and rows side by side."""
    # Not at the top, where it would cost every command its memory.
    from scipy.spatial import cKDTree

    step = np.minimum(np.append(steps, np.inf), np.insert(steps, 0, np.inf))
    distance, near = cKDTree(xyz).query(xyz, k=min(4, len(xyz)))
    offsets = np.abs(near - np.arange(len(xyz))[:, None])
    k, column = np.nonzero((offsets > 1) & (distance < TOL.neighbor_steps * step[:, None]))
    if len(k):
        raise InputError(
            f"candidates: nodes {ids[k[0]]} and {ids[near[k[0], column[0]]]} lie next to each other without following "
            'each other, so the nodes are no open line; select one row, or take kind = "surface"',
            kind="model",
        )


def _walk(xyz: Floats, start: int) -> Ints:
    left = np.ones(len(xyz), dtype=bool)
    order = np.empty(len(xyz), dtype=np.int64)
    at = start
    for k in range(len(xyz)):
        order[k] = at
        left[at] = False
        remaining = np.flatnonzero(left)
        if len(remaining):
            at = int(remaining[np.argmin(np.linalg.norm(xyz[remaining] - xyz[at], axis=1))])
    return order


def vertex_normals(model: FEModel) -> Floats:
    """Unit outward normals (n, 3) of the nodes on the free surface, mean of their faces; zero inside."""
    if model.mesh is None:
        raise InputError("normals need elements; this model has matrices only", kind="unsupported")
    xyz = model.nodes.xyz
    normal = np.zeros_like(xyz)
    for kind, faces in outer_faces(model.mesh).items():
        corners = xyz[faces[:, : 3 if kind.startswith("tri") else 4]]
        area = np.cross(corners[:, 2] - corners[:, 0], corners[:, -1] - corners[:, 1])
        if kind.startswith("tri"):
            area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        for column in faces.T:
            np.add.at(normal, column, area)
    length = np.linalg.norm(normal, axis=1)
    return np.asarray(normal / np.where(length > 0, length, 1.0)[:, None])
