"""A system: components, joints and forces, put together once and evaluated as a whole."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

import numpy as np
import scipy.linalg as sl
from numpy.typing import ArrayLike

from morembs.base.arguments import checked
from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats
from morembs.dynamics.multibody.component import Component, Marker, MarkerState, vector
from morembs.dynamics.multibody.forces import Force
from morembs.dynamics.multibody.joints import Constraint
from morembs.dynamics.multibody.tolerances import TOL

Part = TypeVar("Part", bound=Component | Constraint | Force)


@checked
class System:
    """Components, joints and forces under ``gravity`` (3,) m/s2.

    ``add`` returns its argument. A system may be simulated many times; each component starts as it was made.
    """

    def __init__(self, *, gravity: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        self.gravity = vector("gravity", gravity)
        self.components: list[Component] = []
        self.joints: list[Constraint] = []
        self.forces: list[Force] = []

    def add(self, part: Part) -> Part:
        """Add a component, a joint or a force; components before what is attached to them.

        Raises:
            InputError: a name that is taken, a marker of a component that is not in the system.
        """
        if isinstance(part, Component):
            if any(part.name == other.name for other in self.components):
                raise InputError(
                    f"a body {part.name!r} is in the system already; give each body a name of its own",
                    kind="conflict",
                    keyword="name",
                )
            self.components.append(part)
        elif isinstance(part, Constraint):
            self._check_attached(part.label, (part.first, part.second))
            if part.first.component is part.second.component:
                raise InputError(
                    f"{part.label}: both markers are on one body; expected two bodies, or one and ground",
                    kind="conflict",
                )
            self.joints.append(part)
        elif isinstance(part, Force):
            self._check_attached(f"force {part.name!r}", part.markers)
            self.forces.append(part)
        else:
            raise InputError(
                f"{type(part).__name__} was given; expected a component, a joint or a force", keyword="add"
            )
        return part

    def _check_attached(self, what: str, markers: Sequence[Marker]) -> None:
        for marker in markers:
            if marker.component.size and not any(marker.component is component for component in self.components):
                raise InputError(f"{what}: {marker.label} is not in the system; add its body first", kind="unknown")

    def component(self, name: str) -> Component:
        """The component of that name; raises InputError for unknown names."""
        for component in self.components:
            if component.name == name:
                return component
        raise InputError(
            f"the system has no body {name!r}; {nearest(name, [c.name for c in self.components])}", kind="unknown"
        )


class Assembly:
    """A system with its coordinates numbered: configurations x, velocities v (k,) and multipliers (m,).

    Raises:
        InputError: a system without bodies.
    """

    def __init__(self, system: System) -> None:
        if not system.components:
            raise InputError("the system has no bodies; add at least one", kind="missing", keyword="bodies")
        self.system, self.gravity = system, system.gravity
        # Copies: what is added to the system later is not part of what was done with it before.
        self.components, self.joints = list(system.components), list(system.joints)
        self.forces = [force.for_run() for force in system.forces]
        ends = np.cumsum([0, *(c.configuration_size for c in self.components)])
        self.in_x = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        ends = np.cumsum([0, *(c.size for c in self.components)])
        self.in_v = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self.size = int(ends[-1])
        ends = np.cumsum([0, *(j.count for j in self.joints)], dtype=int)
        self.in_rows = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self.rows = int(ends[-1])
        self._index = {id(c): i for i, c in enumerate(self.components)}
        markers: dict[int, Marker] = {}
        for marker in [m for j in self.joints for m in (j.first, j.second)] + [
            m for f in self.forces for m in f.markers
        ]:
            markers[id(marker)] = marker
        self._markers = list(markers.values())

    def index(self, component: Component) -> int | None:
        """Number of a component, None for the ground."""
        return self._index.get(id(component))

    def start(self) -> tuple[Floats, Floats]:
        """Configuration and velocity at the start."""
        states = [c.start() for c in self.components]
        return np.concatenate([x for x, _ in states]), np.concatenate([v for _, v in states])

    def unpack_state(self, state: State) -> tuple[Floats, Floats]:
        """Configuration and velocity of a state, of this system or of another with the same bodies.

        Raises:
            InputError: a state of other bodies.
        """
        of_other, own = ([(c.name, c.size) for c in a.components] for a in (state.assembly, self))
        if of_other != own:
            raise InputError(
                "the state given is that of another system; expected one of the same bodies in this order",
                kind="conflict",
                keyword="state",
            )
        return state.x, state.v

    def move(self, x: Floats, step: Floats) -> Floats:
        """x o exp(step)."""
        return np.concatenate(
            [c.move(x[i], step[j]) for c, i, j in zip(self.components, self.in_x, self.in_v, strict=True)]
        )

    def tangent(self, A: Floats, step: Floats) -> Floats:
        """A T with the tangent operator of a step; A has k columns."""
        result = A.copy()
        for c, j in zip(self.components, self.in_v, strict=True):
            T = c.tangent(step[j])
            if T is not None:
                result[:, j] = A[:, j] @ T
        return result

    def bracket(self, a: Floats, b: Floats) -> Floats:
        """Lie bracket of two velocities."""
        return np.concatenate([c.bracket(a[j], b[j]) for c, j in zip(self.components, self.in_v, strict=True)])

    def place(self, marker: Marker, x: Floats) -> MarkerState:
        """Where a marker is."""
        i = self.index(marker.component)
        return marker.place(x[:0] if i is None else x[self.in_x[i]])

    def twist(self, marker: Marker, place: MarkerState, v: Floats) -> Floats:
        """Velocity and angular velocity (6,) of a marker."""
        i = self.index(marker.component)
        return np.zeros(6) if i is None else np.asarray(place.jacobian @ v[self.in_v[i]])

    def places(self, x: Floats) -> dict[int, MarkerState]:
        """The places of all markers in use, by their id."""
        return {id(m): self.place(m, x) for m in self._markers}

    def dynamics(self, t: float, x: Floats, v: Floats, places: dict[int, MarkerState]) -> tuple[Floats, Floats]:
        """Mass matrix (k, k) and all forces but those of joints, on the left side of M dv/dt + g."""
        M, g = np.zeros((self.size, self.size)), np.zeros(self.size)
        for c, i, j in zip(self.components, self.in_x, self.in_v, strict=True):
            M[j, j], g[j] = c.dynamics(t, x[i], v[j], self.gravity)
        for force in self.forces:
            self.load(force, t, v, [places[id(m)] for m in force.markers], g)
        return M, g

    def equations(self, t: float, x: Floats, v: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """M and g of ``dynamics``, Phi and B of ``constraints``."""
        places = self.places(x)
        return *self.dynamics(t, x, v, places), *self.constraints(t, places)

    def begin_step(self, t: float, x: Floats, v: Floats) -> None:
        """Tell the forces where a step begins.

        Raises:
            SolverError: a state at which the law of a force does not hold.
        """
        for force in self.forces:
            if type(force).begin_step is Force.begin_step:
                continue
            places = [self.place(m, x) for m in force.markers]
            force.begin_step(t, places, [self.twist(m, p, v) for m, p in zip(force.markers, places, strict=True)])

    def load(self, force: Force, t: float, v: Floats, at: Sequence[MarkerState], g: Floats) -> None:
        """Take the generalised forces of one force from g (k,)."""
        twists = [self.twist(m, p, v) for m, p in zip(force.markers, at, strict=True)]
        for marker, place, wrench in zip(force.markers, at, force.wrenches(t, at, twists), strict=True):
            k = self.index(marker.component)
            if k is not None:
                g[self.in_v[k]] -= wrench @ place.jacobian

    def constraints(self, t: float, places: dict[int, MarkerState]) -> tuple[Floats, Floats]:
        """Phi (m,) and B (m, k)."""
        Phi, B = np.zeros(self.rows), np.zeros((self.rows, self.size))
        for joint, r in zip(self.joints, self.in_rows, strict=True):
            a, b = places[id(joint.first)], places[id(joint.second)]
            value, Ga, Gb = joint.rows(a, b)
            Phi[r] = value
            if joint.motion is not None:
                gap = value[-1] - joint.motion_derivative(0, t)
                Phi[r.stop - 1] = math.remainder(gap, 2 * math.pi) if joint.periodic else gap
            for marker, place, G in ((joint.first, a, Ga), (joint.second, b, Gb)):
                k = self.index(marker.component)
                if k is not None:
                    B[r, self.in_v[k]] += G @ place.jacobian
        return Phi, B

    def motion_derivative(self, order: int, t: float) -> Floats:
        """Rate (order 1) or acceleration (2) of all prescribed motions, per row (m,)."""
        values = np.zeros(self.rows)
        for joint, r in zip(self.joints, self.in_rows, strict=True):
            if joint.motion is not None:
                values[r.stop - 1] = joint.motion_derivative(order, t)
        return values

    def curvature(self, x: Floats, v: Floats, h: float) -> Floats:
        """(m,) d(B v)/dx v: five-point difference along the motion, exact to about twelve digits."""
        rates = [float(np.linalg.norm(self.twist(m, self.place(m, x), v)[3:])) for m in self._markers]
        s = min(TOL.five_point_turn / max([TOL.tiny, *rates]), h)

        def at(k: int) -> Floats:
            return np.asarray(self.constraints(0.0, self.places(self.move(x, k * s * v)))[1] @ v)

        return (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12 * s)

    def energy(self, x: Floats, v: Floats) -> tuple[float, float]:
        """Kinetic and potential energy (gravity, strain, springs), J."""
        parts = [
            c.energy(x[i], v[j], self.gravity) for c, i, j in zip(self.components, self.in_x, self.in_v, strict=True)
        ]
        springs = sum(f.potential_energy([self.place(m, x) for m in f.markers]) for f in self.forces)
        return sum(p[0] for p in parts), sum(p[1] for p in parts) + springs

    def power(self, t: float, x: Floats, v: Floats, multipliers: Floats) -> float:
        """Power of loads, dampers and prescribed motions, W."""
        inner = sum(c.power(x[i], v[j]) for c, i, j in zip(self.components, self.in_x, self.in_v, strict=True))
        outer = 0.0
        for f in self.forces:
            at = [self.place(m, x) for m in f.markers]
            outer += f.power(t, at, [self.twist(m, p, v) for m, p in zip(f.markers, at, strict=True)])
        return float(inner + outer - multipliers @ self.motion_derivative(1, t))

    def check_positions(self, t: float, x: Floats) -> Floats:
        """Raise InputError for joints that are open or redundant; B (m, k)."""
        Phi, B = self.constraints(t, self.places(x))
        length = max([TOL.least_size, *(float(np.abs(self.place(m, x).position).max()) for m in self._markers)])
        far = [
            f"{j.label} by {np.abs(Phi[r]).max():.3g}"
            for j, r in zip(self.joints, self.in_rows, strict=True)
            if np.abs(Phi[r]).max() > TOL.open_joint * max(1.0, length)
        ]
        if far:
            raise InputError(
                f"joints are open at t = {t:.9g} s: {'; '.join(far)} (m or rad). Place the bodies so that both markers "
                "of a joint meet, and let prescribed motions start where the bodies are",
                kind="model",
                keyword="joint",
            )
        self._check_rank(x, B)
        return B

    def check_start(self, t: float, x: Floats, v: Floats) -> None:
        """Raise InputError for joints that are open, moving apart or redundant at the start."""
        B = self.check_positions(t, x)
        drift = B @ v - self.motion_derivative(1, t)
        fast = max(TOL.least_opening, max(np.abs(B) @ np.abs(v), default=0.0))
        moving = [
            f"{j.label} at {np.abs(drift[r]).max():.3g}"
            for j, r in zip(self.joints, self.in_rows, strict=True)
            if np.abs(drift[r]).max() > TOL.opening_joint * max(fast, np.abs(self.motion_derivative(1, t)).max())
        ]
        if moving:
            raise InputError(
                f"velocities at the start violate joints: {'; '.join(moving)} (m/s or rad/s). Give velocities of the "
                "bodies that the joints allow and that follow the prescribed motions",
                kind="model",
                keyword="velocity",
            )

    def _check_rank(self, x: Floats, B: Floats) -> None:
        """Raise InputError with the joints whose rows depend on each other; lengths by the mass matrix."""
        if not self.rows:
            return
        M, _ = self.dynamics(0.0, x, np.zeros(self.size), self.places(x))
        A = sl.solve_triangular(np.linalg.cholesky(M), B.T, lower=True)
        norms = np.linalg.norm(A, axis=0)
        U, s, _ = np.linalg.svd((A / np.where(norms > 0, norms, 1.0)).T, full_matrices=True)
        rank = int((s > TOL.dependent_joints * s[0]).sum())
        if rank == self.rows:
            return
        weight = np.abs(U[:, rank:]).max(axis=1)
        named = [j.label for j, r in zip(self.joints, self.in_rows, strict=True) if weight[r].max() > TOL.named_joint]
        raise InputError(
            f"{self.rows - rank} of {self.rows} joint equations are redundant: {'; '.join(named)} constrain the "
            "same motion. Free it in one of them (a spherical or revolute joint in place of a fixed one), or give the "
            "body elastic modes along it",
            kind="model",
            keyword="joint",
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """A system at one time (s): configuration x, velocity v, acceleration dv/dt, multipliers of joints."""

    assembly: Assembly
    time: float
    x: Floats
    v: Floats
    acceleration: Floats
    multipliers: Floats
