"""Joints between two markers: rows of constraints Phi(x, t) = 0 with their Jacobians.

Axes are given along the axes of the first marker. The relative position that a joint keeps is that of its
markers at the start.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from morembs.base.arguments import checked
from morembs.base.limits import Positive
from morembs.base.types import Floats
from morembs.dynamics.multibody.component import Marker, MarkerState, direction
from morembs.dynamics.multibody.rotations import cross, hat

Rows = tuple[Floats, Floats, Floats]


@checked
@dataclass(frozen=True, eq=False)
class Motion:
    """A prescribed motion: ``value`` (rad or m), its ``rate`` and ``acceleration`` as functions of time (s)."""

    value: Callable[[float], float]
    rate: Callable[[float], float]
    acceleration: Callable[[float], float]

    @classmethod
    @checked
    def steady(cls, rate: float, start: float = 0.0) -> Motion:
        """Constant ``rate`` (rad/s or m/s) from the value ``start`` at time zero."""
        return cls(lambda t: start + rate * t, lambda t: rate, lambda t: 0.0)

    @classmethod
    @checked
    def smooth(cls, change: float, duration: Positive, begin: float = 0.0, start: float = 0.0) -> Motion:
        """From ``start`` by ``change`` within ``duration`` along a polynomial of degree five, at rest outside.

        Its acceleration has a kink at both ends, where forces of joints err to first order in the step for some steps.

        Raises:
            InputError: a duration that is not positive.
        """

        def along(order: int, t: float) -> float:
            s = min(max((t - begin) / duration, 0.0), 1.0)
            terms = (s**3 * (10 + s * (-15 + 6 * s)), 30 * (s * (1 - s)) ** 2, 60 * s * (1 - s) * (1 - 2 * s))
            return change * terms[order] / duration**order + (start if order == 0 else 0.0)

        return cls(lambda t: along(0, t), lambda t: along(1, t), lambda t: along(2, t))


class Constraint(ABC):
    """Rows Phi = 0 between two markers.

    ``motion`` drives the last row: Phi = geometry - motion(t), modulo a full turn where ``periodic``.
    """

    first: Marker
    second: Marker
    name: str
    motion: Motion | None = None
    count: int
    periodic: bool = False

    @abstractmethod
    def rows(self, a: MarkerState, b: MarkerState) -> Rows:
        """Geometry (m,) and its derivatives (m, 6) by velocity and angular velocity of both markers."""

    def bend(self, a: MarkerState, b: MarkerState, multipliers: Floats) -> Floats | None:
        """(12, 12): derivative of the wrenches (6 on each marker) that ``multipliers`` (m,) times ``rows`` give, by the
        displacements and rotations of both markers; None where only differences tell it."""
        return None

    @property
    def label(self) -> str:
        """How messages name it."""
        named = f" {self.name!r}" if self.name else ""
        return f"{type(self).__name__}{named} ({self.first.label} - {self.second.label})"

    def motion_derivative(self, order: int, t: float) -> float:
        """Value, rate or acceleration of the motion; zero without one."""
        if self.motion is None:
            return 0.0
        return (self.motion.value, self.motion.rate, self.motion.acceleration)[order](t)


def _starts(joint: Constraint) -> tuple[MarkerState, MarkerState]:
    a, b = (m.place(m.component.start()[0]) for m in (joint.first, joint.second))
    return a, b


def frame_about(e: Floats) -> Floats:
    """Columns t1, t2, e of a right-handed frame about the unit vector e."""
    t1 = np.zeros(3)
    t1[int(np.argmin(np.abs(e)))] = 1.0
    t1 -= (t1 @ e) * e
    t1 /= np.linalg.norm(t1)
    return np.stack((t1, cross(e, t1), e), axis=1)


def _coincide(a: MarkerState, b: MarkerState) -> Rows:
    G = np.zeros((3, 6))
    G[:, :3] = np.eye(3)
    return b.position - a.position, -G, G


def _perpendicular(a: MarkerState, b: MarkerState, on_a: Floats, on_b: Floats) -> Rows:
    """Products of pairs of columns (3, m), fixed on a and on b."""
    first, second = a.axes @ on_a, b.axes @ on_b
    G = np.zeros((first.shape[1], 6))
    for row, (f, s) in enumerate(zip(first.T, second.T, strict=True)):
        G[row, 3:] = cross(s, f)
    return np.einsum("ij,ij->j", first, second), -G, G


def _along(a: MarkerState, b: MarkerState, on_a: Floats) -> Rows:
    """Distance of the markers along columns (3, m) fixed on a."""
    lines, gap = (a.axes @ on_a).T, b.position - a.position
    Ga, Gb = np.zeros((len(lines), 6)), np.zeros((len(lines), 6))
    Ga[:, :3], Gb[:, :3] = -lines, lines
    Ga[:, 3:] = lines @ hat(gap)
    return lines @ gap, Ga, Gb


def _bend(by_first: Floats, by_second: Floats) -> Floats:
    """(12, 12) of moments on the second marker, and opposite ones on the first, that depend on both rotations."""
    result = np.zeros((12, 12))
    result[9:, 3:6], result[9:, 9:] = by_first, by_second
    result[3:6] = -result[9:]
    return result


def _bend_perpendicular(a: MarkerState, b: MarkerState, on_a: Floats, on_b: Floats, multipliers: Floats) -> Floats:
    by_a, by_b = np.zeros((3, 3)), np.zeros((3, 3))
    for f, s, m in zip((a.axes @ on_a).T, (b.axes @ on_b).T, multipliers.tolist(), strict=True):
        F, S = hat(f), hat(s)
        by_a -= m * S @ F
        by_b += m * F @ S
    return _bend(by_a, by_b)


def _bend_along(a: MarkerState, b: MarkerState, on_a: Floats, multipliers: Floats) -> Floats:
    L, gap, result = hat(a.axes @ on_a @ multipliers), hat(b.position - a.position), np.zeros((12, 12))
    # The force l on the second marker turns with the first, where the moment is l x gap.
    result[6:9, 3:6], result[:3, 3:6] = -L, L
    result[3:6, :3], result[3:6, 3:6], result[3:6, 6:9] = -L, gap @ L, L
    return result


def _stack_rows(*rows: Rows) -> Rows:
    value, Ga, Gb = (np.concatenate(part) for part in zip(*rows, strict=True))
    return value, Ga, Gb


def turn_angle(a: MarkerState, b: MarkerState, on_a: Floats, on_b: Floats) -> tuple[float, Floats]:
    """Angle (rad, within pi) of b about the third column of ``on_a``, and its derivative (3,) by relative rotation."""
    x, y, u = a.axes @ on_a[:, 0], a.axes @ on_a[:, 1], b.axes @ on_b[:, 0]
    cosine, sine = float(u @ x), float(u @ y)
    gradient = (cosine * cross(u, y) - sine * cross(u, x)) / (cosine**2 + sine**2)
    return math.atan2(sine, cosine), gradient


def bend_turn(a: MarkerState, b: MarkerState, on_a: Floats, on_b: Floats) -> Floats:
    """``bend`` of a multiplier of one times the gradient of ``turn_angle``."""
    x, y, u = a.axes @ on_a[:, 0], a.axes @ on_a[:, 1], b.axes @ on_b[:, 0]
    cosine, sine, X, Y, U = float(u @ x), float(u @ y), hat(x), hat(y), hat(u)
    ux, uy, square = U @ x, U @ y, cosine**2 + sine**2
    gradient = (cosine * uy - sine * ux) / square
    relative = np.outer(uy, ux) - np.outer(ux, uy) - 2 * np.outer(gradient, cosine * ux + sine * uy)
    by_first, by_second = sine * U @ X - cosine * U @ Y - relative, cosine * Y @ U - sine * X @ U + relative
    return _bend(by_first / square, by_second / square)


@checked
@dataclass(frozen=True, eq=False)
class SphericalJoint(Constraint):
    """The markers keep one point; all rotations are free."""

    first: Marker
    second: Marker
    _: KW_ONLY
    name: str = ""
    count = 3

    def rows(self, a: MarkerState, b: MarkerState) -> Rows:
        return _coincide(a, b)

    def bend(self, a: MarkerState, b: MarkerState, multipliers: Floats) -> Floats:
        return np.zeros((12, 12))


@checked
@dataclass(frozen=True, eq=False)
class _Aligned(Constraint):
    """A joint with an axis: ``on_a`` (3, 3) has it as third column; ``on_b`` is the same frame at the start."""

    first: Marker
    second: Marker
    _: KW_ONLY
    axis: ArrayLike = (0.0, 0.0, 1.0)
    name: str = ""
    on_a: Floats = field(init=False)
    on_b: Floats = field(init=False)

    def __post_init__(self) -> None:
        a, b = _starts(self)
        frame = frame_about(direction(f"axis of {self.label}", self.axis))
        object.__setattr__(self, "on_a", frame)
        object.__setattr__(self, "on_b", b.axes.T @ a.axes @ frame)


@checked
class RevoluteJoint(_Aligned):
    """The markers keep one point and the ``axis`` (3,) along the axes of the first: one rotation is free.

    Raises:
        InputError: an axis that is no direction; so of all joints with an axis.
    """

    count = 5

    def rows(self, a: MarkerState, b: MarkerState) -> Rows:
        return _stack_rows(_coincide(a, b), _perpendicular(a, b, self.on_a[:, :2], self.on_b[:, [2, 2]]))

    def bend(self, a: MarkerState, b: MarkerState, multipliers: Floats) -> Floats:
        return _bend_perpendicular(a, b, self.on_a[:, :2], self.on_b[:, [2, 2]], multipliers[3:])


@checked
class PrismaticJoint(_Aligned):
    """The second marker slides along the ``axis`` (3,) of the first without turning: one translation is free."""

    count = 5

    def rows(self, a: MarkerState, b: MarkerState) -> Rows:
        return _stack_rows(_along(a, b, self.on_a[:, :2]), _perpendicular(a, b, self.on_a, self.on_b[:, [1, 2, 0]]))

    def bend(self, a: MarkerState, b: MarkerState, multipliers: Floats) -> Floats:
        turning = _bend_perpendicular(a, b, self.on_a, self.on_b[:, [1, 2, 0]], multipliers[2:])
        return _bend_along(a, b, self.on_a[:, :2], multipliers[:2]) + turning


@checked
class FixedJoint(_Aligned):
    """The markers keep point and axes; ``axis`` does not matter."""

    count = 6

    def rows(self, a: MarkerState, b: MarkerState) -> Rows:
        return _stack_rows(_coincide(a, b), _perpendicular(a, b, self.on_a, self.on_b[:, [1, 2, 0]]))

    def bend(self, a: MarkerState, b: MarkerState, multipliers: Floats) -> Floats:
        return _bend_perpendicular(a, b, self.on_a, self.on_b[:, [1, 2, 0]], multipliers[3:])


@checked
@dataclass(frozen=True, eq=False)
class DrivenAngle(_Aligned):
    """The angle of the second marker about the ``axis`` (3,) of the first, zero as it is at the start, follows
    ``motion`` (rad).

    One row: add a joint that keeps the axis.
    """

    motion: Motion = field(kw_only=True)
    count = 1
    periodic = True

    def rows(self, a: MarkerState, b: MarkerState) -> Rows:
        angle, gradient = turn_angle(a, b, self.on_a, self.on_b)
        G = np.zeros((1, 6))
        G[0, 3:] = gradient
        return np.array([angle]), -G, G

    def bend(self, a: MarkerState, b: MarkerState, multipliers: Floats) -> Floats:
        return float(multipliers[0]) * bend_turn(a, b, self.on_a, self.on_b)


@checked
@dataclass(frozen=True, eq=False)
class DrivenPosition(_Aligned):
    """The distance of the second marker from the first along the ``axis`` (3,) of the first follows ``motion`` (m)."""

    motion: Motion = field(kw_only=True)
    count = 1

    def rows(self, a: MarkerState, b: MarkerState) -> Rows:
        return _along(a, b, self.on_a[:, 2:])

    def bend(self, a: MarkerState, b: MarkerState, multipliers: Floats) -> Floats:
        return _bend_along(a, b, self.on_a[:, 2:], multipliers)
