"""A long member as a chain of equal pieces that share one table, and runs that find out how many are needed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.gmp.member import ReducedMember
from morembs.nonlinear.mechanism import Angle, Mechanism, Point
from morembs.nonlinear.nodal import LeftTablesError, MechanismMotion, simulate
from morembs.nonlinear.planar_beam import PlanarBeam

Floats = NDArray[np.float64]
# Part of the tables' range that a new division aims at.
_WITHIN = 0.75


@dataclass(frozen=True, eq=False)
class DividedMember:
    """``pieces`` of one ``member``, end to end with common frames; from ``divided_member``."""

    member: ReducedMember
    pieces: int

    @property
    def length(self) -> float:
        """Distance of its ends without load, m."""
        return self.pieces * self.member.length

    def add(
        self, mechanism: Mechanism, first: Point, second: Point, *, start: Angle | None = None, end: Angle | None = None
    ) -> range:
        """Put the chain from point to point, as ``Mechanism.add`` does a member; the numbers of its members.

        Raises:
            InputError: points or angles at which it would have strain at the start.
        """
        step = second.position - first.position
        direction = math.atan2(step[1], step[0])
        count = len(mechanism.members)
        inner = [mechanism.point(first.position + step * k / self.pieces) for k in range(1, self.pieces)]
        points = [first, *inner, second]
        angles = [start, *(mechanism.angle(direction) for _ in range(1, self.pieces)), end]
        for k in range(self.pieces):
            mechanism.add(self.member, points[k], points[k + 1], start=angles[k], end=angles[k + 1])
        return range(count, count + self.pieces)

    def nodes(self, motion: MechanismMotion, numbers: range) -> Floats:
        """(T, n, 3) x, y in m and rotation in rad of all nodes of the beam, from the ``numbers`` that ``add`` gave."""
        parts = [self.member.nodes(motion.x[k]).T.reshape(len(motion.times), -1, 3) for k in numbers]
        return np.concatenate([parts[0], *(part[:, 1:] for part in parts[1:])], axis=1)


def divided_member(beam: PlanarBeam, pieces: int, **options: Any) -> DividedMember:
    """A straight beam of equal elements as a chain of equal pieces, which share one table.

    Args:
        beam: straight, with a number of elements that ``pieces`` divides.
        pieces: one or more; ``divide_until_within`` finds how many.
        options: of ``ReducedMember``, for one piece.

    Raises:
        InputError: a beam that is not straight and even, or that does not divide.
    """
    elements, lengths = len(beam.lengths), beam.lengths
    nodes = beam.reference.reshape(-1, 3)
    if np.abs(nodes[:, 1:]).max() > 1e-9 * lengths.sum() or np.ptp(lengths) > 1e-9 * lengths.max():
        raise InputError(
            "a beam that is curved, or has elements of different lengths, was given; expected a straight one"
        )
    if pieces < 1 or elements % pieces:
        fitting = [str(k) for k in range(1, elements + 1) if elements % k == 0]
        raise InputError(
            f"{pieces} pieces of {elements} elements were asked for; expected a number that divides them: "
            f"{', '.join(fitting)}"
        )
    piece = PlanarBeam.straight(float(lengths.sum()) / pieces, elements // pieces, beam.section)
    return DividedMember(ReducedMember(piece, **options), pieces)


def divide_until_within(
    build: Callable[[int], Mechanism], *, end: float, step: float, pieces: int = 1, most: int = 64, **options: Any
) -> tuple[MechanismMotion, int]:
    """A run with as many pieces as keep it within the tables, and their number.

    Args:
        build: makes the mechanism with a number of pieces for its long members.
        end, step, options: of ``simulate``.
        pieces: to begin with. Where a run leaves the tables, the next number is the one by which the angle that left
            them comes to three quarters of their range, or twice as many; numbers that ``build`` refuses are passed
            over.
        most: pieces after which it is given up.

    Raises:
        LeftTablesError: the largest number is not enough either.
        InputError: of ``build``, where no number up to ``most`` is taken.
    """
    while True:
        mechanism, pieces = _buildable(build, pieces, most)
        try:
            return simulate(mechanism, end=end, step=step, **options), pieces
        except LeftTablesError as error:
            wanted = max(2 * pieces, math.ceil(pieces * error.share / _WITHIN))
            if wanted > most:
                raise
            pieces = wanted


def _buildable(build: Callable[[int], Mechanism], pieces: int, most: int) -> tuple[Mechanism, int]:
    for count in range(pieces, most):
        try:
            return build(count), count
        except InputError:
            continue
    return build(most), most
