"""Bodies in a floating frame.

A point of a body is r = r0 + R (x + phi q). Configuration: r0 (3), R (9, by rows), q (n); velocity: dr0/dt along the
inertial axes (3), angular velocity along the axes of the body (3), dq/dt (n).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats
from morembs.dynamics.multibody.component import Component, Marker, MarkerState
from morembs.dynamics.multibody.inertia import Inertia
from morembs.dynamics.multibody.rotations import cross, exponential, hat, orthonormal, tangent, tangent_slope
from morembs.dynamics.multibody.tolerances import TOL


class FloatingBody(Component):
    """What rigid and elastic bodies share: ``inertia``, ``Ke`` and ``De`` (n, n), named ``markers``.

    A point that lies at x (3,) m in the body is at r0 + R (x + phi q). ``configuration``: r0 (3,) m, R (9,) by rows,
    q (n,); ``velocity``: that of r0 (3,) m/s along the inertial axes, angular velocity (3,) rad/s along the axes of the
    body, dq/dt (n,). Rows of ``Ke`` and ``De`` are generalised forces of q.

    Raises:
        InputError: a mass matrix that is not positive definite, a ``Ke`` or ``De`` that is not symmetric.
    """

    def __init__(
        self, *, name: str, inertia: Inertia, Ke: Floats, De: Floats, configuration: Floats, velocity: Floats
    ) -> None:
        self.name, self.size, self.configuration_size = name, 6 + inertia.n, 12 + inertia.n
        self.inertia, self.Ke, self.De = inertia, Ke, De
        self.markers: dict[str, BodyMarker] = {}
        self._start = configuration, velocity
        self._check()

    def _check(self) -> None:
        _, q, w, rate = self._parts(*self._start)
        mass = self.inertia.evaluate(w, q, rate)[0]
        scale = np.sqrt(np.maximum(np.diag(mass), 0.0))
        if not (scale > 0).all() or np.linalg.eigvalsh(mass / np.outer(scale, scale))[0] < TOL.least_mass_eigenvalue:
            raise InputError(
                f"body {self.name!r}: its mass matrix is not positive definite; expected a positive mass, an inertia "
                "with three positive principal moments, elastic shapes that are no rigid motion, and with stiffening a "
                "deflection that is small in its frame (mean axes and chord frames tolerate the largest)",
                kind="model",
                keyword="mass",
            )
        for what, matrix in (("Ke", self.Ke), ("De", self.De)):
            if np.abs(matrix - matrix.T).max(initial=0.0) > TOL.stiffness_asymmetry * np.abs(matrix).max(initial=0.0):
                raise InputError(f"body {self.name!r}: {what} is not symmetric", kind="model")

    def start(self) -> tuple[Floats, Floats]:
        return self._start

    def move(self, x: Floats, step: Floats) -> Floats:
        moved = np.empty(self.configuration_size)
        moved[:3] = x[:3] + step[:3]
        moved[3:12] = orthonormal(x[3:12].reshape(3, 3) @ exponential(step[3:6])).ravel()
        moved[12:] = x[12:] + step[6:]
        return moved

    def tangent(self, step: Floats) -> Floats | None:
        T = np.eye(self.size)
        T[3:6, 3:6] = tangent(step[3:6])
        return T

    def bracket(self, a: Floats, b: Floats) -> Floats:
        value = np.zeros(self.size)
        value[3:6] = cross(a[3:6], b[3:6])
        return value

    @staticmethod
    def _parts(x: Floats, v: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        return x[3:12].reshape(3, 3), x[12:], v[3:6], v[6:]

    def dynamics(self, t: float, x: Floats, v: Floats, gravity: Floats) -> tuple[Floats, Floats]:
        R, q, w, rate = self._parts(x, v)
        M, force = self.inertia.evaluate(w, q, rate)
        # Gravity acts like an acceleration of the frame.
        force -= M[:, :3] @ (gravity @ R)
        force[6:] += self.Ke @ q + self.De @ rate
        force[:3] = R @ force[:3]
        M[3:, :3] = M[3:, :3] @ R.T
        M[:3, 3:] = M[3:, :3].T
        return M, force

    def tangents(self, x: Floats, v: Floats, acceleration: Floats, gravity: Floats) -> tuple[Floats, Floats] | None:
        R, q, w, rate = self._parts(x, v)
        frame, alpha, second = (acceleration[:3] - gravity) @ R, acceleration[3:6], acceleration[6:]
        known = self.inertia.tangents(frame, w, alpha, q, rate, second)
        if known is None:
            return None
        K, C = known
        K[6:, 6:] += self.Ke
        C[6:, 6:] += self.De
        K[:3], C[:3] = R @ K[:3], R @ C[:3]
        return K, C

    def energy(self, x: Floats, v: Floats, gravity: Floats) -> tuple[float, float]:
        R, q, w, rate = self._parts(x, v)
        M, _ = self.inertia.evaluate(w, q, rate)
        inner = np.concatenate((v[:3] @ R, v[3:]))
        height = self.inertia.mass * (gravity @ x[:3]) + gravity @ R @ self.inertia.first_moment(q)
        return 0.5 * float(inner @ M @ inner), float(0.5 * q @ self.Ke @ q - height)

    def power(self, x: Floats, v: Floats) -> float:
        return -float(v[6:] @ self.De @ v[6:])

    @cached_property
    def length(self) -> float:
        """Diagonal of the box with the inertia of the undeformed body, or what its markers span if that is more, m."""
        inertia = self.inertia
        center = inertia.first / inertia.mass
        gyration = float(np.trace(inertia.inertia)) / (2 * inertia.mass) - float(center @ center)
        points = np.array([m.point for m in self.markers.values()]).reshape(-1, 3)
        span = float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0
        return max(math.sqrt(max(12 * gyration, 0.0)), span)

    def deflection(self, x: Floats) -> float | None:
        """Of markers and of the body's mass (root of the mean square), per ``length``."""
        q = x[12:]
        if not len(q):
            return None
        rows = np.array([m.motion[:3] for m in self.markers.values()]).reshape(-1, len(q))
        at_markers = np.linalg.norm((rows @ q).reshape(-1, 3), axis=1)
        mean = math.sqrt(max(float(q @ self.inertia.Me @ q), 0.0) / self.inertia.mass)
        return max(mean, float(at_markers.max(initial=0.0))) / self.length

    def marker(self, name: str) -> Marker:
        if name not in self.markers:
            raise InputError(
                f"body {self.name!r} has no marker {name!r}; {nearest(name, self.markers)}", kind="unknown"
            )
        return self.markers[name]

    def add_marker(
        self, name: str, point: Floats, motion: Floats, short: Floats | None = None, axes: Floats | None = None
    ) -> Marker:
        marker = BodyMarker(self, name, point, motion, np.eye(3) if axes is None else axes, short)
        if name:
            if name in self.markers:
                raise InputError(
                    f"body {self.name!r} has a marker {name!r} already; take another name", kind="conflict"
                )
            self.markers[name] = marker
        return marker


@dataclass(frozen=True, eq=False)
class BodyMarker(Marker):
    """A frame on a body: undeformed ``point`` (3,) m, ``motion`` (6, n) of displacement (m) and rotation (rad) per
    elastic coordinate, ``axes`` (3, 3) in the body as columns, ``short`` (6, n, n) second-order motion -q' short q / 2,
    None without."""

    component: FloatingBody
    name: str
    point: Floats
    motion: Floats
    axes: Floats
    short: Floats | None

    def place(self, x: Floats) -> MarkerState:
        R, q, n = x[3:12].reshape(3, 3), x[12:], len(x) - 12
        jacobian = np.zeros((6, 6 + n))
        jacobian[:3, :3] = np.eye(3)
        if n == 0:
            arm = R @ self.point
            jacobian[:3, 3:6] = -hat(arm) @ R
            jacobian[3:, 3:6] = R
            return MarkerState(position=x[:3] + arm, axes=R @ self.axes, jacobian=jacobian)
        motion = self.motion
        small = motion @ q
        if self.short is not None:
            second = self.short @ q
            small, motion = small - 0.5 * (second @ q), motion - second
        arm = self.point + small[:3]
        jacobian[:3, 3:6] = -R @ hat(arm)
        jacobian[3:, 3:6] = R
        jacobian[:3, 6:] = R @ motion[:3]
        jacobian[3:, 6:] = (R @ tangent(small[3:]).T) @ motion[3:]
        return MarkerState(position=x[:3] + R @ arm, axes=R @ exponential(small[3:]) @ self.axes, jacobian=jacobian)

    def bend(self, x: Floats, wrench: Floats) -> Floats | None:
        if self.short is not None:
            return None
        R, q, n = x[3:12].reshape(3, 3), x[12:], len(x) - 12
        force, moment = wrench[:3] @ R, wrench[3:] @ R
        small, result = self.motion @ q, np.zeros((6 + n, 6 + n))
        F, T, arm = hat(force), tangent(small[3:]), self.point + small[:3]
        # On rotation force x arm turns with the frame; on shapes motion' times the force and T times the moment.
        result[3:6, 3:6] = hat(arm) @ F + hat(moment)
        result[3:6, 6:] = -F @ self.motion[:3]
        result[6:, 3:6] = self.motion[:3].T @ F + self.motion[3:].T @ (T @ hat(moment))
        result[6:, 6:] = self.motion[3:].T @ tangent_slope(small[3:], moment) @ self.motion[3:]
        return result
