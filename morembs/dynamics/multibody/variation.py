"""Elastic bodies whose data depend on parameters: derivatives of their equations, and systems at values nearby."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats
from morembs.body.floating.integrals import ShapeIntegrals
from morembs.dynamics.multibody.bodies import FlexibleBody, inertia_of
from morembs.dynamics.multibody.component import Marker, MarkerState
from morembs.dynamics.multibody.floating_body import BodyMarker
from morembs.dynamics.multibody.forces import Force
from morembs.dynamics.multibody.joints import Constraint
from morembs.dynamics.multibody.rotations import cross, tangent, tangent_slope
from morembs.dynamics.multibody.system import Assembly, State
from morembs.dynamics.multibody.tangents import Pull
from morembs.dynamics.multibody.tolerances import TOL


def slope_at_zero(values: Callable[[float], Floats], step: float) -> Floats:
    """Derivative at zero of an array that depends on a number, of fourth order in ``step``."""
    return np.asarray((8 * (values(step) - values(-step)) - (values(2 * step) - values(-2 * step))) / (12 * step))


@dataclass(frozen=True, kw_only=True, eq=False)
class StateSlopes:
    """Derivatives of states by P parameters: configuration ``x`` as a step (k, P) from it, velocity ``v``,
    ``acceleration`` (k, P) and ``multipliers`` (m, P)."""

    x: Floats
    v: Floats
    acceleration: Floats
    multipliers: Floats


class Variation:
    """How the equations of an assembly change with the parameter ``key`` of its elastic ``body``."""

    def __init__(self, assembly: Assembly, body: FlexibleBody, key: str) -> None:
        self.name, self.assembly, self.body, self.slope = f"{body.name}.{key}", assembly, body, body.derivatives[key]
        number = assembly.index(body)
        if number is None:
            raise InputError(f"body {body.name!r} is not in the system; add it first", kind="unknown")
        self.number, self.in_x, self.in_v = number, assembly.in_x[number], assembly.in_v[number]
        # Inertia and elastic forces are linear in the data of a body.
        self._slope_body = self._body_of(self.slope.integrals, self.slope.Ke, self.slope.De)
        self._markers = {id(body.markers[key]): slope for key, slope in self.slope.markers.items()}
        for markers in [(j.first, j.second) for j in assembly.joints] + [f.markers for f in assembly.forces]:
            self._check(markers)

    def _check(self, markers: Sequence[Marker]) -> None:
        for marker in markers:
            if marker.component is self.body and id(marker) not in self._markers:
                raise InputError(
                    f"{marker.label} holds a joint or force, and no derivatives of this marker by {self.name} are "
                    "known; expected an interface of the body",
                    kind="unsupported",
                    keyword="derivatives",
                )

    def _body_of(self, integrals: ShapeIntegrals, Ke: Floats, De: Floats) -> FlexibleBody:
        body = copy.copy(self.body)
        body.inertia, body.Ke, body.De = inertia_of(integrals), Ke, De
        return body

    @cached_property
    def step(self) -> float:
        """Change of the parameter that changes no matrix of the body by more than a part of ``TOL.varied_part``."""
        frame, slope, rates = self.body.frame, self.slope, [0.0]
        pairs = [(frame.Ke, slope.Ke), (frame.De, slope.De), (frame.elastic, slope.elastic)]
        names = ("mass", "inertia", "Me", "phi_phi")
        pairs += [(getattr(frame.integrals, name), getattr(slope.integrals, name)) for name in names]
        for value, change in pairs:
            size = float(np.abs(value).max(initial=0.0))
            rates.append(float(np.abs(change).max(initial=0.0)) / size if size else 0.0)
        return TOL.varied_part / max(rates) if max(rates) else TOL.varied_part

    def at(self, change: float) -> Assembly:
        """The assembly at a value of the parameter that differs by ``change``, to first order."""
        frame, slope = self.body.frame, self.slope
        parts = {
            entry.name: getattr(frame.integrals, entry.name) + change * getattr(slope.integrals, entry.name)
            for entry in fields(ShapeIntegrals)
        }
        body = self._body_of(ShapeIntegrals(**parts), frame.Ke + change * slope.Ke, frame.De + change * slope.De)
        markers = {}
        for key, by in slope.markers.items():
            known = self.body.markers[key]
            moved = replace(known, point=known.point + change * by.point, motion=known.motion + change * by.motion)
            markers[id(known)] = moved
        return _Nearby(self.assembly, self.number, body, markers)

    def partials(self, state: State, pulls: Sequence[Pull]) -> tuple[Floats, Floats]:
        """Derivatives, at a fixed configuration, velocity, acceleration and multipliers, of the equations of motion
        M dv/dt + g + B' multipliers (k,) and of the joints' Phi (m,); ``pulls`` are those of the state."""
        a, x = self.assembly, state.x[self.in_x]
        M, g = self._slope_body.dynamics(state.time, x, state.v[self.in_v], a.gravity)
        forces, Phi = np.zeros(a.size), np.zeros(a.rows)
        forces[self.in_v] = M @ state.acceleration[self.in_v] + g
        for pull in pulls:
            if any(marker.component is self.body for marker in pull.ends):
                self._add_pull(pull, state, x, forces, Phi)
        return forces, Phi

    def _add_pull(self, pull: Pull, state: State, x: Floats, forces: Floats, Phi: Floats) -> None:
        """Adds to ``forces`` and ``Phi`` the changes of a joint or force as its markers move with the parameter."""
        if pull.bend is None:
            forces += slope_at_zero(lambda change: self._load(pull.part, state, change), self.step)
            return
        moves = np.zeros(6 * len(pull.ends))
        for number, (marker, wrench) in enumerate(zip(pull.ends, pull.wrenches, strict=True)):
            if marker.component is self.body:
                moves[6 * number : 6 * number + 6], own = self._marker(marker, x, wrench)
                forces[self.in_v] += own
        bent = (pull.bend @ moves).reshape(-1, 6)
        for marker, place, change in zip(pull.ends, pull.places, bent, strict=True):
            i = self.assembly.index(marker.component)
            if i is not None:
                forces[self.assembly.in_v[i]] += change @ place.jacobian
        if pull.rows is not None and pull.G is not None:
            Phi[pull.rows] += pull.G @ moves

    def _marker(self, marker: Marker, x: Floats, wrench: Floats) -> tuple[Floats, Floats]:
        """Derivatives of the place of a marker, as displacement and rotation (6,) along the inertial axes, and of the
        generalised forces of a constant ``wrench`` (6,) on it."""
        slope, turns = self._markers[id(marker)], self.body.markers[marker.name].motion[3:]
        R, q = x[3:12].reshape(3, 3), x[12:]
        force, moment, small, change = wrench[:3] @ R, wrench[3:] @ R, turns @ q, slope.motion @ q
        T, arm = tangent(small), slope.point + change[:3]
        shapes = force @ slope.motion[:3] + (T @ moment) @ slope.motion[3:]
        shapes += (tangent_slope(small, moment) @ change[3:]) @ turns
        place = np.concatenate((R @ arm, R @ (T.T @ change[3:])))
        return place, np.concatenate((np.zeros(3), cross(arm, force), shapes))

    def _load(self, force: Constraint | Force, state: State, change: float) -> Floats:
        nearby, g = self.at(change), np.zeros(self.assembly.size)
        if isinstance(force, Constraint):
            raise InputError(f"{force.label} knows no derivatives of its forces; sensitivities need them")
        nearby.load(force, state.time, state.v, [nearby.place(m, state.x) for m in force.markers], g)
        return g


class _Nearby(Assembly):
    """An assembly with another body in the place of the one of that number, and its markers by their ids."""

    def __init__(self, assembly: Assembly, number: int, body: FlexibleBody, markers: dict[int, BodyMarker]) -> None:
        # All but these is shared; what was put together once is not put together again.
        self.__dict__.update(assembly.__dict__)
        self.components = [*assembly.components[:number], body, *assembly.components[number + 1 :]]
        self._moved = markers

    def place(self, marker: Marker, x: Floats) -> MarkerState:
        return super().place(self._moved.get(id(marker), marker), x)


def variations(assembly: Assembly, wanted: Sequence[str] | bool) -> list[Variation]:
    """Those of the parameters ``wanted``, as "body.parameter", or of all that are known.

    Raises:
        InputError: an unknown parameter, none at all, or a part of the system that allows no derivatives.
    """
    for force in assembly.forces:
        kind = type(force)
        if kind.begin_step is not Force.begin_step or kind.for_run is not Force.for_run:
            raise InputError(
                f"force {force.name!r} ({kind.__name__}) remembers what happened or switches; sensitivities are known "
                "for systems of joints, loads and springs, without contact, friction and events",
                kind="unsupported",
                keyword="force",
            )
    bodies = [c for c in assembly.components if isinstance(c, FlexibleBody)]
    known = {f"{body.name}.{key}": (body, key) for body in bodies for key in body.derivatives}
    if not known:
        raise InputError(
            "sensitivities were asked for, and no body knows derivatives; give some to "
            "FlexibleBody(..., derivatives=body.at(...).frame_derivatives())",
            kind="missing",
            keyword="derivatives",
        )
    # A text is a sequence of texts too.
    names = list(known) if isinstance(wanted, bool) else [wanted] if isinstance(wanted, str) else list(wanted)
    for name in names:
        if name not in known:
            raise InputError(
                f"the sensitivity to {name!r} was asked for; {nearest(name, list(known))}",
                kind="unknown",
                keyword="sensitivities",
            )
    return [Variation(assembly, *known[name]) for name in names]
