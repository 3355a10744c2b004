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
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
DEGREE, SEGMENTS = 10, 60
# Bernstein ellipses that are tried.
RHO = np.array([2.5, 3.0, 4.0, 6.0, 9.0, 14.0, 22.0, 40.0])


def _interpolation() -> Floats:
    """(SEGMENTS + 1, DEGREE + 1) values of the interpolant on the grid, from those at the Chebyshev points."""
    d = DEGREE
    j, k = np.arange(d + 1), np.arange(d + 1)
    ends = np.where((j == 0) | (j == d), 0.5, 1.0)
    coefficients = 2.0 / d * ends[:, None] * np.cos(np.pi * np.outer(k, j) / d) * ends
    return np.asarray(np.cos(np.outer(GRID, k)) @ coefficients)


GRID = np.pi * np.arange(SEGMENTS + 1) / SEGMENTS
POINTS = np.cos(np.pi * np.arange(DEGREE + 1) / DEGREE)
INTERPOLATION = _interpolation()
# Part of max_grid |p - p_mid| by which p leaves its chords at most.
BULGE = (DEGREE * np.pi / SEGMENTS) ** 2 / 8 / np.cos(DEGREE * np.pi / SEGMENTS / 2)


@dataclass(frozen=True, kw_only=True, eq=False)
class Terms:
    """sum_p N_p / ((w - z_p1) (w - z_p2)): roots ``z`` (P, 2), infinite where there is only one, ``N`` (P, e) entries
    of the residues, ``unsure`` (P,) how far the product of the roots may be off."""

    z: Complexes
    N: NDArray[Any]
    unsure: Floats

    @classmethod
    def second_order(cls, s: NDArray[Any], d: NDArray[Any], N: NDArray[Any], unsure: Floats) -> Self:
        """sum_p N_p / (s_p + i w d_p - w^2)."""
        s, d = np.asarray(s, dtype=complex), np.asarray(d, dtype=complex)
        root = np.sqrt(s - 0.25 * d * d)
        half = 0.5j * d
        # The larger one first: the other one follows without cancellation.
        first = np.where(np.abs(half + root) >= np.abs(half - root), half + root, half - root)
        return cls(z=np.stack([first, -s / first], axis=1), N=-N, unsure=unsure)

    @classmethod
    def first_order(cls, mu: Complexes, N: NDArray[Any], unsure: Floats) -> Self:
        """sum_p N_p / (i w - mu_p)."""
        z = np.stack([-1j * mu, np.full(len(mu), np.inf)], axis=1)
        return cls(z=z, N=-1j * N, unsure=unsure)

    def minus(self, other: Terms) -> Terms:
        """This function less ``other``."""
        return Terms(
            z=np.vstack([self.z, other.z]), N=np.vstack([self.N, -other.N]),
            unsure=np.concatenate([self.unsure, other.unsure]),
        )  # fmt: skip

    def inverse(self, w: Floats) -> Complexes:
        """(..., P) of 1 / ((w - z1) (w - z2)) at ``w`` (...)."""
        one = w[..., None] - self.z[:, 0]
        single = np.isinf(self.z[:, 1])
        if single.all():
            return np.asarray(1.0 / one)
        return np.asarray(1.0 / (one * np.where(single, 1.0, w[..., None] - np.where(single, 0.0, self.z[:, 1]))))

    def at(self, w: Floats) -> Complexes:
        """(..., e) at ``w`` (...) in rad/s."""
        return product(self.inverse(w), self.N)

    def distances(self, w: Floats) -> Floats:
        """(..., P, 2) distances of ``w`` (...) from the roots, one from those that are not there."""
        away = np.abs(w[..., None, None] - np.where(np.isinf(self.z), 0.0, self.z))
        away[..., np.isinf(self.z)] = 1.0
        return np.asarray(away)

    def nearest(self, middle: Floats) -> Floats:
        """(nc,) distance of the nearest root from ``middle`` (nc,)."""
        known = self.z[np.isfinite(self.z)]
        return np.asarray(np.abs(middle[:, None] - known).min(axis=1, initial=np.inf))

    def remainder(self, middle: Floats, half: Floats, sizes: Floats, slope: Floats | None = None) -> Floats:
        """(nc, q) bounds of |X - p| on cells, for the norms ``sizes`` (P, q) of the residues.

        With ``slope`` (P,) they are multiplied with numerators of at most |w|^2 + |w| slope_p.
        """
        reach = np.abs(middle[:, None] - np.where(np.isinf(self.z), 0.0, self.z).ravel()).reshape(len(middle), -1, 2)
        along = np.abs(middle[:, None, None] - self.z.real)
        across = np.abs(self.z.imag)
        found = np.full((len(middle), sizes.shape[1]), np.inf)
        for rho in RHO:
            A, B = (half[:, None, None] * (rho + sign / rho) / 2 for sign in (1.0, -1.0))
            least = np.maximum(np.maximum(across - B, along - A), reach - A)
            least[:, np.isinf(self.z)] = 1.0
            free = (least > 0).all(axis=(1, 2))
            inverse = 1.0 / np.where(free[:, None, None], least, 1.0).prod(axis=2)
            if slope is not None:
                far = np.abs(middle) + half * (rho + 1 / rho) / 2
                inverse = inverse * (far[:, None] ** 2 + far[:, None] * slope)
            bound = 4 * rho**-DEGREE / (rho - 1) * (inverse @ sizes)
            found = np.where(free[:, None], np.minimum(found, bound), found)
        return found


def product(a: Complexes, N: NDArray[Any]) -> Complexes:
    """a N, in real arithmetic where N is real."""
    if np.iscomplexobj(N):
        return np.asarray(a @ N)
    return np.asarray(a.real @ N + 1j * (a.imag @ N))


def cell_points(low: Floats, high: Floats, cosines: Floats) -> Floats:
    """(nc, n) points of the cells at ``cosines`` (n,)."""
    return np.asarray(0.5 * (low + high)[:, None] + 0.5 * (high - low)[:, None] * cosines)


def on_grid(values: Complexes) -> Complexes:
    """(nc, SEGMENTS + 1, e) of the interpolants with ``values`` (nc, DEGREE + 1, e) at the Chebyshev points."""
    parts = np.ascontiguousarray(values).view(np.float64)
    return np.asarray((INTERPOLATION @ parts).view(np.complex128))


def squares(X: Complexes) -> Floats:
    """Squares of the absolute values."""
    return np.asarray(X.real**2 + X.imag**2)
