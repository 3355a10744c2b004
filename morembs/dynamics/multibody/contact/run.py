"""simulate_contact(): a run with unilateral contact, driven by events.

Between events: generalised-alpha of second order, with contact on the level of positions in each step. At a touch: the
step is cut at it, positions are projected, velocities change by complementarity with restitution, and the scheme
restarts with its second-order start. Sliding that reverses or stops is an event too. Points that separate need none,
nor do compliant points, whose forces begin at zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import cast

import numpy as np
from numpy.typing import NDArray

from morembs.base.arguments import checked
from morembs.base.errors import InputError, SolverError
from morembs.base.types import Bools, Floats
from morembs.dynamics.multibody.contact.impact import first_touch, project_positions, resolve_impact, sliding_ends
from morembs.dynamics.multibody.contact.kinematics import Contact, Contacts, ContactState
from morembs.dynamics.multibody.contact.lemke import RayError
from morembs.dynamics.multibody.contact.reactions import ContactReactions
from morembs.dynamics.multibody.contact.result import ContactError, ContactResult, ContactSegment, Impact
from morembs.dynamics.multibody.contact.tolerances import TOL
from morembs.dynamics.multibody.run import Events, Repeat, Run
from morembs.dynamics.multibody.system import Assembly, State, System


@checked
def simulate_contact(
    system: System,
    contacts: Sequence[Contact],
    *,
    end: float,
    step: float,
    rho: float = TOL.default_rho,
    begin: float = 0.0,
    tolerance: float = TOL.newton_error,
    corrected_start: bool = True,
    max_deflection: float | None = 1.0,
) -> ContactResult:
    """Integrate a system with contacts from ``begin`` to ``end`` (s) with steps of at most ``step``.

    Generalised alpha as in ``simulate``, with a linear complementarity problem on the level of positions in each step
    and on that of velocities at impacts (Stewart and Trinkle 1996), with Newton's law of restitution.

    A rigid point that touches again within one step of its last impact takes restitution zero there; infinitely many
    rebounds end so.

    Args:
        rho: spectral radius at infinite frequency, 1 no numerical damping, 0 the most.
        tolerance: of Newton's method, relative to the largest velocity in the norm of kinetic energy.
        corrected_start: start and restart of second order.
        max_deflection: of an elastic body in its floating frame, per length of the body; None for any.

    Raises:
        InputError: invalid times, joints that are open, points that penetrate their surface at the start.
        ContactError: contact without solution, a step that does not converge, or a deflection beyond its limit, with
            time and place; its ``result`` is the run so far.
    """
    if not contacts:
        raise InputError(
            "no contacts were given to simulate_contact; expected one or more, else take simulate",
            kind="missing",
            keyword="contacts",
        )
    events = ContactEvents(contacts, step)
    run = Run(
        system,
        events,
        begin=begin,
        end=end,
        step=step,
        rho=rho,
        tolerance=tolerance,
        corrected=corrected_start,
        max_deflection=max_deflection,
    )
    try:
        run.finish()
    except np.linalg.LinAlgError:
        time = run.states[-1].time if run.states else begin
        message = f"the equations of joints and contacts are dependent at t = {time:.9g} s (a lock or dead centre)"
        raise ContactError(message, result=events.result(run)) from None
    except RayError as error:
        raise ContactError(events.no_solution(error, run.states, begin), result=events.result(run)) from None
    except SolverError as error:
        raise ContactError(f"{error}. Contact: {events.place(run.states)}", result=events.result(run)) from None
    return cast(ContactResult, events.result(run))


class ContactEvents(Events):
    """Touches and ends of sliding as events of a run: what is kept of it, and when each point had its last impact."""

    advice = "Take a smaller step, a restitution of zero, or compliant points"

    def __init__(self, contacts: Sequence[Contact], step: float) -> None:
        self._contacts, self.step = contacts, step
        self.touches: list[ContactSegment] = []
        self.impacts: list[Impact] = []
        self.size, self.slowest = TOL.least_size, 0.0

    def start(self, assembly: Assembly, t: float, x: Floats, v: Floats) -> tuple[Floats, Floats]:
        self.assembly, self.group = assembly, Contacts(assembly, self._contacts)
        self.last = np.full(self.group.count, -math.inf)
        self._check_begin(t, x)
        none = np.zeros(self.group.count, dtype=bool)
        return self._impact(t, x, v, self._find_touching(x, v, none), none)

    def _check_begin(self, t: float, x: Floats) -> None:
        kinematics = self.group.kinematics(x)
        positions = [float(np.abs(p.position).max()) for p in self.assembly.places(x).values()]
        self.size = max([TOL.least_size, float(np.abs(kinematics.foot).max(initial=0.0)), *positions])
        inside = np.flatnonzero((kinematics.gap < -TOL.start_penetration * self.size) & ~self.group.compliant)
        if len(inside):
            named = "; ".join(
                f"{self.group.label(i)} by {-kinematics.gap[i]:.3g} m at {_words(kinematics.foot[i])} m"
                for i in inside[:3]
            )
            more = f" and {len(inside) - 3} more" if len(inside) > 3 else ""
            raise InputError(
                f"points are inside their surfaces at t = {t:.9g} s: {named}{more}. Place the bodies so that no point "
                "penetrates, or flip the surface (its normal points to where the points may be)",
                kind="model",
                keyword="points",
            )

    def _find_touching(self, x: Floats, v: Floats, closed: Bools) -> Bools:
        """Points that touch, or will within a millionth of a step."""
        kinematics = self.group.kinematics(x)
        soon = np.maximum(0.0, -kinematics.N @ v) * TOL.negligible_step * self.step
        return np.asarray((closed | (kinematics.gap <= TOL.touching_gap * self.size + soon)) & ~self.group.compliant)

    def restart(self, state: State) -> tuple[Assembly, Floats, Floats]:
        return self.assembly, *self._impact(state.time, state.x, state.v, self._met, cast(ContactState, state).closed)

    def _impact(self, t: float, x: Floats, v: Floats, touching: Bools, closed: Bools) -> tuple[Floats, Floats]:
        """Projected positions and velocities after the impact, if it is one."""
        group, assembly = self.group, self.assembly
        x = project_positions(assembly, group, t, x, touching)
        kinematics = group.kinematics(x)
        approach = kinematics.N @ v
        # What points approach with that were closed before is round-off of the scheme.
        hits = touching & (approach < -kinematics.round_off(v, 1e-12)) & ~closed
        again = t - self.last <= self.step * (1 + TOL.negligible_step)
        restitution = np.where(hits & ~again, group.restitution, 0.0)
        after = resolve_impact(assembly, group, t, x, v, touching, restitution, self.step)
        self._closed, self.slowest = after.closed, after.limit
        if hits.any():
            points = tuple(group.locate_point(int(i)) for i in np.flatnonzero(hits))
            self.impacts.append(
                Impact(
                    time=t,
                    points=points,
                    approach=np.where(touching, -approach, 0.0),
                    impulse=after.impulse,
                    friction=after.friction,
                    loss=-after.work,
                    driving=after.driving,
                    segment=len(self.touches),
                )
            )
            self.last[hits] = t
        return x, after.v

    def reactions(self, assembly: Assembly) -> ContactReactions:
        return ContactReactions(assembly, self.group, self._closed)

    def keep(self, states: Sequence[State]) -> None:
        self.touches.append(ContactSegment.of(cast(Sequence[ContactState], states)))

    def cut(self, before: State, after: State, repeat: Repeat) -> State | None:
        """Repeat the step up to its first event; the points that touch there are for the restart."""
        before, after = cast(ContactState, before), cast(ContactState, after)
        part, met = first_touch(before, after, np.flatnonzero(~before.closed & ~self.group.compliant))
        turn = sliding_ends(before, after, self.group, self.slowest)
        if not min(part, turn) < np.inf:
            return None
        if min(part, turn) < TOL.negligible_step:
            self._met = self._find_touching(before.x, before.v, before.closed)
            if part < TOL.negligible_step:
                self._met[met[before.kinematics.gap[met] <= TOL.start_penetration * self.size]] = True
            return before
        h = after.time - before.time
        turned = turn < part
        state = repeat(before.time + turn * h) if turned else self._touch(before.time, h, part, met, repeat)
        state = cast(ContactState, state)
        self._met = self._find_touching(state.x, state.v, state.closed)
        if not turned:
            self._refuse_inside(state, met)
            self._met[met[state.kinematics.gap[met] <= 10 * TOL.touching_gap * self.size]] = True
        return state

    def _touch(self, t0: float, h: float, part: float, met: NDArray[np.int_], repeat: Repeat) -> State:
        """The state at which the first of the points ``met`` touches, by Newton's method on its gap."""
        time = t0 + part * h
        for _ in range(TOL.touch_iterations):
            state = cast(ContactState, repeat(time))
            nearest = int(met[np.argmin(state.kinematics.gap[met])])
            gap, rate = float(state.kinematics.gap[nearest]), float(state.approach[nearest])
            if abs(gap) <= TOL.touching_gap * self.size or rate >= 0:
                break
            time = min(max(time - gap / rate, t0 + 0.5 * (time - t0)), t0 + h)
        return state

    def _refuse_inside(self, state: ContactState, met: NDArray[np.int_]) -> None:
        i = int(met[np.argmin(state.kinematics.gap[met])])
        if state.kinematics.gap[i] < -TOL.edge_penetration * self.size:
            raise SolverError(
                f"{self.group.label(i)} is {-state.kinematics.gap[i]:.3g} m inside its surface at t = "
                f"{state.time:.9g} s, at {_words(state.kinematics.foot[i])} m, without having crossed it: it came in "
                "over an edge. Let the surface reach further, or take smaller steps"
            )

    def result(self, run: Run) -> ContactResult | None:
        """The run so far, None where it did not begin."""
        if not run.so_far():
            return None
        return ContactResult(
            segments=tuple(run.segments), group=self.group, touches=tuple(self.touches), impacts=tuple(self.impacts)
        )

    def place(self, states: Sequence[State], points: Sequence[int] = ()) -> str:
        """Text on some points at the last state, by default those under load."""
        last = states[-1] if states else None
        if not isinstance(last, ContactState):
            return "no point touches"
        points = points or np.flatnonzero(last.force > 0).tolist()
        named = [f"{self.group.label(i)} at {_words(last.kinematics.foot[i])} m" for i in points[:3]]
        return ("; ".join(named) or "no point touches") + (f" and {len(points) - 3} more" if len(points) > 3 else "")

    def no_solution(self, error: RayError, states: Sequence[State], begin: float) -> str:
        """Message on a complementarity problem without solution."""
        points = np.flatnonzero(
            error.direction > TOL.named_force * max(error.direction.max(initial=0.0), TOL.tiny)
        ).tolist()
        time = states[-1].time if states else begin
        return (
            f"contact has no solution after t = {time:.9g} s: {self.place(states, points)} cannot be kept apart by any "
            "forces (Lemke's method ends on a ray). Look for points held from two sides by prescribed motions, and for "
            "friction so high that the body jams"
        )


def _words(point: Floats) -> str:
    return "(" + ", ".join(f"{c:.6g}" for c in np.round(point, 12) + 0.0) + ")"
