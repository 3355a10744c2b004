"""What a reduced planar member needs online: tables over its end angles, fields, modes. A body file holds the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from morembs.base.types import Floats
from morembs.dynamics.gmp.chebyshev import ChebyshevTable
from morembs.dynamics.gmp.fields import Fields
from morembs.storage.table import dataset, table_of

Formulation = Literal["linear", "foreshortened", "membrane", "tangent"]
FORMULATIONS: tuple[str, ...] = get_args(Formulation)
_COEFFICIENTS = "coefficients of Chebyshev polynomials: "


@dataclass(frozen=True, kw_only=True, eq=False)
class Parameterised:
    """Tables of one member; morembs.dynamics.gmp.shapes has their meaning.

    ``count`` m bending modes are in use, the last of ``squares`` (m + e,) only tell what more would have answered.

    ``table``: at t the numbers [X (p), A (p), d0, k, c (m + e), H (m m)], X and A as amplitudes of ``fields``;
    ``energy``: W. ``Psi`` (p, m + e) amplitudes of the modes, ``peaks`` (m + e,) their largest deflection,
    ``squares`` angular frequencies squared, ``H0`` (m + e,) diagonal of H at the straight shape;
    ``excluded`` (x,) squares of modes of stretching that were left out;
    ``errors`` (2,) of the derivatives of the tables against constraint modes and reactions, 0 without a manifold.
    """

    formulation: Formulation = dataset("text", "", f"one of {', '.join(FORMULATIONS)}", known=FORMULATIONS)
    reach: float = dataset(
        "real", "", "largest angle t1, t2 of an end to the chord; beyond it the tables are no more than extended", "rad"
    )
    length: float = dataset("real", "", "distance of the frames without load", "m")
    count: int = dataset(
        "whole", "", "bending modes in use; the others estimate the response that is left out", largest="k"
    )
    fields: Fields = dataset(table_of(Fields), inline=True)
    Psi: Floats = dataset("real", "p k", "amplitudes of the bending modes, Psi' M Psi = 1")
    peaks: Floats = dataset("real", "k", "largest deflection of each mode")
    squares: Floats = dataset("real", "k", "their angular frequencies squared", "1/s2")
    H0: Floats = dataset("real", "k", "diagonal of H at the straight shape")
    excluded: Floats = dataset(
        "real", "any", "angular frequencies squared of modes of stretching that were left out", "1/s2"
    )
    errors: Floats = dataset("real", "2", "of derivatives of the tables: against constraint modes, against reactions")
    table: ChebyshevTable = dataset(
        "real",
        "c c s",
        f"{_COEFFICIENTS}[i, j] times T_i(t1 / reach) T_j(t2 / reach): X, A, d0, k, c, H in a row",
        write=lambda data: data.table.coefficients,
    )
    energy: ChebyshevTable = dataset(
        "real", "ce ce", f"{_COEFFICIENTS}the same for W, in J", write=lambda data: data.energy.coefficients
    )

    def outline(self) -> dict[str, Any]:
        """Its size, range and error as plain values, SI units."""
        return {
            "formulation": self.formulation,
            "modes": self.count,
            "coordinates": 6 + self.count,
            "length": self.length,
            "reach": self.reach,
            "points": len(self.table.coefficients),
            "error": float(self.errors.max()),
        }

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
