"""Curves through points with cubic pieces whose slopes are (P_i+1 - P_i-1) / 2.

Such a curve is the blend of two parabolas of Overhauser (1968) and the spline of Catmull and Rom (1974): it
interpolates, its tangent is continuous, and the ends follow the parabola of the last three points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass

import numpy as np
from numpy.typing import ArrayLike

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.dynamics.multibody.component import vector
from morembs.dynamics.multibody.contact.tolerances import TOL


def checked_points(what: str, value: ArrayLike, ndim: int) -> Floats:
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{what}: expected an array of points, with three numbers in its last axis") from None
    if array.ndim != ndim or array.shape[-1] != 3 or not np.isfinite(array).all():
        shape = "(n, 3)" if ndim == 2 else "(n, m, 3)"
        raise InputError(f"{what}: points of shape {array.shape} were given; expected finite numbers of shape {shape}")
    array.flags.writeable = False
    return array


def _check_spacing(what: str, points: Floats, closed: bool) -> None:
    """Points along the first axis must differ."""
    steps = np.diff(np.concatenate((points, points[:1])) if closed else points, axis=0)
    lengths = np.linalg.norm(steps, axis=-1)
    short = np.argwhere(lengths <= TOL.same_point * lengths.max())
    if len(short):
        raise InputError(
            f"{what}: points {tuple(short[0].tolist())} and the next coincide; expected points apart",
            kind="model",
            keyword="points",
        )


def overhauser(count: int, u: float, closed: bool = False) -> tuple[Ints, Floats, Floats]:
    """Numbers (w,) of the points that matter at parameter u (0 to count - 1, or to count where closed), their weights
    (w,) and the derivatives of weights."""
    pieces = count if closed else count - 1
    u = u % pieces if closed else u
    i = min(max(int(np.floor(u)), 0), pieces - 1)
    s = u - i
    value = 0.5 * np.array([-s + 2 * s**2 - s**3, 2 - 5 * s**2 + 3 * s**3, s + 4 * s**2 - 3 * s**3, s**3 - s**2])
    slope = 0.5 * np.array([-1 + 4 * s - 3 * s**2, -10 * s + 9 * s**2, 1 + 8 * s - 9 * s**2, 3 * s**2 - 2 * s])
    near = np.arange(i - 1, i + 3)
    if closed:
        return near % count, value, slope
    for end, inner, at in ((-1, 1, 0), (count, -1, 3)):
        if near[at] == end:
            # The point beyond the end is that of the parabola (a line for two points).
            factors = (3.0, -3.0, 1.0) if count > 2 else (2.0, -1.0)
            for k, f in enumerate(factors):
                where = at + inner * (k + 1)
                value[where] += f * value[at]
                slope[where] += f * slope[at]
            value[at] = slope[at] = 0.0
            near[at] = near[at + inner]
    return near, value, slope


@checked
@dataclass(frozen=True, eq=False)
class Path:
    """Overhauser curve (1968) through ``points`` (n, 3) m, ``closed`` to a loop or not.

    Its parameter u runs from 0 to n - 1, on a loop to n.

    Raises:
        InputError: fewer than two points (three of a loop), neighbours that coincide.
    """

    points: ArrayLike
    _: KW_ONLY
    closed: bool = False
    name: str = "path"

    def __post_init__(self) -> None:
        points, least = checked_points(f"{self.name!r}", self.points, 2), 3 if self.closed else 2
        if len(points) < least:
            raise InputError(
                f"{self.name!r}: {len(points)} points were given; expected {least} or more", keyword="points"
            )
        _check_spacing(f"{self.name!r}", points, self.closed)
        object.__setattr__(self, "points", points)

    @property
    def end(self) -> float:
        """Largest parameter."""
        return float(len(np.asarray(self.points)) - (0 if self.closed else 1))

    def at(self, u: float) -> tuple[Floats, Floats]:
        """Point (3,) and derivative by u (3,)."""
        points = np.asarray(self.points)
        near, value, slope = overhauser(len(points), u, self.closed)
        return value @ points[near], slope @ points[near]

    def nearest(self, point: ArrayLike) -> float:
        """Parameter of the nearest point of the path."""
        target, points = vector("point", point), np.asarray(self.points)
        u = float(np.argmin(np.linalg.norm(points - target, axis=1)))
        # Quarters of the spans before and behind.
        best = min((u + s for s in (-0.5, -0.25, 0.0, 0.25, 0.5)), key=lambda k: self._distance(k, target))
        return float(descend(lambda k: self.at(float(k[0])), np.array([best]), target, self._keep_inside)[0])

    def _distance(self, u: float, target: Floats) -> float:
        return float(np.linalg.norm(self.at(self._keep_inside(np.array([u]))[0])[0] - target))

    def _keep_inside(self, u: Floats) -> Floats:
        return u % self.end if self.closed else np.clip(u, 0.0, self.end)


def descend(
    at: Callable[[Floats], tuple[Floats, ...]], start: Floats, target: Floats, kept: Callable[[Floats], Floats]
) -> Floats:
    """Gauss-Newton to the nearest point, with parameters ``kept`` in their range; halved steps where it overshoots."""
    u = kept(start)
    for _ in range(TOL.foot_iterations):
        point, *slopes = at(u)
        J, miss = np.stack(slopes), target - point
        gradient, hessian = J @ miss, J @ J.T
        step = np.linalg.solve(hessian + TOL.foot_regularisation * np.trace(hessian) * np.eye(len(u)), gradient)
        # A parameter held at its end leaves the others free.
        held = (kept(u + 1e-9 * np.sign(step)) == u) & (step != 0)
        if held.any() and not held.all():
            free = ~held
            step = np.where(held, 0.0, step)
            step[free] = np.linalg.solve(hessian[np.ix_(free, free)], gradient[free])
        size, distance = 1.0, float(miss @ miss)
        moved = kept(u + step)
        largest = distance * (1 + TOL.distance_growth)
        while size > TOL.least_step_part and float(np.sum((target - at(moved)[0]) ** 2)) > largest:
            size *= 0.5
            moved = kept(u + size * step)
        done = float(np.abs(moved - u).max()) < TOL.foot_change * 10
        u = moved
        if done:
            break
    return u
