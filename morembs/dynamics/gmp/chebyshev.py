"""Tables of functions of two parameters: tensor products of Chebyshev polynomials, with analytic derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial.chebyshev import chebder

from morembs.base.errors import InputError
from morembs.base.types import Floats


def points(reach: float, count: int) -> Floats:
    """The ``count`` extrema of a Chebyshev polynomial on [-reach, reach], in rising order; the ends belong to them.

    Args:
        reach: half the length of the interval.
        count: number of extrema.
    """
    if count < 2 or not (np.isfinite(reach) and reach > 0):
        raise InputError(f"a table of {count} points on +-{reach} was given; expected two or more on a positive range")
    return np.asarray(reach * np.sin(np.pi * (2 * np.arange(count) - (count - 1)) / (2 * (count - 1))))


@lru_cache
def _derivatives(count: int) -> Floats:
    """(4, count, count): T_0 to T_(count-1) and their first three derivatives as sums of the same polynomials."""
    tables, now = [np.eye(count)], np.eye(count)
    for _ in range(3):
        lower = chebder(now, axis=1) if now.any() else np.zeros((count, 1))
        now = np.zeros((count, count))
        now[:, : lower.shape[1]] = lower[:, :count]
        tables.append(now)
    polynomials = np.array(tables)
    polynomials.flags.writeable = False
    return polynomials


def _basis(z: Floats, count: int) -> Floats:
    """T_0 to T_(count-1) with their first three derivatives at all z (n,) in [-1, 1], (n, 4, count)."""
    T = np.cos(np.arccos(z)[:, None] * np.arange(count))
    return np.asarray(np.matmul(_derivatives(count), T[:, None, :, None])[..., 0])


@dataclass(frozen=True, kw_only=True, eq=False)
class ChebyshevTable:
    """Polynomial in two parameters through samples at the tensor grid of ``points(reach, count)``.

    ``coefficients`` (count, count, ...). Outside of the range the table goes on as its Taylor polynomial of the
    nearest point, of first order, or of second where ``curved`` (an energy keeps its curvature).
    """

    reach: float
    coefficients: Floats
    curved: bool = False

    @classmethod
    def through(cls, reach: float, samples: Floats, *, curved: bool = False) -> ChebyshevTable:
        """From ``samples`` (count, count, ...) on the grid."""
        count = samples.shape[0]
        z = points(1.0, count)
        A = np.linalg.inv(_basis(z, count)[:, 0])
        coefficients = np.einsum("ia,jb,ab...->ij...", A, A, samples)
        return cls(reach=reach, coefficients=coefficients, curved=curved)

    def basis(self, t: Floats) -> Floats:
        """Polynomials in both parameters with their first three derivatives, (2, 4, count); t (2,) in the range."""
        z = np.minimum(1.0, np.maximum(-1.0, t / self.reach))
        return np.asarray(_basis(z, len(self.coefficients)) * (1 / self.reach) ** np.arange(4.0)[:, None])

    def tensor(self, basis: Floats) -> Floats:
        """[i, j]: derivative (s,) of order i in the first and of order j in the second parameter."""
        count, orders = len(self.coefficients), basis.shape[1]
        rows = (basis[0] @ self.coefficients.reshape(count, -1)).reshape(orders, count, -1)
        return np.asarray(np.matmul(basis[1], rows))

    def at(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Value (...), first (2, ...) and second derivative (2, 2, ...) at t (2,)."""
        inside = np.clip(t, -self.reach, self.reach)
        shape, d = self.coefficients.shape[2:], self.tensor(self.basis(inside))
        value, first = d[0, 0], np.stack((d[1, 0], d[0, 1]))
        second = np.stack((d[2, 0], d[1, 1], d[1, 1], d[0, 2])).reshape(2, 2, -1)
        out = t - inside
        if out.any():
            value = value + out @ first
            # Along the edge of the table the continuation changes as the table does, so that derivatives are exact.
            edge = (out == 0)[:, None]
            if self.curved:
                value = value + 0.5 * np.einsum("i,ijk,j->k", out, second, out)
                third = np.stack((d[1, 2] * out[1] ** 2, d[2, 1] * out[0] ** 2))
                first = first + np.einsum("ijk,j->ik", second, out) + 0.5 * edge * third
            else:
                first = first + edge * np.einsum("ijk,j->ik", second, out)
        return value.reshape(shape), first.reshape(2, *shape), second.reshape(2, 2, *shape)
