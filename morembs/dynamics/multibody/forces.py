"""Loads and springs between markers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.limits import NotNegative
from morembs.base.types import Floats
from morembs.dynamics.multibody.component import Marker, MarkerState, direction, vector
from morembs.dynamics.multibody.joints import bend_turn, frame_about, turn_angle
from morembs.dynamics.multibody.rotations import hat

Load = ArrayLike | Callable[[float], ArrayLike]


class Force(ABC):
    """A law that gives a wrench (force, moment along the inertial axes) on each of its ``markers``."""

    markers: tuple[Marker, ...]
    name: str

    def for_run(self) -> Force:
        """The force as one run uses it: a copy where it remembers what happened."""
        return self

    def begin_step(self, t: float, places: Sequence[MarkerState], twists: Sequence[Floats]) -> None:  # noqa: B027
        """A step begins from here; a step may begin again from an earlier time.

        Raises:
            SolverError: a state at which the law does not hold.
        """

    @abstractmethod
    def wrenches(self, t: float, places: Sequence[MarkerState], twists: Sequence[Floats]) -> Sequence[Floats]:
        """One wrench (6,) per marker; a twist (6,) is the velocity and angular velocity of a marker."""

    def bend(self, t: float, places: Sequence[MarkerState]) -> Floats | None:
        """(6 e, 6 e): derivative of the wrenches on e markers by the displacements and rotations of these, where they
        do not depend on velocities; None where only differences tell it."""
        return None

    @abstractmethod
    def potential_energy(self, places: Sequence[MarkerState]) -> float:
        """Potential energy, J."""

    @abstractmethod
    def power(self, t: float, places: Sequence[MarkerState], twists: Sequence[Floats]) -> float:
        """Power put into the system that is not taken from ``stored``, W."""


def _load(what: str, value: Load) -> Callable[[float], Floats]:
    if callable(value):
        law = value
        vector(f"{what} at t = 0", law(0.0))
        return lambda t: np.asarray(law(t), dtype=float)
    constant = vector(what, value)
    return lambda t: constant


@checked
@dataclass(frozen=True, eq=False)
class PointLoad(Force):
    """Force (3,) N and moment (3,) Nm at a marker, constant or functions of time.

    Along the inertial axes, or along those of the marker where ``follows``.

    Raises:
        InputError: a constant that is not (3,) finite numbers.
    """

    marker: Marker
    _: KW_ONLY
    force: Load = (0.0, 0.0, 0.0)
    moment: Load = (0.0, 0.0, 0.0)
    follows: bool = False
    name: str = "load"
    markers: tuple[Marker, ...] = field(init=False)
    _laws: tuple[Callable[[float], Floats], Callable[[float], Floats]] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "markers", (self.marker,))
        laws = _load(f"force of {self.name!r}", self.force), _load(f"moment of {self.name!r}", self.moment)
        object.__setattr__(self, "_laws", laws)

    def wrenches(self, t: float, places: Sequence[MarkerState], twists: Sequence[Floats]) -> Sequence[Floats]:
        force, moment = self._laws[0](t), self._laws[1](t)
        if self.follows:
            force, moment = places[0].axes @ force, places[0].axes @ moment
        return (np.concatenate((force, moment)),)

    def bend(self, t: float, places: Sequence[MarkerState]) -> Floats | None:
        slope = np.zeros((6, 6))
        if self.follows:
            force, moment = (places[0].axes @ law(t) for law in self._laws)
            slope[:3, 3:], slope[3:, 3:] = -hat(force), -hat(moment)
        return slope

    def potential_energy(self, places: Sequence[MarkerState]) -> float:
        return 0.0

    def power(self, t: float, places: Sequence[MarkerState], twists: Sequence[Floats]) -> float:
        return float(self.wrenches(t, places, twists)[0] @ twists[0])


@checked
@dataclass(frozen=True, eq=False)
class SpringDamper(Force):
    """Spring and damper between two points.

    ``stiffness`` N/m, ``damping`` Ns/m, ``length`` m without force (None: the distance at the start). Force and
    damping act along the line of the markers; with length zero along all directions.

    Raises:
        InputError: a negative number, or markers that coincide at the start where there is a length.
    """

    first: Marker
    second: Marker
    _: KW_ONLY
    stiffness: NotNegative
    damping: NotNegative = 0.0
    length: NotNegative | None = None
    name: str = "spring"
    markers: tuple[Marker, ...] = field(init=False)
    rest: float = field(init=False)

    def __post_init__(self) -> None:
        what = f"spring {self.name!r}"
        a, b = (m.place(m.component.start()[0]).position for m in (self.first, self.second))
        distance = float(np.linalg.norm(b - a))
        rest = distance if self.length is None else self.length
        if rest > 0 and distance == 0:
            raise InputError(
                f"{what}: its markers coincide at the start; expected a line between them, or length=0",
                kind="model",
                keyword="markers",
            )
        object.__setattr__(self, "rest", rest)
        object.__setattr__(self, "markers", (self.first, self.second))

    def _pull(self, places: Sequence[MarkerState], twists: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Vectors of the elongation and of its rate."""
        gap, rate = places[1].position - places[0].position, twists[1][:3] - twists[0][:3]
        if self.rest == 0:
            return gap, rate
        length = float(np.linalg.norm(gap))
        line = gap / length
        return (length - self.rest) * line, (line @ rate) * line

    def wrenches(self, t: float, places: Sequence[MarkerState], twists: Sequence[Floats]) -> Sequence[Floats]:
        stretch, rate = self._pull(places, twists)
        wrench = np.concatenate((self.stiffness * stretch + self.damping * rate, np.zeros(3)))
        return wrench, -wrench

    def bend(self, t: float, places: Sequence[MarkerState]) -> Floats | None:
        if self.damping:
            return None
        gap, slope = places[1].position - places[0].position, self.stiffness * np.eye(3)
        if self.rest:
            length = float(np.linalg.norm(gap))
            slope *= 1 - self.rest / length
            slope += self.stiffness * self.rest / length**3 * np.outer(gap, gap)
        return np.kron(np.array([[-1.0, 1.0], [1.0, -1.0]]), np.pad(slope, (0, 3)))

    def potential_energy(self, places: Sequence[MarkerState]) -> float:
        length = float(np.linalg.norm(places[1].position - places[0].position))
        return 0.5 * self.stiffness * (length - self.rest) ** 2

    def power(self, t: float, places: Sequence[MarkerState], twists: Sequence[Floats]) -> float:
        _, rate = self._pull(places, twists)
        return -self.damping * float(rate @ rate)


@checked
@dataclass(frozen=True, eq=False)
class TorsionSpring(Force):
    """Rotational spring and damper about an axis of the first marker, for turns within half a turn.

    ``axis`` (3,) along the axes of the first marker; ``stiffness`` Nm/rad, ``damping`` Nms/rad, ``angle`` rad without
    moment, measured from the start.

    Raises:
        InputError: a negative number, or an axis that is no direction.
    """

    first: Marker
    second: Marker
    _: KW_ONLY
    axis: ArrayLike
    stiffness: NotNegative
    damping: NotNegative = 0.0
    angle: float = 0.0
    name: str = "torsion spring"
    markers: tuple[Marker, ...] = field(init=False)
    _frames: tuple[Floats, Floats] = field(init=False)

    def __post_init__(self) -> None:
        what = f"spring {self.name!r}"
        a, b = (m.place(m.component.start()[0]) for m in (self.first, self.second))
        on_a = frame_about(direction(f"axis of {what}", self.axis))
        object.__setattr__(self, "_frames", (on_a, b.axes.T @ a.axes @ on_a))
        object.__setattr__(self, "markers", (self.first, self.second))

    def wrenches(self, t: float, places: Sequence[MarkerState], twists: Sequence[Floats]) -> Sequence[Floats]:
        angle, gradient = turn_angle(places[0], places[1], *self._frames)
        rate = gradient @ (twists[1][3:] - twists[0][3:])
        moment = (self.stiffness * (angle - self.angle) + self.damping * rate) * gradient
        wrench = np.concatenate((np.zeros(3), moment))
        return wrench, -wrench

    def bend(self, t: float, places: Sequence[MarkerState]) -> Floats | None:
        if self.damping:
            return None
        angle, gradient = turn_angle(places[0], places[1], *self._frames)
        # The gradient is that of the angle of the second marker, where the moment is opposite.
        turning = -(angle - self.angle) * bend_turn(places[0], places[1], *self._frames)
        relative = np.concatenate((np.zeros(3), gradient, np.zeros(3), -gradient))
        return self.stiffness * (turning - np.outer(relative, relative))

    def potential_energy(self, places: Sequence[MarkerState]) -> float:
        angle, _ = turn_angle(places[0], places[1], *self._frames)
        return 0.5 * self.stiffness * (angle - self.angle) ** 2

    def power(self, t: float, places: Sequence[MarkerState], twists: Sequence[Floats]) -> float:
        _, gradient = turn_angle(places[0], places[1], *self._frames)
        return -self.damping * float(gradient @ (twists[1][3:] - twists[0][3:])) ** 2
