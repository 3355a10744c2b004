"""Histories of a run: motions of markers, elastic coordinates, energies, forces of joints."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.summary import summarised
from morembs.base.types import Floats
from morembs.dynamics.multibody.bodies import FlexibleBody
from morembs.dynamics.multibody.component import Component, Marker, MarkerState
from morembs.dynamics.multibody.floating_body import FloatingBody
from morembs.dynamics.multibody.joints import Constraint
from morembs.dynamics.multibody.linear_body import LinearBody
from morembs.dynamics.multibody.segment import Segment, wrench_on
from morembs.dynamics.multibody.tolerances import TOL
from morembs.dynamics.multibody.variation import StateSlopes, Variation


@dataclass(frozen=True, kw_only=True, eq=False)
class Energy:
    """Histories (s,) in J: kinetic, potential (gravity, strain, springs), and the work put in since the start.

    ``work`` is that of loads, dampers and prescribed motions (negative where they take energy), by the trapezoidal
    rule; ``total - work`` is constant up to integration error.
    """

    kinetic: Floats
    potential: Floats
    work: Floats

    @property
    def total(self) -> Floats:
        """Kinetic and potential energy."""
        return self.kinetic + self.potential


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    """A run as its segments; a time at which it was restarted occurs twice, before and after the switch."""

    segments: tuple[Segment, ...]
    sensitivities: Mapping[str, ResultSensitivity] = field(default_factory=dict)

    def _facts(self) -> dict[str, object]:
        return {"segments": self.segments, "sensitivities": list(self.sensitivities)}

    def sensitivity(self, name: str) -> ResultSensitivity:
        """Derivatives with respect to a parameter, "body.parameter".

        Raises:
            InputError: one that was not asked for.
        """
        if name not in self.sensitivities:
            raise InputError(
                f"the sensitivity to {name!r} was asked for; {nearest(name, self.sensitivities)} (simulate and "
                "equilibrium find those in sensitivities=)",
                kind="unknown",
                keyword="sensitivity",
            )
        return self.sensitivities[name]

    @cached_property
    def time(self) -> Floats:
        """Times (s,), s."""
        return np.concatenate([s.time for s in self.segments])

    def _markers(self, marker: Marker, value: Callable[[MarkerState, Floats], Floats]) -> Floats:
        rows = []
        for segment in self.segments:
            same, assembly = segment.marker(marker), segment.assembly
            for x, v in zip(segment.x, segment.v, strict=True):
                place = assembly.place(same, x)
                rows.append(value(place, assembly.twist(same, place, v)))
        return np.array(rows)

    def motion(self, marker: Marker) -> dict[str, Floats]:
        """``position``, ``axes``, ``velocity`` and ``angular_velocity`` of a marker by these names, as the methods give
        them, in a quarter of their time."""

        def all_of(place: MarkerState, twist: Floats) -> Floats:
            return np.concatenate((place.position, place.axes.ravel(), twist))

        rows = self._markers(marker, all_of)
        return {
            "position": rows[:, :3],
            "axes": rows[:, 3:12].reshape(-1, 3, 3),
            "velocity": rows[:, 12:15],
            "angular_velocity": rows[:, 15:],
        }

    def position(self, marker: Marker) -> Floats:
        """(s, 3) m."""
        return self._markers(marker, lambda place, _: place.position)

    def axes(self, marker: Marker) -> Floats:
        """(s, 3, 3): axes of the marker as columns."""
        return self._markers(marker, lambda place, _: place.axes)

    def velocity(self, marker: Marker) -> Floats:
        """(s, 3) m/s along the inertial axes."""
        return self._markers(marker, lambda _, twist: twist[:3])

    def angular_velocity(self, marker: Marker) -> Floats:
        """(s, 3) rad/s along the inertial axes."""
        return self._markers(marker, lambda _, twist: twist[3:])

    def _coordinates(self, component: Component, pick: Callable[[Segment], Floats], in_x: bool) -> Floats:
        parts = []
        for segment in self.segments:
            i = segment.assembly.index(segment.component(component))
            if i is not None:
                parts.append(pick(segment)[:, (segment.assembly.in_x if in_x else segment.assembly.in_v)[i]])
        if len({p.shape[1] for p in parts}) > 1:
            raise InputError(f"{component.name!r} changes its coordinates during the run; read them from segments")
        return np.concatenate(parts)

    def configuration(self, component: Component) -> Floats:
        """(s, .): configuration of a component, as it defines it.

        Raises:
            InputError: a component that changes its coordinates during the run; so do ``speeds`` and ``elastic``.
        """
        return self._coordinates(component, lambda segment: segment.x, True)

    def speeds(self, component: Component) -> Floats:
        """(s, k): velocities of a component, as it defines them."""
        return self._coordinates(component, lambda segment: segment.v, False)

    def elastic(self, body: FloatingBody) -> Floats:
        """(s, n): elastic coordinates of a body."""
        return self.configuration(body)[:, 12:]

    def stress(self, body: FloatingBody, shapes: Floats) -> Floats:
        """(s, points, 6) Pa: stresses that are ``shapes`` (6 points, n) times the elastic coordinates."""
        return (self.elastic(body) @ shapes.T).reshape(len(self.time), -1, 6)

    def multipliers(self, joint: Constraint) -> Floats:
        """(s, m): multipliers of a joint, one per row of its constraints."""
        return np.concatenate([s.multipliers[:, s.rows(joint)] for s in self.segments])

    def reaction(self, joint: Constraint) -> Floats:
        """(s, 6): force N and moment Nm of the joint on its second marker, at that marker, along the inertial axes."""
        rows = []
        for segment in self.segments:
            assembly = segment.assembly
            r = segment.rows(joint)
            for x, multipliers in zip(segment.x, segment.multipliers, strict=True):
                _, _, G = joint.rows(assembly.place(joint.first, x), assembly.place(joint.second, x))
                rows.append(-multipliers[r] @ G)
        return np.array(rows)

    def load(self, marker: Marker) -> Floats:
        """(s, 6): force N and moment Nm that all joints and forces put on the body at a marker, along the axes of the
        body. Contacts are not in it."""
        rows = []
        for segment in self.segments:
            same, assembly = segment.marker(marker), segment.assembly
            for t, x, v, multipliers in zip(segment.time, segment.x, segment.v, segment.multipliers, strict=True):
                wrench = wrench_on(same, assembly, float(t), x, v, multipliers)
                number = assembly.index(same.component)
                if number is not None and isinstance(same.component, FloatingBody):
                    R = x[assembly.in_x[number]][3:12].reshape(3, 3)
                    wrench = np.concatenate((wrench[:3] @ R, wrench[3:] @ R))
                rows.append(wrench)
        return np.array(rows)

    def trajectory(self, body: FlexibleBody | LinearBody, interfaces: Sequence[str] = ()) -> dict[str, Floats]:
        """What ``recover`` needs of an elastic body, by its names: ``numpy.savez("motion.npz", **trajectory)``.

        ``times`` (nt,) s, ``coordinates`` (nt, n), for a floating body ``position`` (nt, 3) m and ``rotation``
        (nt, 3, 3) of its frame, and where ``interfaces`` are named (markers of the body; all those of the body file, in
        its order) ``loads`` (nt, 6 k), as ``load`` gives them. A time of a restart comes once, after the switch.

        Raises:
            InputError: another kind of body, or one that has no such marker.
        """
        if not isinstance(body, FlexibleBody | LinearBody):
            raise InputError(
                f"the trajectory of {body.name!r} was asked for; expected a FlexibleBody or a LinearBody "
                "(local_response gives the stress under sliding loads)",
                keyword="trajectory",
            )
        x, times = self.configuration(body), self.time
        if len(x) != len(times):
            raise InputError(
                f"{body.name!r} is not in the system during the whole run; take its segments", kind="unknown"
            )
        arrays = {"times": times, "coordinates": x}
        if isinstance(body, FlexibleBody):
            arrays |= {"coordinates": x[:, 12:], "position": x[:, :3], "rotation": x[:, 3:12].reshape(-1, 3, 3)}
        if interfaces:
            arrays["loads"] = np.hstack([self.load(body.marker(name)) for name in interfaces])
        last = np.append(np.diff(times) > 0, True)
        return {name: values[last] for name, values in arrays.items()}

    def energy(self) -> Energy:
        """Kinetic and potential energy and work over time."""
        kinetic, potential, work, done = [], [], [], 0.0
        for segment in self.segments:
            assembly, last = segment.assembly, None
            for t, x, v, multipliers in zip(segment.time, segment.x, segment.v, segment.multipliers, strict=True):
                T, V = assembly.energy(x, v)
                power = assembly.power(float(t), x, v, multipliers)
                if last is not None:
                    done += 0.5 * (power + last[1]) * (float(t) - last[0])
                last = float(t), power
                kinetic.append(T)
                potential.append(V)
                work.append(done)
        return Energy(kinetic=np.array(kinetic), potential=np.array(potential), work=np.array(work))


class ResultSensitivity:
    """Derivatives of the values of a ``Result`` with respect to one ``parameter``, per unit of it.

    Angles and rest lengths that joints and springs keep from the start do not change. Elastic coordinates are those of
    the shapes at the value, which stay.
    """

    def __init__(self, segment: Segment, of: Variation, slopes: Sequence[StateSlopes], number: int) -> None:
        self.parameter, self._segment, self._of = of.name, segment, of
        self._slopes = [
            np.array([getattr(each, name)[:, number] for each in slopes])
            for name in ("x", "v", "acceleration", "multipliers")
        ]
        fastest = float(np.abs(self._slopes[0]).max(initial=0.0))
        self._step = min(of.step, TOL.varied_part / fastest) if fastest else of.step

    @cached_property
    def _nearby(self) -> dict[int, Result]:
        """Results at values of the parameter that differ by some steps, to first order."""
        return {number: self._at(number * self._step) for number in (-2, -1, 1, 2)}

    def _at(self, change: float) -> Result:
        base, (x, v, acceleration, multipliers) = self._segment, self._slopes
        return Result(
            segments=(
                Segment(
                    assembly=self._of.at(change),
                    time=base.time,
                    x=np.array([base.assembly.move(a, change * b) for a, b in zip(base.x, x, strict=True)]),
                    v=base.v + change * v,
                    acceleration=base.acceleration + change * acceleration,
                    multipliers=base.multipliers + change * multipliers,
                ),
            )
        )

    def of(self, values: Callable[[Result], Floats]) -> Floats:
        """Derivative of any smooth ``values`` of a result: ``slope.of(lambda result: result.axes(marker))``."""
        at = {number: np.asarray(values(result)) for number, result in self._nearby.items()}
        return np.asarray((8 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12 * self._step))

    @property
    def configuration_step(self) -> Floats:
        """(s, k): derivative of the configuration, as a step from it in the velocity coordinates of the components."""
        return self._slopes[0]

    def position(self, marker: Marker) -> Floats:
        """(s, 3) m per unit."""
        return self.of(lambda result: result.position(marker))

    def velocity(self, marker: Marker) -> Floats:
        """(s, 3) m/s per unit, along the inertial axes."""
        return self.of(lambda result: result.velocity(marker))

    def elastic(self, body: FloatingBody) -> Floats:
        """(s, n) per unit."""
        return self.of(lambda result: result.elastic(body))

    def reaction(self, joint: Constraint) -> Floats:
        """(s, 6) N and Nm per unit, as ``Result.reaction``."""
        return self.of(lambda result: result.reaction(joint))

    def load(self, marker: Marker) -> Floats:
        """(s, 6) N and Nm per unit, as ``Result.load``."""
        return self.of(lambda result: result.load(marker))

    def stress(self, body: FloatingBody, shapes: Floats, change: Floats | None = None) -> Floats:
        """(s, points, 6) Pa per unit, as ``Result.stress`` of ``shapes`` that change by ``change`` per unit."""
        slope = self.of(lambda result: result.stress(body, shapes))
        return slope if change is None else slope + Result(segments=(self._segment,)).stress(body, change)


def sensitivities(
    segment: Segment, variations: Sequence[Variation], slopes: Sequence[StateSlopes]
) -> dict[str, ResultSensitivity]:
    """Those of a segment, of the derivatives of its states, by the names of the parameters."""
    return {of.name: ResultSensitivity(segment, of, slopes, j) for j, of in enumerate(variations)}
