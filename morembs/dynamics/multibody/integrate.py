"""Generalised-alpha for constrained systems on Lie groups, index 3 (Chung and Hulbert 1993; Bruels and Cardona 2010).

One stepper for all: contacts take part as ``Reactions``, loads that slide along a body as forces and joints. Start and
restart are of second order after Arnold, Bruels and Cardona (2015): the auxiliary acceleration is taken at its own
time, and velocity and multipliers start from a small perturbation that removes the first-order error of multipliers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl

from morembs.base.arguments import check_options
from morembs.base.errors import SolverError
from morembs.base.limits import SpectralRadius
from morembs.base.types import Floats
from morembs.dynamics.multibody.reactions import LU, Iterate, Reactions, saddle
from morembs.dynamics.multibody.system import Assembly, State
from morembs.dynamics.multibody.tangents import stiffness_and_damping
from morembs.dynamics.multibody.tolerances import TOL


@dataclass(frozen=True, kw_only=True)
class Scheme:
    """Parameters of generalised-alpha from ``rho`` (0 to 1), the spectral radius at infinite frequency."""

    rho: SpectralRadius

    def __post_init__(self) -> None:
        check_options(self)

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
        # Chung and Hulbert 1993: (1 - alpha_m + alpha_f)^2 / 4.
        return 0.25 * (self.gamma + 0.5) ** 2


class Stepper:
    """Steps of one size from a consistent state on: the ``state``, the velocity ``v`` and ``auxiliary`` acceleration
    that the next step begins with, and the Newton matrix; ``iterate`` is the end of the last step.

    ``reactions`` are solved for in every iteration; ``tangents`` K and C (k, k) of another stepper of the same state.

    Raises:
        LinAlgError: joints that are dependent at the start.
    """

    def __init__(
        self,
        scheme: Scheme,
        reactions: Reactions,
        *,
        t: float,
        x: Floats,
        v: Floats,
        h: float,
        tolerance: float,
        corrected: bool = True,
        tangents: tuple[Floats, Floats] | None = None,
    ) -> None:
        self.scheme, self.reactions, self.assembly, self.h = scheme, reactions, reactions.assembly, h
        rate, multipliers = reactions.balance(t, x, v, h)
        state = State(assembly=self.assembly, time=t, x=x, v=v, acceleration=rate, multipliers=multipliers)
        self.state, self.v, self.auxiliary, self._multipliers = reactions.state(state), v, rate, multipliers
        self._corrected = corrected
        if corrected:
            self._correct_start(state)
        positions = [float(np.abs(p.position).max()) for p in self.assembly.places(x).values()]
        length = reactions.measure(self.state, max([TOL.least_size, *positions]))
        self._limit = ChangeLimit(tolerance=tolerance, h=h, length=length)
        self.tangents = tangents or self._tangents(self.state)
        self.iterate = self._predict()

    def begin_at(self, assembly: Assembly, x: Floats, v: Floats) -> Stepper:
        """The stepper of another assembly of the same sizes, begun at another state and the same time."""
        return Stepper(
            self.scheme,
            Reactions(assembly),
            t=self.state.time,
            x=x,
            v=v,
            h=self.h,
            tolerance=self._limit.tolerance,
            corrected=self._corrected,
            tangents=self.tangents,
        )

    def _correct_start(self, state: State) -> None:
        """The start values of second order of Arnold, Bruels and Cardona (2015)."""
        s, a, t, h, x, v, rate = (self.assembly, self.scheme, state.time, self.h, state.x, state.v, state.acceleration)
        ahead, behind = (
            self.reactions.accelerations(t + k, s.move(x, k * v + 0.5 * k * k * rate), v + k * rate, h)[0]
            for k in (h, -h)
        )
        jerk, offset = 0.5 * (ahead - behind), a.alpha_m - a.alpha_f
        shift = h * ((1 - 6 * a.beta - 3 * offset) / 6 * jerk + h / 12 * s.bracket(v, rate))
        dv, dm = self.reactions.correction(t, x, v, shift)
        self.v, self.auxiliary, self._multipliers = v + dv, rate + offset * jerk, state.multipliers + dm

    def _tangents(self, at: State) -> tuple[Floats, Floats]:
        K, C = stiffness_and_damping(self.assembly, at.time, at.x, at.v, at.acceleration, at.multipliers)
        return K + self.reactions.stiffness(at.x), C

    def _predict(self) -> Iterate:
        """Unknowns at the end of the step if the acceleration stays as it is."""
        h, a, old = self.h, self.scheme, self.state.acceleration
        c_a = (1 - a.alpha_f) / (1 - a.alpha_m)
        auxiliary = (a.alpha_f * old - a.alpha_m * self.auxiliary) / (1 - a.alpha_m) + c_a * old
        return Iterate(
            acceleration=old.copy(),
            multipliers=self._multipliers.copy(),
            auxiliary=auxiliary,
            step=h * (self.v + h * ((0.5 - a.beta) * self.auxiliary + a.beta * auxiliary)),
            v=self.v + h * ((1 - a.gamma) * self.auxiliary + a.gamma * auxiliary),
            c_a=c_a,
            c_v=h * a.gamma * c_a,
            c_q=h * h * a.beta * c_a,
        )

    def _factor(self, iterate: Iterate, mass: Floats, B: Floats) -> LU:
        K, C = self.tangents
        S = saddle(mass + iterate.c_v * C + self.assembly.tangent(iterate.c_q * K, iterate.step), B)
        S[self.assembly.size :, : self.assembly.size] = self.assembly.tangent(B, iterate.step)
        lu: LU = sl.lu_factor(S, check_finite=False)
        return lu

    # Iterations that diverge end with a message of their own.
    @np.errstate(over="ignore", invalid="ignore")
    def advance(self, time: float) -> State:
        """One step, to ``time``; the new state.

        Raises:
            RayError: no forces keep the points of contacts apart.
            SolverError: Newton's method does not converge.
        """
        s, old, iterate = self.assembly, self.state, self._predict()
        s.begin_step(old.time, old.x, old.v)
        factor, last, refreshed, M, noise, d = None, math.inf, False, self.tangents[0], 0.0, np.zeros(s.size)
        for _ in range(self.reactions.iterations):
            x = s.move(old.x, iterate.step)
            mass, g, Phi, B = s.equations(time, x, iterate.v)
            if factor is None:
                M, factor = mass, self._factor(iterate, mass, B)
                noise = self._limit(M, g, iterate.v, old.time)
            residual = np.concatenate((mass @ iterate.acceleration + g + iterate.multipliers @ B, Phi / iterate.c_q))
            if not np.isfinite(residual).all():
                d = residual[: s.size]
                break
            d = iterate.correct(self.reactions.solve(factor, residual, x, iterate))
            size = iterate.c_v * math.sqrt(max(float(d @ M @ d), 0.0))
            if size <= noise:
                self.iterate = iterate
                self.v, self.auxiliary, self._multipliers = iterate.v, iterate.auxiliary, iterate.multipliers
                self.state = self.reactions.state(iterate.state(s, time, s.move(old.x, iterate.step)), converged=True)
                return self.state
            if size > TOL.slow_ratio * last:
                if not refreshed:
                    self.tangents = self._tangents(iterate.state(s, time, s.move(old.x, iterate.step)))
                factor, refreshed = None, True
            last = size
        raise SolverError(
            f"the step from t = {old.time:.9g} s with h = {self.h:.3g} s does not converge in "
            f"{self.reactions.iterations} Newton iterations (last change {last:.2g}, limit {noise:.2g}, in the norm of "
            f"kinetic energy{self._most_of(d, M)}). Take a smaller step; {self.reactions.advice}"
        )

    def _most_of(self, d: Floats, M: Floats) -> str:
        """The body with the largest part of a change (k,) of velocity, in words."""
        s = self.assembly
        with np.errstate(over="ignore", invalid="ignore"):
            parts = np.nan_to_num([float(d[j] @ M[j, j] @ d[j]) for j in s.in_v], nan=np.inf)
        return f", most of it in body {s.components[int(np.argmax(parts))].name!r}" if parts.any() else ""


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
                "allow larger ones, or fewer modes"
            )
        self._scale = max(self._scale, math.sqrt(square), self.h * math.sqrt(max(force, 0.0)))
        floor = 100 * np.finfo(float).eps * math.sqrt(float(np.abs(np.diag(M)).max())) / self.h
        return max(self.tolerance * self._scale, floor * self.length)
