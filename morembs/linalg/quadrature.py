"""Integrals over a band of frequencies: nodes and weights for what is smooth, for resonances, and for given samples."""

from __future__ import annotations

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Complexes, Floats
from morembs.linalg.tolerances import TOL


def gauss(low: float, high: float, points: int) -> tuple[Floats, Floats]:
    """``points`` Gauss-Legendre nodes and weights from ``low`` to ``high``: for an integrand without poles nearby."""
    x, w = np.polynomial.legendre.leggauss(points)
    half = 0.5 * (high - low)
    return 0.5 * (low + high) + half * x, half * w


def resonant(low: float, high: float, poles: Complexes) -> tuple[Floats, Floats]:
    """Nodes and weights (n,) from ``low`` to ``high`` that resolve every resonance.

    A resonance omega_k with half width d_k = zeta_k omega_k is the pole omega_k + i d_k; ``poles`` (k,) may lie
    outside the band. The band is cut halfway between resonances; omega = b + a sinh t in each piece, with b the
    resonance and a its half width, makes the integrand smooth in t, where Gauss' rule converges geometrically.

    Raises:
        InputError: an empty band, or a pole on it, where the integral does not exist.
    """
    if not low < high:
        raise InputError(f"a band from {low} to {high} was given; expected the lower end first", keyword="band_hz")
    order = np.lexsort((np.abs(poles.imag), poles.real))
    at, width = poles.real[order], np.abs(poles.imag[order])
    if ((at >= low) & (at <= high) & (width == 0)).any():
        raise InputError(
            "a pole lies on the band; give it damping, or integrate along a shifted line",
            kind="model",
            keyword="damping",
        )
    if not len(at):
        return gauss(low, high, TOL.first_points)
    first = np.append(True, np.diff(at) > 0)
    at, width = at[first], width[first]
    # Far from its pole the map is a logarithm, also where there is no damping.
    width = np.maximum(width, TOL.least_pole_width * np.maximum(low - at, at - high))
    edges = np.concatenate([[low], np.clip(0.5 * (at[1:] + at[:-1]), low, high), [high]])
    nodes: list[Floats] = []
    weights: list[Floats] = []
    for b, a, start, end in zip(at, width, edges[:-1], edges[1:], strict=True):
        if start < end:
            t0, t1 = np.arcsinh((start - b) / a), np.arcsinh((end - b) / a)
            t, w = gauss(t0, t1, int(np.ceil(TOL.points_per_asinh * (t1 - t0))) + TOL.first_points)
            nodes.append(b + a * np.sinh(t))
            weights.append(w * a * np.cosh(t))
    return np.concatenate(nodes), np.concatenate(weights)


def trapezoid(x: Floats) -> Floats:
    """Weights (n,) of the samples at ``x`` (n,), ascending."""
    half = 0.5 * np.diff(x)
    return np.asarray(np.append(half, 0.0) + np.append(0.0, half))


def modal_poles(values: Floats, damping: Floats) -> Complexes:
    """Poles omega + i width (k,) of 1 / (values + s damping + s^2) in s = i omega; of two overdamped ones the slow."""
    half = 0.5 * damping
    inside = values - half**2
    # The slow one of two real roots, free of cancellation.
    fast = half + np.sqrt(np.maximum(-inside, 0.0))
    width = np.where(inside >= 0, half, values / np.where(fast > 0, fast, 1.0))
    return np.asarray(np.sqrt(np.maximum(inside, 0.0)) + 1j * width)
