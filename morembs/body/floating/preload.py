"""Preload: a static load stresses the body, and its geometric stiffness joins K before anything is reduced.

K' = K + P'(K_g + L)P. K_g = kg (x) I3 is the geometric stiffness of the linear static stress, L that of the interface
couplings, whose frames turn under load (see ``link_stiffness``). A dead load would turn a free body back or
over; here the loads turn with the body, so P = I - R (S R)^-1 S takes out its rigid motion R, as six dofs S see it, and
K' R = 0 as K R = 0 (the geometric terms of a floating frame, Wallrapp and Schwertassek 1991). Without its six
rows and columns K' has the pattern of K.

What a simulator adds by itself is not in K': the centrifugal softening of a body that spins, -M W W with the angular
velocity W, belongs to the floating frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp

from morembs.base import progress
from morembs.base.arguments import check_options, check_value
from morembs.base.budget import current_budget
from morembs.base.errors import InputError, nearest
from morembs.base.limits import Bounded, Direction, Vector, Wrench
from morembs.base.types import Floats, Ints
from morembs.body.floating.buckling import critical_factor
from morembs.body.floating.static_state import coupling_stiffness, static_state
from morembs.body.floating.stiffening_terms import why_no_stiffening
from morembs.body.floating.tolerances import TOL
from morembs.fem import FEModel, rigid_motion
from morembs.fem.geometric_stiffness import StressedMesh
from morembs.fem.interface import Interface
from morembs.linalg.dense import symmetric
from morembs.linalg.statics import support_dofs
from morembs.problem import Problem


@dataclass(frozen=True, kw_only=True)
class Preload:
    """Loads that act together, in SI units along the axes of the model.

    ``wrench`` interface -> three forces (N) and three moments (Nm) at its point. ``speed`` (rad/s) of a steady
    rotation about ``axis`` (3,) through ``point`` (3,) m. ``acceleration`` (3,) m/s2 of the body, gravity taken off.
    Interfaces ``held`` carry what is not in equilibrium; without any the inertia of the free body does. The loads keep
    their direction to a frame that ``follows`` six dofs of these interfaces: by default the held ones, or else
    all interfaces.

    Raises:
        InputError: no load, or numbers that make none.
    """

    wrench: Mapping[str, Sequence[float]] = field(default_factory=dict)
    speed: Bounded = 0.0
    axis: Direction | None = None
    point: Vector = (0.0, 0.0, 0.0)
    acceleration: Vector = (0.0, 0.0, 0.0)
    held: tuple[str, ...] = ()
    follows: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_options(self)
        for name, load in self.wrench.items():
            check_value(f"wrench.{name}", load, Wrench)
        if (self.speed != 0) != (self.axis is not None):
            raise InputError(
                "a rotation needs both speed and axis; give both, or leave both out", kind="missing", keyword="axis"
            )
        if any(self.acceleration) and not self.held:
            raise InputError(
                "acceleration strains a free body only through what holds it; name the interfaces that do "
                'with held = ["NAME"]',
                kind="missing",
                keyword="held",
            )
        if not (self.speed or any(self.acceleration) or any(any(f) for f in self.wrench.values())):
            raise InputError(
                "no load was given; expected a wrench, a speed with its axis, or an acceleration",
                kind="missing",
                keyword="preload",
            )

    def check(self, interfaces: Sequence[Interface]) -> None:
        """Refuse what does not fit the ``interfaces``.

        Raises:
            InputError: an unknown interface, one without a frame, or a wrench on a held one.
        """
        framed, known = [i.name for i in interfaces if i.kind.framed], [i.name for i in interfaces]
        for key, names in (("wrench", tuple(self.wrench)), ("held", self.held)):
            for name in names:
                if name not in framed:
                    raise InputError(
                        f"preload: {key} names the interface {name!r}; {nearest(name, framed)} "
                        "(only rigid and average interfaces have a frame)",
                        kind="unknown",
                        keyword="mesh",
                    )
        for name in self.follows:
            if name not in known:
                raise InputError(
                    f"preload: follows names the interface {name!r}; {nearest(name, known)}",
                    kind="unknown",
                    keyword=key,
                )
        both = [name for name in self.held if name in self.wrench]
        if both:
            raise InputError(
                f"preload: the interface {both[0]!r} is held and has a wrench; leave one of them out", kind="conflict"
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class Preloaded:
    """``model`` with K' in place of K; ``displacements`` (N,) m under the preload, rigid motion of no meaning.

    ``critical_factor`` times the load makes the body buckle, at the accuracy of ``TOL.buckling_error``; None where
    that is farther than ``TOL.far_factor`` times away or never. ``notes`` say what balances the load, and
    what was left out.
    """

    model: FEModel
    displacements: Floats
    critical_factor: float | None
    notes: Mapping[str, object]


def apply_preload(problem: Problem, preload: Preload) -> Preloaded:
    """The model of ``problem`` under ``preload``; make a new ``Problem`` of it with the same interfaces.

    Peak memory: K' where the budget wants it, a scalar matrix of 1/9 of it, and up to ``TOL.buckling_steps`` columns.

    Raises:
        InputError: a model without solid elements, a body that is not free, loads that do not fit the interfaces, or a
            load beyond buckling (the message gives the critical factor).
    """
    _refuse(problem)
    preload.check(problem.interfaces)
    progress.update("preload: static solution")
    u, turning, notes = _solution(problem, preload)
    return _stiffen_model(problem, u, turning, preload.follows or preload.held, notes)


def apply_prestress(problem: Problem, displacements: Floats, follows: tuple[str, ...] = ()) -> Preloaded:
    """As ``apply_preload``, for the stress of known ``displacements`` (N,) in m, from whatever static solution.

    The couplings of interfaces add nothing, as the forces in them are not known.

    Raises:
        InputError: as ``apply_preload``, or displacements of another length.
    """
    _refuse(problem)
    u = np.asarray(displacements, dtype=float)
    if u.shape != (problem.model.size,) or not np.isfinite(u).all():
        raise InputError(
            f"displacements of shape {u.shape} were given; expected {problem.model.size} finite numbers",
            keyword="displacements",
        )
    return _stiffen_model(problem, u, {}, follows, {})


def _refuse(problem: Problem) -> None:
    reason = why_no_stiffening(problem.model)
    if reason:
        raise InputError(f"preload: {reason}", kind="unsupported", keyword="preload")
    if problem.rigid.shape[1] != 6:
        raise InputError(
            f"preload: the body has {problem.rigid.shape[1]} rigid-body motions; expected a free body with six",
            kind="model",
        )


def _solution(problem: Problem, preload: Preload) -> tuple[Floats, Mapping[str, Floats], dict[str, object]]:
    """Displacements (N,), what turns the couplings, and how the load is balanced."""
    model, coupling = problem.model, problem.coupling
    a = np.tile(np.asarray(preload.acceleration, dtype=float), (len(model.nodes), 1))
    if preload.axis is not None:
        n = np.asarray(preload.axis, dtype=float) / np.linalg.norm(preload.axis)
        x = model.nodes.xyz - np.asarray(preload.point, dtype=float)
        a += preload.speed**2 * np.cross(n, np.cross(n, x))
    wrench = np.zeros(coupling.frames.shape[1])
    for name, given in preload.wrench.items():
        wrench[coupling.frame_columns[name]] = given
    state = static_state(problem, a.ravel(), wrench, preload.held, "the held interfaces of the preload")
    notes: dict[str, object] = {}
    if preload.held:
        notes["preload_reactions"] = {
            name: state.wrench[coupling.frame_columns[name]].tolist() for name in preload.held
        }
    else:
        # Moment about the centre of mass.
        force, moment = np.split(coupling.R.T @ state.load, 2)
        moment = moment - np.cross(problem.mass_properties[1] - coupling.pole, force)
        notes["preload_balanced_by_inertia"] = [*force.tolist(), *moment.tolist()]
    return coupling.T @ state.u, state.turning, notes


def _stiffen_model(
    problem: Problem, u: Floats, turning: Mapping[str, Floats], follows: tuple[str, ...], notes: dict[str, object]
) -> Preloaded:
    model, T = problem.model, problem.coupling.T
    if model.mesh is None:
        raise InputError("preload: geometric stiffness needs the elements of the model", kind="missing")
    progress.update("preload: geometric stiffness")
    with problem.budget.in_use():
        kg = StressedMesh.of(model.mesh, model.materials).stiffness(u[:, None])[0]
    L, left_out = coupling_stiffness(problem, turning)
    if left_out:
        notes["preload_left_out"] = left_out
    # Rotations in units of displacement.
    R = rigid_motion((model.nodes.xyz[model.dofs.node] - problem.coupling.pole) / problem.length, model.dofs.component)
    turned = (kg @ R.reshape(len(model.nodes), -1)).reshape(R.shape) + L @ R
    extra = _together(sp.coo_array(L), _without_rigid(R, turned, _find_followed_dofs(problem, follows, R)))

    def geometric(x: Floats) -> Floats:
        X = T @ x
        return np.asarray(T.T @ ((kg @ X.reshape(-1, 3)).ravel() + extra @ X))

    factor = critical_factor(problem, geometric)
    if factor is not None and factor <= 1.0:
        raise InputError(
            f"preload: the body buckles at {factor:.4g} times this load, so that its stiffness is not positive any "
            "more; lower the load",
            kind="model",
            keyword="preload",
        )
    notes["preload_critical_factor"] = f"above {TOL.far_factor:g}" if factor is None else factor
    with problem.budget.in_use():
        K = _sum(model.K, kg, extra)
    return Preloaded(model=replace(model, K=K), displacements=u, critical_factor=factor, notes=notes)


def _find_followed_dofs(problem: Problem, names: tuple[str, ...], R: Floats) -> Ints:
    """Six dofs that the loads turn with, far from each other on the interfaces ``names`` (none: all of them)."""
    model = problem.model
    chosen = [i for i in problem.interfaces if not names or i.name in names]
    rows = np.unique(np.concatenate([i.nodes for i in chosen])) if chosen else np.arange(len(model.nodes))
    for nodes in (rows, np.arange(len(model.nodes))):
        dofs = model.dofs.of_nodes(nodes).ravel()
        if len(dofs) >= 6:
            supports = dofs[support_dofs(R[dofs])]
            if np.linalg.cond(R[supports]) < TOL.loose_condition:
                return np.asarray(supports)
        if names:
            raise InputError(
                f"preload: the nodes of {', '.join(names)} lie on a line or in a point, and no frame can follow them; "
                "name more interfaces in follows",
                kind="model",
                keyword="follows",
            )
    raise InputError("preload: the nodes of the model lie on a line; no frame can follow them", kind="model")


def _without_rigid(R: Floats, turned: Floats, rows: Ints) -> sp.coo_array:
    """P'GP - G with P = I - R R_s^-1 (.)_s on the dofs ``rows`` (6,), for ``turned`` = G R (N, 6).

    All dofs of a node get entries, zeros too, so that they keep equal patterns.
    """
    n = len(R)
    dofs = np.unique(3 * (rows // 3)[:, None] + np.arange(3))
    C = np.zeros((6, len(dofs)))
    C[:, np.searchsorted(dofs, rows)] = np.linalg.inv(R[rows])
    G = -turned @ C
    loaded = np.abs(turned).reshape(-1, 18).max(axis=1) > TOL.negligible_term * np.abs(turned).max(initial=0.0)
    on = np.flatnonzero(np.repeat(loaded, 3))
    W = R.T @ turned
    corner = C.T @ symmetric(W) @ C
    d = len(dofs)
    side_rows, side_cols, side = np.repeat(on, d), np.tile(dofs, len(on)), G[on].ravel()
    data = np.concatenate([side, side, corner.ravel()])
    at = (
        np.concatenate([side_rows, side_cols, np.repeat(dofs, d)]),
        np.concatenate([side_cols, side_rows, np.tile(dofs, d)]),
    )
    return sp.coo_array((data, at), shape=(n, n))


def _together(*parts: sp.coo_array) -> sp.csr_array:
    """Sum of sparse matrices with the zeros they store."""
    row, column = (np.concatenate([part.coords[axis] for part in parts]) for axis in (0, 1))
    data = np.concatenate([part.data for part in parts])
    total = sp.csr_array(sp.coo_array((data, (row, column)), shape=parts[0].shape))
    total.sum_duplicates()
    return total


def _sum(K: sp.csr_array, kg: sp.csr_array, extra: sp.csr_array) -> sp.csr_array:
    """K + kg (x) I3 + extra with the zeros they store, a piece of rows at a time."""
    # An assembled K has the pattern of kg (x) I3, filled up to blocks.
    alike = K.nnz == 9 * kg.nnz and np.array_equal(np.diff(K.indptr)[::3], 3 * np.diff(kg.indptr))
    room = K.nnz + extra.nnz + (0 if alike else 3 * kg.nnz)
    index = np.int32 if room < np.iinfo(np.int32).max else np.int64
    budget = current_budget()
    data, indices = budget.empty(room), budget.empty(room, index)
    indptr, used = np.zeros(K.shape[0] + 1, dtype=index), 0
    for first in range(0, kg.shape[0], TOL.nodes_at_once):
        last = min(first + TOL.nodes_at_once, kg.shape[0])
        own = sp.coo_array(kg[first:last])
        shape = (3 * (last - first), K.shape[1])
        thrice = [
            sp.coo_array((own.data, (3 * own.coords[0] + a, 3 * own.coords[1] + a)), shape=shape) for a in range(3)
        ]
        whole = _together(*(sp.coo_array(A[3 * first : 3 * last]) for A in (K, extra)), *thrice)
        data[used : used + whole.nnz], indices[used : used + whole.nnz] = whole.data, whole.indices
        indptr[3 * first + 1 : 3 * last + 1] = used + whole.indptr[1:]
        used += whole.nnz
        budget.release_if_tight()
    total = sp.csr_array((data[:used], indices[:used], indptr), shape=K.shape)
    total.has_canonical_format = True
    return total
