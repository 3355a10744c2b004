"""Reduced model -> elastic body in a floating frame of reference, for simulators with large rotations.

A node is at r + A (x + phi q): r and A are position and rotation of the frame, x undeformed positions from its
origin, phi q a small deformation. Six conditions S u = 0 say how the frame follows the body (Schwertassek,
Wallrapp and Shabana 1999). Any basis that holds rigid motion R gives phi = phi_0 - R (S R)^-1 S phi_0, so the frame
is chosen, and changed, after the reduction, and the stiffness is the same in all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.summary import summarised
from morembs.base.types import Floats
from morembs.body.floating.integrals import ShapeIntegrals, shape_integrals
from morembs.body.floating.stiffening import STIFFENING, Stiffening
from morembs.body.floating.tolerances import TOL
from morembs.fem import frozen_numbers, rigid_motion, skew
from morembs.fem.fe_model import has_places
from morembs.linalg.dense import symmetric
from morembs.linalg.massless import split_massless
from morembs.storage.table import dataset, table_of

if TYPE_CHECKING:
    from morembs.problem import Problem
    from morembs.reducers.base import ReducedModel

# Kinds of frames, and how many interfaces each needs.
FRAMES = {"mean-axes": 0, "center-of-mass": 1, "tangent": 1, "chord": 2}


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class InterfaceMarker:
    """The frame of an interface: ``point`` (3,) undeformed, from the origin of the body frame; ``motion`` (6, n)
    displacement and small rotation for each elastic coordinate."""

    point: Floats = dataset("real", "3", "undeformed, from the origin", "m")
    motion: Floats = dataset("real", "6 ne", "displacement and small rotation per coordinate")

    def __post_init__(self) -> None:
        for name in ("point", "motion"):
            object.__setattr__(self, name, frozen_numbers(getattr(self, name)))


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class FloatingFrame:
    """An elastic body in its floating frame, with n elastic coordinates q.

    ``kind`` one of ``FRAMES`` and the ``interfaces`` that it follows; ``origin`` (3,) of the frame in the model (its
    axes are those of the model). Coordinates of the reduced model are ``elastic`` (nr, n) @ q; ``rigid`` (nr, 6) are
    those of unit translations and rotations about the origin. ``Ke``, ``De`` (n, n); ``markers`` of all rigid and
    average interfaces. ``notes`` say what is not exact.

    >>> body.floating.in_frame("tangent", ["LEFT"])
    FloatingFrame: kind tangent; interfaces LEFT; elastic coordinates 12; mass 7.85; markers LEFT, RIGHT
    """

    kind: str = dataset(
        "text",
        "",
        "conditions that the frame follows",
        doc="`mean-axes`, `center-of-mass`, `tangent` or `chord`: how the body frame follows the body",
        known=tuple(FRAMES),
    )
    interfaces: tuple[str, ...] = dataset(
        "text",
        "any",
        "that it follows",
        default=(),
        doc="interfaces that it follows",
        when="where it follows any",
        known="interfaces",
        write=lambda frame: frame.interfaces or None,
    )
    origin: Floats = dataset(
        "real",
        "3",
        "of the frame, in coordinates of the model",
        "m",
        doc="of the frame, in coordinates of the model; its axes are those of the model",
    )
    elastic: Floats = dataset("real", "n ne", "reduced coordinates of the elastic ones")
    rigid: Floats = dataset("real", "n 6", "reduced coordinates of unit translations and rotations about the origin")
    Ke: Floats = dataset("real", "ne ne", "stiffness of the elastic coordinates")
    De: Floats = dataset("real", "ne ne", "damping of the elastic coordinates")
    integrals: ShapeIntegrals = dataset(table_of(ShapeIntegrals))
    markers: Mapping[str, InterfaceMarker] = dataset(table_of(InterfaceMarker), name="markers/*", known="interfaces")
    notes: tuple[str, ...] = dataset("notes", default_factory=tuple, doc="what is not exact")
    stiffening: Stiffening | None = dataset(
        STIFFENING,
        default=None,
        doc="geometric stiffening, if that was asked for: see "
        "[conventions](schema/conventions.md#geometric-stiffening)",
        when="if",
    )

    def __post_init__(self) -> None:
        for name in ("origin", "elastic", "rigid", "Ke", "De"):
            object.__setattr__(self, name, frozen_numbers(getattr(self, name)))

    @property
    def count(self) -> int:
        """Number n of elastic coordinates."""
        return len(self.Ke)

    def _facts(self) -> dict[str, object]:
        return {
            "kind": self.kind,
            "interfaces": list(self.interfaces),
            "elastic coordinates": self.count,
            "mass": float(self.integrals.mass),
            "markers": list(self.markers),
            "geometric stiffening": None if self.stiffening is None else "yes",
            "notes": "; ".join(self.notes),
        }

    def in_frame(self, kind: str, interfaces: Sequence[str] = ()) -> FloatingFrame:
        """The same body seen from another frame. Geometric stiffening is left out: it belongs to the loads of a frame.

        Raises:
            InputError: unknown kind, or interfaces that do not define such a frame.
        """
        momentum = np.hstack([self.integrals.Ct, self.integrals.Cr]).T
        c = _follow_interfaces(
            self, kind, interfaces, {name: marker.motion for name, marker in self.markers.items()}, momentum
        )
        markers = {
            name: InterfaceMarker(point=marker.point, motion=marker.motion - _motion_of(marker.point) @ c)
            for name, marker in self.markers.items()
        }
        return replace(
            self,
            kind=kind,
            interfaces=tuple(interfaces),
            elastic=self.elastic - self.rigid @ c,
            integrals=self.integrals.without_rigid(c),
            markers=markers,
            stiffening=None,
        )

    def follow_interfaces(self, motions: Mapping[str, Floats], count: int) -> Floats:
        """(6, count): how the frame moves, about its origin, with displacements free of momentum in which the
        interfaces move by ``motions`` (6, count); mean axes stay.
        """
        return _follow_interfaces(self, self.kind, self.interfaces, motions, np.zeros((6, count)))

    def about(self, origin: Sequence[float]) -> FloatingFrame:
        """The same body with the origin of its frame at ``origin`` (3,), in coordinates of the model."""
        d = np.asarray(origin, dtype=float) - self.origin
        H = np.eye(6, dtype=d.dtype)
        H[:3, 3:] = skew(d)
        markers = {name: replace(marker, point=marker.point - d) for name, marker in self.markers.items()}
        return replace(
            self,
            origin=self.origin + d,
            rigid=self.rigid @ H,
            integrals=self.integrals.about(d),
            markers=markers,
            stiffening=None if self.stiffening is None else self.stiffening.about(d),
        )


def _motion_of(point: Floats) -> Floats:
    """(6, 6): motion of a frame at ``point`` under rigid motion about the origin."""
    return rigid_motion(np.tile(point, (6, 1)), np.arange(6))


def check_frame(kind: str, interfaces: Sequence[str], framed: Sequence[str]) -> None:
    """Check that ``interfaces`` have a frame each (``framed`` do) and define a floating frame of this kind.

    Raises:
        InputError: they do not.
    """
    if kind not in FRAMES:
        raise InputError(
            f"frame kind {kind!r} was given; {nearest(kind, list(FRAMES))}", kind="unknown", keyword="kind"
        )
    wanted = FRAMES[kind]
    if len(interfaces) != wanted:
        raise InputError(
            f"a {kind} frame was given {len(interfaces)} interfaces ({', '.join(interfaces) or 'none'}); expected "
            f"{wanted}, by name",
            keyword="interfaces",
        )
    for name in interfaces:
        if name not in framed:
            raise InputError(
                f"a {kind} frame cannot follow the interface {name!r}; {nearest(name, list(framed))} "
                "(only rigid and average interfaces have a frame)",
                kind="unknown",
                keyword="interfaces",
            )
    if len(set(interfaces)) < len(interfaces):
        raise InputError(
            f"a chord frame was given the interface {interfaces[0]!r} twice; expected two",
            kind="conflict",
            keyword="interfaces",
        )


def _selection(kind: str, points: Sequence[Floats]) -> Floats:
    """(6, 6 k): the conditions of a frame on the motions of its k interfaces."""
    if kind != "chord":
        return np.eye(6)
    chord = points[1] - points[0]
    # Not a norm, which no complex step passes.
    length = np.sqrt(chord @ chord)
    if not length.real > 0:
        raise InputError("the two interfaces of a chord frame are at one point; take a tangent frame", kind="conflict")
    along = chord / length
    # The three rotations are those of the chord itself, from its transverse motion, and the twist at its start.
    across = skew(along) / length
    turn = across @ np.hstack([-np.eye(3), np.zeros((3, 3)), np.eye(3), np.zeros((3, 3))])
    turn[:, 3:6] += np.outer(along, along)
    return np.vstack([np.hstack([np.eye(3), np.zeros((3, 9))]), turn])


def _follow_interfaces(
    body: FloatingFrame, kind: str, interfaces: Sequence[str], motions: Mapping[str, Floats], momentum: Floats
) -> Floats:
    """(S R)^-1 S u (6, k) of displacements u with these ``motions`` (6, k) of markers and ``momentum`` (6, k)."""
    check_frame(kind, interfaces, list(body.markers))
    if kind == "mean-axes":
        return np.asarray(np.linalg.solve(body.integrals.rigid, momentum))
    points = [body.markers[name].point for name in interfaces]
    S = _selection(kind, points)
    on_rigid = S @ np.vstack([_motion_of(point) for point in points])
    on_shapes = S @ np.vstack([motions[name] for name in interfaces])
    if kind == "center-of-mass":
        on_rigid[:3], on_shapes[:3] = body.integrals.rigid[:3], momentum[:3]
    return np.asarray(np.linalg.solve(on_rigid, on_shapes))


def frame_rows(problem: Problem, kind: str, interfaces: Sequence[str] = ()) -> Floats:
    """S' (Nc, 6): the conditions of a frame in coupled dofs, as columns.

    Raises:
        InputError: unknown kind, or interfaces that do not define such a frame.
    """
    coupling = problem.coupling
    check_frame(kind, interfaces, list(coupling.frame_columns))
    inertial = problem.M @ coupling.R
    if kind == "mean-axes":
        return np.asarray(inertial)
    of = {interface.name: interface for interface in problem.interfaces}
    S = _selection(kind, [of[name].point for name in interfaces])
    motions = np.hstack([coupling.frames[:, coupling.frame_columns[name]].toarray() for name in interfaces])
    rows = motions @ S.T
    if kind == "center-of-mass":
        rows[:, :3] = inertial[:, :3]
    return np.asarray(rows)


def floating_frame(
    problem: Problem,
    reduced: ReducedModel,
    *,
    kind: str = "mean-axes",
    interfaces: Sequence[str] = (),
    origin: Sequence[float] = (0.0, 0.0, 0.0),
) -> FloatingFrame:
    """Floating-frame data of a free body from its consistent mass.

    ``origin`` (3,) in coordinates of the model. The elastic coordinates are the free modes of the reduced model, of
    unit modal mass, as the frame sees them. Peak memory: the shapes (N, n) at all dofs where the budget wants them.

    Args:
        problem: the full, free model.
        reduced: its reduced model.
        kind: "mean-axes", "center-of-mass", "tangent" or "chord".
        interfaces: names that carry the frame.
        origin: (3,) in m, in coordinates of the model.

    Raises:
        InputError: a body that is held or whose equations are not symmetric (see ``floats``), or an impossible frame.

    >>> floating_frame(problem, reduced, kind="chord", interfaces=["LEFT", "RIGHT"]).count
    12
    """

    check_frame(kind, interfaces, list(problem.coupling.frame_columns))
    reason = why_not_floating(problem, reduced)
    if reason:
        raise InputError(reason, kind="unsupported", keyword="frame")
    space, coupling, r = problem.space, problem.coupling, TOL.rigid_motions
    Y = reduced.modes()[1][:, r:]
    center = problem.mass_properties[1]
    H = np.eye(6)
    H[:3, 3:] = skew(center - coupling.pole)
    R = coupling.R @ H
    rigid = _coordinates(problem, reduced, R)
    elastic = space.multiply(reduced.V, Y)
    motions = space.dot(coupling.frames.toarray(), elastic) if coupling.frame_columns else np.zeros((0, Y.shape[1]))
    points = {interface.name: interface.point for interface in problem.interfaces}
    markers = {
        name: InterfaceMarker(point=points[name] - center, motion=motions[at])
        for name, at in coupling.frame_columns.items()
    }
    with problem.budget.in_use():
        integrals, note = shape_integrals(problem.model, _on_model(problem, elastic), center)
    return frame_about(
        reduced.K,
        reduced.D,
        Y,
        rigid,
        integrals,
        markers,
        center,
        kind=kind,
        interfaces=interfaces,
        origin=origin,
        note=note,
    )


def frame_about(
    K: Floats,
    D: Floats,
    Y: Floats,
    rigid: Floats,
    integrals: ShapeIntegrals,
    markers: Mapping[str, InterfaceMarker],
    center: Floats,
    *,
    kind: str,
    interfaces: Sequence[str],
    origin: Sequence[float],
    note: str = "",
) -> FloatingFrame:
    """A floating frame about ``origin``, of what is known about the ``center`` of mass (3,) in the model.

    ``K``, ``D`` (nr, nr) of a reduced model, ``Y`` (nr, n) its elastic modes, with their ``integrals`` and ``markers``,
    and ``rigid`` (nr, 6) unit motions.
    """
    Ke, De = Y.T @ K @ Y, Y.T @ D @ Y
    body = FloatingFrame(
        kind="mean-axes",
        interfaces=(),
        origin=center,
        elastic=Y,
        rigid=rigid,
        integrals=integrals,
        Ke=symmetric(Ke),
        De=symmetric(De),
        markers=markers,
        notes=(note,) if note else (),
    )
    # What is left of rigid motion in the modes is round-off; the frame takes it out.
    return body.in_frame("mean-axes").in_frame(kind, interfaces).about(origin)


def why_not_floating(problem: Problem, reduced: ReducedModel) -> str:
    """Why a body has no floating frame; "" where it has one."""
    if reduced.congruent and not reduced.symmetric:
        return (
            f"the body {reduced.name!r} has gyroscopic or circulatory terms, so that its matrices are not symmetric; a "
            "floating frame needs a body without"
        )
    if not reduced.symmetric:
        return (
            f"the body {reduced.name!r} comes from a two-sided reduction, whose matrices are not symmetric; a floating "
            "frame needs a one-sided one"
        )
    if not has_places(problem.model):
        return (
            f"the model of the body {reduced.name!r} has coordinates without places; a floating frame needs nodes "
            "(give their coordinates and a dof map at the import)"
        )
    if reduced.rigid_count != TOL.rigid_motions:
        return (
            f"the body {reduced.name!r} has {reduced.rigid_count} rigid-body motions; a floating frame needs a free "
            "body with six (leave supports to the simulator)"
        )
    return ""


def _on_model(problem: Problem, shapes: Floats) -> Floats:
    """``shapes`` (Nc, n) in dofs of the model (N, n)."""
    T = problem.coupling.T
    if T.shape[0] == T.shape[1]:
        return shapes
    out = problem.budget.empty((T.shape[0], shapes.shape[1]), order="F")
    width = problem.budget.columns(T.shape[0])
    for first in range(0, shapes.shape[1], width):
        block = slice(first, first + width)
        out[:, block] = T @ shapes[:, block]
        problem.budget.release_if_tight()
    return np.asarray(out)


def _coordinates(problem: Problem, reduced: ReducedModel, R: Floats) -> Floats:
    """Reduced coordinates (nr, 6) of rigid motions ``R`` (Nc, 6) that the basis holds."""
    import scipy.linalg as sl

    split = split_massless(reduced.K, reduced.M)
    # Motions without mass have no part in rigid motion.
    M = reduced.M if split is None else symmetric(split.P.T @ reduced.M @ split.P)
    # Unit diagonal: coordinates of different units would spoil the factor.
    scale = 1.0 / np.sqrt(np.diag(M))
    factor = sl.cho_factor(M * np.outer(scale, scale))
    coordinates = np.zeros((reduced.order, R.shape[1]))
    rest = R
    for _ in range(2):
        loads = problem.space.dot(reduced.V, problem.M @ rest)
        loads = loads if split is None else split.P.T @ loads
        found = scale[:, None] * sl.cho_solve(factor, scale[:, None] * loads)
        coordinates += found if split is None else split.P @ found
        rest = R - reduced.V @ coordinates
    return coordinates
