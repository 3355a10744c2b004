"""Generalised-alpha for constrained systems on Lie groups, index 3 (Chung and Hulbert 1993; Bruels and Cardona 2010).

Start and restart of second order after Arnold, Bruels and Cardona (2015): the auxiliary acceleration is taken at its
own time, and velocity and multipliers start from a small perturbation that removes the first-order error of
multipliers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.errors import InputError, SolverError
from morembs.multibody.system import Assembly
from morembs.multibody.tangents import stiffness_and_damping

Floats = NDArray[np.float64]
_ITERATIONS = 15
_SLOW = 0.15


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """A moment of a simulation: time s, configuration x, velocity v, acceleration dv/dt, multipliers of joints."""

    assembly: Assembly
    time: float
    x: Floats
    v: Floats
    acceleration: Floats
    multipliers: Floats


@dataclass(frozen=True, kw_only=True)
class Scheme:
    """Parameters of generalised-alpha from ``rho`` (0 to 1), the spectral radius at infinite frequency."""

    rho: float

    def __post_init__(self) -> None:
        if not 0 <= self.rho <= 1:
            raise InputError(f"rho = {self.rho} was given; expected 0 (strong damping) to 1 (none)")

    @property
    def alpha_m(self) -> float:
        return (2 * self.rho - 1) / (self.rho + 1)

    @property
    def alpha_f(self) -> float:
        return self.rho / (self.rho + 1)

    @property
    def gamma(self) -> float:
        return 0.5 - self.alpha_m + self.alpha_f

    @property
    def beta(self) -> float:
        return 0.25 * (self.gamma + 0.5) ** 2


def _saddle(M: Floats, B: Floats) -> Floats:
    m, k = B.shape
    S = np.zeros((k + m, k + m))
    S[:k, :k], S[:k, k:], S[k:, :k] = M, B.T, B
    return S


def accelerations(assembly: Assembly, t: float, x: Floats, v: Floats, h: float) -> tuple[Floats, Floats, Floats]:
    """Acceleration, multipliers and the saddle matrix [[M, B'], [B, 0]] at a consistent state."""
    places = assembly.places(x)
    M, g = assembly.dynamics(t, x, v, places)
    _, B = assembly.constraints(t, places)
    S = _saddle(M, B)
    right = np.concatenate((-g, assembly.driven(2, t) - assembly.curvature(x, v, h)))
    solution: Floats = np.asarray(np.linalg.solve(S, right), dtype=np.float64)
    return solution[: assembly.size], solution[assembly.size :], S


def projected(assembly: Assembly, t: float, x: Floats, v: Floats) -> Floats:
    """The velocity nearest to v, in the norm of kinetic energy, that the joints allow."""
    places = assembly.places(x)
    M, _ = assembly.dynamics(t, x, v, places)
    _, B = assembly.constraints(t, places)
    right = np.concatenate((np.zeros(assembly.size), assembly.driven(1, t) - B @ v))
    return np.asarray(v + np.linalg.solve(_saddle(M, B), right)[: assembly.size])


def _newton(A: Floats, B: Floats, BT: Floats) -> Floats:
    S = _saddle(A, B)
    S[len(A) :, : len(A)] = BT
    return S


class Stepper:
    """Steps of one size from a consistent state on: the state, the auxiliary acceleration and the Newton matrix."""

    def __init__(
        self, scheme: Scheme, assembly: Assembly, t: float, x: Floats, v: Floats, h: float, tolerance: float,
        corrected: bool = True,
    ) -> None:  # fmt: skip
        self.scheme, self.assembly, self.h = scheme, assembly, h
        a, s = scheme, assembly
        rate, multipliers, S = accelerations(s, t, x, v, h)
        self.state = State(assembly=s, time=t, x=x, v=v, acceleration=rate, multipliers=multipliers)
        offset = a.alpha_m - a.alpha_f
        self._v, self._auxiliary = v, rate
        if corrected:
            ahead, behind = (
                accelerations(s, t + k, s.moved(x, k * v + 0.5 * k * k * rate), v + k * rate, h)[0] for k in (h, -h)
            )
            jerk = 0.5 * (ahead - behind)
            self._auxiliary = rate + offset * jerk
            shift = h * ((1 - 6 * a.beta - 3 * offset) / 6 * jerk + h / 12 * s.bracket(v, rate))
            right = np.concatenate((np.zeros(s.size), S[s.size :, : s.size] @ shift))
            change = np.linalg.solve(S, right)
            self._v = v + change[: s.size]
            self._multipliers = multipliers + change[s.size :]
        else:
            self._multipliers = multipliers
        self._K, self._C = stiffness_and_damping(s, t, x, v, rate, multipliers)
        length = max([1e-3, *(float(np.abs(p.position).max()) for p in s.places(x).values())])
        self._limit = ChangeLimit(tolerance=tolerance, h=h, length=length)

    def advance(self, time: float) -> State:
        """One step, to ``time``; the new state.

        Raises:
            SolverError: Newton's method does not converge.
        """
        s, h, a = self.assembly, self.h, self.scheme
        t, old = time, self.state
        c_a = (1 - a.alpha_f) / (1 - a.alpha_m)
        c_v, c_q = h * a.gamma * c_a, h * h * a.beta * c_a
        rate, multipliers = old.acceleration.copy(), self._multipliers.copy()
        auxiliary = (a.alpha_f * old.acceleration - a.alpha_m * self._auxiliary) / (1 - a.alpha_m) + c_a * rate
        step = h * (self._v + h * ((0.5 - a.beta) * self._auxiliary + a.beta * auxiliary))
        v = self._v + h * ((1 - a.gamma) * self._auxiliary + a.gamma * auxiliary)
        factor, last, refreshed, M, noise = None, math.inf, False, self._K, 0.0
        for _ in range(_ITERATIONS):
            x = s.moved(old.x, step)
            places = s.places(x)
            mass, g = s.dynamics(t, x, v, places)
            Phi, B = s.constraints(t, places)
            if factor is None:
                M = mass
                tangent = s.tangent(c_q * self._K, step)
                factor = sl.lu_factor(_newton(M + c_v * self._C + tangent, B, s.tangent(B, step)), check_finite=False)
                noise = self._limit(M, g, v, old.time)
            residual = np.concatenate((mass @ rate + g + multipliers @ B, Phi / c_q))
            if not np.isfinite(residual).all():
                break
            change = -sl.lu_solve(factor, residual, check_finite=False)
            d = change[: s.size]
            rate += d
            multipliers += change[s.size :]
            auxiliary += c_a * d
            step += c_q * d
            v = v + c_v * d
            size = c_v * math.sqrt(max(float(d @ M @ d), 0.0))
            if size <= noise:
                self._v, self._auxiliary, self._multipliers = v, auxiliary, multipliers
                self.state = State(
                    assembly=s, time=t, x=s.moved(old.x, step), v=v, acceleration=rate, multipliers=multipliers
                )
                return self.state
            if size > _SLOW * last:
                if not refreshed:
                    self._K, self._C = stiffness_and_damping(s, t, s.moved(old.x, step), v, rate, multipliers)
                factor, refreshed = None, True
            last = size
        raise SolverError(
            f"the step from t = {old.time:.9g} s with h = {h:.3g} s does not converge in {_ITERATIONS} "
            f"Newton iterations (last change {last:.2g}, limit {noise:.2g}, in the norm of "
            "kinetic energy). Take a smaller step; check "
            "for positions where joints lock or a force that jumps"
        )


class ChangeLimit:
    """When changes of velocity in Newton's method are small enough, in the norm of kinetic energy.

    That is ``tolerance`` times the largest velocity so far, but not below round-off of constraints of ``length`` m in a
    step of ``h`` s.
    """

    def __init__(self, *, tolerance: float, h: float, length: float) -> None:
        self.tolerance, self.h, self.length, self._scale = tolerance, h, length, 0.0

    def __call__(self, M: Floats, g: Floats, v: Floats, time: float) -> float:
        """The limit for mass matrix M, forces g and velocities v after ``time`` in s.

        Raises:
            SolverError: the kinetic energy is negative: the mass matrix is not positive definite.
        """
        square, force = float(v @ M @ v), float(g @ np.linalg.solve(M, g))
        if square < 0:
            raise SolverError(
                f"after t = {time:.9g} s the mass matrix is not positive definite: deflections are too large for the "
                "second-order terms of the geometric stiffening in this frame. Take mean axes or a chord frame, which "
                "bear larger ones, or fewer modes"
            )
        self._scale = max(self._scale, math.sqrt(square), self.h * math.sqrt(max(force, 0.0)))
        floor = 100 * np.finfo(float).eps * math.sqrt(float(np.abs(np.diag(M)).max())) / self.h
        return max(self.tolerance * self._scale, floor * self.length)
