"""The assembly of the models that its bodies were reduced from: what certificates of an assembly are measured against.

Each part is its coupled model along the axes of the assembly, with the motions of its interfaces as coordinates: where
these are means of nodal motions (average interfaces), they take the places of as many nodal ones. Couplings are those
of the bodies. The bodies span a part of this space, and so does whatever the assembly of them is reduced to: residuals,
counts and references of the full problem say its error as they say that of a single part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.closing import Closing
from morembs.base.errors import BudgetError, InputError, enough_megabytes
from morembs.base.progress import listening
from morembs.base.types import Floats, Ints
from morembs.body.body import Body
from morembs.dynamics.assembly.belonging import basis_of, eliminations, refuse_other_matrices
from morembs.dynamics.assembly.bodies import AssembledModel, join_parts
from morembs.dynamics.assembly.parts import Placed, PlacedBody, Substructure
from morembs.dynamics.assembly.tolerances import TOL
from morembs.fem.fe_model import Component
from morembs.importers.tolerances import TOL as IMPORTED
from morembs.problem import Problem
from morembs.reducers.base import ReducedModel
from morembs.responses.direct import why_no_response


class Unreduced(Closing):
    """The unreduced parts of the assembly that the model of ``given`` is, coupled as their bodies are: ``problem``.

    Peak memory: the matrices of all parts about four times, those of parts with modal damping or ``alpha`` as full
    ones; and what ``certify`` of a problem as large as all parts together takes.

    Raises:
        InputError: parts without their problem, a body that is not that of its problem, turned nodes without all three
            displacements or rotations, or damping that has no matrix of this size.
        BudgetError: the matrices exceed the memory budget.

    >>> stored = read_body(write_body("bar.h5", [body]))
    >>> parts = [
    ...     Substructure(name=name, bodies=stored, problem=problem, position=(x, 0, 0))
    ...     for name, x in (("a", 0.0), ("b", 0.4))
    ... ]
    >>> bars = assemble_bodies(parts, [Couple(between=("a:RIGHT", "b:LEFT"))])
    >>> ends = [make_interface(bars, name="end", nodes=bars.nodes.sets["a:LEFT"])]
    >>> with Problem(bars, ends) as small, Unreduced(small) as full:
    ...     reduced = CraigBampton(modes=6).reduce(small)
    ...     [certificate] = certify(full.problem, [full.expand(reduced)], [0.0, 1000.0])
    >>> certificate.kind
    'proven'
    """

    def __init__(self, given: Problem) -> None:
        model = given.model
        if not isinstance(model, AssembledModel) or any(part.problem is None for part in model.parts):
            raise InputError("an assembly without the problems of its parts was given; give each Substructure its own")
        _refuse_too_large(given, model.parts)
        self._given, self.model, self.interfaces = given, model, given.interfaces
        placed = [PlacedBody.of(part) for part in model.parts]
        self._parts = [_Full.of(part, body) for part, body in zip(model.parts, placed, strict=True)]
        whole = join_parts([part.placed for part in self._parts], model.couples, model.source)
        reason = why_no_response(given.damping, whole.D is not None, whole.size)
        if reason:
            raise InputError(f"the unreduced parts have a damping matrix; {reason}")
        firsts = [0, *accumulate(len(part.placed.xyz) for part in self._parts)]
        own = np.concatenate([first + np.arange(len(body.xyz)) for first, body in zip(firsts, placed, strict=False)])
        with listening(given.listener), given.budget.in_use():
            self.problem = Problem(
                whole,
                [replace(interface, nodes=own[interface.nodes]) for interface in given.interfaces],
                solver=given.solver,
                damping=given.damping,
                workers=given.workers,
            )

    @property
    def note(self) -> str:
        """What certificates of ``problem`` are against."""
        return f"against the unreduced parts {', '.join(part.placed.name for part in self._parts)}"

    def expand(self, reduced: ReducedModel) -> ReducedModel:
        """``reduced`` of the assembled bodies with its coordinates expanded in the coupled dofs of ``problem``."""
        coupling, kept = self._given.coupling, self.problem.coupling.kept
        U, at, first, blocks = coupling.T @ reduced.V, 0, 0, []
        for part in self._parts:
            end = first + len(part.placed.node)
            moved = part.motions(U[at : at + len(part.body.coordinates)])
            blocks.append(moved[kept[(kept >= first) & (kept < end)] - first])
            at, first = at + len(part.body.node), end
        return replace(reduced, V=np.vstack([*blocks, reduced.V[len(coupling.kept) :]]))

    def in_parts(self, x: Floats) -> Floats:
        """Motions (sum of Nc, k) of the coupled dofs of all parts, along the axes of their own models, of vectors ``x``
        (Nc, k) of ``problem``."""
        u, at, blocks = self.problem.coupling.T @ x, 0, []
        for part in self._parts:
            blocks.append(part.own @ u[at : at + part.own.shape[1]])
            at += len(part.placed.node)
        return np.vstack(blocks)

    def close(self) -> None:
        """Release the factorisations."""
        self.problem.close()


@dataclass(frozen=True, kw_only=True, eq=False)
class _Full:
    """An unreduced part: ``placed`` like its ``body``, which ``V`` (Nc, n) expands in its coupled dofs; ``turned``
    (Nc, Nc) makes these of the assembly's axes, ``rest`` are the coordinates beside the interfaces, and ``own``
    (Nc, Nc) makes the coupled dofs of all coordinates."""

    placed: Placed
    body: PlacedBody
    V: Floats
    turned: sp.csr_array
    rest: Ints
    own: sp.csr_array

    @classmethod
    def of(cls, part: Substructure, body: PlacedBody) -> _Full:
        problem = part.problem
        if problem is None:
            raise InputError(f"part {part.name!r} has no problem")
        V = problem.compute_once(("basis", part.bodies, body.body.name), lambda: _check_basis(part, body.body, problem))
        raw, coupling = problem.model.dofs, problem.coupling
        node, component = _labels(problem)
        Q = _rotate_dofs(part.name, problem, body.turn, node, component)
        Q_raw = _rotate_dofs(part.name, problem, body.turn, raw.node, raw.component)
        W, chosen = _motions(part, body, problem, Q, component)
        rest = np.delete(np.arange(len(node)), chosen)
        C = sp.csr_array(Q.T @ sp.csc_array(W)[:, np.concatenate([chosen, rest])])
        # Dofs of the model stay what they are, but for those that follow the coordinates.
        kept = coupling.kept[rest[rest < len(coupling.kept)]]
        others = np.delete(np.arange(len(raw)), kept)
        places = np.concatenate([len(chosen) + np.arange(len(kept)), len(node) + np.arange(len(others))])
        pick = sp.csr_array(
            (np.ones(len(raw)), (places, np.concatenate([kept, others]))), shape=(len(node) + len(others), len(raw))
        )
        pick = sp.csr_array(pick @ Q_raw)
        matrices = {name: _symmetric(pick @ getattr(problem.model, name) @ pick.T) for name in ("K", "M")}
        xyz, at = _nodes(problem, body)
        placed = Placed(
            name=part.name,
            matrices=matrices | {"D": _damping(part.name, problem, pick, C)},
            xyz=xyz,
            sets=body.sets,
            node=np.concatenate([body.node[: body.inputs], at[node[rest]], at[raw.node[others]]]),
            component=np.concatenate([body.component[: body.inputs], component[rest], raw.component[others]]),
            basis=sp.csr_array((Q_raw @ coupling.T @ C)[others]),
        )
        return cls(placed=placed, body=body, V=V, turned=Q, rest=rest, own=C)

    def motions(self, u: Floats) -> Floats:
        """Coordinates (Nc, k) of the part where the dofs of its body are ``u`` (n, k)."""
        inside = self.turned @ (self.V @ (self.body.coordinates @ u))
        return np.vstack([u[: self.body.inputs], inside[self.rest]])


def _check_basis(part: Substructure, body: Body, problem: Problem) -> Floats:
    V = basis_of(part, body, problem)
    refuse_other_matrices(part, body, problem, V)
    return V


def _damping(name: str, problem: Problem, pick: sp.csr_array, C: sp.csr_array) -> sp.csr_array:
    """Viscous damping of a part in its dofs, which ``pick`` and ``C`` make of those of its model and of its coupled
    ones: it resists the part's own elastic motion only, and so most often is a full matrix."""
    damping, model, (size, dofs) = problem.damping, problem.model, (len(problem.rigid), pick.shape[0])
    D = sp.csr_array((dofs, dofs)) if model.D is None else _symmetric(pick @ model.D @ pick.T)
    if not (damping.is_modal or damping.alpha):
        return sp.csr_array(D + damping.beta * _symmetric(pick @ model.K @ pick.T)) if damping.beta else D
    if size > TOL.max_full_damping_dofs:
        raise InputError(
            f"part {name!r} has {'modal damping' if damping.is_modal else 'alpha of rayleigh damping'}, which resists "
            f"its elastic motion by a full matrix of {size:,} dofs; certificates against unreduced parts take up to "
            f"{TOL.max_full_damping_dofs:,} of them: give [damping] to the assembly instead, or take beta alone",
            kind="unsupported",
        )
    full = sp.csr_array(C.T @ damping.matrix(problem.M.toarray(), problem.K.toarray(), problem.rigid) @ C)
    full.resize((dofs, dofs))
    return sp.csr_array(D + _symmetric(full))


def _labels(problem: Problem) -> tuple[Ints, Ints]:
    """Node and component (Nc,) of each coupled dof; frames are nodes behind those of the model."""
    model, kept = problem.model, problem.coupling.kept
    node, component = [model.dofs.node[kept]], [model.dofs.component[kept]]
    for number, elimination in enumerate(eliminations(problem).values()):
        node.append(np.full(len(elimination.components), len(model.nodes) + number))
        component.append(np.array(elimination.components))
    return np.concatenate(node), np.concatenate(component)


def _nodes(problem: Problem, body: PlacedBody) -> tuple[Floats, Ints]:
    """Places of the nodes, those of the body first, and where those of the model and then its frames are in them."""
    nodes = problem.model.nodes
    points = [interface.point for interface in problem.interfaces if interface.name in eliminations(problem)]
    known = {label: row for row, label in enumerate(nodes.ids.tolist())}
    shown = np.array([known[label] for label in body.shown.tolist()], dtype=np.int64)
    others = np.delete(np.arange(len(nodes) + len(points)), shown)
    inside = np.vstack([nodes.xyz, *points])[others] @ body.turn.T + body.place
    at = np.empty(len(shown) + len(others), dtype=np.int64)
    at[np.concatenate([shown, others])] = len(body.xyz) - len(shown) + np.arange(len(at))
    return np.vstack([body.xyz, inside]), at


def _rotate_dofs(name: str, problem: Problem | None, turn: Floats, node: Ints, component: Ints) -> sp.csr_array:
    """(n, n) motions of nodes along the axes of the assembly from those along the axes of the part."""
    Q = sp.eye_array(len(node), format="csr")
    if np.array_equal(turn, np.eye(3)):
        return Q
    rows, columns, values = [], [], []
    for first in (0, 3):
        own = np.flatnonzero((component >= first) & (component < first + 3))
        own = own[np.lexsort((component[own], node[own]))]
        labels, count = np.unique(node[own], return_counts=True)
        if (count != 3).any():
            label = labels[count != 3][0]
            known = problem is not None and label < len(problem.model.nodes)
            which = f"node {problem.model.nodes.ids[label]}" if problem is not None and known else "an interface"
            raise InputError(
                f"part {name!r} is rotated, and equations hold {which} of its model along one or two axes; "
                "certificates "
                "against unreduced parts need all three axes free: leave the rotation out, or job in [[substructure]]"
            )
        triples = own.reshape(-1, 3)
        rows.append(np.repeat(triples, 3, axis=1).ravel())
        columns.append(np.tile(triples, (1, 3)).ravel())
        values.append(np.tile(turn.ravel(), len(triples)))
    scalars = np.flatnonzero(component == Component.SCALAR)
    data = np.concatenate([*values, np.ones(len(scalars))])
    places = (np.concatenate([*rows, scalars]), np.concatenate([*columns, scalars]))
    return sp.csr_array(sp.coo_array((data, places), shape=(len(node), len(node))))


def _motions(
    part: Substructure, body: PlacedBody, problem: Problem, Q: sp.csr_array, component: Ints
) -> tuple[sp.csr_array, Ints]:
    """W (Nc, Nc), dofs along the axes of the assembly from coordinates, of which the ``chosen`` (m,) are the motions of
    the interfaces, B'u.

    Motions that are dofs of the model are ones. Others take the places of the dofs that tell them best (pivoted QR).
    """
    node, outer = body.node[: body.inputs], body.component[: body.inputs]
    chosen = _same(problem.B, node, outer, component)
    B = sp.csc_array(Q @ problem.B @ _rotate_dofs(part.name, None, body.turn, node, outer).T)
    W, source = sp.eye_array(B.shape[0], format="csr"), part.bodies
    for number in np.unique(source.input_interface[chosen < 0]).tolist():
        columns = np.flatnonzero((source.input_interface == number) & (chosen < 0))
        own = sp.csr_array(W.T @ B[:, columns])
        rows = np.flatnonzero(np.diff(own.indptr))
        if len(rows) ** 2 > IMPORTED.max_spread_entries:
            raise InputError(
                f"part {part.name!r}: interface {list(source.interfaces)[number]!r} is the mean of {len(rows):,} "
                f"dofs, which would fill the matrices; certificates against unreduced parts take up to "
                f"{int(IMPORTED.max_spread_entries**0.5):,}: take a rigid interface, or fewer nodes"
            )
        free = rows[~np.isin(rows, chosen)]
        A = own[free].toarray()
        size = np.linalg.norm(A, axis=0)
        R, order = sl.qr((A / np.where(size > 0, size, 1.0)).T, mode="r", pivoting=True)
        k = len(columns)
        if len(free) < k or abs(R[k - 1, k - 1]) < TOL.dependent_motion * abs(R[0, 0]):
            raise InputError(f"part {part.name!r}: the motions of its interfaces depend on each other", kind="conflict")
        pivots = free[order[:k]]
        others = rows[~np.isin(rows, pivots)]
        # B'u = y: what the pivots are where y and the others are known.
        known = sp.hstack([sp.eye_array(k), -own[others].T]).toarray()
        solved = np.linalg.solve(A[order[:k]].T, known)
        step = sp.lil_array(sp.eye_array(B.shape[0]))
        step[np.ix_(pivots, np.concatenate([pivots, others]))] = solved
        W, chosen[columns] = sp.csr_array(W @ step.tocsr()), pivots
    return W, chosen


def _same(B: sp.csc_array, node: Ints, outer: Ints, component: Ints) -> Ints:
    """Dof (m,) that each interface motion of ``node`` (m,) and component ``outer`` (m,) is, -1 where it is none.

    Of the displacements of a node, and of its rotations, all are dofs or none is: they turn together.
    """
    one = (np.diff(B.indptr) == 1) & (B.data[B.indptr[:-1]] == 1.0)
    dof = np.where(one, B.indices[B.indptr[:-1]], -1)
    dof[component[dof] != outer] = -1
    group = 2 * node + outer // 3
    return np.where(np.isin(group, group[dof < 0]), -1, dof)


def _symmetric(A: sp.csr_array) -> sp.csr_array:
    return sp.csr_array(0.5 * (A + A.T))


def _refuse_too_large(given: Problem, parts: Sequence[Substructure]) -> None:
    left = given.budget.bytes_left()
    entries = sum(part.problem.K.nnz + part.problem.M.nnz for part in parts if part.problem is not None)
    needed = TOL.matrix_copies * TOL.entry_bytes * entries
    if left is not None and needed > left:
        raise BudgetError(
            f"the matrices of the {len(parts)} unreduced parts take about {needed / 1e6:.0f} MB, and "
            f"{max(left, 0) / 1e6:.0f} MB are left of the memory budget; give {enough_megabytes(needed - left)} MB "
            "more, or certify against the reduced parts (no job in [[substructure]])",
            needed=(given.budget.memory or 0) + needed - left,
        )
