"""What a reduced planar member needs online: tables over its end angles, fields, modes. A body file holds the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from morembs.base.types import Floats
from morembs.dynamics.gmp.chebyshev import ChebyshevTable
from morembs.dynamics.gmp.fields import Fields

Formulation = Literal["linear", "foreshortened", "membrane", "tangent"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Parameterised:
    """Tables of one member; see morembs.dynamics.gmp.shapes for what they mean.

    ``count`` m bending modes are in use, the last of ``squares`` (m + e,) only tell what more would have answered.

    ``table``: at t the numbers [X (p), A (p), d0, k, c (m + e), H (m m)], X and A as amplitudes of ``fields``;
    ``energy``: W. ``Psi`` (p, m + e) amplitudes of the modes, ``peaks`` (m + e,) their largest deflection,
    ``squares`` angular frequencies squared, ``H0`` (m + e,) diagonal of H at the straight shape;
    ``excluded`` (x,) squares of modes of stretching that were left out;
    ``errors`` (2,) of the derivatives of the tables against constraint modes and reactions, 0 without a manifold.
    """

    formulation: Formulation
    reach: float
    length: float
    count: int
    table: ChebyshevTable
    energy: ChebyshevTable
    fields: Fields
    Psi: Floats
    peaks: Floats
    squares: Floats
    H0: Floats
    excluded: Floats
    errors: Floats

    def at(self, t: Floats) -> tuple[Floats, Floats, tuple[Floats, Floats, Floats]]:
        """Numbers (s,) of the table and their derivatives (2, s); W with its first two derivatives."""
        c, other = len(self.table.coefficients), len(self.energy.coefficients)
        if np.abs(t).max() > self.reach or c != other:
            return *self.table.at(t)[:2], self.energy.at(t)
        # Both at once, and no derivative that is not used.
        basis = self.table.basis(t)
        d = self.table.tensor(basis[:, :2])
        w = basis[0, :3] @ self.energy.coefficients @ basis[1, :3].T
        first = np.array([d[1, 0], d[0, 1]])
        return (
            d[0, 0],
            first,
            (w[0, 0], np.array([w[1, 0], w[0, 1]]), np.array([[w[2, 0], w[1, 1]], [w[1, 1], w[0, 2]]])),
        )

    def parts(self, numbers: Floats) -> tuple[Floats, ...]:
        """X, A, d0, k, c, H from the last axis of ``numbers`` (..., s)."""
        p, m, cut = self.fields.size, self.count, 2 * self.fields.size
        H = numbers[..., cut + 2 + len(self.squares) :]
        return (
            numbers[..., :p],
            numbers[..., p:cut],
            numbers[..., cut],
            numbers[..., cut + 1],
            numbers[..., cut + 2 : cut + 2 + len(self.squares)],
            H.reshape(*H.shape[:-1], m, m),
        )
