"""The switch that follows sliders: active sets move with them, a log says when, failed runs keep their results."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from morembs.base.arguments import checked
from morembs.base.errors import InputError, Kind, MorembsError
from morembs.base.types import Floats
from morembs.dynamics.multibody.result import Result
from morembs.dynamics.multibody.run import EventHandler, RestartState, Run
from morembs.dynamics.multibody.sliding.body import Active, SwitchingBody
from morembs.dynamics.multibody.sliding.loads import PathSupport, Slider
from morembs.dynamics.multibody.system import Assembly, State, System
from morembs.dynamics.multibody.tolerances import TOL


@dataclass(frozen=True, kw_only=True, eq=False)
class Activation:
    """One entry of a switching log.

    ``slider`` at ``position`` m moved its window at ``time`` s; ``on`` and ``off`` are labels of nodes. ``rank`` of the
    active set; ``kinetic`` and ``strain`` (2,) J before and after; ``dropped`` the largest amplitude that went, as a
    part of the largest of all.
    """

    time: float
    slider: str
    position: float
    on: tuple[int, ...]
    off: tuple[int, ...]
    rank: int
    kinetic: tuple[float, float]
    strain: tuple[float, float]
    dropped: float

    @property
    def quiet(self) -> bool:
        """True if all that went had died away."""
        return self.dropped <= TOL.quiet_amplitude


class SlidingSwitch(EventHandler):
    """Moves the windows of all sliders of a body; ``log`` lists every change of a run.

    A window moves at the end of the step in which its slider comes to depend on the outermost node, which carried
    no load before. It then has the full look-ahead on both sides, so a load that goes back and forth does not move it
    again. Displacements are projected in K, velocities in M: no energy grows.
    """

    def __init__(self, *bodies: SwitchingBody) -> None:
        self.bodies = bodies
        self.log: list[Activation] = []
        self._wanted: list[tuple[SwitchingBody, int, str, float]] = []

    def reset(self) -> None:
        """Forget the last run."""
        self.log = []

    def _sliders(self, assembly: Assembly, body: SwitchingBody) -> list[Slider]:
        parts = [*assembly.forces, *assembly.joints]
        return [part for part in parts if isinstance(part, Slider) and part.path.component is body]

    def time(self, before: State, after: State) -> float | None:
        self._wanted = []
        for body in self.bodies:
            number = after.assembly.index(body)
            if number is None:
                raise InputError(f"body {body.name!r} of the switch is not in the system; add it", kind="unknown")
            firsts = body.firsts(after.x[after.assembly.in_x[number]])
            for slider in self._sliders(after.assembly, body):
                self._look(body, slider, firsts, before, after)
        return after.time if self._wanted else None

    def _look(self, body: SwitchingBody, slider: Slider, firsts: tuple[int, ...], before: State, after: State) -> None:
        s = slider.along(after)
        if s is None:
            return
        body.refuse_outside(s, f"at t = {after.time:.9g} s ({slider.name or 'joint'})")
        tables, window = body.switching, slider.path.window
        first, last = firsts[window], firsts[window] + body.width - 1
        i, end = tables.interval(s), len(tables.node_ids) - 1
        low, high = max(i - 1, 0), min(i + 2, end)
        if low < first or high > last:
            old = slider.along(before)
            raise InputError(
                f"body {body.name!r}: in the step from t = {before.time:.9g} s to {after.time:.9g} s the slider "
                f"{slider.name or 'joint'!r} went from s = {math.nan if old is None else old:.9g} m to {s:.9g} m, "
                f"over the look-ahead of {body.look_ahead} nodes; take a smaller step or a larger look_ahead",
                keyword="step",
            )
        if (high == last and last < end) or (low == first and first > 0):
            self._wanted.append((body, window, slider.name, s))

    def change(self, state: State) -> RestartState:
        x, v = state.x.copy(), state.v.copy()
        for body in self.bodies:
            windows = [window for window in self._wanted if window[0] is body]
            if not windows:
                continue
            number = state.assembly.index(body)
            if number is None:
                continue
            in_x, in_v = state.assembly.in_x[number], state.assembly.in_v[number]
            new = list(body.firsts(x[in_x]))
            for _, window, _, s in windows:
                new[window] = body.window_about(s)
            try:
                x[in_x], v[in_v] = self._move_windows(body, x[in_x], v[in_v], tuple(new), state, windows)
            except InputError as error:
                raise error.restate(f"at t = {state.time:.9g} s, s = {windows[0][3]:.9g} m: {error}") from error
        return RestartState(x=x, v=v)

    def _move_windows(
        self,
        body: SwitchingBody,
        x: Floats,
        v: Floats,
        firsts: tuple[int, ...],
        state: State,
        wanted: Sequence[tuple[SwitchingBody, int, str, float]],
    ) -> tuple[Floats, Floats]:
        """Configuration and velocity in the new active set, with an entry in the log for each window."""
        old, olds = body.active(x), body.firsts(x)
        new = body.active_of(firsts)
        x1 = x.copy()
        x1[body.configuration_size - body.windows :] = firsts
        v1, dropped = v, 0.0
        if old.set is not None and new.set is not None:
            inner = body.inner.configuration_size
            z = x[inner : inner + body.extra]
            x1[inner : inner + body.extra] = project_in_stiffness(body, old, new, z)
            v1 = project_in_mass(body, x, old, new, v)
            a = old.set.Y @ z
            released = ~np.isin(old.set.candidates, new.set.candidates)
            scale = np.sqrt(body.switching.stiffness[0, old.set.candidates])
            dropped = float(np.abs(a * scale)[released].max(initial=0.0) / max(np.abs(a * scale).max(), TOL.tiny))
        none = np.zeros(3)
        (T0, U0), (T1, U1) = body.energy(x, v, none), body.energy(x1, v1, none)
        ids = body.switching.node_ids
        rank = 0 if new.set is None else int(np.any(new.set.Y != 0, axis=0).sum())
        for _, window, name, s in wanted:
            was, now = (set(range(f, f + body.width)) for f in (olds[window], firsts[window]))
            self.log.append(
                Activation(
                    time=state.time,
                    slider=name,
                    position=s,
                    on=tuple(int(ids[j]) for j in sorted(now - was)),
                    off=tuple(int(ids[j]) for j in sorted(was - now)),
                    rank=rank,
                    kinetic=(T0, T1),
                    strain=(U0, U1),
                    dropped=dropped,
                )
            )
        return x1, v1

    def places(self, state: State) -> str:
        """Where all sliders are at a state, in words."""
        sliders = [slider for body in self.bodies for slider in self._sliders(state.assembly, body)]
        along = [(slider.name or "joint", slider.along(state)) for slider in sliders]
        return ", ".join(f"{name} at s = {s:.9g} m" for name, s in along if s is not None) or "no load on the path"


def project_in_stiffness(body: SwitchingBody, old: Active, new: Active, z: Floats) -> Floats:
    """Coordinates of the new active set whose displacement is nearest to that of z (r,) in the norm of K."""
    if old.set is None or new.set is None:
        return z
    cross = body.switching.R(new.set.candidates, old.set.candidates)
    return np.asarray(new.set.Y.T @ (cross @ (old.set.Y @ z)) / new.set.omega**2)


def project_in_mass(body: SwitchingBody, x: Floats, old: Active, new: Active, v: Floats) -> Floats:
    """Velocity of the body with the new active set that is nearest to v in the norm of M at the configuration x.

    All velocities change: static modes may share mass with the constant basis.
    """
    if old.set is None or new.set is None:
        return v
    k, rate = body.inner.size, v[body.inner.size :]
    inner, _ = body.split(x)
    M, _ = body.inner.dynamics(0.0, inner, v[:k], np.zeros(3))
    whole = np.eye(body.size)
    whole[:k, :k] = M
    shared = body.on_inner(new, inner)
    whole[:k, k:], whole[k:, :k] = shared, shared.T
    momentum = np.empty(body.size)
    momentum[:k] = M @ v[:k] + body.on_inner(old, inner) @ rate
    cross = body.switching.Q(new.set.candidates, old.set.candidates)
    momentum[k:] = shared.T @ v[:k] + new.set.Y.T @ (cross @ (old.set.Y @ rate))
    return np.asarray(np.linalg.solve(whole, momentum))


class UnfinishedRunError(InputError):
    """A run that could not go on; ``result`` is what there is of it, None if nothing."""

    kind: Kind = "result"

    def __init__(self, message: str, result: Result | None) -> None:
        super().__init__(message)
        self.result = result


@checked
def simulate_sliding(
    system: System,
    switch: SlidingSwitch,
    *,
    end: float,
    step: float,
    rho: float = TOL.default_rho,
    begin: float = 0.0,
    tolerance: float = TOL.newton_error,
    max_deflection: float | None = 1.0,
) -> Result:
    """``simulate`` with a switch, from ``begin`` to ``end`` (s) in steps of at most ``step`` (s) and with its options;
    what was integrated is not lost where the run cannot go on.

    Args:
        system: bodies, joints and loads.
        switch: changes static modes as loads slide.
        end: last time in s.
        step: largest time step in s.
        rho: spectral radius at infinity of the integrator.
        begin: first time in s.
        tolerance: relative residual of each step.
        max_deflection: largest elastic displacement, per length of the body; None for any.

    Raises:
        UnfinishedRunError: as ``simulate``, with the time and the place, and the result up to there.
    """
    switch.reset()
    _refuse_mixed(system, switch)
    # The second-order start looks one step ahead and back, which static modes far faster than a step do not tolerate.
    slow = all(body.variant == "quasi-static" for body in switch.bodies)
    run = None
    try:
        run = Run(
            system,
            switch,
            begin=begin,
            end=end,
            step=step,
            rho=rho,
            tolerance=tolerance,
            corrected=slow,
            max_deflection=max_deflection,
        )
        run.finish()
        return run.result()
    except MorembsError as error:
        text = f"{error}"
        if run is None or not run.so_far():
            raise UnfinishedRunError(text, None) from error
        if not ("t = " in text and "s = " in text):
            # What a force or the integrator says while a step is tried.
            last = run.states[-1]
            text = f"in the step from t = {last.time:.9g} s on, {switch.places(last)}: {text}"
        raise UnfinishedRunError(text, run.result()) from error


def _refuse_mixed(system: System, switch: SlidingSwitch) -> None:
    for body in switch.bodies:
        on_it = [f for f in [*system.forces, *system.joints] if isinstance(f, Slider) and f.path.component is body]
        supports = [f for f in on_it if isinstance(f, PathSupport)]
        if supports and len(on_it) > 1:
            raise InputError(
                f"body {body.name!r}: {len(on_it)} loads slide on it, and the compliance of {supports[0].name!r} knows "
                "its own load only; take the dynamic variant with a PointOnPath"
            )
        if len({f.path.window for f in on_it}) < len(on_it):
            raise InputError(f"body {body.name!r}: two sliders share a window; give each its own body.path(NUMBER)")
