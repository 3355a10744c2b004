"""Sensitivities of motions and forces to parameters of elastic bodies, by direct differentiation.

Each converged step of generalised-alpha is differentiated as it stands: the matrix of Newton's method at its end, with
exact tangents, is factorised once, and every parameter is one right-hand side more (Haug and Arora 1978; for Lie groups
Sonneville and Bruels 2014).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.multibody.bodies import FloatingBody
from morembs.multibody.component import Marker
from morembs.multibody.integrate import Stepper
from morembs.multibody.joints import Constraint
from morembs.multibody.reactions import saddle
from morembs.multibody.result import Result, Segment
from morembs.multibody.system import Assembly, State
from morembs.multibody.tangents import stiffness_and_damping
from morembs.multibody.variation import CHANGE, Variation, pulls, slope_at_zero

if TYPE_CHECKING:
    from morembs.multibody.bodies import FlexibleBody

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class StateSlopes:
    """Derivatives of states by P parameters: configuration ``x`` as a step (k, P) from it, velocity ``v``,
    ``acceleration`` (k, P) and ``multipliers`` (m, P)."""

    x: Floats
    v: Floats
    acceleration: Floats
    multipliers: Floats


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
            return of.at(change), s.moved(state.x, change * x)

        def joints(change: float, x: Floats) -> tuple[Floats, Floats]:
            a, there = nearby(change, x)
            Phi, B = a.constraints(t, a.places(there))
            return Phi, B @ state.v

        if x is None:
            x = least(slope_at_zero(lambda c: joints(c, np.zeros(k))[0], of.step))
        v = least(slope_at_zero(lambda c: joints(c, x)[1], of.step))

        def start(change: float) -> Floats:
            a, there = nearby(change, x)
            begun = self.stepper.begun(a, there, state.v + change * v)
            return np.concatenate((begun.state.acceleration, begun.state.multipliers, begun.v, begun.auxiliary))

        ends = np.cumsum([k, s.rows, k])
        return x, v, *np.split(slope_at_zero(start, of.step), ends)

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
        K, C = stiffness_and_damping(
            s, state.time, state.x, state.v, state.acceleration, state.multipliers, exact=True
        )  # fmt: skip
        at = pulls(s, state)
        partials = [of.partials(state, at) for of in self.variations]
        forces, Phi = (np.stack(part, axis=1) for part in zip(*partials, strict=True))
        S = saddle(M + iterate.c_v * C + iterate.c_q * K @ T, B)
        S[k:, :k] = B @ T
        right = np.vstack((K @ x + C @ v + forces, (B @ x + Phi) / iterate.c_q))
        y = -sl.lu_solve(sl.lu_factor(S, check_finite=False), right, check_finite=False)
        self._v, self._auxiliary = v + iterate.c_v * y[:k], auxiliary + iterate.c_a * y[:k]
        self.motions.append(StateSlopes(
            x=x + iterate.c_q * T @ y[:k], v=self._v, acceleration=y[:k], multipliers=y[k:]
        ))  # fmt: skip

    def result(self, segment: Segment) -> dict[str, ResultSensitivity]:
        """Those of a finished ``segment``, by the names of the parameters."""
        return {of.name: ResultSensitivity(segment, of, self.motions, j) for j, of in enumerate(self.variations)}


def at_rest(variations: Sequence[Variation], state: State, solve: Callable[[Floats, Floats], Floats]) -> StateSlopes:
    """Derivatives of an equilibrium; ``solve`` gives the change (k + m,) by which Newton's method answers forces (k,)
    that are left and joints (m,) that are open."""
    k = len(state.v)
    at = pulls(state.assembly, state)
    y = np.stack([solve(*of.partials(state, at)) for of in variations], axis=1)
    none = np.zeros((k, len(variations)))
    return StateSlopes(x=y[:k], v=none, acceleration=none, multipliers=y[k:])


class ResultSensitivity:
    """Derivatives of what a ``Result`` tells with respect to one parameter, per unit of it.

    ``position``, ``reaction`` and the others are as those of the result. Angles and rest lengths that joints and
    springs keep from the start do not change. Elastic coordinates are those of the shapes at the value, which stay.
    """

    def __init__(self, segment: Segment, of: Variation, motions: Sequence[StateSlopes], number: int) -> None:
        self.parameter, self._segment, self._of = of.name, segment, of
        self._motion = [
            np.array([getattr(each, name)[:, number] for each in motions])
            for name in ("x", "v", "acceleration", "multipliers")
        ]  # fmt: skip
        fastest = float(np.abs(self._motion[0]).max(initial=0.0))
        self._step = min(of.step, CHANGE / fastest) if fastest else of.step

    @cached_property
    def _nearby(self) -> Mapping[int, Result]:
        """Results at values of the parameter that differ by some steps, to first order."""
        return {number: self._at(number * self._step) for number in (-2, -1, 1, 2)}

    def _at(self, change: float) -> Result:
        base, (x, v, acceleration, multipliers) = self._segment, self._motion
        return Result(segments=(Segment(
            assembly=self._of.at(change), time=base.time,
            x=np.array([base.assembly.moved(a, change * b) for a, b in zip(base.x, x, strict=True)]),
            v=base.v + change * v, acceleration=base.acceleration + change * acceleration,
            multipliers=base.multipliers + change * multipliers,
        ),))  # fmt: skip

    def of(self, values: Callable[[Result], Floats]) -> Floats:
        """Derivative of any smooth ``values`` of a result: ``s.of(lambda result: result.energy().total)``."""
        at = {number: np.asarray(values(result)) for number, result in self._nearby.items()}
        return np.asarray((8 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12 * self._step))

    @property
    def configuration_step(self) -> Floats:
        """(s, k): derivative of the configuration, as a step from it in the velocity coordinates of the components."""
        return self._motion[0]

    def position(self, marker: Marker) -> Floats:
        """(s, 3) m per unit."""
        return self.of(lambda result: result.position(marker))

    def axes(self, marker: Marker) -> Floats:
        """(s, 3, 3) per unit."""
        return self.of(lambda result: result.axes(marker))

    def velocity(self, marker: Marker) -> Floats:
        """(s, 3) m/s per unit, along the inertial axes."""
        return self.of(lambda result: result.velocity(marker))

    def angular_velocity(self, marker: Marker) -> Floats:
        """(s, 3) rad/s per unit, along the inertial axes."""
        return self.of(lambda result: result.angular_velocity(marker))

    def elastic(self, body: FloatingBody) -> Floats:
        """(s, n) per unit."""
        return self.of(lambda result: result.elastic(body))

    def multipliers(self, joint: Constraint) -> Floats:
        """(s, m) per unit."""
        return self.of(lambda result: result.multipliers(joint))

    def reaction(self, joint: Constraint) -> Floats:
        """(s, 6) N and Nm per unit, as ``Result.reaction``."""
        return self.of(lambda result: result.reaction(joint))

    def load(self, marker: Marker) -> Floats:
        """(s, 6) N and Nm per unit, as ``Result.load``."""
        return self.of(lambda result: result.load(marker))

    def stress(self, body: FlexibleBody, shapes: Floats, change: Floats | None = None) -> Floats:
        """(s, points, 6) Pa per unit, of stresses that are ``shapes`` (6 points, n) times the elastic coordinates;
        ``change`` is the derivative of the shapes themselves, zero unless given."""
        slope = self.of(lambda result: result.stress(body, shapes))
        return slope if change is None else slope + Result(segments=(self._segment,)).stress(body, change)
