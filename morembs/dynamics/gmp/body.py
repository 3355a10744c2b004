"""A parameterised member as a body of morembs.dynamics.multibody: plane motion, in any plane of space.

Equations: J'M J q'' + J'M (dJ/dt) q' + dV/dq = J'(loads), with J = dx/dq and the second derivative of x along the
motion from those of the tables, so that energy is kept. Coordinates are those of ``ReducedMember``.

beam = ParameterisedBody(member, position=(0, 0, 1), rotation=rotation((1, 0, 0), np.pi / 2), name="rod")
system.add(beam)
system.add(PlaneJoint(ground.marker_at((0, 0, 1)), beam.marker("start"), normal=(0, -1, 0)))
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from morembs.base.arguments import checked
from morembs.base.errors import InputError, SolverError, nearest
from morembs.base.types import Floats
from morembs.dynamics.gmp.member import ReducedMember
from morembs.dynamics.gmp.tolerances import TOL
from morembs.dynamics.multibody.component import (
    Marker,
    MarkerState,
    VectorComponent,
    checked_rotation,
    direction,
    vector,
)
from morembs.dynamics.multibody.joints import Constraint, Rows, frame_about
from morembs.dynamics.nonlinear.member import MemberState


@checked
class ParameterisedBody(VectorComponent):
    """A member that moves in the plane of the first two of its axes; markers ``start`` and ``end``.

    Its configuration is q = (x, y, angle of the start, x, y, angle of the end, eta), seen from ``position`` along the
    axes of ``rotation``. Gravity across the plane has no effect. There is no damping.

    Args:
        member: from ``ReducedMember`` or ``solid_member``.
        position: (3,) m, of the start at the beginning.
        rotation: (3, 3), axes of the plane as columns: the chord at the beginning, the direction across, the normal.
        velocity: (3,) m/s of the start along the inertial axes, within the plane.
        spin: rad/s about the normal.
        ends: (2,) rad, by which start and end are turned from the chord at the beginning.

    Raises:
        InputError: a velocity out of the plane, wrong shapes.
    """

    def __init__(
        self,
        member: ReducedMember,
        *,
        position: ArrayLike = (0.0, 0.0, 0.0),
        rotation: ArrayLike | None = None,
        velocity: ArrayLike = (0.0, 0.0, 0.0),
        spin: float = 0.0,
        ends: ArrayLike = (0.0, 0.0),
        name: str = "member",
    ) -> None:
        label = f"body {name!r}"
        self.name, self.member = name, member
        self.size = self.configuration_size = member.size
        self.origin, self.axes = (
            vector(f"{label}: position", position),
            checked_rotation(f"{label}: rotation", rotation),
        )
        speed = vector(f"{label}: velocity", velocity) @ self.axes
        if abs(speed[2]) > TOL.velocity_out_of_plane * max(1.0, float(np.abs(speed).max())) or not math.isfinite(spin):
            raise InputError(
                f"{label}: a velocity of {speed[2]:.3g} m/s across its plane and a spin of {spin} rad/s were given; "
                "expected a motion in the plane",
                keyword="velocity",
            )
        q = member.start(np.array([0, 0, 0, member.length, 0, 0], dtype=float))
        q[[2, 5]] += vector(f"{label}: ends", ends, 2)
        v = np.zeros(member.size)
        v[:6] = speed[0], speed[1], spin, speed[0], speed[1] + spin * member.length, spin
        self._start = q, v
        self.markers = {"start": EndMarker(self, "start", 0), "end": EndMarker(self, "end", 3)}

    def start(self) -> tuple[Floats, Floats]:
        return self._start

    def _fall(self, gravity: Floats) -> Floats:
        """M times the amplitudes of a unit of gravity."""
        return np.asarray(self.member.M @ (self.member.rigid[:, :2] @ (gravity @ self.axes[:, :2])))

    def dynamics(self, t: float, x: Floats, v: Floats, gravity: Floats) -> tuple[Floats, Floats]:
        left = self.member.outside(x)
        if left is not None:
            name, value, limit = left
            raise SolverError(
                f"body {self.name!r}: {name} = {value:.4g} left its tabulated range of +-{limit:.4g} at t = {t:.6g} s. "
                "Tabulate a larger range, or divide the member into more"
            )
        at = self.member.at(x)
        J = _jacobian(at)
        MJ = np.asarray(self.member.M @ J)
        return J.T @ MJ, MJ.T @ self.member.bending(x, v) + at.force - J.T @ self._fall(gravity)

    def energy(self, x: Floats, v: Floats, gravity: Floats) -> tuple[float, float]:
        at = self.member.at(x)
        speed = _jacobian(at) @ v
        return 0.5 * float(speed @ (self.member.M @ speed)), at.V - float(self._fall(gravity) @ at.x)

    def power(self, x: Floats, v: Floats) -> float:
        return 0.0

    def marker(self, name: str) -> Marker:
        if name not in self.markers:
            raise InputError(
                f"body {self.name!r} has no marker {name!r}; {nearest(name, self.markers)}", kind="unknown"
            )
        return self.markers[name]

    def nodes(self, q: Floats) -> Floats:
        """Coordinates (N,) of the nodes of the component in the plane, at the configuration q."""
        return self.member.nodes(self.member.at(q).x)


def _jacobian(at: MemberState) -> Floats:
    return np.zeros((len(at.x), 0)) if at.J is None else at.J


@dataclass(frozen=True, eq=False)
class EndMarker(Marker):
    """A frame at an end of a member; ``first`` of its three coordinates."""

    component: ParameterisedBody
    name: str
    first: int

    def place(self, x: Floats) -> MarkerState:
        axes, k = self.component.axes, self.first
        c, s = math.cos(x[k + 2]), math.sin(x[k + 2])
        jacobian = np.zeros((6, self.component.size))
        jacobian[:3, k : k + 2], jacobian[3:, k + 2] = axes[:, :2], axes[:, 2]
        turned = axes @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return MarkerState(position=self.component.origin + axes[:, :2] @ x[k : k + 2], axes=turned, jacobian=jacobian)


@checked
@dataclass(frozen=True, eq=False)
class PlaneJoint(Constraint):
    """Two markers of plane motion share a point; their directions, too, where it is ``fixed``.

    Between a plane body and the ground, or another plane body of the same plane, a joint of space would hold again what
    the plane holds already. ``normal`` (3,) of the plane, along the axes of the first marker at the start.

    Raises:
        InputError: a normal that is not that of the plane of a body.
    """

    first: Marker
    second: Marker
    _: KW_ONLY
    normal: ArrayLike = (0.0, 0.0, 1.0)
    fixed: bool = False
    name: str = ""
    count: int = field(init=False)
    _plane: Floats = field(init=False)
    _on_a: Floats = field(init=False)
    _on_b: Floats = field(init=False)

    def __post_init__(self) -> None:
        a, b = (m.place(m.component.start()[0]) for m in (self.first, self.second))
        frame = a.axes @ frame_about(direction(f"normal of {self.label}", self.normal))
        for marker in (self.first, self.second):
            if isinstance(marker, EndMarker):
                self._refuse_other_plane(marker.component, a.axes, frame[:, 2])
        object.__setattr__(self, "_plane", frame.T)
        object.__setattr__(self, "_on_a", a.axes.T @ frame[:, 0])
        object.__setattr__(self, "_on_b", b.axes.T @ frame[:, 1])
        object.__setattr__(self, "count", 3 if self.fixed else 2)

    def _refuse_other_plane(self, body: ParameterisedBody, axes: Floats, normal: Floats) -> None:
        if np.linalg.norm(np.cross(normal, body.axes[:, 2])) <= TOL.normal_mismatch:
            return
        # Adding zero takes the sign of zeros away.
        given, expected = ((np.round(axes.T @ each, 6) + 0.0).tolist() for each in (normal, body.axes[:, 2]))
        raise InputError(
            f"{self.label}: the axis {given} was given, but the plane of body {body.name!r} is across {expected}; give "
            "that axis, or turn the body by its rotation"
        )

    def rows(self, a: MarkerState, b: MarkerState) -> Rows:
        plane, normal = self._plane[:2], self._plane[2]
        Ga, Gb, values = np.zeros((self.count, 6)), np.zeros((self.count, 6)), np.empty(self.count)
        Ga[:2, :3], Gb[:2, :3] = -plane, plane
        values[:2] = plane @ (b.position - a.position)
        if self.fixed:
            # Directions that were at a right angle: their product is minus the sine of the turn since then.
            x, y = a.axes @ self._on_a, b.axes @ self._on_b
            cosine = float(np.cross(x, y) @ normal)
            values[2], Ga[2, 3:], Gb[2, 3:] = x @ y, cosine * normal, -cosine * normal
        return values, Ga, Gb
