"""Geometric stiffening terms of a body in a floating frame, for any basis.

Every unit load l (an acceleration, an angular rate, a force on an interface) is balanced by the reaction of the frame,
f = (I - S'(R'S')^-1 R') f_l for the conditions S u = 0 and rigid motions R. The free body then has a stress, whatever
its rigid motion, and G_l = sum_a Phi_a' kg_l Phi_a with the scalar geometric stiffness kg_l and the components Phi_a
of the elastic shapes along x, y and z, and the share of the couplings (see ``link_stiffness``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base import progress
from morembs.base.errors import InputError, SolverError
from morembs.base.types import Floats
from morembs.body.floating.frame import FloatingFrame, frame_rows, why_not_floating
from morembs.body.floating.integrals import PAIRS
from morembs.body.floating.link_stiffness import Links
from morembs.body.floating.stiffening import Envelope, Stiffening
from morembs.body.floating.tolerances import TOL
from morembs.fem import FEModel
from morembs.fem.geometric_stiffness import StressedMesh
from morembs.linalg.dense import symmetric
from morembs.problem import Problem
from morembs.reducers.base import ReducedModel


def why_no_stiffening(model: FEModel) -> str:
    """Why there are no geometric stiffening terms; "" where there are."""
    if model.mesh is None or not model.materials:
        return (
            "geometric stiffening needs the stress in the elements, and this model has matrices only; give its mesh "
            "and materials, or leave stiffening out"
        )
    if not model.dofs.is_solid:
        return "geometric stiffening needs solid elements; this model has other degrees of freedom than x, y and z"
    return ""


def geometric_stiffening(
    problem: Problem, reduced: ReducedModel, frame: FloatingFrame, envelope: Envelope | None = None
) -> Stiffening:
    """Geometric stiffening terms of the body in ``frame``.

    Loads of one unit: acceleration of the frame along each axis (the load -M S_t e_a), angular acceleration
    (-M (e_a x x)), products of angular velocities (-M (e_a x (e_b x x)), both orders where a and b differ; x from the
    origin of the frame) and six forces and moments at the point of every rigid and average interface. Terms that stay
    below ``envelope.share`` of Ke are zero and listed in ``dropped``; without an envelope all are kept.

    Peak memory: the loads (N, 12 + 6 k for k interfaces) where the budget wants them, and for a group of loads a
    scalar matrix each (1/9 of the entries of K) with three blocks of columns.

    Args:
        problem: the full model.
        reduced: its reduced model.
        frame: floating frame of ``reduced``.
        envelope: largest loads, and the share of Ke below which terms are dropped.

    Raises:
        InputError: a model without elements, or a body that has no floating frame.
        SolverError: a stiffness of the frame that is not positive.

    >>> stiffening = geometric_stiffening(problem, reduced, body.floating)
    >>> len(stiffening.share)                                        # 3 + 3 + 6 of the frame, 6 of each interface
    24
    """
    reason = why_no_stiffening(problem.model) or why_not_floating(problem, reduced)
    if reason:
        raise InputError(reason, kind="unsupported", keyword="mesh")
    mesh = problem.model.mesh
    if mesh is None or len(frame.elastic) != reduced.order:
        raise InputError(
            f"the floating frame belongs to a body of {len(frame.elastic)} coordinates, but {reduced.name!r} has "
            f"{reduced.order}; make the frame from the same reduction",
            kind="conflict",
            keyword="frame",
        )
    links = Links(problem)
    loads = _unit_loads(problem, links, frame.origin)
    loaded = _balance(problem, frame, links, loads)
    progress.update("geometric stiffening: node graph")
    stressed = StressedMesh.of(mesh, problem.model.materials)
    G = np.zeros((loads.F.shape[1], frame.count, frame.count))
    group = _group(problem, stressed.graph.nnz)
    for first in range(0, len(loaded), group):
        some = loaded[first : first + group]
        U = problem.coupling.T @ problem.free_free.flexibility(loads.F[:, some])
        with problem.budget.in_use():
            kg = stressed.stiffness(U)
        turning = links.turning(U, loads.inertial[:, some], loads.wrench[:, some])
        del U
        P = _project_terms(problem, reduced.V, kg)
        for place, load in enumerate(some):
            value = frame.elastic.T @ P[place] @ frame.elastic
            for name, A in turning.items():
                rotation = frame.markers[name].motion[3:]
                value += rotation.T @ A[place] @ rotation
            G[load] = symmetric(value)
        progress.update(f"geometric stiffening: {first + len(some)} of {len(loaded)} loads")
    return _select_terms(problem, frame, G, envelope or Envelope(share=0.0))


@dataclass(frozen=True, eq=False)
class _Loads:
    """Loads ``F`` (Nc, 12 + 6 k) = -M a + wrenches, in the order of ``Envelope.limits``: M a at the nodes of interfaces
    in ``inertial`` (ns, .), the wrenches on all interfaces in ``wrench`` (6 k, .)."""

    F: Floats
    inertial: Floats
    wrench: Floats


def _unit_loads(problem: Problem, links: Links, origin: Floats) -> _Loads:
    model, coupling = problem.model, problem.coupling
    x, eye, count = model.nodes.xyz - origin, np.eye(3), coupling.frames.shape[1]
    turned = [np.cross(axis, x) for axis in eye]
    F = problem.budget.empty((coupling.T.shape[1], 12 + count), order="F")
    inertial, wrench = np.zeros((len(links.dofs), 12 + count)), np.zeros((count, 12 + count))

    def add_acceleration(load: int, field: Floats) -> None:
        force = model.M @ field.ravel()
        F[:, load], inertial[:, load] = -(coupling.T.T @ force), force[links.dofs]

    for a in range(3):
        add_acceleration(a, np.broadcast_to(eye[a], x.shape))
        add_acceleration(3 + a, turned[a])
    for place, (a, b) in enumerate(PAIRS):
        once = np.cross(eye[a], turned[b])
        add_acceleration(6 + place, once if a == b else once + np.cross(eye[b], turned[a]))
    F[:, 12:], wrench[:, 12:] = coupling.frames.toarray(), np.eye(count)
    return _Loads(F, inertial, wrench)


def _balance(problem: Problem, frame: FloatingFrame, links: Links, loads: _Loads) -> list[int]:
    """Adds the frame's reaction to the ``loads`` in place; returns indices of loads that still load the body."""
    rows, R = frame_rows(problem, frame.kind, frame.interfaces), problem.coupling.R
    before = np.linalg.norm(loads.F, axis=0)
    share = np.linalg.solve(R.T @ rows, R.T @ loads.F)
    for load in range(loads.F.shape[1]):
        loads.F[:, load] -= rows @ share[:, load]
    # Conditions are motions of interfaces or of the mass: rows = M R alpha + frames beta.
    basis = sp.csc_array(sp.hstack([sp.csc_array(problem.M @ R), problem.coupling.frames]))
    scale = 1.0 / np.sqrt(np.asarray(basis.multiply(basis).sum(axis=0)).ravel())
    gram = scale[:, None] * (basis.T @ basis).toarray() * scale
    parts, *_ = np.linalg.lstsq(gram, scale[:, None] * (basis.T @ rows), rcond=TOL.dependent_reaction)
    parts = scale[:, None] * parts @ share
    loads.inertial[:] += links.M @ (problem.coupling.T @ R) @ parts[:6]
    loads.wrench[:] -= parts[6:]
    return [int(load) for load in np.flatnonzero(np.linalg.norm(loads.F, axis=0) > TOL.balanced_load * before)]


def _group(problem: Problem, entries: int) -> int:
    """How many loads to handle at once: each has a scalar matrix, and ``TOL.basis_columns`` and more columns."""
    left = problem.budget.bytes_left()
    if left is None:
        return TOL.loads_at_once
    per_load = 8 * entries + 8 * problem.K.shape[0] * (2 * TOL.basis_columns + 4)
    return int(np.clip(TOL.budget_share * left // per_load, 1, TOL.loads_at_once))


def _project_terms(problem: Problem, V: Floats, kg: list[sp.csr_array]) -> Floats:
    """V' T' (kg (x) I3) T V (k, nr, nr) for each of the k scalar matrices, a block of columns at a time."""
    T, space, order = problem.coupling.T, problem.space, V.shape[1]
    width = space.budget.columns(len(V), copies=2 * len(kg) + 2, widest=TOL.basis_columns)
    P = np.empty((len(kg), order, order))
    for first in range(0, order, width):
        X = np.ascontiguousarray(T @ V[:, first : first + width])
        w = X.shape[1]
        # Rows 3 i + a of X: displacement a of node i, so one product with kg serves all three.
        by_node = X.reshape(-1, 3 * w)
        Y = np.empty((len(V), len(kg) * w))
        for place, matrix in enumerate(kg):
            Y[:, place * w : (place + 1) * w] = T.T @ (matrix @ by_node).reshape(-1, w)
        product = space.dot(V, Y)
        P[:, :, first : first + w] = product.reshape(order, len(kg), w).transpose(1, 0, 2)
        space.budget.release_if_tight()
    return P


def _select_terms(problem: Problem, frame: FloatingFrame, G: Floats, envelope: Envelope) -> Stiffening:
    """The terms (loads, n, n) that matter within the envelope."""
    columns = problem.coupling.frame_columns
    share, load, dropped = {}, {}, []
    for term, (name, limit) in zip(G, envelope.limits(list(columns)).items(), strict=True):
        load[name] = 1.0 if limit is None else limit
        share[name] = load[name] * _largest_change(term, frame.Ke)
        if limit is not None and term.any() and share[name] < envelope.share:
            dropped.append(name)
            term[:] = 0.0
    return Stiffening(
        acceleration=G[:3],
        angular_acceleration=G[3:6],
        rotation=G[6:12],
        wrench={name: G[12:][at] for name, at in columns.items()},
        share=share,
        load=load,
        dropped=tuple(dropped),
        least_share=envelope.share,
    )


def _largest_change(G: Floats, Ke: Floats) -> float:
    """Largest |eigenvalue| of Ke^-1/2 G Ke^-1/2."""
    if not G.any():
        return 0.0
    try:
        values = sl.eigh(G, Ke, eigvals_only=True)
    except sl.LinAlgError as error:
        raise SolverError(
            "the stiffness of the body in its floating frame is not positive, so that nothing can be compared with it; "
            "a shape without stiffness is left in the basis"
        ) from error
    return float(np.abs(values).max())
