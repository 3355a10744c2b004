"""Planar mechanisms of full and reduced members that share points and angles; no constraint equations are needed.

mechanism = Mechanism(gravity=(0, -9.81))
a, b = mechanism.point((0, 0), fixed="xy"), mechanism.point((0.3, 0))
mechanism.add(member, a, b)
motion = simulate(mechanism, end=0.5, step=5e-4)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from morembs.base.arguments import check_value, checked
from morembs.base.errors import InputError
from morembs.base.limits import NotNegative, Positive, one_of
from morembs.base.types import Floats, Ints
from morembs.dynamics.nonlinear.chain import Chain
from morembs.dynamics.nonlinear.member import Member
from morembs.dynamics.nonlinear.tolerances import TOL


@dataclass(frozen=True, eq=False)
class Point:
    """A point that members share; ``numbers`` (2,) of its coordinates, negative where it is held.

    ``motion`` (2,) m, of the time in s, is added to the position of a held point.
    """

    position: Floats
    numbers: Ints
    motion: Callable[[float], ArrayLike] | None = None

    def at(self, t: float) -> Floats:
        """Position (2,) of a held point at the time ``t``."""
        return self.position if self.motion is None else self.position + np.asarray(self.motion(t), dtype=float)


@checked
@dataclass(frozen=True, eq=False)
class Angle:
    """The direction of one or more ends of members; ``number`` is negative where it is held.

    ``motion`` (rad, of the time in s) is added to the coordinate.
    """

    value: float
    number: int
    motion: Callable[[float], float] | None = None


@checked
class Mechanism:
    """Members between points, under ``gravity`` (2,) m/s2. It starts at rest and without strain.

    ``damping`` in s is the factor of Rayleigh damping proportional to the stiffness of strains: rigid motion is free of
    it, and small vibrations of f Hz have the ratio pi f ``damping``.
    """

    def __init__(self, *, gravity: ArrayLike = (0.0, 0.0), damping: NotNegative = 0.0) -> None:
        self.gravity, self.damping = _pair("gravity", gravity), float(damping)
        self.members: list[Member] = []
        self.numbers: list[Ints] = []
        self.masses: list[tuple[Point, float]] = []
        self.torques: list[tuple[int, Callable[[float], float]]] = []
        self.drives: list[list[tuple[int, Callable[[float], float]]]] = []
        self._start: list[float] = []
        self._held: list[float] = []
        self._configurations: list[Floats] = []

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return len(self._start)

    def _number(self, value: float, held: bool) -> int:
        if held:
            self._held.append(value)
            return -len(self._held)
        self._start.append(value)
        return len(self._start) - 1

    def point(
        self, position: ArrayLike, *, fixed: str = "", motion: Callable[[float], ArrayLike] | None = None
    ) -> Point:
        """A point at ``position`` (2,) m at the start; ``fixed``: "", "x", "y" or "xy".

        With a ``motion`` (2,) m, a function of the time that starts at zero and at rest, it is moved by that much from
        its position.

        Raises:
            InputError: another word, or a motion that does not start at zero and at rest.
        """
        where = _pair("position of a point", position)
        if motion is not None:
            if np.abs(first := _pair("motion of a point at t = 0", motion(0.0))).max() > TOL.motion_at_start:
                raise InputError(f"the motion of a point starts at {first.tolist()} m; expected zero", keyword="motion")
            _at_rest("point", "m/s", motion)
            fixed = "xy"
        check_value("fixed", fixed, Annotated[str, one_of("", "x", "y", "xy")])
        numbers = np.array([self._number(float(where[k]), "xy"[k] in fixed) for k in range(2)])
        return Point(where, numbers, motion)

    def angle(self, value: float, *, fixed: bool = False) -> Angle:
        """A direction (rad) that ends of members may share."""
        return Angle(float(value), self._number(float(value), fixed))

    def drive(self, value: float, motion: Callable[[float], float], *, seen_from: Angle | None = None) -> Angle:
        """A direction that a joint drives: ``value`` at the start, then with ``motion`` (rad) more, a function of the
        time that starts at zero and at rest.

        Seen from the ground, or from another angle, with which it then turns as well.

        Raises:
            InputError: a motion that does not start at zero and at rest, or as seen from an angle that
                is driven itself.
        """
        if not abs(motion(0.0)) < TOL.motion_at_start:
            raise InputError(f"the motion of a joint starts at {motion(0.0):.6g} rad; expected zero", keyword="motion")
        _at_rest("joint", "rad/s", motion)
        if seen_from is None:
            return Angle(float(value), self._number(float(value), True), motion)
        if seen_from.motion is not None or seen_from.number < 0:
            raise InputError(
                "a joint was given as seen from an angle that is driven or held itself; expected one that is free",
                kind="conflict",
                keyword="seen_from",
            )
        step = float(value) - seen_from.value
        return Angle(float(value), seen_from.number, lambda t: step + motion(t))

    def add(
        self, member: Member, first: Point, second: Point, *, start: Angle | None = None, end: Angle | None = None
    ) -> None:
        """A member from point to point. Its ends turn freely unless an angle is given, which they then share.

        Raises:
            InputError: points or angles at which the member would have strain at the start.
        """
        step = second.position - first.position
        distance, direction = float(np.hypot(*step)), math.atan2(step[1], step[0])
        if abs(distance - member.length) > TOL.length_mismatch * member.length:
            raise InputError(
                f"the points of a member are {distance:.6g} m apart; expected its length {member.length:.6g} m",
                keyword="points",
            )
        if start is not None and start is end:
            raise InputError("one angle was given for both ends of a member; expected two, or none")
        angles = [a if a is not None else self.angle(direction) for a in (start, end)]
        for given in angles:
            if abs(given.value - direction) > TOL.angle_mismatch:
                raise InputError(
                    f"an angle of {given.value:.6g} rad was given for a member along {direction:.6g} rad; expected the "
                    "same number (also the same turn): members start without strain",
                    keyword="angle",
                )
        q = member.start(np.concatenate((first.position, [direction], second.position, [direction])))
        inner = [self._number(float(value), False) for value in q[6:]]
        drives = [(place, a.motion) for place, a in zip((2, 5), angles, strict=True) if a.motion is not None]
        for place, point in ((0, first), (3, second)):
            if point.motion is not None:
                drives += [(place + k, _part(point.motion, k)) for k in range(2)]
        self.drives.append(drives)
        if angles[0].number == angles[1].number:
            raise InputError("both ends of a member follow the same angle; expected different ones")
        numbers = [*first.numbers, angles[0].number, *second.numbers, angles[1].number, *inner]
        self.members.append(member)
        self.numbers.append(np.array(numbers, dtype=np.int64))
        self._configurations.append(q)

    def chain(self, chain: Chain, joints: Sequence[Angle]) -> None:
        """A chain of links from the origin; ``joints``: the angle of each, seen from the link before.

        Raises:
            InputError: another number of joints than of links, one coordinate for two of them.
        """
        if len(joints) != len(chain.links):
            raise InputError(
                f"{len(joints)} joints of a chain were given; expected one for each of its links", keyword="joints"
            )
        free = [joint.number for joint in joints if joint.number >= 0]
        if len(set(free)) < len(free):
            raise InputError(
                "two joints of a chain follow the same angle; expected different ones, each seen from the link before",
                kind="conflict",
                keyword="joints",
            )
        q = chain.start([joint.value for joint in joints])
        inner = [self._number(0.0, False) for _ in q[len(joints) :]]
        self.members.append(chain)
        self.numbers.append(np.array([*(joint.number for joint in joints), *inner], dtype=np.int64))
        self.drives.append([(k, a.motion) for k, a in enumerate(joints) if a.motion is not None])
        self._configurations.append(q)

    def ends(self, member: int) -> tuple[int, int]:
        """Numbers of the angles of a member between points at its start and end."""
        return int(self.numbers[member][2]), int(self.numbers[member][5])

    def mass(self, point: Point, mass: float) -> None:
        """A point mass in kg."""
        check_value("mass of a point in kg", mass, Positive)
        self.masses.append((point, mass))

    def torque(self, angle: Angle | int, value: Callable[[float], float]) -> None:
        """A torque (N m) as a function of time (s) on an angle or the number of one (see ``ends``)."""
        number = angle.number if isinstance(angle, Angle) else angle
        if not 0 <= number < self.size:
            raise InputError("a torque acts on an angle that is held or unknown; expected one that can turn")
        self.torques.append((number, value))

    def start(self) -> Floats:
        """Coordinates (size,) at the start."""
        return np.array(self._start)

    def configuration(self, member: int, q: Floats, t: float) -> Floats:
        """The configuration of one member for coordinates q (size,) at the time t."""
        local, numbers = self._configurations[member].copy(), self.numbers[member]
        free = numbers >= 0
        local[free] = q[numbers[free]]
        for place, motion in self.drives[member]:
            local[place] += motion(t)
        return local


def _at_rest(what: str, unit: str, motion: Callable[[float], ArrayLike]) -> None:
    # s, forward: a motion need not be known before the start. An acceleration cancels.
    h = 1e-6
    near, far = (np.asarray(motion(t), dtype=float) for t in (h, 2 * h))
    speed = float(np.abs(4 * near - far).max() / (2 * h))
    if not speed < TOL.rate_at_start:
        raise InputError(
            f"the motion of a {what} starts with {speed:.6g} {unit}; expected zero, as a mechanism starts at rest: let "
            "it begin smoothly",
            kind="value",
            keyword="motion",
        )


def _part(motion: Callable[[float], ArrayLike], k: int) -> Callable[[float], float]:
    return lambda t: float(np.asarray(motion(t), dtype=float)[k])


def _pair(what: str, value: ArrayLike) -> Floats:
    array = np.array(value, dtype=float)
    if array.shape != (2,) or not np.isfinite(array).all():
        raise InputError(f"{what}: {value!r} was given; expected two finite numbers")
    return array
