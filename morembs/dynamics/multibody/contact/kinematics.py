"""Unilateral contact of points with a surface, with Coulomb's friction or without.

A point touches where its gap g to the surface is zero. On the normal 0 <= g, 0 <= force, g force = 0; with a
compliance R of the points g + R force takes the place of g. Friction is at most ``friction`` times the normal
force, in any direction of the tangent plane, and opposes sliding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.limits import NotNegative, Restitution
from morembs.base.types import Bools, Floats
from morembs.dynamics.multibody.component import Component, Marker, MarkerState, direction, numbers
from morembs.dynamics.multibody.contact.surfaces import NodalSurface, Surface
from morembs.dynamics.multibody.contact.tolerances import TOL
from morembs.dynamics.multibody.rotations import cross, hat
from morembs.dynamics.multibody.system import Assembly, State


@runtime_checkable
class Compliant(Protocol):
    """A body with quasi-static local compliance at its points: shapes without inertia, amplitude = force."""

    def flexibility(self, points: Sequence[Marker]) -> ArrayLike:
        """(3 m, 3 m) m/N, symmetric and positive semidefinite: displacements of the m points per force on each,
        along the axes of the markers, x, y, z of the first point first. Motion of the coordinates is left out."""


@checked
class Contact:
    """Points of one body against a surface that another carries.

    Args:
        points: markers of the points, all on one body.
        surface: along the axes of ``on``; its outside is where the points may be.
        on: the marker that carries the surface: on the ground, or on another body.
        vertices: markers of the points of a nodal surface on an elastic body; the surface follows them. They are on the
            body of ``on``, which should not deform itself.
        friction: coefficient of Coulomb's law, not negative.
        restitution: Newton's, 0 to 1: approach and rebound of an impact.
        axis: (3,) in the axes of ``on``: the first of the two components of friction and slip in results is along its
            part in the tangent plane.
        compliance: (m, m) m/N along the normals, (3 m, 3 m) along the axes of the markers, or an object with
            ``flexibility(points)``. Contact is then without impact; friction does not move the points by it.

    Raises:
        InputError: numbers out of range, points on several bodies, a compliance that is not positive definite.
    """

    def __init__(
        self,
        points: Sequence[Marker],
        surface: Surface,
        *,
        on: Marker,
        vertices: Sequence[Marker] = (),
        friction: NotNegative = 0.0,
        restitution: Restitution = 0.0,
        axis: ArrayLike = (1.0, 0.0, 0.0),
        compliance: ArrayLike | Compliant | None = None,
        name: str = "contact",
    ) -> None:
        self.name, self.surface, self.on = name, surface, on
        self.points, self.vertices = tuple(points), tuple(vertices)
        self.friction, self.restitution = float(friction), float(restitution)
        self.axis = direction(f"contact {name!r}: axis", axis)
        self._check()
        self.compliance = None if compliance is None else self._checked_compliance(compliance)

    def _check(self) -> None:
        what = f"contact {self.name!r}"
        if not self.points:
            raise InputError(f"{what}: no points were given; expected one marker or more", kind="missing")
        if len({id(m.component) for m in self.points}) > 1:
            raise InputError(
                f"{what}: its points are on several bodies; make a contact for each body",
                kind="conflict",
                keyword="points",
            )
        if self.points[0].component is self.on.component:
            raise InputError(f"{what}: points and surface are on one body; expected two bodies, or one and ground")
        if self.vertices:
            known = len(self.surface.points) if isinstance(self.surface, NodalSurface) else 0
            if known != len(self.vertices):
                raise InputError(f"{what}: {len(self.vertices)} vertices were given for a surface with {known} points")
            if any(m.component is not self.on.component for m in self.vertices):
                raise InputError(f"{what}: its vertices are not on the body that carries the surface")

    def _checked_compliance(self, value: ArrayLike | Compliant) -> Floats:
        what, m = f"contact {self.name!r}: compliance", len(self.points)
        given = value.flexibility(self.points) if isinstance(value, Compliant) else value
        size = 3 * m if np.shape(given) == (3 * m, 3 * m) else m
        R = numbers(what, given, (size, size))
        if (
            np.abs(R - R.T).max() > TOL.compliance_asymmetry * np.abs(R).max()
            or np.linalg.eigvalsh(R)[0] < -TOL.negative_compliance * np.abs(R).max()
        ):
            raise InputError(f"{what}: the matrix is not symmetric and positive semidefinite", kind="model")
        if np.diag(R).min() <= 0:
            raise InputError(f"{what}: some points have no compliance; give these points a contact of their own")
        if self.restitution:
            raise InputError(
                f"{what} and restitution {self.restitution} were given; compliant points have no impacts",
                kind="conflict",
                keyword="restitution",
            )
        return R

    @property
    def markers(self) -> tuple[Marker, ...]:
        """All markers it uses."""
        return (*self.points, self.on, *self.vertices)

    @property
    def components(self) -> tuple[Component, ...]:
        """The bodies that meet."""
        return self.points[0].component, self.on.component

    def surface_at(self, on: MarkerState, vertices: Sequence[MarkerState]) -> Surface:
        """The surface as its vertices are now, along the axes of its marker."""
        if not vertices or not isinstance(self.surface, NodalSurface):
            return self.surface
        now = (np.array([p.position for p in vertices]) - on.position) @ on.axes
        return self.surface.displace(now - self.surface.points)


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactKinematics:
    """All points of all contacts of a system, for one configuration.

    gap (m,) m; foot (m, 3) m and normal (m, 3), inertial; N (m, k) and T (m, 2, k): normal and tangential velocity of
    the points over the surface per velocity of the system; tangents (m, 2, 3).
    """

    gap: Floats
    foot: Floats
    normal: Floats
    tangents: Floats
    N: Floats
    T: Floats

    def round_off(self, v: Floats, least: float) -> float:
        """Relative velocities below this are round-off, m/s; at least that of ``least`` m/s."""
        parts = np.abs(self.N) @ np.abs(v), np.abs(self.T) @ np.abs(v)
        return TOL.at_rest * max([least, *(float(p.max(initial=0.0)) for p in parts)])


class Contacts:
    """The contacts of a system with their m points numbered."""

    def __init__(self, assembly: Assembly, contacts: Sequence[Contact]) -> None:
        self.assembly, self.contacts = assembly, tuple(contacts)
        self._check()
        counts = [len(c.points) for c in self.contacts]
        ends = np.cumsum([0, *counts])
        self.rows = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self.count = int(ends[-1])
        self.friction = np.repeat([c.friction for c in self.contacts], counts)
        self.restitution = np.repeat([c.restitution for c in self.contacts], counts)
        self.compliant = np.repeat([c.compliance is not None for c in self.contacts], counts)
        self._of = np.repeat(np.arange(len(self.contacts)), counts)

    def _check(self) -> None:
        names: set[str] = set()
        for contact in self.contacts:
            if not isinstance(contact, Contact):
                raise InputError(f"{type(contact).__name__} was given as a contact; expected a Contact")
            if contact.name in names:
                raise InputError(
                    f"two contacts are called {contact.name!r}; give each a name of its own",
                    kind="conflict",
                    keyword="name",
                )
            names.add(contact.name)
            for marker in contact.markers:
                if marker.component.size and self.assembly.index(marker.component) is None:
                    raise InputError(
                        f"contact {contact.name!r}: {marker.label} is not in the system; add its body", kind="unknown"
                    )

    def locate_point(self, i: int) -> tuple[str, int]:
        """The contact of a point, and its number there."""
        return self.contacts[self._of[i]].name, int(i - self.rows[self._of[i]].start)

    def label(self, i: int) -> str:
        """How messages name a point."""
        name, number = self.locate_point(i)
        return f"contact {name!r}, point {number} ({self.contacts[self._of[i]].points[number].label})"

    def kinematics(self, x: Floats) -> ContactKinematics:
        """Gaps and Jacobians of all points."""
        m, k = self.count, self.assembly.size
        gap, foot, normal, tangents = np.zeros(m), np.zeros((m, 3)), np.zeros((m, 3)), np.zeros((m, 2, 3))
        V = np.zeros((m, 3, k))
        for contact, rows in zip(self.contacts, self.rows, strict=True):
            on, corners = self.assembly.place(contact.on, x), [self.assembly.place(v, x) for v in contact.vertices]
            surface = contact.surface_at(on, corners)
            carrier, body = (self.assembly.index(c.component) for c in (contact.on, contact.points[0]))
            first = on.axes @ contact.axis
            for i, marker in enumerate(contact.points, rows.start):
                place = self.assembly.place(marker, x)
                closest = surface.nearest((place.position - on.position) @ on.axes)
                gap[i], normal[i] = closest.gap, on.axes @ closest.normal
                foot[i] = on.position + on.axes @ closest.point
                tangents[i] = _tangents(normal[i], first, on.axes)
                if body is not None:
                    V[i, :, self.assembly.in_v[body]] += place.jacobian[:3]
                if carrier is not None:
                    at = self.assembly.in_v[carrier]
                    V[i, :, at] -= _surface_motion(on, corners, foot[i], closest.vertices, closest.weights)
        N = np.einsum("ia,iak->ik", normal, V)
        return ContactKinematics(gap=gap, foot=foot, normal=normal, tangents=tangents, N=N, T=tangents @ V)

    def flexibility(self, x: Floats, kinematics: ContactKinematics) -> Floats:
        """R (m, m) along the normals, zero for points without compliance."""
        R = np.zeros((self.count, self.count))
        for contact, rows in zip(self.contacts, self.rows, strict=True):
            if contact.compliance is None:
                continue
            if len(contact.compliance) == len(contact.points):
                R[rows, rows] = contact.compliance
                continue
            local = [
                self.assembly.place(p, x).axes.T @ n
                for p, n in zip(contact.points, kinematics.normal[rows], strict=True)
            ]
            rotated = np.zeros((len(contact.compliance), len(contact.points)))
            for i, n in enumerate(local):
                rotated[3 * i : 3 * i + 3, i] = n
            R[rows, rows] = rotated.T @ contact.compliance @ rotated
        return R

    def rates(self, x: Floats, v: Floats, h: float, rows: NDArray[np.int_]) -> tuple[Floats, Floats]:
        """(d N/dt) v (r,) and (d T/dt) v (r, 2) of some points: five-point difference along the motion."""
        turning = [float(np.abs(v[self.assembly.in_v[i]][3:6]).max(initial=0.0)) for i in self._find_moving()]
        s = min(TOL.five_point_turn / max([TOL.tiny, *turning]), h)

        def at(k: int) -> Floats:
            kinematics = self.kinematics(self.assembly.move(x, k * s * v))
            return np.concatenate(((kinematics.N[rows] @ v)[:, None], kinematics.T[rows] @ v), axis=1)

        change = (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12 * s)
        return change[:, 0], change[:, 1:]

    def _find_moving(self) -> list[int]:
        numbers = (self.assembly.index(body) for contact in self.contacts for body in contact.components)
        return sorted({i for i in numbers if i is not None})

    def stiffness(self, x: Floats, force: Floats, friction: Floats, step: float = TOL.forward_step) -> Floats:
        """(k, k): derivative of minus the contact forces by the configuration, for Newton's method only."""
        size = self.assembly.size
        K = np.zeros((size, size))
        if not force.any():
            return K

        def pull(at: Floats) -> Floats:
            kinematics = self.kinematics(at)
            return np.asarray(-(force @ kinematics.N) - np.einsum("ia,iak->k", friction, kinematics.T))

        base = pull(x)
        for i in self._find_moving():
            at = self.assembly.in_x[i]
            for column in range(self.assembly.in_v[i].start, self.assembly.in_v[i].stop):
                change, varied = np.zeros(size), x.copy()
                change[column] = step
                varied[at] = self.assembly.components[i].move(x[at], change[self.assembly.in_v[i]])
                K[:, column] = (pull(varied) - base) / step
        return K


def _tangents(normal: Floats, first: Floats, axes: Floats) -> Floats:
    """(2, 3) at right angles to the normal; where ``first`` is along it another axis takes its place."""
    for candidate in (first, *axes.T):
        along = candidate - (candidate @ normal) * normal
        length = float(np.linalg.norm(along))
        if length > TOL.least_tangent:
            t = along / length
            return np.stack((t, cross(normal, t)))
    return np.zeros((2, 3))


def _surface_motion(
    on: MarkerState, corners: Sequence[MarkerState], foot: Floats, vertices: NDArray[np.int_], weights: Floats
) -> Floats:
    """(3, k): velocity of the material point of the surface at ``foot`` per velocity of its body."""
    if not corners:
        return np.asarray(on.jacobian[:3] - hat(foot - on.position) @ on.jacobian[3:])
    chosen = [corners[int(a)] for a in vertices]
    # What the vertices do not carry (curvature of the patch) turns with the marker.
    offset = foot - sum(w * p.position for w, p in zip(weights, chosen, strict=True))
    motion = sum(w * p.jacobian[:3] for w, p in zip(weights, chosen, strict=True))
    return np.asarray(motion - hat(np.asarray(offset)) @ on.jacobian[3:])


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactState(State):
    """A state with contact: force (m,) N, friction (m, 2) N along the tangents, sliding (m,) bool, deflection (m,) m of
    compliant points, and the rigid points that are closed (m,) bool."""

    kinematics: ContactKinematics
    force: Floats
    friction: Floats
    sliding: Bools
    deflection: Floats
    closed: Bools

    @property
    def gap(self) -> Floats:
        """(m,) m, with the deflection of compliant points."""
        return np.asarray(self.kinematics.gap + self.deflection)

    @property
    def approach(self) -> Floats:
        """(m,) rates of the gaps by the coordinates, m/s."""
        return np.asarray(self.kinematics.N @ self.v)

    @property
    def slip(self) -> Floats:
        """(m, 2) m/s."""
        return np.asarray(self.kinematics.T @ self.v)
