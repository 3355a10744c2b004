"""Many rotation vectors p (n, 3) at once, as coordinates: first and second derivatives of the rotation they give.

exp(p + d) = exp(p) exp(T(p) d + ...) with the tangent operator T of morembs.dynamics.multibody.rotations. The second
derivative of the argument along d is D T(p)[d] d, since the exponential itself has none at zero.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from scipy.special import zeta

from morembs.base.types import Floats
from morembs.dynamics.nonlinear.tolerances import TOL
from morembs.fem import skew

_EYE = np.eye(3)
_FACTORIALS = [float(math.factorial(k)) for k in range(2 * TOL.series_terms + 5)]


def coefficients(square: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """b = (1 - cos p)/p^2 and c = (p - sin p)/p^3 of p^2 (n,), and their derivatives by p^2."""
    s = np.asarray(square, dtype=float)
    large = np.where(s > TOL.series_square, s, 1.0)
    p = np.sqrt(large)
    a, b, c = np.sin(p) / p, 2 * (np.sin(p / 2) / p) ** 2, (p - np.sin(p)) / (p * large)
    # Sums of (-s)^k / (2k + 2)! and (-s)^k / (2k + 3)!, and their derivatives, by Horner's rule.
    small = np.where(s > TOL.series_square, 0.0, s)
    sums = [np.zeros_like(s) for _ in range(4)]
    for k in range(TOL.series_terms, -1, -1):
        sums[2], sums[3] = sums[0] - small * sums[2], sums[1] - small * sums[3]
        sums[0], sums[1] = 1 / _FACTORIALS[2 * k + 2] - small * sums[0], 1 / _FACTORIALS[2 * k + 3] - small * sums[1]
    far = s > TOL.series_square
    b_s, c_s = (a - 2 * b) / (2 * large), (b - 3 * c) / (2 * large)
    return (
        np.where(far, b, sums[0]),
        np.where(far, c, sums[1]),
        np.where(far, b_s, -sums[2]),
        np.where(far, c_s, -sums[3]),
    )


@cache
def _zetas() -> Floats:
    k = np.arange(1, 41)
    return np.asarray(2 * zeta(2.0 * k) / (2 * np.pi) ** (2 * k))


def inverse_coefficient(square: Floats) -> tuple[Floats, Floats, Floats]:
    """e of T(p)^-1 = 1 + hat(p)/2 + e hat(p)^2, e = (1 - (p/2) cot(p/2))/p^2, and two derivatives by p^2.

    By its power series, whose coefficients are values of the zeta function; to all digits up to p = pi.
    """
    e, e1, e2 = (np.zeros_like(square) for _ in range(3))
    for value in _zetas()[::-1]:
        e2 = e1 * 2 + square * e2
        e1 = e + square * e1
        e = value + square * e
    return e, e1, e2


def rotation_matrices(p: Floats) -> Floats:
    """Rotation matrices exp(p) (n, 3, 3)."""
    b, c, _, _ = coefficients(np.sum(p * p, axis=-1))
    P = skew(p)
    a = 1 - np.sum(p * p, axis=-1) * c
    return np.asarray(_EYE + a[..., None, None] * P + b[..., None, None] * (P @ P))


def tangents(p: Floats) -> Floats:
    """T(p) (n, 3, 3); transposed it gives the spin along the fixed axes."""
    b, c, _, _ = coefficients(np.sum(p * p, axis=-1))
    P = skew(p)
    return np.asarray(_EYE - b[..., None, None] * P + c[..., None, None] * (P @ P))


def curvature(p: Floats, f: Floats, *, fixed: bool = False) -> Floats:
    """Symmetric S (n, 3, 3) with d' S d = f . D T(p)[d] d for every d; of T' instead of T where ``fixed``."""
    _, c, b_s, c_s = (value[..., None] for value in coefficients(np.sum(p * p, axis=-1)))
    sign = -1.0 if fixed else 1.0
    v = -2 * sign * b_s * np.cross(f, p) + 2 * c_s * np.cross(p, np.cross(p, f)) - c * f
    S = v[..., :, None] * p[..., None, :]
    along = (c[..., 0] * np.sum(f * p, axis=-1))[..., None, None]
    return np.asarray(0.5 * (S + np.swapaxes(S, -1, -2)) + along * _EYE)


def shorten_vectors(p: Floats) -> Floats:
    """The same rotations by vectors of at most half a turn."""
    angle = np.linalg.norm(p, axis=-1, keepdims=True)
    turns = np.round(angle / (2 * np.pi))
    return np.asarray(p * (1 - 2 * np.pi * turns / np.where(turns > 0, angle, 1.0)))
