"""Spin of a reduced body: one body for all speeds, its whirl and its Campbell diagram."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from morembs.base.arguments import refuse_out_of_range
from morembs.base.errors import InputError
from morembs.base.types import Complexes, Floats
from morembs.body.floating.tolerances import TOL
from morembs.linalg.dense import symmetric
from morembs.storage.table import dataset


@dataclass(frozen=True, kw_only=True, eq=False)
class ReducedSpin:
    """``Spin`` of reduced coordinates: ``C``, ``S``, ``Kg`` (n, n); ``held`` (h, n) are motions that are zero in modes.

    ``elongation`` (Nc,) is the static displacement in m per (rad/s)^2, in coupled dofs; in a file of its nodes (3 N,).
    """

    C: Floats = dataset(
        "real",
        "n n",
        "Coriolis matrix per rad/s: add 2 W C to damping_matrix; skew",
        doc="Coriolis matrix per rad/s, skew: 2 W C is added to `damping_matrix` at the speed W",
    )
    S: Floats = dataset(
        "real",
        "n n",
        "spin softening per (rad/s)2: take W2 S from stiffness_matrix",
        doc="spin softening: W² S is taken from `stiffness_matrix`",
    )
    Kg: Floats = dataset(
        "real",
        "n n",
        "stiffness of the centrifugal stress per (rad/s)2: add W2 Kg to stiffness_matrix",
        doc="stiffness of the centrifugal stress: W² Kg is added to `stiffness_matrix`",
    )
    held: Floats = dataset("real", "h n", "motions of the interfaces that are at rest in the frame that turns")
    elongation: Floats = dataset("real", "3N", "static displacement of the nodes per (rad/s)2", "m s2")
    axis: Floats = dataset("real", "3", "unit axis", doc="unit axis of the spin")
    point: Floats = dataset("real", "3", "a point of the axis", "m")
    speeds: Floats = dataset(
        "real",
        "speeds",
        "with modes compared to those of the full model",
        "rad/s",
        doc="speeds at which modes were compared with those of the full model; the recipe has the deviations",
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Whirl:
    """Modes (k,) at one ``speed`` rad/s: eigenvalues in 1/s in the frame that turns; ``whirl`` "forward", "backward" or
    "mixed", ``inertial`` whirl speed in rad/s at rest, negative where backward, not a number where mixed."""

    speed: float
    eigenvalues: Complexes
    whirl: tuple[str, ...]
    inertial: Floats

    @classmethod
    def unknown(cls, eigenvalues: Complexes, speed: float) -> Whirl:
        """Modes of which no direction is known."""
        n = len(eigenvalues)
        return cls(speed=speed, eigenvalues=eigenvalues, whirl=("",) * n, inertial=np.full(n, np.nan))


def campbell(body: Spinning, speeds: Sequence[float], count: int = 12) -> tuple[Whirl, ...]:
    """The ``count`` lowest modes of a body with spin, of a job or of its file, at each of the ``speeds`` in rad/s.

    Args:
        body: a body with spin matrices.
        speeds: in rad/s.
        count: number of modes at each speed.

    Raises:
        InputError: a body without spin matrices, or a speed out of range.

    >>> from morembs import Rotation, campbell
    >>> campbell(body, [0.0, 100.0])
    Traceback (most recent call last):
        ...
    morembs.base.errors.InputError: body 'craig-bampton' has no spin matrices; reduce with a table [spin] in the job
    """
    spin = body.spin
    if spin is None:
        raise InputError(
            f"body {body.name!r} has no spin matrices; reduce with a table [spin] in the job",
            kind="missing",
            keyword="spin",
        )
    refuse_out_of_range("speed", speeds)
    M, K, D = body.matrices
    return tuple(whirl_modes(M, K, D, spin, float(speed), count) for speed in speeds)


class Spinning(Protocol):
    """A body with the matrices at rest, and those of spin."""

    @property
    def name(self) -> str:
        """Name of the reduction."""
        ...

    @property
    def spin(self) -> ReducedSpin | None:
        """Matrices of spin."""
        ...

    @property
    def matrices(self) -> tuple[Floats, Floats, Floats]:
        """M, K, D (n, n)."""
        ...


def whirl_modes(M: Floats, K: Floats, D: Floats, spin: ReducedSpin, speed: float, count: int) -> Whirl:
    """Modes of a reduced body at ``speed`` rad/s with its held interfaces at rest, ``count`` of lowest \\|s\\|.

    ``M``, ``K``, ``D`` (n, n) are those at rest.
    """
    # Not at the top: files are shown without what solves.
    from morembs.linalg.complex_modes import small_complex_modes

    _, s, Vt = np.linalg.svd(spin.held, full_matrices=True)
    Z = Vt[int((s > TOL.dependent_hold * s.max(initial=0.0)).sum()) :].T
    Kw, Mz, Dz, Cz, Sz = (Z.T @ A @ Z for A in (K + speed**2 * (spin.Kg - spin.S), M, D, spin.C, spin.S))
    gyroscopic = speed * (Cz - Cz.T)
    damping = symmetric(Dz) + gyroscopic if np.abs(D).max(initial=0.0) > 0 else gyroscopic
    values, Y = small_complex_modes(symmetric(Kw), symmetric(Mz), damping)
    return whirl_of(values[:count], Y[:, :count], Cz, Sz, Mz, speed)


def whirl_of(values: Complexes, X: Complexes, C: Any, S: Any, M: Any, speed: float) -> Whirl:
    """Directions and inertial speeds of modes ``X`` (n, k): Im(conj(u_y) u_z) m, summed up, for an axis along x.

    That sum is x^H C x with the Coriolis matrix; x^H S x is its value for a circular orbit.
    """
    turn, across, whole = (np.einsum("ij,ij->j", X.conj(), A @ X) for A in (C, S, M))
    part = np.divide(turn.imag, across.real, out=np.zeros(len(turn)), where=across.real > TOL.across_axis * whole.real)
    words = tuple("mixed" if abs(p) < TOL.circular_whirl else "forward" if p > 0 else "backward" for p in part)
    signs = np.array([{"mixed": np.nan, "forward": 1.0, "backward": -1.0}[word] for word in words])
    return Whirl(speed=speed, eigenvalues=values, whirl=words, inertial=np.asarray(signs * values.imag + speed))
