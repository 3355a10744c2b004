"""Reduced pencils with motions that have no mass, split exactly into motions with mass and static compliance.

With M Z = 0, Z' K Z = 1 and Z' K P = 0 the coordinates q = P x + Z y have the equations P'MP x'' + P'KP x = P'f and
y = Z'f: M = [M_xx 0; 0 0] after a congruence, and nothing of x is in y. Forces reach y at once (Guyan 1965, where it is
exact). Nothing here needs SciPy, which readers of body files do without.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.linalg.dense import symmetric
from morembs.linalg.tolerances import TOL

# What users of a body with such motions can do.
CURE = (
    "take --time-step, which makes static compliance of them (statespace, fmu, c, exudyn, mujoco), give their dofs "
    "mass, or leave these out of the interface (components = [...])"
)


@dataclass(frozen=True, kw_only=True, eq=False)
class MassSplit:
    """Motions ``P`` (n, n - m) with mass and ``Z`` (n, m) without, M Z = 0, Z' K P = 0 and Z' K Z = 1."""

    P: Floats
    Z: Floats

    def time_constants(self, D: Floats) -> Floats:
        """(m,) in s, ascending: by the damping ``D`` (n, n) the motions without mass follow loads as exp(-t / T)."""
        return np.asarray(np.linalg.eigvalsh(symmetric(self.Z.T @ D @ self.Z)))

    def with_mass(self, K: Floats, M: Floats, omega: float | None = None) -> Floats:
        """``M`` (n, n) and the mass with which each motion without one vibrates at ``omega`` in rad/s, by default above
        all others.

        The other modes of (K, M) stay as they are to the last digit, as Z' K P = 0.
        """
        KZ = K @ self.Z / (self.above(K, M) if omega is None else omega)
        return symmetric(M + KZ @ KZ.T)

    def above(self, K: Floats, M: Floats) -> float:
        """A frequency in rad/s above those of the motions with mass, as far as double precision holds the slow ones."""
        mass, stiffness = (np.einsum("ij,ij->j", self.P, A @ self.P) for A in (M, K))
        return TOL.far_above * float(np.sqrt((stiffness / mass).max(initial=0.0))) or 1.0


def split_massless(K: Floats, M: Floats) -> MassSplit | None:
    """The motions of ``K`` and ``M`` (n, n) that have no mass; None where each has some, or ``M`` is indefinite.

    These are coordinates whose entry of the diagonal is zero, and of the others, scaled to one, eigenvectors with
    eigenvalues up to n eps, the round-off of M.

    Args:
        K: symmetric, at least semidefinite.
        M: likewise.

    Raises:
        InputError: a motion that has neither mass nor stiffness.

    >>> split_massless(np.array([[3.0, -1.0], [-1.0, 1.0]]), np.diag([2.0, 0.0])).Z.T
    array([[0., 1.]])
    """
    n, mass = len(M), np.abs(np.diag(M))
    roundoff, heavy = n * float(np.finfo(float).eps), np.flatnonzero(mass)
    scale = 1.0 / np.sqrt(mass[heavy])
    S = symmetric(M[np.ix_(heavy, heavy)] * np.outer(scale, scale))
    if len(heavy) == n and _is_definite(S, roundoff):
        return None
    values, U = np.linalg.eigh(S)
    if values.min(initial=0.0) < -TOL.negative_mass:
        return None
    none = values <= roundoff
    light = np.setdiff1d(np.arange(n), heavy)
    Z, Q = np.zeros((n, len(light) + int(none.sum()))), np.zeros((n, int((~none).sum())))
    Z[light, np.arange(len(light))] = 1.0
    Z[heavy, len(light) :] = scale[:, None] * U[:, none]
    Q[heavy] = scale[:, None] * U[:, ~none]
    Z = _of_unit_stiffness(K, Z)
    # Twice, as Gram and Schmidt would.
    for _ in range(2):
        Q = Q - Z @ (Z.T @ (K @ Q))
    return MassSplit(P=Q, Z=Z)


def _is_definite(S: Floats, shift: float) -> bool:
    try:
        np.linalg.cholesky(S - shift * np.eye(len(S)))
    except np.linalg.LinAlgError:
        return False
    return True


def _of_unit_stiffness(K: Floats, Z: Floats) -> Floats:
    """Columns with the span of ``Z`` (n, m) and Z' K Z = 1.

    Raises:
        InputError: one that has no stiffness.
    """
    A = symmetric(Z.T @ K @ Z)
    d = np.sqrt(np.maximum(np.diag(A), 0.0))
    sound = bool((d > 0).all())
    values, U = np.linalg.eigh(A / np.outer(d, d)) if sound else (np.zeros(1), A)
    if not values[0] > TOL.loose_motion:
        raise InputError(
            f"{Z.shape[1]} motions of a reduced body have no mass, and one of them no stiffness either, so that any "
            "load moves it without end; connect its dofs, or leave them out",
            kind="model",
            keyword="mass",
        )
    return np.asarray((Z / d) @ U / np.sqrt(values))
