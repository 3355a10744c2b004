"""A long elastic body as a chain of pieces, each small in its own floating frame: large bending and twist in space.

What is not small for the whole is small for a piece, so that linear reduced bodies do. Equal pieces, which a rigid
motion moves onto each other, share one reduction.

spring = divided_body(divided_mesh(mesh, [steel], line, 12, start="ROOT", end="TIP"), modes=4)
bodies = spring.add(system, name="spring")
system.add(FixedJoint(ground.marker_at(spring.start), bodies[0].marker("start")))
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from morembs.base.arguments import checked
from morembs.base.errors import InputError, nearest
from morembs.base.types import Bools, Floats, Ints
from morembs.body.floating.frame import FloatingFrame, floating_frame
from morembs.dynamics.multibody.bodies import FlexibleBody
from morembs.dynamics.multibody.component import checked_rotation, vector
from morembs.dynamics.multibody.joints import FixedJoint
from morembs.dynamics.multibody.result import Result
from morembs.dynamics.multibody.system import System
from morembs.dynamics.multibody.tolerances import TOL
from morembs.fem import FEModel, Mesh, Nodes
from morembs.fem.assembly import assemble
from morembs.fem.interface import make_interface
from morembs.fem.material import Material
from morembs.problem import Problem
from morembs.reducers import CraigBampton

START, END = "START", "END"


@dataclass(frozen=True, eq=False)
class DividedBody:
    """Pieces of one body in their order: ``frames``, equal ones the same, and how each is moved from its frame.

    ``turns`` (k, 3, 3) and ``steps`` (k, 3) m: a point x of the model that was reduced is at turn x + step. ``start``
    and ``end`` (3,) m are the points of the first and the last interface.
    """

    frames: tuple[FloatingFrame, ...]
    turns: Floats
    steps: Floats
    start: Floats
    end: Floats

    @property
    def reductions(self) -> int:
        """Number of pieces that differ."""
        return len({id(frame) for frame in self.frames})

    def add(
        self, system: System, *, name: str, position: ArrayLike = (0.0, 0.0, 0.0), rotation: ArrayLike | None = None
    ) -> list[FlexibleBody]:
        """Put the pieces, fixed to each other, into a system; each has the markers ``start`` and ``end``.

        ``position`` (3,) m and ``rotation`` (3, 3) move the whole from where its mesh is.
        """
        label = f"body {name!r}"
        Q, at = checked_rotation(f"{label}: rotation", rotation), vector(f"{label}: position", position)
        bodies: list[FlexibleBody] = []
        for k, (frame, turn, step) in enumerate(zip(self.frames, self.turns, self.steps, strict=True)):
            place = at + Q @ (turn @ frame.origin + step)
            body = FlexibleBody(frame, position=place, rotation=Q @ turn, name=f"{name} {k + 1}")
            system.add(body)
            if bodies:
                system.add(FixedJoint(bodies[-1].marker("end"), body.marker("start")))
            bodies.append(body)
        return bodies


def largest_turn(result: Result, bodies: Sequence[FlexibleBody]) -> float:
    """Largest angle (rad) by which an end of a piece turned against its other end during a run.

    Args:
        result: the run.
        bodies: pieces of one body, in order.
    """
    worst = 0.0
    for body in bodies:
        a, b = (result.axes(body.marker(name)) for name in ("start", "end"))
        between = np.einsum("tji,tjk->tik", a, b)
        turned = np.einsum("tij,kj->tik", between, between[0])
        cosine = np.clip((np.trace(turned, axis1=1, axis2=2) - 1) / 2, -1, 1)
        worst = max(worst, float(np.arccos(cosine).max()))
    return worst


@checked
def divided_body(models: Sequence[FEModel], *, modes: int) -> DividedBody:
    """Pieces reduced by Craig-Bampton between rigid interfaces at their node sets START and END, in mean axes.

    Args:
        models: in order along the body, in their places; from ``divided_mesh``, or ``beam_pieces`` of a SpatialBeam.
        modes: fixed-interface modes of each piece.

    Raises:
        InputError: no models, one without these sets, pieces that do not meet; what the reduction refuses.
    """
    if not models:
        raise InputError("no models were given; expected one for each piece", kind="missing", keyword="models")
    made: list[tuple[FEModel, FloatingFrame]] = []
    frames: list[FloatingFrame] = []
    turns: list[Floats] = []
    steps: list[Floats] = []
    points: list[Floats] = []
    for number, model in enumerate(models):
        missing = [name for name in (START, END) if name not in model.nodes.sets]
        if missing:
            raise InputError(
                f"piece {number + 1} has no node set {missing[0]}; expected START and END",
                kind="unknown",
                keyword="set",
            )
        equal = ((motion, frame) for known, frame in made if (motion := _motion(known, model)) is not None)
        (turn, step), frame = next(equal, ((np.eye(3), np.zeros(3)), None))
        if frame is None:
            frame = _reduce_piece(model, modes)
            made.append((model, frame))
        ends = [turn @ (frame.markers[name].point + frame.origin) + step for name in ("start", "end")]
        size = np.linalg.norm(np.ptp(model.nodes.xyz, axis=0))
        if points and np.linalg.norm(points[-1] - ends[0]) > TOL.gap_of_pieces * size:
            raise InputError(
                f"piece {number + 1} starts at {ends[0].tolist()} m, the one before ends at {points[-1].tolist()} m; "
                "expected pieces that meet, in their order",
                keyword="models",
            )
        points += ends
        frames.append(frame)
        turns.append(turn)
        steps.append(step)
    return DividedBody(tuple(frames), np.array(turns), np.array(steps), points[0], points[-1])


def _reduce_piece(model: FEModel, modes: int) -> FloatingFrame:
    ends = [
        make_interface(model, name=name.lower(), nodes=model.nodes.sets[name], coupling="rigid")
        for name in (START, END)
    ]
    with Problem(model, ends) as problem:
        reduced = CraigBampton(modes=modes).reduce(problem, name="piece")
        return floating_frame(problem, reduced, origin=(0.5 * (ends[0].point + ends[1].point)).tolist())


def _motion(a: FEModel, b: FEModel) -> tuple[Floats, Floats] | None:
    """Rotation and step that move the model a onto b, None where they are not equal."""
    x, y = a.nodes.xyz, b.nodes.xyz
    if x.shape != y.shape or a.size != b.size or not np.array_equal(a.dofs.component, b.dofs.component):
        return None
    if any(not np.array_equal(a.nodes.sets[name], b.nodes.sets[name]) for name in (START, END)):
        return None
    p, q = x - x.mean(axis=0), y - y.mean(axis=0)
    # Kabsch (1976); pieces of a straight line have no own rotation, and are tried without one.
    U, _, Vt = np.linalg.svd(q.T @ p)
    for turn in (np.eye(3), U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt):
        if np.abs(p @ turn.T - q).max() > TOL.same_piece * np.abs(p).max():
            continue
        T = _turned_dofs(a, turn)
        if all(_equal(T @ own @ T.T, other) for own, other in ((a.K, b.K), (a.M, b.M))):
            return turn, y.mean(axis=0) - turn @ x.mean(axis=0)
    return None


def _turned_dofs(model: FEModel, turn: Floats) -> sp.csr_array:
    """(N, N): displacements and rotations of all nodes turned with the model."""
    node, component = model.dofs.node, model.dofs.component
    table = model.dofs.table(len(model.nodes))
    rows, columns, values = [], [], []
    for axis in range(3):
        other = table[node, component - component % 3 + axis]
        there = (other >= 0) & (component < 6)
        rows.append(np.flatnonzero(there))
        columns.append(other[there])
        values.append(turn[component[there] % 3, axis])
    where = np.concatenate(rows), np.concatenate(columns)
    return sp.csr_array((np.concatenate(values), where), shape=(model.size, model.size))


def _equal(a: sp.csr_array, b: sp.csr_array) -> bool:
    return bool(abs(a - b).max() <= TOL.same_piece * abs(b).max())


@checked
def divided_mesh(
    mesh: Mesh, materials: Sequence[Material], line: ArrayLike, pieces: int, *, start: str, end: str
) -> list[FEModel]:
    """Models of the pieces of a mesh along a ``line``, for ``divided_body``.

    The line is cut into equal lengths, and each element belongs to the piece whose part of the line is nearest to its
    centre. Elements are not cut.

    Args:
        line: (m, 3) m, points along the body from its start to its end.
        pieces: one or more.
        start, end: node sets at the ends of the body.

    Raises:
        InputError: unknown sets, sets that are not within the first and the last piece, a piece without elements,
            pieces that touch others than their neighbours.
    """
    for name in (start, end):
        if name not in mesh.nodes.sets:
            raise InputError(
                f"the mesh has no node set {name!r}; {nearest(name, list(mesh.nodes.sets))}",
                kind="unknown",
                keyword="set",
            )
    owners = _owners(mesh, line, pieces)
    used = np.zeros((pieces, len(mesh.nodes)), dtype=bool)
    for block, owner in zip(mesh.blocks, owners, strict=True):
        for k in range(pieces):
            used[k, block.nodes[owner == k].ravel()] = True
    touching = [(i, k) for i in range(pieces) for k in range(i + 2, pieces) if (used[i] & used[k]).any()]
    empty = np.flatnonzero(~used.any(axis=1))
    if touching or len(empty):
        what = (
            f"piece {empty[0] + 1} has no elements"
            if len(empty)
            else f"pieces {touching[0][0] + 1} and {touching[0][1] + 1} touch"
        )
        raise InputError(
            f"{what}; expected a line through the body and fewer pieces, each longer than its elements",
            keyword="pieces",
        )
    first, last = (np.isin(np.arange(len(mesh.nodes)), mesh.nodes.sets[name]) for name in (start, end))
    for what, name, there, k in (("first", start, first, 0), ("last", end, last, pieces - 1)):
        if not there.any() or (there & ~used[k]).any():
            raise InputError(
                f"{(there & used[k]).sum()} of the {there.sum()} nodes of set {name!r} are in the {what} of {pieces} "
                "pieces; expected all of them, some at least, and a line that runs from start to end",
                keyword="set",
            )
    models = []
    for k in range(pieces):
        ends = (first if k == 0 else used[k - 1], last if k == pieces - 1 else used[k + 1])
        part = _part(mesh, [owner == k for owner in owners], used[k], ends)
        # Materials of sets that are in other pieces only are not for this one.
        absent = set(mesh.element_sets) - set(part.element_sets)
        models.append(assemble(part, [material for material in materials if material.set not in absent]))
    return models


def _owners(mesh: Mesh, line: ArrayLike, pieces: int) -> list[Ints]:
    """Per block the piece of each element."""
    points, whole = np.asarray(line, dtype=float), isinstance(pieces, int | np.integer) and pieces >= 1
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2 or not np.isfinite(points).all() or not whole:
        raise InputError(
            f"a line of shape {points.shape} and {pieces} pieces were given; expected (m, 3) finite numbers, m >= 2, "
            "and one or more pieces",
            keyword="points",
        )
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    s = (np.arange(TOL.points_of_piece * pieces) + 0.5) / (TOL.points_of_piece * pieces)
    dense = np.column_stack([np.interp(s * along[-1], along, points[:, k]) for k in range(3)])
    tree = cKDTree(dense)
    centres = (mesh.nodes.xyz[block.nodes].mean(axis=1) for block in mesh.blocks)
    return [tree.query(centre)[1] // TOL.points_of_piece for centre in centres]


def _part(mesh: Mesh, chosen: list[Bools], used: Bools, ends: tuple[Bools, Bools]) -> Mesh:
    """Elements ``chosen`` per block, with their nodes and the sets START and END."""
    new = np.cumsum(used) - 1
    sets = {name: new[np.flatnonzero(used & there)] for name, there in zip((START, END), ends, strict=True)}
    nodes = Nodes(ids=mesh.nodes.ids[used], xyz=mesh.nodes.xyz[used], sets=sets)
    kept = [k for k, rows in enumerate(chosen) if rows.any()]
    blocks = tuple(
        replace(mesh.blocks[k], nodes=new[mesh.blocks[k].nodes[chosen[k]]], ids=mesh.blocks[k].ids[chosen[k]])
        for k in kept
    )
    place = [np.cumsum(rows) - 1 for rows in chosen]
    groups = {
        name: tuple(place[k][rows[k][chosen[k][rows[k]]]] for k in kept) for name, rows in mesh.element_sets.items()
    }
    groups = {name: rows for name, rows in groups.items() if any(len(part) for part in rows)}
    return replace(mesh, nodes=nodes, blocks=blocks, element_sets=groups)
