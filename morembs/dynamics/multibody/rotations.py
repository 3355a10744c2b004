"""Rotations as (3, 3) matrices: exponential, logarithm and the tangent operator of SO(3).

A rotation R moves with the angular velocity w along the axes of the body: dR/dt = R hat(w). Then
d/dt exp(p) = exp(p) hat(T(p) dp/dt) with the tangent operator T (Iserles, Munthe-Kaas, Norsett, Zanna 2000).
"""

from __future__ import annotations

import math

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.dynamics.multibody.tolerances import TOL


def hat(a: Floats) -> Floats:
    """Matrix (3, 3) with hat(a) b = a x b."""
    x, y, z = a.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def cross(a: Floats, b: Floats) -> Floats:
    """a x b of two vectors (3,)."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


def _coefficients(square: float) -> tuple[float, float, float]:
    """sin(p)/p, (1 - cos p)/p^2 and (p - sin p)/p^3 from p^2, by series where the quotients lose digits."""
    if square < TOL.series_angle**2:
        return (
            1 - square / 6 * (1 - square / 20),
            0.5 - square / 24 * (1 - square / 30),
            # Series of (p - sin p) / p^3 by p^2, as the two above.
            1 / 6 - square / 120 * (1 - square / 42),
        )
    if not square < math.inf:
        # Of iterations that diverge; what they find is not finite, and is refused there.
        return math.nan, math.nan, math.nan
    p = math.sqrt(square)
    sine = math.sin(p)
    return sine / p, 2 * (math.sin(p / 2) / p) ** 2, (p - sine) / (p * square)


def exponential(p: Floats) -> Floats:
    """Rotation by the angle |p| (rad) about p (3,)."""
    P = hat(p)
    a, b, _ = _coefficients(float(p @ p))
    return np.asarray(np.eye(3) + a * P + b * (P @ P))


def rotation(axis: tuple[float, float, float] | Floats, angle: float) -> Floats:
    """Rotation matrix (3, 3) of ``angle`` (rad) about ``axis`` (3,) of any length but zero.

    Args:
        axis: (3,), of any length but zero.
        angle: in rad.

    Raises:
        InputError: an axis that is no direction.
    """
    direction = np.asarray(axis, dtype=float)
    length = float(np.linalg.norm(direction))
    if direction.shape != (3,) or not 0 < length < np.inf:
        raise InputError(
            f"axis = {axis} of a rotation was given; expected a direction (3,) of any length but zero", keyword="axis"
        )
    return exponential(angle / length * direction)


def tangent(p: Floats) -> Floats:
    """T(p) (3, 3): angular velocity along the moved axes per rate of p; its transpose gives it along the fixed ones."""
    P = hat(p)
    _, b, c = _coefficients(float(p @ p))
    return np.asarray(np.eye(3) - b * P + c * (P @ P))


def tangent_slope(p: Floats, m: Floats) -> Floats:
    """(3, 3): derivative of T(p) m by p."""
    square, P, turned = float(p @ p), hat(p), cross(p, m)
    a, b, c = _coefficients(square)
    if square < TOL.derivative_series_angle**2:
        # Series of (1 - cos p) / p^2 by p^2,
        db = -1 / 24 + square * (1 / 360 - square / 13440)
        # and of (p - sin p) / p^3.
        dc = -1 / 120 + square * (1 / 2520 - square / 120960)
    else:
        db, dc = (a - 2 * b) / (2 * square), (b - 3 * c) / (2 * square)
    along = 2 * np.outer(dc * cross(p, turned) - db * turned, p)
    return np.asarray(along + b * hat(m) - c * (hat(turned) + P @ hat(m)))


def logarithm(R: Floats) -> Floats:
    """Rotation vector p (3,) with exp(p) = R and |p| <= pi."""
    skew = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine, cosine = float(np.linalg.norm(skew)), 0.5 * (float(np.trace(R)) - 1)
    angle = math.atan2(sine, cosine)
    if cosine > TOL.least_cosine:
        return np.asarray(skew / _coefficients(angle**2)[0])
    # Near half a turn the skew part vanishes; the symmetric part still has the axis, the skew part its sign.
    symmetric = 0.5 * (R + R.T) - cosine * np.eye(3)
    column = symmetric[:, int(np.argmax(np.diag(symmetric)))]
    axis = column / np.linalg.norm(column)
    return np.asarray(math.copysign(angle, float(axis @ skew)) * axis)


def orthonormal(R: Floats) -> Floats:
    """One Newton step to the nearest rotation: takes the round-off of many products away."""
    # Newton and Schulz: R (3 - R'R) / 2.
    return np.asarray(1.5 * R - 0.5 * R @ (R.T @ R))


def is_rotation(R: Floats, tolerance: float = TOL.default_rotation_error) -> bool:
    """True if R (3, 3) is orthonormal and right-handed."""
    return bool(R.shape == (3, 3) and np.abs(R.T @ R - np.eye(3)).max() <= tolerance and np.linalg.det(R) > 0)
