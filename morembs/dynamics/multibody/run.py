"""simulate() and the run loop that all simulations share: steps, events that cut them, restarts."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from morembs.base import progress
from morembs.base.arguments import check_value, checked
from morembs.base.errors import InputError, SolverError
from morembs.base.limits import Finite
from morembs.base.types import Floats
from morembs.dynamics.multibody.equilibrium import Equilibrium
from morembs.dynamics.multibody.integrate import Scheme, Stepper
from morembs.dynamics.multibody.reactions import Reactions
from morembs.dynamics.multibody.result import Result
from morembs.dynamics.multibody.segment import Segment
from morembs.dynamics.multibody.sensitivity import DirectDifferentiation
from morembs.dynamics.multibody.system import Assembly, State, System
from morembs.dynamics.multibody.tolerances import TOL, NewtonTolerance
from morembs.dynamics.multibody.variation import variations

Repeat = Callable[[float], State]


@dataclass(frozen=True, kw_only=True, eq=False)
class RestartState:
    """Configuration and velocity to go on with after an event; ``system`` only where parts or coordinates change."""

    x: Floats
    v: Floats
    system: System | None = None


class Events:
    """Events of a run, none here: they cut steps, give the state to restart from, and add reactions.

    ``advice``: what to change where too many events fall into one step.
    """

    advice = "Take a smaller step"

    def reactions(self, assembly: Assembly) -> Reactions:
        """Reactions of the steps from the last restart on."""
        return Reactions(assembly)

    def start(self, assembly: Assembly, t: float, x: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Configuration and velocity to begin with."""
        return x, v

    def cut(self, before: State, after: State, repeat: Repeat) -> State | None:
        """The state at the first event of a step, None where it has none.

        ``repeat`` repeats the step from ``before`` up to a given time. An event at the start of the step gives
        ``before`` itself.
        """
        return None

    def restart(self, state: State) -> tuple[Assembly, Floats, Floats]:
        """Assembly, configuration and velocity after an event."""
        raise NotImplementedError

    def keep(self, states: list[State]) -> None:
        """Keep what is needed of a finished segment."""


class EventHandler(Events, ABC):
    """Watches a run and may stop a step, change the system or its coordinates, and let it go on."""

    advice = "Let the event handler change more at each event"

    @abstractmethod
    def time(self, before: State, after: State) -> float | None:
        """A time (s) after ``before`` and up to ``after`` at which to stop and restart; None to go on.

        A time inside the step has the step repeated up to it.
        """

    @abstractmethod
    def change(self, state: State) -> RestartState:
        """The state to go on with; velocities are made to fit the joints."""

    def cut(self, before: State, after: State, repeat: Repeat) -> State | None:
        wanted, h = self.time(before, after), after.time - before.time
        if wanted is None:
            return None
        if not before.time < wanted <= after.time + TOL.negligible_step * h:
            raise InputError(
                f"an event handler asked for a restart at t = {wanted:.9g} s in the step from {before.time:.9g} to "
                f"{after.time:.9g} s; expected a time after its begin and up to its end"
            )
        if wanted - before.time < TOL.negligible_step * h:
            return before
        return repeat(wanted) if after.time - wanted > TOL.negligible_step * h else after

    def restart(self, state: State) -> tuple[Assembly, Floats, Floats]:
        new = self.change(state)
        assembly = state.assembly if new.system is None else Assembly(new.system)
        x, v = _check_shape("x", new.x, state.x, assembly), _check_shape("v", new.v, state.v, assembly)
        assembly.check_positions(state.time, x)
        return assembly, x, Reactions(assembly).project(state.time, x, v, 0.0)


@checked
def simulate(
    system: System,
    *,
    end: float,
    step: float,
    rho: float = TOL.default_rho,
    begin: float = 0.0,
    tolerance: float = TOL.newton_error,
    events: EventHandler | None = None,
    corrected_start: bool = True,
    max_deflection: float | None = 1.0,
    start: State | Equilibrium | None = None,
    sensitivities: Sequence[str] | bool = False,
) -> Result:
    """Integrate from ``begin`` to ``end`` (s) with equal steps of at most ``step``.

    Generalised alpha on Lie groups for constraints of index 3 (Chung and Hulbert 1993; Bruels and Cardona 2010).

    Args:
        rho: spectral radius at infinite frequency, 1 no numerical damping, 0 the most.
        tolerance: of Newton's method, relative to the largest velocity in the norm of kinetic energy.
        events: stops the run at events, with a restart of second order at each.
        corrected_start: start and restart of second order (Arnold, Bruels and Cardona 2015). Without it multipliers
            are of first order after each start.
        max_deflection: of an elastic body in its floating frame, per length of the body; None for any.
        start: where to begin, such as an equilibrium; the start of the components unless given.
        sensitivities: differentiate each step by these parameters of elastic bodies, as "body.parameter", or by all
            (True): ``result.sensitivity("rod.E")``. From an equilibrium with sensitivities these go on; else bodies
            start where they are put, moved by the least that joints need.

    Raises:
        InputError: invalid times, joints that are open or redundant, velocities that violate joints.
        SolverError: a step that does not converge, with its time and size; a deflection beyond ``max_deflection``.
    """
    run = Run(
        system,
        events or Events(),
        begin=begin,
        end=end,
        step=step,
        rho=rho,
        tolerance=tolerance,
        corrected=corrected_start,
        max_deflection=max_deflection,
        start=start,
        sensitivities=sensitivities,
    )
    run.finish()
    return run.result()


def _check_times(begin: float, end: float, step: float, tolerance: float) -> None:
    for name, value in (("begin", begin), ("end", end), ("step", step)):
        check_value(name, value, Finite)
    check_value("tolerance", tolerance, NewtonTolerance)
    if not end > begin:
        raise InputError(
            f"end = {end:g} s was given with begin = {begin:g} s; expected an end after the beginning",
            kind="conflict",
            keyword="end",
        )
    if not 0 < step <= end - begin:
        raise InputError(
            f"step = {step:g} s was given; expected a positive step up to the span of {end - begin:g} s", keyword="step"
        )


def _checked_deflection(value: float | None) -> float:
    limit = math.inf if value is None else float(value)
    if not limit > 0:
        raise InputError(
            f"max_deflection = {value} was given; expected a positive part of the length, or None",
            keyword="max_deflection",
        )
    return limit


def _check_shape(what: str, value: Floats, old: Floats, assembly: Assembly) -> Floats:
    wanted = sum(c.configuration_size for c in assembly.components) if what == "x" else assembly.size
    if np.shape(value) != (wanted,):
        raise InputError(
            f"an event handler gave {what} of shape {np.shape(value)} (it was {old.shape}); expected ({wanted},)"
        )
    return np.array(value, dtype=float)


class Run:
    """A run under ``events``: finished ``segments``, and the ``states`` of the one at work.

    Raises:
        InputError: invalid times, joints that are open or redundant, velocities that violate joints.
    """

    def __init__(
        self,
        system: System,
        events: Events,
        *,
        begin: float,
        end: float,
        step: float,
        rho: float,
        tolerance: float,
        corrected: bool = True,
        max_deflection: float | None = None,
        start: State | Equilibrium | None = None,
        sensitivities: Sequence[str] | bool = False,
    ) -> None:
        _check_times(begin, end, step, tolerance)
        self.scheme, self.events, self.end, self.step = Scheme(rho=rho), events, end, step
        self.tolerance, self.corrected = tolerance, corrected
        self.max_deflection = _checked_deflection(max_deflection)
        self.segments: list[Segment] = []
        self.states: list[State] = []
        self._times: list[float] = []
        self._differentiation: DirectDifferentiation | None = None
        assembly = Assembly(system)
        self._still = start if isinstance(start, Equilibrium) else None
        at = start.state if isinstance(start, Equilibrium) else start
        x, v = assembly.start() if at is None else assembly.unpack_state(at)
        assembly.check_start(begin, x, v)
        self._sensitivities = sensitivities
        if sensitivities and type(events) is not Events:
            raise InputError(
                "sensitivities were given with events, contact or sliding; they are known for runs without these: "
                "leave one out",
                kind="unsupported",
                keyword="sensitivities",
            )
        self._next = assembly, begin, x, v

    def finish(self) -> None:
        """All steps to the end.

        Raises:
            SolverError: a step that does not converge, too many events in one step.
        """
        assembly, t, x, v = self._next
        x, v = self.events.start(assembly, t, x, v)
        while self._segment(assembly, t, x, v):
            last = self.states[-1]
            self._count(last.time)
            self._close()
            assembly, x, v = self.events.restart(last)
            t = last.time
        self._close()

    def result(self) -> Result:
        """All finished segments."""
        differentiated = self._differentiation
        known = {} if differentiated is None else differentiated.result(self.segments[-1])
        return Result(segments=tuple(self.segments), sensitivities=known)

    def so_far(self) -> bool:
        """Close the segment at work where a run failed; whether there is anything to show."""
        done = self.segments[-1].time[-1] if self.segments else -math.inf
        if self.states and self.states[-1].time > done:
            self._close()
        return bool(self.segments)

    def _segment(self, assembly: Assembly, t: float, x: Floats, v: Floats) -> bool:
        """States from t on, and whether an event ended them."""
        left, reactions = self.end - t, self.events.reactions(assembly)
        if left <= TOL.negligible_step * self.step:
            self.states = [self._stepper(reactions, t, x, v, self.step).state]
            return False
        count = max(1, math.ceil(left / self.step * (1 - TOL.step_count_error)))
        h = left / count
        stepper = self._stepper(reactions, t, x, v, h)
        self.states = [stepper.state]
        if self._sensitivities:
            of = variations(assembly, self._sensitivities)
            begun = None if self._still is None else self._still.slopes_of([each.name for each in of])
            self._differentiation = DirectDifferentiation(stepper, of, begun)
        self._elastic = [
            (c, at)
            for c, at in zip(assembly.components, assembly.in_x, strict=True)
            if self.max_deflection < math.inf and c.deflection(x[at]) is not None
        ]
        for number in range(1, count + 1):
            before = self.states[-1]
            after = stepper.advance(t + number * h)
            progress.update(f"t = {after.time:.4g} of {self.end:.4g} s")
            cut = self.events.cut(before, after, self._repeat(stepper, before))
            if cut is not before:
                self._check_deflection(cut or after)
                self.states.append(cut or after)
                if self._differentiation is not None:
                    self._differentiation.advance()
            if cut is not None:
                return True
        return False

    def _stepper(
        self,
        reactions: Reactions,
        t: float,
        x: Floats,
        v: Floats,
        h: float,
        tangents: tuple[Floats, Floats] | None = None,
    ) -> Stepper:
        try:
            return Stepper(
                self.scheme,
                reactions,
                t=t,
                x=x,
                v=v,
                h=h,
                tolerance=self.tolerance,
                corrected=self.corrected,
                tangents=tangents,
            )
        except np.linalg.LinAlgError:
            raise SolverError(
                f"no accelerations fit the joints at t = {t:.9g} s: their equations are dependent there (a lock or "
                "dead centre). Start the run elsewhere, or free a joint"
            ) from None

    def _repeat(self, stepper: Stepper, before: State) -> Repeat:
        """Steps of other sizes from a state inside a segment: each is a start of its own."""
        t, x, velocity = before.time, before.x, list[Floats]()

        def repeat(time: float) -> State:
            if not velocity:
                again = stepper.reactions.restart(before)
                velocity.append(again.project(t, x, before.v, stepper.h))
            reactions = stepper.reactions.restart(before)
            return self._stepper(reactions, t, x, velocity[0], time - t, stepper.tangents).advance(time)

        return repeat

    def _check_deflection(self, state: State) -> None:
        """Raise SolverError where a body that deflects linearly does so by more than the limit."""
        for component, at in self._elastic:
            deflection = component.deflection(state.x[at])
            if deflection is not None and not deflection <= self.max_deflection:
                raise SolverError(
                    f"at t = {state.time:.9g} s body {component.name!r} deflects by {deflection:.3g} of its length in "
                    f"its floating frame; the limit max_deflection is {self.max_deflection:g}. Linear elastic shapes "
                    "do not hold there: spinning or compressed parts need geometric stiffening (stiffening=True), "
                    "large bending several bodies or a geometrically nonlinear one. max_deflection=None removes the "
                    "limit"
                )

    def _count(self, time: float) -> None:
        self._times = [t for t in self._times if t > time - self.step] + [time]
        if len(self._times) > TOL.max_events_per_step:
            raise SolverError(
                f"the run restarts again and again at t = {time:.9g} s: more than {TOL.max_events_per_step} events "
                f"within one step. {self.events.advice}",
                keyword="events",
            )

    def _close(self) -> None:
        self.segments.append(Segment.of(self.states))
        self.events.keep(self.states)
