"""Transfer functions as sums over poles, whose values between samples are known to lie within limits.

X(w) = sum_p N_p / ((w - z_p1) (w - z_p2)) on the axis of frequencies w, in rad/s; a pole of a first-order form has one
root only. On a cell [m - h, m + h] X is interpolated at the d + 1 Chebyshev points. For any rho > 1 whose Bernstein
ellipse holds no pole

    |X - p| <= 4 rho^-d / (rho - 1) sum_p |N_p| / inf_ellipse |(w - z_p1) (w - z_p2)|

(Trefethen 2013, theorem 8.2): the sum of sizes, which sees no cancellation, counts with rho^-d. In w = m + h cos t the
interpolant is a trigonometric polynomial of degree d. Between the points of a grid in t of step delta it lies within
d^2 delta^2 / 8 max |p - p_mid| of the chord (Bernstein), and max |q| <= max_grid |q| / cos(d delta / 2) for such a
polynomial q (Ehlich and Zeller 1964).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from morembs.base.types import Complexes, Floats
from morembs.responses.tolerances import TOL

TINY = np.finfo(float).tiny
# Bernstein ellipses that are tried.
RHO = np.array([2.5, 3.0, 4.0, 6.0, 9.0, 14.0, 22.0, 40.0])


def _interpolation() -> Floats:
    """(segments + 1, degree + 1) values of the interpolant on the grid, from those at the Chebyshev points."""
    d = TOL.degree
    j, k = np.arange(d + 1), np.arange(d + 1)
    ends = np.where((j == 0) | (j == d), 0.5, 1.0)
    coefficients = 2.0 / d * ends[:, None] * np.cos(np.pi * np.outer(k, j) / d) * ends
    return np.asarray(np.cos(np.outer(GRID, k)) @ coefficients)


GRID = np.pi * np.arange(TOL.segments + 1) / TOL.segments
POINTS = np.cos(np.pi * np.arange(TOL.degree + 1) / TOL.degree)
INTERPOLATION = _interpolation()


@dataclass(frozen=True, kw_only=True, eq=False)
class PoleResidueForm:
    """sum_p N_p / ((w - z_p1) (w - z_p2)): roots ``z`` (P, 2), or (P, 1) where there is but one, ``N`` (P, e) entries
    of the residues."""

    z: Complexes
    N: NDArray[Any]

    @classmethod
    def second_order(cls, s: NDArray[Any], d: NDArray[Any], N: NDArray[Any]) -> Self:
        """sum_p N_p / (s_p + i w d_p - w^2)."""
        s, d = np.asarray(s, dtype=complex), np.asarray(d, dtype=complex)
        # The roots of w^2 - i w d_p - s_p.
        root = np.sqrt(s - 0.25 * d * d)
        half = 0.5j * d
        # The larger one first: the other one follows without cancellation.
        first = np.where(np.abs(half + root) >= np.abs(half - root), half + root, half - root)
        return cls(z=np.stack([first, -s / first], axis=1), N=-N)

    @classmethod
    def first_order(cls, mu: Complexes, N: NDArray[Any]) -> Self:
        """sum_p N_p / (i w - mu_p)."""
        return cls(z=-1j * mu[:, None], N=-1j * N)

    def inverse(self, w: Floats) -> Complexes:
        """(..., P) of 1 / ((w - z1) (w - z2)) at ``w`` (...)."""
        return np.asarray(1.0 / reduce(np.multiply, [w[..., None] - z for z in self.z.T]))

    def at(self, w: Floats) -> Complexes:
        """(..., e) at ``w`` (...) in rad/s."""
        return product(self.inverse(w), self.N)

    def moduli(self, w: Floats) -> tuple[Floats, Floats]:
        """(..., P) of 1 / |(w - z1) (w - z2)| at ``w`` (...), and the distance (...) of the nearest root."""
        away = [(w[..., None] - z.real) ** 2 + z.imag**2 for z in self.z.T]
        near = np.sqrt(reduce(np.minimum, [squared.min(axis=-1, initial=np.inf) for squared in away]))
        return 1.0 / np.sqrt(np.maximum(reduce(np.multiply, away), TINY)), near

    def nearest(self, middle: Floats) -> Floats:
        """(nc,) distance of the nearest root from ``middle`` (nc,)."""
        return np.asarray(np.abs(middle[:, None] - self.z.ravel()).min(axis=1, initial=np.inf))

    def remainder(self, middle: Floats, half: Floats, norms: Floats, slope: Floats | None = None) -> Floats:
        """(nc, q) bounds of |X - p| on cells, for the norms ``norms`` (P, q) of the residues.

        With ``slope`` (P,) they are multiplied with numerators of at most |w|^2 + |w| slope_p.
        """
        along = [np.abs(middle[:, None] - z.real) for z in self.z.T]
        across = np.abs(self.z.imag.T)
        distances = [np.hypot(along_axis, across_axis) for along_axis, across_axis in zip(along, across, strict=True)]
        bounds = np.full((len(middle), norms.shape[1]), np.inf)
        for rho in RHO:
            A, B = (half[:, None] * (rho + sign / rho) / 2 for sign in (1.0, -1.0))
            least = [
                np.maximum(np.maximum(across_axis - B, along_axis - A), length - A)
                for along_axis, across_axis, length in zip(along, across, distances, strict=True)
            ]
            free = reduce(np.minimum, least).min(axis=1, initial=np.inf) > 0
            inverse = 1.0 / reduce(np.multiply, [np.where(free[:, None], distance, 1.0) for distance in least])
            if slope is not None:
                far = np.abs(middle) + half * (rho + 1 / rho) / 2
                inverse = inverse * (far[:, None] ** 2 + far[:, None] * slope)
            bound = 4 * rho**-TOL.degree / (rho - 1) * (inverse @ norms)
            bounds = np.where(free[:, None], np.minimum(bounds, bound), bounds)
        return bounds


def product(a: NDArray[Any], N: NDArray[Any]) -> NDArray[Any]:
    """a N, in real arithmetic where one of them is real."""
    if np.iscomplexobj(N) == np.iscomplexobj(a):
        return np.asarray(a @ N)
    if np.iscomplexobj(N):
        return np.asarray(a @ N.real + 1j * (a @ N.imag))
    return np.asarray(a.real @ N + 1j * (a.imag @ N))


def cell_points(low: Floats, high: Floats, cosines: Floats) -> Floats:
    """(nc, n) points of the cells at ``cosines`` (n,)."""
    return np.asarray(0.5 * (low + high)[:, None] + 0.5 * (high - low)[:, None] * cosines)


def on_grid(values: Complexes) -> Complexes:
    """(nc, segments + 1, e) of the interpolants with ``values`` (nc, degree + 1, e) at the Chebyshev points."""
    parts = np.ascontiguousarray(values).view(np.float64)
    return np.asarray((INTERPOLATION @ parts).view(np.complex128))


def squares(X: Complexes) -> Floats:
    """Squares of the absolute values."""
    return np.asarray(X.real**2 + X.imag**2)
