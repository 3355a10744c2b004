"""Sensitivities of motions and forces to parameters of elastic bodies, by direct differentiation.

Each converged step of generalised-alpha is differentiated as it stands: the matrix of Newton's method at its end, with
exact tangents, is factorised once, and every parameter is one right-hand side more (Haug and Arora 1978; for Lie groups
Sonneville and Bruels 2014).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import scipy.linalg as sl

from morembs.base.types import Floats
from morembs.dynamics.multibody.integrate import Stepper
from morembs.dynamics.multibody.reactions import saddle
from morembs.dynamics.multibody.result import ResultSensitivity, sensitivities
from morembs.dynamics.multibody.segment import Segment
from morembs.dynamics.multibody.system import Assembly, State
from morembs.dynamics.multibody.tangents import pulls, stiffness_and_damping
from morembs.dynamics.multibody.tolerances import TOL
from morembs.dynamics.multibody.variation import StateSlopes, Variation, slope_at_zero


class DirectDifferentiation:
    """The derivatives of the states of a ``stepper``: one call of ``advance`` after each of its steps.

    ``start`` (k, P) are derivatives of the configuration to begin with; without them the bodies start where they are
    put, moved by the least that joints need.
    """

    def __init__(self, stepper: Stepper, variations: Sequence[Variation], start: Floats | None = None) -> None:
        self.stepper, self.variations = stepper, list(variations)
        begun = [self._start(each, None if start is None else start[:, j]) for j, each in enumerate(self.variations)]
        stacked = [np.stack(values, axis=1) for values in zip(*begun, strict=True)]
        x, v, acceleration, multipliers, self._v, self._auxiliary = stacked
        self.motions = [StateSlopes(x=x, v=v, acceleration=acceleration, multipliers=multipliers)]

    def _start(self, of: Variation, x: Floats | None) -> tuple[Floats, ...]:
        """Derivatives at the start: configuration, velocity, acceleration and multipliers, velocity and auxiliary
        acceleration that the first step begins with."""
        s, state, k = self.stepper.assembly, self.stepper.state, self.stepper.assembly.size
        t, M, _, _, B = state.time, *s.equations(state.time, state.x, state.v)

        def least(rows: Floats) -> Floats:
            return np.asarray(np.linalg.solve(saddle(M, B), np.concatenate((np.zeros(k), -rows)))[:k])

        def nearby(change: float, x: Floats) -> tuple[Assembly, Floats]:
            return of.at(change), s.move(state.x, change * x)

        def joints(change: float, x: Floats) -> tuple[Floats, Floats]:
            a, there = nearby(change, x)
            Phi, B = a.constraints(t, a.places(there))
            return Phi, B @ state.v

        if x is None:
            x = least(slope_at_zero(lambda c: joints(c, np.zeros(k))[0], of.step))
        v = least(slope_at_zero(lambda c: joints(c, x)[1], of.step))

        def start(change: float) -> Floats:
            a, there = nearby(change, x)
            begun = self.stepper.begin_at(a, there, state.v + change * v)
            return np.concatenate((begun.state.acceleration, begun.state.multipliers, begun.v, begun.auxiliary))

        ends = np.cumsum([k, s.rows, k])
        return x, v, *np.split(slope_at_zero(start, TOL.varied_start_part * of.step), ends)

    def advance(self) -> None:
        """Differentiate the step that was done last."""
        s, state, iterate = self.stepper.assembly, self.stepper.state, self.stepper.iterate
        h, a, old, k = self.stepper.h, self.stepper.scheme, self.motions[-1], self.stepper.assembly.size
        # What the step begins with, and where it would end if the acceleration did not change.
        auxiliary = (a.alpha_f * old.acceleration - a.alpha_m * self._auxiliary) / (1 - a.alpha_m)
        step = h * (self._v + h * ((0.5 - a.beta) * self._auxiliary + a.beta * auxiliary))
        v = self._v + h * ((1 - a.gamma) * self._auxiliary + a.gamma * auxiliary)
        T = s.tangent(np.eye(k), iterate.step)
        moved = T @ old.x
        # Ad(exp(-step)) = 1 - ad(step) T(step).
        x = old.x - np.stack([s.bracket(iterate.step, each) for each in moved.T], axis=1) + T @ step
        M, _, _, B = s.equations(state.time, state.x, state.v)
        at = pulls(s, state)
        K, C = stiffness_and_damping(s, state.time, state.x, state.v, state.acceleration, state.multipliers, known=at)
        partials = [of.partials(state, at) for of in self.variations]
        forces, Phi = (np.stack(part, axis=1) for part in zip(*partials, strict=True))
        S = saddle(M + iterate.c_v * C + iterate.c_q * K @ T, B)
        S[k:, :k] = B @ T
        right = np.vstack((K @ x + C @ v + forces, (B @ x + Phi) / iterate.c_q))
        y = -sl.lu_solve(sl.lu_factor(S, check_finite=False), right, check_finite=False)
        self._v, self._auxiliary = v + iterate.c_v * y[:k], auxiliary + iterate.c_a * y[:k]
        self.motions.append(
            StateSlopes(x=x + iterate.c_q * T @ y[:k], v=self._v, acceleration=y[:k], multipliers=y[k:])
        )

    def result(self, segment: Segment) -> dict[str, ResultSensitivity]:
        """Those of a finished ``segment``, by the names of the parameters."""
        return sensitivities(segment, self.variations, self.motions)


def at_rest(variations: Sequence[Variation], state: State, solve: Callable[[Floats, Floats], Floats]) -> StateSlopes:
    """Derivatives of an equilibrium; ``solve`` gives the change (k + m,) by which Newton's method answers forces (k,)
    that are left and joints (m,) that are open."""
    k = len(state.v)
    at = pulls(state.assembly, state)
    y = np.stack([solve(*of.partials(state, at)) for of in variations], axis=1)
    none = np.zeros((k, len(variations)))
    return StateSlopes(x=y[:k], v=none, acceleration=none, multipliers=y[k:])
