"""simulate(): a run from start to end, with restarts where a switch asks for them."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError, SolverError
from morembs.multibody.integrate import Scheme, State, Stepper, projected
from morembs.multibody.result import Result, Segment
from morembs.multibody.system import Assembly, System

Floats = NDArray[np.float64]
# The part of a step that is too short to be a step; an event that near to the end of a step is at its end.
_CLOSE = 1e-6
# Restarts at one time after which the run is given up.
_RESTARTS = 50


@dataclass(frozen=True, kw_only=True, eq=False)
class Restart:
    """Configuration and velocity to go on with after a switch; ``system`` only where parts or coordinates change."""

    x: Floats
    v: Floats
    system: System | None = None


class Switch(ABC):
    """Watches a run and may stop a step, change the system or its coordinates, and let it go on."""

    @abstractmethod
    def time(self, before: State, after: State) -> float | None:
        """A time (s) after ``before`` and up to ``after`` at which to stop and restart; None to go on.

        A time inside the step has the step repeated up to it.
        """

    @abstractmethod
    def change(self, state: State) -> Restart:
        """The state to go on with; velocities are made to fit the joints."""


def simulate(
    system: System, *, end: float, step: float, rho: float = 0.9, begin: float = 0.0, tolerance: float = 1e-9,
    switch: Switch | None = None, corrected_start: bool = True,
) -> Result:  # fmt: skip
    """Integrate from ``begin`` to ``end`` (s) with equal steps of at most ``step``.

    Args:
        rho: spectral radius at infinite frequency, 1 no numerical damping, 0 the most.
        tolerance: of Newton's method, relative to the largest velocity in the norm of kinetic energy.
        switch: events, with a restart of second order at each.
        corrected_start: start and restart of second order (Arnold, Bruels and Cardona 2015). Without it multipliers
            are of first order after each start.

    Raises:
        InputError: nonsense times, joints that are open or redundant, velocities that break joints.
        SolverError: a step that does not converge, with its time and size.
    """
    _check_times(begin, end, step, tolerance)
    scheme, assembly = Scheme(rho=rho), Assembly(system)
    x, v = assembly.start()
    assembly.check_start(begin, x, v)
    segments: list[Segment] = []
    t, stuck = begin, 0
    while True:
        run = _Run(scheme, tolerance, corrected_start, switch, end, step)
        states, stopped = run.until_switch(assembly, t, x, v)
        segments.append(Segment.of(states))
        if not stopped or switch is None:
            return Result(segments=tuple(segments))
        last, stuck = states[-1], stuck + 1 if len(states) == 1 else 0
        if stuck > _RESTARTS:
            raise SolverError(
                f"the switch restarts the run again and again at t = {last.time:.9g} s; let it change more"
            )
        restart = switch.change(last)
        assembly = assembly if restart.system is None else Assembly(restart.system)
        t, x, v = last.time, _fitting("x", restart.x, last.x, assembly), _fitting("v", restart.v, last.v, assembly)
        assembly.check_positions(t, x)
        v = projected(assembly, t, x, v)
        if t >= end - _CLOSE * step:
            return Result(segments=tuple(segments))


def _check_times(begin: float, end: float, step: float, tolerance: float) -> None:
    for name, value in (("begin", begin), ("end", end), ("step", step), ("tolerance", tolerance)):
        if not math.isfinite(value):
            raise InputError(f"{name} = {value} was given; expected a finite number")
    if not end > begin:
        raise InputError(f"end = {end:g} s was given with begin = {begin:g} s; expected an end after the beginning")
    if not 0 < step <= end - begin:
        raise InputError(f"step = {step:g} s was given; expected a positive step up to the span of {end - begin:g} s")
    if not 0 < tolerance < 1e-2:
        raise InputError(f"tolerance = {tolerance:g} was given; expected a number between 0 and 0.01, such as 1e-9")


def _fitting(what: str, value: Floats, old: Floats, assembly: Assembly) -> Floats:
    wanted = sum(c.configuration_size for c in assembly.components) if what == "x" else assembly.size
    if np.shape(value) != (wanted,):
        raise InputError(f"a switch gave {what} of shape {np.shape(value)} (it was {old.shape}); expected ({wanted},)")
    return np.array(value, dtype=float)


class _Run:
    """The steps between two restarts."""

    def __init__(
        self, scheme: Scheme, tolerance: float, corrected: bool, switch: Switch | None, end: float, step: float
    ) -> None:
        self.scheme, self.tolerance, self.corrected = scheme, tolerance, corrected
        self.switch, self.end, self.step = switch, end, step

    def _stepper(self, assembly: Assembly, t: float, x: Floats, v: Floats, h: float) -> Stepper:
        try:
            return Stepper(self.scheme, assembly, t, x, v, h, self.tolerance, self.corrected)
        except np.linalg.LinAlgError:
            raise SolverError(
                f"no accelerations fit the joints at t = {t:.9g} s: their equations are dependent there (a lock or "
                "dead point). Start the run elsewhere, or free a joint"
            ) from None

    def until_switch(self, assembly: Assembly, t: float, x: Floats, v: Floats) -> tuple[list[State], bool]:
        """States from t on, and whether a switch ended them."""
        count = max(1, math.ceil((self.end - t) / self.step * (1 - 1e-12)))
        h = (self.end - t) / count
        stepper = self._stepper(assembly, t, x, v, h)
        states = [stepper.state]
        for number in range(1, count + 1):
            before = states[-1]
            after = stepper.advance(t + number * h)
            wanted = None if self.switch is None else self.switch.time(before, after)
            if wanted is None:
                states.append(after)
                continue
            if not before.time < wanted <= after.time + _CLOSE * h:
                raise InputError(
                    f"a switch asked for a restart at t = {wanted:.9g} s in the step from {before.time:.9g} to "
                    f"{after.time:.9g} s; expected a time after its begin and up to its end"
                )
            if wanted - before.time < _CLOSE * h:
                return states, True
            if after.time - wanted > _CLOSE * h:
                # The step is repeated with another size: a start of its own.
                v0 = projected(assembly, before.time, before.x, before.v)
                short = wanted - before.time
                after = self._stepper(assembly, before.time, before.x, v0, short).advance(wanted)
            return [*states, after], True
        return states, False
