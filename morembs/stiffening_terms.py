"""Geometric stiffening terms of a body in a floating frame, for any basis.

Every unit load l (an acceleration, an angular rate, a force on an interface) is balanced by the reaction of the frame,
f = (I - S'(R'S')^-1 R') f_l for the conditions S u = 0 and rigid motions R. The free body then has a stress, whatever
its rigid motion, and G_l = sum_a Phi_a' kg_l Phi_a with the scalar geometric stiffness kg_l and the components Phi_a
of the elastic shapes along x, y and z.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.errors import InputError, SolverError
from morembs.floating_frame import FloatingFrame, frame_rows, why_not_floating
from morembs.geometric_stiffness import StressedMesh
from morembs.linalg.orthogonal import dot
from morembs.model import FEModel
from morembs.problem import Problem
from morembs.progress import SILENT, Progress
from morembs.reducers.base import ReducedModel
from morembs.shape_integrals import PAIRS
from morembs.stiffening import Envelope, Stiffening

Floats = NDArray[np.float64]
# A load that keeps less than this part of its size once the frame's reaction balances it causes no stress.
BALANCED = 1e-10
# Loads, and columns of the basis, that are handled at a time.
LOADS, COLUMNS = 8, 16
# Part of the budget left that the matrices of one group of loads may take.
SHARE_OF_BUDGET = 0.25


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


def stiffening(
    problem: Problem, reduced: ReducedModel, frame: FloatingFrame, envelope: Envelope | None = None,
    progress: Progress = SILENT,
) -> Stiffening:  # fmt: skip
    """Geometric stiffening terms of the body in ``frame``.

    Loads of one unit: acceleration of the frame along each axis (the load -M S_t e_a), angular acceleration
    (-M (e_a x x)), products of angular velocities (-M (e_a x (e_b x x)), both orders where a and b differ; x from the
    origin of the frame) and six forces and moments at the point of every rigid and average interface. Terms that stay
    below ``envelope.share`` of Ke are zero and listed in ``dropped``; without an envelope all are kept.

    Peak memory: the loads (N, 12 + 6 k for k interfaces) where the budget wants them, and for a group of loads a
    scalar matrix each (1/9 of the entries of K) with three blocks of columns.

    Raises:
        InputError: a model without elements, or a body that has no floating frame.
        SolverError: a stiffness of the frame that is not positive.
    """
    reason = why_no_stiffening(problem.model) or why_not_floating(reduced)
    if reason:
        raise InputError(reason)
    mesh = problem.model.mesh
    if mesh is None or len(frame.elastic) != reduced.order:
        raise InputError(
            f"the floating frame belongs to a body of {len(frame.elastic)} coordinates, but {reduced.name!r} has "
            f"{reduced.order}; make the frame from the same reduction"
        )
    F = _unit_loads(problem, frame.origin)
    loaded = _balance(problem, frame, F)
    progress.update("geometric stiffening: node graph")
    stressed = StressedMesh.of(mesh, problem.model.materials)
    G = np.zeros((F.shape[1], frame.count, frame.count))
    group = _group(problem, stressed.graph.nnz)
    for first in range(0, len(loaded), group):
        some = loaded[first : first + group]
        U = problem.coupling.T @ problem.elastic.flexibility(F[:, some])
        kg = stressed.stiffness(U, problem.budget)
        del U
        P = _projected(problem, reduced.V, kg)
        for one, load in zip(P, some, strict=True):
            value = frame.elastic.T @ one @ frame.elastic
            G[load] = 0.5 * (value + value.T)
        progress.update(f"geometric stiffening: {first + len(some)} of {len(loaded)} loads")
    return _kept(problem, frame, G, envelope or Envelope(share=0.0))


def _unit_loads(problem: Problem, origin: Floats) -> Floats:
    """Loads (Nc, 12 + 6 k) in coupled dofs, in the order of ``Envelope.limits``."""
    model, coupling, budget = problem.model, problem.coupling, problem.budget
    x, eye = model.nodes.xyz - origin, np.eye(3)
    turned = [np.cross(axis, x) for axis in eye]
    F = budget.empty((coupling.T.shape[1], 12 + coupling.frames.shape[1]), order="F")

    def inertial(field: Floats) -> Floats:
        return np.asarray(-(coupling.T.T @ (model.M @ field.ravel())))

    for a in range(3):
        F[:, a] = inertial(np.broadcast_to(eye[a], x.shape))
        F[:, 3 + a] = inertial(turned[a])
    for place, (a, b) in enumerate(PAIRS):
        once = np.cross(eye[a], turned[b])
        F[:, 6 + place] = inertial(once if a == b else once + np.cross(eye[b], turned[a]))
    F[:, 12:] = coupling.frames.toarray()
    return np.asarray(F)


def _balance(problem: Problem, frame: FloatingFrame, F: Floats) -> list[int]:
    """Adds the frame's reaction to the loads ``F`` in place; returns those that still load the body."""
    rows, R = frame_rows(problem, frame.kind, frame.interfaces), problem.coupling.R
    before = np.linalg.norm(F, axis=0)
    share = np.linalg.solve(R.T @ rows, R.T @ F)
    for load in range(F.shape[1]):
        F[:, load] -= rows @ share[:, load]
    return [int(load) for load in np.flatnonzero(np.linalg.norm(F, axis=0) > BALANCED * before)]


def _group(problem: Problem, entries: int) -> int:
    """How many loads to handle at once: each has a scalar matrix, and ``COLUMNS`` and more columns."""
    left = problem.budget.left()
    if left is None:
        return LOADS
    per_load = 8 * entries + 8 * problem.K.shape[0] * (2 * COLUMNS + 4)
    return int(np.clip(SHARE_OF_BUDGET * left // per_load, 1, LOADS))


def _projected(problem: Problem, V: Floats, kg: list[sp.csr_array]) -> Floats:
    """V' T' (kg (x) I3) T V (k, nr, nr) for each of the k scalar matrices, a block of columns at a time."""
    T, budget, order = problem.coupling.T, problem.budget, V.shape[1]
    width = budget.columns(len(V), copies=2 * len(kg) + 2, widest=COLUMNS)
    P = np.empty((len(kg), order, order))
    for first in range(0, order, width):
        X = np.ascontiguousarray(T @ V[:, first : first + width])
        w = X.shape[1]
        # Rows 3 i + a of X: displacement a of node i, so one product with kg serves all three.
        by_node = X.reshape(-1, 3 * w)
        Y = np.empty((len(V), len(kg) * w))
        for place, matrix in enumerate(kg):
            Y[:, place * w : (place + 1) * w] = T.T @ (matrix @ by_node).reshape(-1, w)
        found = dot(V, Y, budget)
        P[:, :, first : first + w] = found.reshape(order, len(kg), w).transpose(1, 0, 2)
        budget.relax()
    return P


def _kept(problem: Problem, frame: FloatingFrame, G: Floats, envelope: Envelope) -> Stiffening:
    """The terms (loads, n, n) that matter within the envelope."""
    columns = problem.coupling.frame_columns
    share, load, dropped = {}, {}, []
    for one, (name, limit) in zip(G, envelope.limits(list(columns)).items(), strict=True):
        load[name] = 1.0 if limit is None else limit
        share[name] = load[name] * _largest_change(one, frame.Ke)
        if limit is not None and one.any() and share[name] < envelope.share:
            dropped.append(name)
            one[:] = 0.0
    return Stiffening(
        acceleration=G[:3], angular_acceleration=G[3:6], rotation=G[6:12],
        wrench={name: G[12:][at] for name, at in columns.items()}, share=share, load=load, dropped=tuple(dropped),
        least_share=envelope.share,
    )  # fmt: skip


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
