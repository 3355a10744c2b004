"""What a component of a system must give: its coordinates, mass matrix, forces, energy and markers.

The equations of a component are M(x) dv/dt + g(t, x, v) = (forces of others). Its configuration x lives on a
Lie group (a flat array), its velocity v in a vector space; x moves to ``move(x, s)`` = x o exp(s).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.dynamics.multibody.rotations import is_rotation, orthonormal
from morembs.dynamics.multibody.tolerances import TOL


@dataclass(frozen=True, kw_only=True, eq=False, slots=True)
class MarkerState:
    """Where a marker is: position (3,) m, axes (3, 3) as columns, jacobian (6, k).

    ``jacobian @ v`` is its velocity (3) and angular velocity (3) along the inertial axes.
    """

    position: Floats
    axes: Floats
    jacobian: Floats


class Component(ABC):
    """A part of a system with coordinates of its own.

    ``name`` is unique in a system; ``size`` (k) counts the velocities, ``configuration_size`` the numbers in x.
    """

    name: str
    size: int
    configuration_size: int

    @abstractmethod
    def start(self) -> tuple[Floats, Floats]:
        """Configuration (configuration_size,) and velocity (k,) at the start."""

    @abstractmethod
    def move(self, x: Floats, step: Floats) -> Floats:
        """x o exp(step), step (k,)."""

    @abstractmethod
    def tangent(self, step: Floats) -> Floats | None:
        """(k, k): how x o exp(step) moves with step, seen from the moved x; None for the identity."""

    @abstractmethod
    def bracket(self, a: Floats, b: Floats) -> Floats:
        """Lie bracket [a, b] (k,) of two velocities; zero in vector spaces."""

    @abstractmethod
    def dynamics(self, t: float, x: Floats, v: Floats, gravity: Floats) -> tuple[Floats, Floats]:
        """Mass matrix M (k, k), symmetric positive definite, and g (k,): inertia forces that do not depend on
        accelerations plus inner forces minus gravity."""

    def tangents(self, x: Floats, v: Floats, acceleration: Floats, gravity: Floats) -> tuple[Floats, Floats] | None:
        """Derivatives (k, k) of M dv/dt + g by configuration and by velocity at ``acceleration`` (k,), exact; None
        where only differences tell them."""
        return None

    @abstractmethod
    def energy(self, x: Floats, v: Floats, gravity: Floats) -> tuple[float, float]:
        """Kinetic and potential (gravity, strain) energy in J."""

    @abstractmethod
    def power(self, x: Floats, v: Floats) -> float:
        """Power of inner forces that is not stored, W: minus the damping."""

    def slopes(self, t: float, x: Floats, v: Floats) -> tuple[Floats, Floats] | None:
        """Derivatives (k, k) of g by steps of x and by v, where M is constant and they come cheaper than one by one.

        Only the speed of Newton's method depends on them. None: the simulator takes differences.
        """
        return None

    def deflection(self, x: Floats) -> float | None:
        """Largest displacement by linear elastic shapes per length of the body; None for all other components."""
        return None

    @abstractmethod
    def marker(self, name: str) -> Marker:
        """The marker of that name; raises InputError for unknown names."""


class VectorComponent(Component):
    """A component whose configuration is a vector: x and v have the same size, v = dx/dt."""

    def move(self, x: Floats, step: Floats) -> Floats:
        return x + step

    def tangent(self, step: Floats) -> Floats | None:
        return None

    def bracket(self, a: Floats, b: Floats) -> Floats:
        return np.zeros(self.size)


class Marker(ABC):
    """A frame that moves with one component; joints and forces act on markers."""

    component: Component
    name: str

    @abstractmethod
    def place(self, x: Floats) -> MarkerState:
        """Where it is for a configuration of its component."""

    def bend(self, x: Floats, wrench: Floats) -> Floats | None:
        """(k, k): derivative by the configuration of the generalised forces of a constant ``wrench`` (6,) along the
        inertial axes; None where only differences tell it."""
        return None

    @property
    def label(self) -> str:
        """How messages name it."""
        return f"{self.component.name}.{self.name}" if self.component.size else f"ground.{self.name}"


@dataclass(frozen=True, eq=False)
class FixedMarker(Marker):
    """A frame that does not move."""

    component: Component
    name: str
    fixed: MarkerState

    def place(self, x: Floats) -> MarkerState:
        return self.fixed

    def bend(self, x: Floats, wrench: Floats) -> Floats | None:
        return np.zeros((0, 0))


class Ground(VectorComponent):
    """The inertial frame: no coordinates, any number of markers."""

    name = "ground"
    size = 0
    configuration_size = 0

    def start(self) -> tuple[Floats, Floats]:
        return np.zeros(0), np.zeros(0)

    def dynamics(self, t: float, x: Floats, v: Floats, gravity: Floats) -> tuple[Floats, Floats]:
        return np.zeros((0, 0)), np.zeros(0)

    def energy(self, x: Floats, v: Floats, gravity: Floats) -> tuple[float, float]:
        return 0.0, 0.0

    def power(self, x: Floats, v: Floats) -> float:
        return 0.0

    def marker(self, name: str) -> Marker:
        raise InputError(
            f"ground has no named markers, {name!r} was given; take ground.marker_at(point)", kind="missing"
        )

    def marker_at(self, point: ArrayLike = (0.0, 0.0, 0.0), *, axes: ArrayLike | None = None, name: str = "") -> Marker:
        """Marker at ``point`` (3,) m with ``axes`` (3, 3) as columns, by default the inertial ones."""
        turn = checked_rotation("axes of a ground marker", axes)
        place = MarkerState(position=vector("point of a ground marker", point), axes=turn, jacobian=np.zeros((6, 0)))
        return FixedMarker(self, name or "marker", place)


def numbers(what: str, value: ArrayLike, shape: tuple[int, ...]) -> Floats:
    """A read-only array of finite numbers of that shape; raises InputError for anything else."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{what}: {value!r} was given; expected numbers of shape {shape}") from None
    if array.shape != shape or not np.isfinite(array).all():
        problem = f"shape {array.shape}" if array.shape != shape else "a value that is not finite"
        raise InputError(
            f"{what}: {problem} was given; expected finite numbers of shape {shape}", keyword=what.rpartition(": ")[2]
        )
    array.flags.writeable = False
    return array


def vector(what: str, value: ArrayLike, size: int = 3) -> Floats:
    """A read-only vector (size,) of finite numbers."""
    return numbers(what, value, (size,))


def direction(what: str, value: ArrayLike) -> Floats:
    """A unit vector (3,) along ``value``."""
    array = vector(what, value)
    length = np.linalg.norm(array)
    if length == 0:
        raise InputError(
            f"{what}: a zero vector was given; expected a direction (3,) of any length", keyword="direction"
        )
    return np.asarray(array / length)


def checked_rotation(what: str, value: ArrayLike | None) -> Floats:
    """A rotation matrix (3, 3), the identity for None."""
    if value is None:
        return np.eye(3)
    R = numbers(what, value, (3, 3))
    if not is_rotation(R, TOL.rotation_error):
        raise InputError(
            f"{what}: the matrix given is no rotation; expected R'R = 1 and det R = 1, see rotation()",
            keyword="rotation",
        )
    return orthonormal(orthonormal(R))
