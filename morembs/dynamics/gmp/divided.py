"""A long, curved or bent member as a chain of pieces, and runs that find out how many are needed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.dynamics.gmp.data import Formulation
from morembs.dynamics.gmp.member import ReducedMember
from morembs.dynamics.gmp.tolerances import TOL
from morembs.dynamics.nonlinear.mechanism import Angle, Mechanism, Point
from morembs.dynamics.nonlinear.nodal import LeftTablesError, MechanismMotion, simulate
from morembs.dynamics.nonlinear.planar_beam import PlanarBeam


@dataclass(frozen=True, eq=False)
class DividedMember:
    """``members`` end to end with common frames, equal ones the same; from ``divided_member``.

    ``places`` (pieces + 1, 2) m of their ends and ``directions`` (pieces,) rad of their chords without load, along the
    chord of the whole, which leaves the origin along x.
    """

    members: tuple[ReducedMember, ...]
    places: Floats
    directions: Floats

    @property
    def pieces(self) -> int:
        """Their number."""
        return len(self.members)

    @property
    def length(self) -> float:
        """Distance of its ends without load, m."""
        return float(self.places[-1, 0])

    def add(
        self, mechanism: Mechanism, first: Point, second: Point, *, start: Angle | None = None, end: Angle | None = None
    ) -> range:
        """Put the chain from point to point, as ``Mechanism.add`` does a member; the numbers of its members.

        ``start`` and ``end`` are those of the chord from point to point, as for one member.

        Raises:
            InputError: points or angles at which it would have strain at the start.
        """
        step = second.position - first.position
        direction, distance = math.atan2(step[1], step[0]), float(np.hypot(*step))
        if abs(distance - self.length) > TOL.length_mismatch * self.length:
            raise InputError(
                f"the points of a divided member are {distance:.6g} m apart; expected {self.length:.6g} m, the "
                "distance of its ends",
                keyword="points",
            )
        for given in (start, end):
            if given is not None and abs(given.value - direction) > TOL.angle_mismatch:
                raise InputError(
                    f"an angle of {given.value:.6g} rad was given for a divided member whose chord is along "
                    f"{direction:.6g} rad; expected the same number, also where its axis leaves the chord",
                    keyword="angle",
                )
        c, s = math.cos(direction), math.sin(direction)
        placed = first.position + self.places @ np.array([[c, s], [-s, c]])
        points = [first, *(mechanism.point(place) for place in placed[1:-1]), second]
        # As the mechanism counts them, from -pi to pi.
        steps = np.diff([point.position for point in points], axis=0).tolist()
        turns = [math.atan2(y, x) for x, y in steps]
        angles = [start, *(mechanism.angle(turn) for turn in turns[1:]), end]
        count = len(mechanism.members)
        for k, (member, turn) in enumerate(zip(self.members, turns, strict=True)):
            ends = [None if angle is None else _shift_angle(angle, turn) for angle in angles[k : k + 2]]
            mechanism.add(member, points[k], points[k + 1], start=ends[0], end=ends[1])
        return range(count, count + self.pieces)

    def nodes(self, motion: MechanismMotion, numbers: range) -> Floats:
        """(T, n, 3) x, y in m and rotation in rad of all nodes of the beam, from the ``numbers`` that ``add`` gave.

        Rotations count from the chord of their piece without load.
        """
        parts = [
            member.nodes(motion.x[k]).T.reshape(len(motion.times), -1, 3)
            for k, member in zip(numbers, self.members, strict=True)
        ]
        return np.concatenate([parts[0], *(part[:, 1:] for part in parts[1:])], axis=1)


def _shift_angle(angle: Angle, value: float) -> Angle:
    """The same angle for a member along ``value``: both turn as one, rigidly joined."""
    offset, motion = value - angle.value, angle.motion
    if offset == 0 or angle.number < 0:
        return Angle(value, angle.number, motion)
    return Angle(value, angle.number, lambda t: offset + (0.0 if motion is None else motion(t)))


@checked
def divided_member(
    beam: PlanarBeam, pieces: int, *, formulation: Formulation | Literal["auto"] = "auto", **options: Any
) -> DividedMember:
    """A beam as a chain of pieces; equal ones share one table.

    It is cut at its corners, and between them where the part of the length plus the part of the turning angle has
    grown by equal amounts: a circle at equal angles, a straight beam at equal lengths.

    Args:
        beam: straight or curved, its elements at least as many as ``pieces``; ``PlanarBeam.along`` makes one of a line.
        pieces: one or more, and more than there are corners; ``divide_until_within`` finds how many.
        formulation: "auto" is "foreshortened". Curved pieces have no "membrane".
        options: of ``ReducedMember``, for each piece.

    Raises:
        InputError: a number of pieces that is too small or too large; of ``ReducedMember``.
    """
    kind: Formulation = "foreshortened" if formulation == "auto" else formulation
    line, cuts = _line(beam), _cuts(beam, pieces)
    made: dict[bytes, ReducedMember] = {}
    members = []
    for a, b in pairwise(cuts):
        piece = _piece(beam, a, b)
        # Pieces that differ by less than round-off are one.
        shape = (piece.reference / beam.lengths.sum(), piece.directions.ravel())
        key = (np.round(np.concatenate(shape) / TOL.same_piece).astype(np.int64)).tobytes()
        if key not in made:
            made[key] = ReducedMember(piece, formulation=kind, **options)
        members.append(made[key])
    steps = np.diff(line[cuts], axis=0)
    return DividedMember(tuple(members), line[cuts], np.arctan2(steps[:, 1], steps[:, 0]))


def _piece(beam: PlanarBeam, a: int, b: int) -> PlanarBeam:
    """Elements ``a`` to ``b``, the last one excluded."""
    nodes = np.repeat(beam.reference.reshape(-1, 3)[a : b + 1], 2, axis=0)[1:-1]
    nodes[:, 2] = beam.directions[a:b].ravel()
    return PlanarBeam.along(nodes, beam.section, corrected=beam.corrected)


def _line(beam: PlanarBeam) -> Floats:
    """Nodes (n, 2) from the start, x along the chord."""
    nodes = beam.reference.reshape(-1, 3)[:, :2]
    step = nodes[-1] - nodes[0]
    c, s = step / np.hypot(*step)
    return np.asarray((nodes - nodes[0]) @ np.array([[c, -s], [s, c]]))


def _cuts(beam: PlanarBeam, pieces: int) -> list[int]:
    """Numbers of the nodes where pieces end, the first and the last included."""
    elements, turns = len(beam.lengths), beam.directions
    bends = np.abs(turns[:, 1] - turns[:, 0])
    corners = np.flatnonzero(np.abs(turns[1:, 0] - turns[:-1, 1]) > TOL.least_bend) + 1
    if not len(corners) < pieces <= elements:
        raise InputError(
            f"{pieces} pieces of a beam of {elements} elements with {len(corners)} corners were asked for; expected "
            f"{len(corners) + 1} to {elements}",
            keyword="pieces",
        )
    share = beam.lengths / beam.lengths.sum()
    if bends.sum() > TOL.least_bend:
        share = (share + bends / bends.sum()) / 2
    along = np.concatenate(([0.0], np.cumsum(share)))
    fixed = [0, *corners.tolist(), elements]
    # To each part between corners at least one piece, the next one where pieces are longest.
    spans = [along[b] - along[a] for a, b in pairwise(fixed)]
    counts = [1] * len(spans)
    for _ in range(pieces - len(spans)):
        room = [
            span / count if count < b - a else 0.0
            for span, count, (a, b) in zip(spans, counts, pairwise(fixed), strict=True)
        ]
        counts[int(np.argmax(np.round(room, 9)))] += 1
    cuts = [0]
    for (a, b), count in zip(pairwise(fixed), counts, strict=True):
        for k in range(1, count + 1):
            target = along[a] + (along[b] - along[a]) * k / count
            nearest = int(np.abs(along - target).argmin())
            cuts.append(min(max(nearest, cuts[-1] + 1), b - (count - k)))
    return cuts


@checked
def divide_until_within(
    build: Callable[[int], Mechanism], *, end: float, step: float, pieces: int = 1, max_pieces: int = 64, **options: Any
) -> tuple[MechanismMotion, int]:
    """A run with as many pieces as keep it within the tables, and their number.

    Args:
        build: makes the mechanism with a number of pieces for its long members.
        end, step, options: of ``simulate``.
        pieces: to begin with. Where a run leaves the tables, the next number is the one by which the angle that left
            them comes to three quarters of their range, or twice as many; numbers that ``build`` refuses are passed
            over, to larger ones first.
        max_pieces: pieces after which it is given up.

    Raises:
        LeftTablesError: the largest number is not enough either.
        InputError: of ``build``, where no number up to ``max_pieces`` is taken.
    """
    counts: Sequence[int] = range(pieces, max(pieces, max_pieces) + 1)
    left: LeftTablesError | None = None
    while True:
        try:
            mechanism, pieces = _buildable(build, counts)
        except InputError:
            if left is None:
                raise
            raise left from None
        try:
            return simulate(mechanism, end=end, step=step, **options), pieces
        except LeftTablesError as error:
            wanted, left = (
                min(max(2 * pieces, math.ceil(pieces * error.share / TOL.wanted_table_part)), max_pieces),
                error,
            )
            # Of the numbers that are larger than the wanted one the first, else of those that are smaller.
            counts = [*range(max(wanted, pieces + 1), max_pieces + 1), *range(wanted - 1, pieces, -1)]


def _buildable(build: Callable[[int], Mechanism], counts: Sequence[int]) -> tuple[Mechanism, int]:
    """The first number of pieces that can be; where none can, the first refusal."""
    refused = InputError("no count of pieces was given; expected one or more", kind="missing", keyword="pieces")
    for number, count in enumerate(counts):
        try:
            return build(count), count
        except InputError as error:
            refused = refused if number else error
    raise refused
