"""Reactions that a step of the integrator solves for: those of joints here, those of contact in ``contact``.

The equations of motion are M dv/dt + g + B' multipliers = pull of other reactions, with B dv/dt given.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.base.types import Floats
from morembs.dynamics.multibody.system import Assembly, State
from morembs.dynamics.multibody.tolerances import TOL

LU = tuple[NDArray[np.float64], NDArray[np.int32]]


@dataclass(frozen=True, kw_only=True, eq=False)
class HeldRows:
    """Rows (r, k) whose velocity is constrained in addition to that of joints.

    ``pull`` (r, k): generalised force per unit of each multiplier; ``acceleration`` (r,): right-hand side of the rows;
    ``load`` (k,): given forces. Points may hold one motion twice, so solutions are those of least norm.
    """

    rows: Floats
    pull: Floats
    acceleration: Floats
    load: Floats


@dataclass(kw_only=True, eq=False)
class Iterate:
    """Unknowns at the end of a step in Newton's method: accelerations (k,), multipliers of joints (m,), auxiliary
    acceleration, ``step`` in configuration and velocity, and by how much the last three change with the first."""

    acceleration: Floats
    multipliers: Floats
    auxiliary: Floats
    step: Floats
    v: Floats
    c_a: float
    c_v: float
    c_q: float

    def correct(self, change: Floats) -> Floats:
        """Take over a change of accelerations and multipliers (k + m,); that of the accelerations."""
        d = change[: len(self.v)]
        self.acceleration += d
        self.multipliers += change[len(self.v) :]
        self.auxiliary += self.c_a * d
        self.step += self.c_q * d
        self.v = self.v + self.c_v * d
        return d

    def state(self, assembly: Assembly, time: float, x: Floats) -> State:
        """The state it stands for at configuration x."""
        return State(
            assembly=assembly, time=time, x=x, v=self.v, acceleration=self.acceleration, multipliers=self.multipliers
        )


def saddle(M: Floats, B: Floats) -> Floats:
    """[[M, B'], [B, 0]] of M (k, k) and B (m, k)."""
    m, k = B.shape
    S = np.zeros((k + m, k + m))
    S[:k, :k], S[:k, k:], S[k:, :k] = M, B.T, B
    return S


def least_norm(S: Floats, right: Floats) -> Floats:
    """The solution of least norm of a system that may be singular."""
    return np.asarray(np.linalg.lstsq(S, right, rcond=TOL.least_norm_cut)[0], dtype=np.float64)


class Reactions:
    """Joints alone. Contact overrides what follows; one object serves one stepper.

    ``iterations`` and ``advice``: how many Newton iterations a step may take, and what to look for if it needs more.
    """

    iterations = 15
    advice = "check for positions where joints lock or a force that jumps"

    def __init__(self, assembly: Assembly) -> None:
        self.assembly = assembly

    def restart(self, state: State) -> Reactions:
        """Reactions for another stepper from an earlier state on."""
        return self

    def held_rows(self, x: Floats, v: Floats, h: float) -> HeldRows | None:
        """Rows that are constrained in addition to joints at a state near the start."""
        return None

    def closed_rows(self, x: Floats) -> Floats | None:
        """Those of ``held_rows`` (., k) that are held in position as well."""
        return None

    def balance(self, t: float, x: Floats, v: Floats, h: float) -> tuple[Floats, Floats]:
        """Accelerations (k,) and multipliers of joints (m,) at a consistent state."""
        return self.accelerations(t, x, v, h)

    def accelerations(self, t: float, x: Floats, v: Floats, h: float) -> tuple[Floats, Floats]:
        """As ``balance``, for a state near the start with the same rows held."""
        a, k = self.assembly, self.assembly.size
        held, (M, g, _, B) = self.held_rows(x, v, h), a.equations(t, x, v)
        given = a.motion_derivative(2, t) - a.curvature(x, v, h)
        if held is None:
            y = np.asarray(np.linalg.solve(saddle(M, B), np.concatenate((-g, given))), dtype=np.float64)
        else:
            S = saddle(M, np.vstack((B, held.rows)))
            S[:k, k:] = np.vstack((B, -held.pull)).T
            y = least_norm(S, np.concatenate((held.load - g, given, held.acceleration)))
        return y[:k], y[k : k + a.rows]

    def correction(self, t: float, x: Floats, v: Floats, shift: Floats) -> tuple[Floats, Floats]:
        """Smallest change of velocity that follows ``shift`` (k,) in all held rows, and that of joint multipliers."""
        a, k = self.assembly, self.assembly.size
        closed, (M, _, _, B) = self.closed_rows(x), a.equations(t, x, v)
        J = B if closed is None else np.vstack((B, closed))
        right = np.concatenate((np.zeros(k), J @ shift))
        y = np.linalg.solve(saddle(M, J), right) if closed is None else least_norm(saddle(M, J), right)
        return np.asarray(y[:k]), np.asarray(y[k : k + a.rows])

    def project(self, t: float, x: Floats, v: Floats, h: float) -> Floats:
        """The velocity nearest to v, in the norm of kinetic energy, that joints (and closed contacts) allow."""
        M, _, _, B = self.assembly.equations(t, x, v)
        right = np.concatenate((np.zeros(len(v)), self.assembly.motion_derivative(1, t) - B @ v))
        return np.asarray(v + np.linalg.solve(saddle(M, B), right)[: len(v)])

    def state(self, state: State, converged: bool = False) -> State:
        """The state together with the reactions at it, at a start or after a ``converged`` step."""
        return state

    def measure(self, state: State, length: float) -> float:
        """Size of the system, m: ``length`` of the positions of its markers, and what is touched."""
        return length

    def stiffness(self, x: Floats) -> Floats | float:
        """(k, k) for Newton's method: derivative of minus the forces found last by the configuration."""
        return 0.0

    def solve(self, lu: LU, residual: Floats, x: Floats, iterate: Iterate) -> Floats:
        """Newton's change of accelerations and multipliers (k + m,) for a factored matrix and a residual at x."""
        return np.asarray(-sl.lu_solve(lu, residual, check_finite=False))
