"""A run between two restarts, and what is where in it: components, markers and joints that events may replace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.dynamics.multibody.component import Component, Marker
from morembs.dynamics.multibody.joints import Constraint
from morembs.dynamics.multibody.system import Assembly, State


@dataclass(frozen=True, kw_only=True, eq=False)
class Segment:
    """A run between two restarts: times (s,), x (s, .), v (s, k), accelerations (s, k), multipliers (s, m)."""

    assembly: Assembly
    time: Floats
    x: Floats
    v: Floats
    acceleration: Floats
    multipliers: Floats

    @classmethod
    def of(cls, states: Sequence[State]) -> Segment:
        """The segment of states of one assembly."""
        return cls(
            assembly=states[0].assembly,
            time=np.array([s.time for s in states]),
            x=np.array([s.x for s in states]),
            v=np.array([s.v for s in states]),
            acceleration=np.array([s.acceleration for s in states]),
            multipliers=np.array([s.multipliers for s in states]),
        )

    def component(self, component: Component) -> Component:
        """The component itself, or the one of its name where a switch replaced it."""
        if component.size == 0 or self.assembly.index(component) is not None:
            return component
        return self.assembly.system.component(component.name)

    def marker(self, marker: Marker) -> Marker:
        """The marker itself, or the one of its name where a switch replaced its body."""
        component = self.component(marker.component)
        return marker if component is marker.component else component.marker(marker.name)

    def rows(self, joint: Constraint) -> slice:
        """The rows of a joint among the multipliers.

        Raises:
            InputError: a joint that is not in the system.
        """
        for rows, other in zip(self.assembly.in_rows, self.assembly.joints, strict=True):
            if other is joint or (joint.name and other.name == joint.name):
                return rows
        raise InputError(
            f"{joint.label} is not in the system during the whole run; name joints that a switch replaces",
            kind="unknown",
        )


def wrench_on(marker: Marker, assembly: Assembly, t: float, x: Floats, v: Floats, multipliers: Floats) -> Floats:
    """(6,) of all joints and forces on a marker, at it, along the inertial axes."""
    total = np.zeros(6)
    for joint, rows in zip(assembly.joints, assembly.in_rows, strict=True):
        if marker is joint.first or marker is joint.second:
            _, on_first, on_second = joint.rows(assembly.place(joint.first, x), assembly.place(joint.second, x))
            for end, G in ((joint.first, on_first), (joint.second, on_second)):
                total -= multipliers[rows] @ G if end is marker else 0.0
    for force in assembly.forces:
        if any(end is marker for end in force.markers):
            places = [assembly.place(end, x) for end in force.markers]
            twists = [assembly.twist(end, place, v) for end, place in zip(force.markers, places, strict=True)]
            for end, wrench in zip(force.markers, force.wrenches(t, places, twists), strict=True):
                total += wrench[:6] if end is marker else 0.0
    return total
