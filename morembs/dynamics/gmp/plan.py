"""How the tables of a member are made, and what came of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.limits import Positive, number
from morembs.dynamics.gmp.tolerances import TOL

EndAngle = Annotated[float, number("an angle in rad above zero and below pi", gt=0, lt=math.pi)]


@checked
@dataclass(frozen=True, kw_only=True)
class AngleRange:
    """What a member must bear; the range of its tables follows from it. One of three is given.

    ``angle``: largest angle (rad) of an end to the chord. ``moment``: largest moment (N m) on each of its ends, of any
    sign, while no force acts along the chord. ``load``: largest force (N) across the member, spread as its mass is,
    while its ends turn freely. A range from a moment or a load is 5 % larger than the angles it causes.

    Where equilibria end or become unstable before, the range ends before, and the report of the member says so.

    Raises:
        InputError: not one of the three, or no positive number.
    """

    angle: EndAngle | None = None
    moment: Positive | None = None
    load: Positive | None = None

    def __post_init__(self) -> None:
        given = {name: value for name in ("angle", "moment", "load") if (value := getattr(self, name)) is not None}
        if len(given) != 1:
            raise InputError(
                f"an envelope of {', '.join(given) or 'nothing'} was given; expected one of angle, moment, load",
                keyword="envelope",
            )


@checked
@dataclass(frozen=True, kw_only=True)
class Plan:
    """Settings of the offline stage.

    Attributes:
        reach: range (rad) of both end angles, refused where equilibria do not reach so far; or an envelope.
        points_per_angle: Chebyshev points in each direction; None: 3, 5, 9 or 17, the first that meet ``tolerance``.
        tolerance: largest error of the tables, each quantity per its largest value: between points, and of their
            derivatives.
        workers: number of processes; the result does not depend on it.
        checkpoint: file that keeps equilibria, from which the same run goes on where it was ended.
        symmetric: take equilibria from others by the symmetries that the component is found to have.
    """

    reach: EndAngle | AngleRange = TOL.default_reach
    points_per_angle: Annotated[int, number("an integer, 2 or more", ge=2)] | None = None
    tolerance: Positive = TOL.table_error
    workers: int = 1
    checkpoint: str | Path | None = None
    symmetric: bool = True


@dataclass(frozen=True, kw_only=True)
class Report:
    """What the offline stage did.

    ``reach`` (rad) and ``points`` per angle of the tables; ``equilibria`` in the tables and checks, ``solved`` and
    ``restored`` from a checkpoint (the others come by ``symmetries``); ``errors``: per quantity the largest error at
    points outside of the tables and of derivatives at all, empty for a number of points that was given;
    ``notes``: what is not as asked for; ``seconds`` it took.
    """

    reach: float
    points: int
    equilibria: int
    solved: int
    restored: int
    symmetries: tuple[str, ...]
    errors: dict[str, float]
    notes: tuple[str, ...]
    seconds: float
