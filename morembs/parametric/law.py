"""Coefficients of affine terms: products of functions of single parameters, with exact derivatives. NumPy only."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import comb

import numpy as np

from morembs.base.types import Floats, Ints

# Factors of a law: one, p, p squared; from LAGRANGE on the polynomials that are one at one of the points of p.
ONE, LINEAR, SQUARE, LAGRANGE = range(4)


def chebyshev_points(low: float, high: float, count: int) -> Floats:
    """The ``count`` extrema of a Chebyshev polynomial on [low, high], ascending; the ends belong to them."""
    z = np.sin(np.pi * (2 * np.arange(count) - (count - 1)) / (2 * (count - 1)))
    return np.asarray(0.5 * (low + high) + 0.5 * (high - low) * z)


def chebyshev_roots(low: float, high: float, count: int) -> Floats:
    """The ``count`` roots of a Chebyshev polynomial on [low, high], ascending, where interpolation is most even."""
    z = np.sin(np.pi * (2 * np.arange(count) - (count - 1)) / (2 * count))
    return np.asarray(0.5 * (low + high) + 0.5 * (high - low) * z)


def lagrange(points: Floats, t: Floats) -> tuple[Floats, Floats]:
    """The polynomials (..., S) that are one at one of the ``points`` (S,) and zero at the others, and their
    derivatives (..., S).

    Barycentric form (Berrut and Trefethen 2004).
    """
    t = np.asarray(t, dtype=float)
    gaps = points[:, None] - points
    np.fill_diagonal(gaps, 1.0)
    # Scaled by their mean, so that products of many neither vanish nor overflow.
    weights = 1.0 / np.prod(gaps / np.exp(np.log(np.abs(gaps)).mean()), axis=1)
    away = t[..., None] - points
    hit = away == 0
    terms = weights / np.where(hit, 1.0, away)
    values = terms / terms.sum(axis=-1, keepdims=True)
    values = np.where(hit.any(axis=-1, keepdims=True), hit.astype(float), values)
    # Derivative of each polynomial at all points, which the polynomials themselves interpolate.
    slopes = (weights / weights[:, None]) / gaps
    np.fill_diagonal(slopes, 0.0)
    np.fill_diagonal(slopes, -slopes.sum(axis=1))
    return np.asarray(values), np.asarray(values @ slopes)


def bernstein(points: Floats, low: float, high: float) -> Floats:
    """Matrix (S, S) from values at ``points`` (S,) of a polynomial of degree S - 1 to its Bernstein coefficients on
    [low, high], between the least and the largest of which all of its values there lie.
    """
    degree = len(points) - 1
    x = 0.5 - 0.5 * np.cos(np.pi * np.arange(degree + 1) / max(degree, 1))
    polynomials = np.array([comb(degree, k) * x**k * (1 - x) ** (degree - k) for k in range(degree + 1)]).T
    return np.asarray(np.linalg.solve(polynomials, lagrange(points, low + (high - low) * x)[0]))


@dataclass(frozen=True, kw_only=True, eq=False)
class Law:
    """theta_q(p) = prod_j f_qj(p_j) of Q terms and P parameters.

    ``factors`` (Q, P): 0 for one, 1 for p, 2 for its square, 3 + k for the Lagrange polynomial of point k; ``points``
    are those of each parameter, none where it enters by positive factors only; with points the law is a polynomial in
    it, known by its values there.
    """

    factors: Ints
    points: tuple[Floats, ...]

    def __call__(self, p: Floats) -> Floats:
        """Coefficients (..., Q) at ``p`` (..., P)."""
        return np.asarray(np.prod(self._tables(p)[0], axis=-2))

    def derivative(self, p: Floats) -> Floats:
        """Derivatives (..., Q, P) of the coefficients at ``p`` (..., P)."""
        values, slopes = self._tables(p)
        result = np.empty((*values.shape[:-2], values.shape[-1], values.shape[-2]))
        for j in range(values.shape[-2]):
            others = np.prod(np.delete(values, j, axis=-2), axis=-2)
            result[..., j] = slopes[..., j, :] * others
        return result

    @cached_property
    def monotone(self) -> Law:
        """The factors of parameters without points alone: positive ones, of moduli, densities and springs."""
        pointed = [len(points) > 0 for points in self.points]
        return Law(factors=np.where(pointed, ONE, self.factors), points=self.points)

    def _tables(self, p: Floats) -> tuple[Floats, Floats]:
        """Factors (..., P, Q) and their derivatives."""
        p = np.asarray(p, dtype=float)
        values: list[Floats] = []
        slopes: list[Floats] = []
        for j, points in enumerate(self.points):
            x = p[..., j]
            one, zero = np.ones_like(x), np.zeros_like(x)
            plain = np.stack([one, x, x * x], axis=-1), np.stack([zero, one, 2 * x], axis=-1)
            tables = lagrange(points, x) if len(points) else (np.zeros((*x.shape, 0)),) * 2
            for table, first, more in zip((values, slopes), plain, tables, strict=True):
                table.append(np.concatenate([first, more], axis=-1)[..., self.factors[:, j]])
        return np.stack(values, axis=-2), np.stack(slopes, axis=-2)
