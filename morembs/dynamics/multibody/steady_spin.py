"""Steady spin: a system that turns as a whole about an axis, and small motion in the frame that turns with it.

A floating body with its frame at r0, R has the velocity W x (r0 - p) + r' and the angular velocity R'W + w in its own
axes, where r', w and q' are seen by an observer who turns with W about p. Its accelerations are then
W x (W x (r0 - p)) + 2 W x r' + r'', w' - w x R'W and q'' (Geradin and Rixen 1997, ch. 2): with them the equations of
motion are those of a system whose rest is to be found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.limits import Finite
from morembs.base.types import Floats
from morembs.dynamics.multibody.component import direction, vector
from morembs.dynamics.multibody.floating_body import FloatingBody
from morembs.dynamics.multibody.rotations import cross, rotation
from morembs.dynamics.multibody.system import Assembly
from morembs.dynamics.multibody.tolerances import TOL


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class SteadySpin:
    """Rotation of a whole system with ``speed`` rad/s about ``axis`` (3,) through ``point`` (3,) m.

    Raises:
        InputError: numbers that make no axis.
    """

    axis: Sequence[float]
    speed: Finite
    point: Sequence[float] = (0.0, 0.0, 0.0)
    vector: Floats = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "vector", self.speed * direction("axis of the steady spin", self.axis))
        object.__setattr__(self, "point", vector("point of the steady spin", self.point, 3))

    def motion(self, a: Assembly, x: Floats, relative: Floats) -> tuple[Floats, Floats]:
        """Velocity and acceleration (k,) of a system with a ``relative`` velocity (k,) and no relative acceleration."""
        v, rate, W = relative.copy(), np.zeros(a.size), self.vector
        for component, i, j in zip(a.components, a.in_x, a.in_v, strict=True):
            if not isinstance(component, FloatingBody):
                raise InputError(
                    f"body {component.name!r} is held in the inertial frame and cannot spin with others",
                    kind="unsupported",
                )
            arm, w = x[i][:3] - self.point, W @ x[i][3:12].reshape(3, 3)
            v[j] += np.concatenate((cross(W, arm), w, np.zeros(component.size - 6)))
            rate[j][:3] = cross(W, cross(W, arm)) + 2 * cross(W, relative[j][:3])
            rate[j][3:6] = -cross(relative[j][3:6], w)
        return v, rate

    def equations(self, a: Assembly, t: float, x: Floats, relative: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """As those of the assembly, with the inertia forces of the spin in g."""
        v, rate = self.motion(a, x, relative)
        M, g, Phi, B = a.equations(t, x, v)
        return M, M @ rate + g, Phi, B

    def tangents(self, a: Assembly, t: float, x: Floats, multipliers: Floats) -> tuple[Floats, Floats]:
        """K and C (k, k) of the frame that turns, Coriolis forces included, by central differences."""

        def forces(step: Floats, relative: Floats) -> Floats:
            _, g, _, B = self.equations(a, t, a.move(x, step), relative)
            return np.asarray(g + multipliers @ B)

        K, C, none = np.zeros((a.size, a.size)), np.zeros((a.size, a.size)), np.zeros(a.size)
        for column, step in enumerate(TOL.central_step * np.eye(a.size)):
            K[:, column] = (forces(step, none) - forces(-step, none)) / (2 * TOL.central_step)
            C[:, column] = (forces(none, step) - forces(none, -step)) / (2 * TOL.central_step)
        return K, C

    def check(self, a: Assembly, t: float, x: Floats) -> None:
        """Refuse a system that cannot turn steadily: joints that the spin would open, forces that do not turn with it.

        Raises:
            InputError: in these cases.
        """
        v, _ = self.motion(a, x, np.zeros(a.size))
        _, g, _, B = a.equations(t, x, v)
        opened, size = (
            np.abs(B @ v - a.motion_derivative(1, t)),
            np.abs(B) @ np.abs(v) + np.abs(a.motion_derivative(1, t)),
        )
        for joint, rows in zip(a.joints, a.in_rows, strict=True):
            if (opened[rows] > TOL.steady_part * max(1.0, float(size[rows].max(initial=0.0)))).any():
                raise InputError(
                    f"{joint.label} does not let the system turn by {self.speed:g} rad/s about the axis of the "
                    "spin; expected joints to ground along the axis, free to turn or driven with that speed",
                    kind="model",
                    keyword="joint",
                )
        R, turned, back = rotation(np.asarray(self.axis, dtype=float), 1.0), x.copy(), np.zeros(a.size)
        for i in a.in_x:
            turned[i][:3] = R @ (x[i][:3] - self.point) + self.point
            turned[i][3:12] = (R @ x[i][3:12].reshape(3, 3)).ravel()
        other = a.equations(t, turned, self.motion(a, turned, np.zeros(a.size))[0])[1]
        for j in a.in_v:
            back[j] = other[j]
            back[j][:3] = other[j][:3] @ R
        if np.abs(back - g).max(initial=0.0) > TOL.steady_part * max(TOL.tiny, float(np.abs(g).max(initial=0.0))):
            raise InputError(
                "forces change as the system turns, so that no spin is steady: gravity and loads on the ground must be "
                "along the axis of the spin, springs to the ground on it",
                kind="unsupported",
                keyword="forces",
            )
