"""simulate_contact(): a run with unilateral contact, driven by events.

Between events: generalised-alpha of second order, with contact on the level of positions in each step. At a touch: the
step is cut at it, positions are closed up, velocities jump by complementarity with restitution, and the scheme starts
anew with its second-order start. Sliding that turns round or ends is an event too. Points that separate need none,
nor do compliant points, whose forces begin at zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError, SolverError
from morembs.multibody.contact import Contact, Contacts
from morembs.multibody.contact_impact import closed_up, first_touch, jump, sliding_ends
from morembs.multibody.contact_result import ContactError, ContactResult, ContactSegment, Impact
from morembs.multibody.contact_start import speed_limit
from morembs.multibody.contact_step import ContactState, ContactStepper
from morembs.multibody.integrate import Scheme
from morembs.multibody.lemke import RayError
from morembs.multibody.result import Segment
from morembs.multibody.run import _check_times
from morembs.multibody.system import Assembly, System

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
_CLOSE = 1e-6
# Touching, as part of the size of the system: for the search, and at most at the begin.
_TOUCH, _PENETRATION = 1e-11, 1e-9
_SEARCH = 8
# Events within one step after which a run is given up.
_EVENTS = 400


def simulate_contact(
    system: System, contacts: Sequence[Contact], *, end: float, step: float, rho: float = 0.8, begin: float = 0.0,
    tolerance: float = 1e-9, corrected_start: bool = True,
) -> ContactResult:  # fmt: skip
    """Integrate a system with contacts from ``begin`` to ``end`` (s) with steps of at most ``step``.

    A rigid point that touches again within one step of its last impact takes restitution zero there; infinitely many
    rebounds end so.

    Args:
        rho: spectral radius at infinite frequency, 1 no numerical damping, 0 the most.
        tolerance: of Newton's method, relative to the largest velocity in the norm of kinetic energy.
        corrected_start: start and restart of second order.

    Raises:
        InputError: nonsense times, joints that are open, points that penetrate their surface at the begin.
        ContactError: contact without solution, or a step that does not converge, with time and place; its ``result``
            is the run so far.
    """
    _check_times(begin, end, step, tolerance)
    assembly = Assembly(system)
    if not contacts:
        raise InputError("no contacts were given to simulate_contact; expected one or more, else take simulate")
    x, v = assembly.start()
    assembly.check_start(begin, x, v)
    run = _ContactRun(assembly, Contacts(assembly, contacts), Scheme(rho=rho), end, step, tolerance, corrected_start)
    return run.all(begin, x, v)


class _ContactRun:
    """State of a run: what is done, when each point had its last impact, how many events there were."""

    def __init__(
        self, assembly: Assembly, group: Contacts, scheme: Scheme, end: float, step: float, tolerance: float,
        corrected: bool,
    ) -> None:  # fmt: skip
        self.assembly, self.group, self.scheme, self.end, self.step = assembly, group, scheme, end, step
        self.tolerance, self.corrected = tolerance, corrected
        self.segments: list[Segment] = []
        self.touches: list[ContactSegment] = []
        self.impacts: list[Impact] = []
        self.states: list[ContactState] = []
        self.last = np.full(group.count, -math.inf)
        self.events: list[float] = []
        self.length, self.limit = 1e-3, 0.0

    def all(self, t: float, x: Floats, v: Floats) -> ContactResult:
        """The whole run."""
        self._check_begin(t, x)
        touching = self._touching(x, v, np.zeros(self.group.count, dtype=bool))
        try:
            while True:
                x, v, closed = self._restart(t, x, v, touching)
                met = self._until_event(t, x, v, closed)
                last = self.states[-1].state
                t, x, v = last.time, last.x, last.v
                self._close()
                if met is None:
                    return self._result()
                touching = met
        except np.linalg.LinAlgError:
            message = f"the equations of joints and contacts are dependent at t = {t:.9g} s (a lock or dead point)"
            raise ContactError(message, result=self._so_far()) from None
        except RayError as error:
            raise ContactError(self._ray_words(error), result=self._so_far()) from None
        except ContactError:
            raise
        except SolverError as error:
            where = self._place(self._pressed())
            raise ContactError(f"{error}. Contact: {where}", result=self._so_far()) from None

    def _check_begin(self, t: float, x: Floats) -> None:
        meeting = self.group.meet(x)
        positions = [float(np.abs(p.position).max()) for p in self.assembly.places(x).values()]
        self.length = max([1e-3, float(np.abs(meeting.foot).max(initial=0.0)), *positions])
        inside = np.flatnonzero((meeting.gap < -_PENETRATION * self.length) & ~self.group.compliant)
        if len(inside):
            named = "; ".join(
                f"{self.group.label(i)} by {-meeting.gap[i]:.3g} m at {_words(meeting.foot[i])} m" for i in inside[:3]
            )
            more = f" and {len(inside) - 3} more" if len(inside) > 3 else ""
            raise InputError(
                f"points are inside their surfaces at t = {t:.9g} s: {named}{more}. Place the bodies so that no point "
                "penetrates, or turn the surface round (its normal points to where the points may be)"
            )

    def _touching(self, x: Floats, v: Floats, closed: Bools) -> Bools:
        """Points that touch, or will within a millionth of a step."""
        meeting = self.group.meet(x)
        soon = np.maximum(0.0, -meeting.N @ v) * _CLOSE * self.step
        return np.asarray((closed | (meeting.gap <= _TOUCH * self.length + soon)) & ~self.group.compliant)

    def _restart(self, t: float, x: Floats, v: Floats, touching: Bools) -> tuple[Floats, Floats, Bools]:
        """Closed positions and velocities after the impact, if it is one."""
        group, assembly = self.group, self.assembly
        x = closed_up(assembly, group, t, x, touching)
        meeting = group.meet(x)
        approach = meeting.N @ v
        limit = speed_limit(meeting, v, 1e-12)
        hits = touching & (approach < -limit) & ~self._resting(touching)
        again = t - self.last <= self.step * (1 + _CLOSE)
        restitution = np.where(hits & ~again, group.restitution, 0.0)
        after = jump(assembly, group, t, x, v, touching, restitution, self.step)
        self.limit = after.limit
        if hits.any():
            points = tuple(self._named(int(i)) for i in np.flatnonzero(hits))
            self.impacts.append(
                Impact(
                    time=t, points=points, approach=np.where(touching, -approach, 0.0), impulse=after.impulse,
                    friction=after.friction, loss=-after.work, segment=len(self.segments),
                )
            )  # fmt: skip
            self.last[hits] = t
        return x, after.v, after.closed

    def _resting(self, touching: Bools) -> Bools:
        """Points that were closed before already: what they approach with is round-off of the scheme."""
        if not self.touches:
            return np.zeros_like(touching)
        return np.asarray(touching & self._closed)

    def _named(self, i: int) -> tuple[str, int]:
        for contact, rows in zip(self.group.contacts, self.group.rows, strict=True):
            if rows.start <= i < rows.stop:
                return contact.name, int(i - rows.start)
        return "", int(i)

    def _stepper(
        self, t: float, x: Floats, v: Floats, h: float, closed: Bools, like: ContactStepper | None = None
    ) -> ContactStepper:
        return ContactStepper(
            self.scheme, self.assembly, self.group, t=t, x=x, v=v, h=h, tolerance=self.tolerance, closed=closed,
            corrected=self.corrected, tangents=None if like is None else like.tangents,
        )  # fmt: skip

    def _until_event(self, t: float, x: Floats, v: Floats, closed: Bools) -> Bools | None:
        """Steps until an event; the points that touch at it, or None at the end of the run."""
        left = self.end - t
        self._closed = closed
        count = max(1, math.ceil(left / self.step * (1 - 1e-12)))
        if left <= _CLOSE * self.step:
            self.states = [self._stepper(t, x, v, self.step, closed).state]
            return None
        h = left / count
        stepper = self._stepper(t, x, v, h, closed)
        self.states = [stepper.state]
        for number in range(1, count + 1):
            before, closed = self.states[-1], stepper.closed.copy()
            after = stepper.advance(t + number * h)
            watched = np.flatnonzero(~closed & ~self.group.compliant)
            part, met = first_touch(before, after, watched)
            turn = sliding_ends(before, after, self.group, self.limit)
            self._closed = stepper.closed
            if min(part, turn) < np.inf:
                self._count(before.state.time + min(part, turn) * h)
                return self._cut(stepper, before, closed, part, turn, met, h)
            self.states.append(after)
        return None

    def _cut(
        self, stepper: ContactStepper, before: ContactState, closed: Bools, part: float, turn: float,
        met: NDArray[np.int_], h: float,
    ) -> Bools:  # fmt: skip
        """Repeat the step up to its first event; the points that touch there."""
        t0, old = before.state.time, before.state
        self._closed = closed
        if min(part, turn) < _CLOSE:
            touching = self._touching(old.x, old.v, closed)
            if part < _CLOSE:
                touching[met[before.meeting.gap[met] <= _PENETRATION * self.length]] = True
            return touching
        v0 = jump(self.assembly, self.group, t0, old.x, old.v, closed, np.zeros(self.group.count), h).v
        time, limit = t0 + min(part, turn) * h, _TOUCH * self.length
        state, now = before, closed
        for _ in range(_SEARCH):
            short = self._stepper(t0, old.x, v0, time - t0, closed, stepper)
            state, now = short.advance(time), short.closed
            if turn < part:
                break
            nearest = int(met[np.argmin(state.meeting.gap[met])])
            gap, rate = float(state.meeting.gap[nearest]), float(state.approach[nearest])
            if abs(gap) <= limit or rate >= 0:
                break
            time = min(max(time - gap / rate, t0 + 0.5 * (time - t0)), t0 + h)
        self.states.append(state)
        self._closed = now
        touching = self._touching(state.state.x, state.state.v, now)
        if part <= turn:
            deep = float(state.meeting.gap[met].min())
            if deep < -1e-6 * self.length:
                i = int(met[np.argmin(state.meeting.gap[met])])
                raise SolverError(
                    f"{self.group.label(i)} is {-deep:.3g} m inside its surface at t = {time:.9g} s, at "
                    f"{_words(state.meeting.foot[i])} m, without having crossed it: it came in over an edge. Let the "
                    "surface reach further, or take smaller steps"
                )
            touching[met[state.meeting.gap[met] <= 10 * limit]] = True
        return touching

    def _count(self, time: float) -> None:
        self.events = [e for e in self.events if e > time - self.step] + [time]
        if len(self.events) > _EVENTS:
            raise SolverError(
                f"more than {_EVENTS} impacts or reversals within one step before t = {time:.9g} s. Take a smaller "
                "step, a restitution of zero, or compliant points"
            )

    def _close(self) -> None:
        self.segments.append(Segment.of([s.state for s in self.states]))
        self.touches.append(ContactSegment.of(self.states))

    def _result(self) -> ContactResult:
        return ContactResult(
            segments=tuple(self.segments), group=self.group, touches=tuple(self.touches), impacts=tuple(self.impacts)
        )

    def _so_far(self) -> ContactResult | None:
        done = sum(len(s.time) for s in self.segments)
        if self.states and (not self.segments or self.states[-1].state.time > self.segments[-1].time[-1]):
            self._close()
            done += 1
        return self._result() if done else None

    def _pressed(self) -> list[int]:
        return np.flatnonzero(self.states[-1].force > 0).tolist() if self.states else []

    def _place(self, points: list[int]) -> str:
        if not self.states or not points:
            return "no point touches"
        foot = self.states[-1].meeting.foot
        named = [f"{self.group.label(i)} at {_words(foot[i])} m" for i in points[:3]]
        return "; ".join(named) + (f" and {len(points) - 3} more" if len(points) > 3 else "")

    def _ray_words(self, error: RayError) -> str:
        points = np.flatnonzero(error.direction > 1e-6 * max(error.direction.max(initial=0.0), 1e-300)).tolist()
        time = self.states[-1].state.time if self.states else 0.0
        return (
            f"contact has no solution after t = {time:.9g} s: {self._place(points or self._pressed())} cannot be kept "
            "apart by any forces (Lemke's method ends on a ray). Look for points held from two sides by prescribed "
            "motions, and for friction so high that the body jams"
        )


def _words(point: Floats) -> str:
    return "(" + ", ".join(f"{c:.6g}" for c in np.round(point, 12) + 0.0) + ")"
