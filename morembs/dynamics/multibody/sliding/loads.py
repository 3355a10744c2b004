"""Loads and joints that slide along the path of a body with static modes."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.limits import NotNegative
from morembs.base.types import Floats
from morembs.dynamics.multibody.component import Marker, MarkerState, direction
from morembs.dynamics.multibody.forces import Force, Load, _load
from morembs.dynamics.multibody.joints import Constraint, Rows
from morembs.dynamics.multibody.rotations import cross
from morembs.dynamics.multibody.sliding.body import PathMarker
from morembs.dynamics.multibody.sliding.path import PathState, PointOfPath
from morembs.dynamics.multibody.system import State
from morembs.dynamics.multibody.tolerances import TOL


class Slider:
    """What moves along a path: it has a position s (m) there."""

    path: PathMarker
    name: str

    @abstractmethod
    def along(self, state: State) -> float | None:
        """Position at a state, m; None where it does not touch the path."""


def _path(place: MarkerState) -> PathState:
    if not isinstance(place, PathState):
        raise InputError("a slider was given another marker than a path; take body.path()")
    return place


@checked
@dataclass(frozen=True, eq=False)
class MovingLoad(Force, Slider):
    """Force (3,) N along the inertial axes, constant or of time (s), at ``position(t)`` m along a path; it must be zero
    off the path.

    Raises:
        InputError: a constant force that is not (3,) finite numbers.
    """

    path: PathMarker
    _: KW_ONLY
    position: Callable[[float], float]
    force: Load
    name: str = "moving load"
    markers: tuple[Marker, ...] = field(init=False)
    _law: Callable[[float], Floats] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "markers", (self.path,))
        object.__setattr__(self, "_law", _load(f"force of {self.name!r}", self.force))

    def along(self, state: State) -> float | None:
        return float(self.position(state.time)) if self._law(state.time).any() else None

    def wrenches(self, t: float, places: Sequence[MarkerState], twists: Sequence[Floats]) -> Sequence[Floats]:
        force = self._law(t)
        if not force.any():
            return (np.zeros(len(places[0].jacobian)),)
        return (_path(places[0]).at(float(self.position(t))).wrench(force),)

    def potential_energy(self, places: Sequence[MarkerState]) -> float:
        return 0.0

    def power(self, t: float, places: Sequence[MarkerState], twists: Sequence[Floats]) -> float:
        return float(self.wrenches(t, places, twists)[0] @ twists[0])


def _across(point: PointOfPath, up: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors (2, 3) across the path, the first nearest to ``up``; and the unit tangent."""
    along = point.slope / np.linalg.norm(point.slope)
    first = up - (up @ along) * along
    first /= np.linalg.norm(first)
    return np.stack((first, cross(along, first))), along


def _check_up(label: str, path: PathMarker, up: ArrayLike, rider: Marker) -> Floats:
    """A unit vector that is not along the path, once the rider is seen to be on it at the start."""
    if not isinstance(path, PathMarker):
        raise InputError(f"{label}: its first marker is no path; take body.path()")
    e = direction(f"up of {label}", up)
    place = path.place(path.component.start()[0])
    s = place.nearest(rider.place(rider.component.start()[0]).position)
    path.component.refuse_outside(s, f"at the start ({label})")
    slope = place.at(s).slope
    if abs(e @ slope) > TOL.along_path * np.linalg.norm(slope):
        raise InputError(
            f"{label}: up = {np.asarray(up).tolist()} is along the path; expected a direction across it", keyword="up"
        )
    return e


@checked
@dataclass(frozen=True, eq=False)
class PointOnPath(Constraint, Slider):
    """``second`` stays on the path of ``first`` and slides along it freely: two rows, at the place where it is.

    For the dynamic variant: its place then follows the static modes. ``up`` (3,) is a direction across the path.

    Raises:
        InputError: a first marker that is no path, a second one off its path at the start, ``up`` along the path, a
            body of another variant.
    """

    first: PathMarker
    second: Marker
    _: KW_ONLY
    up: ArrayLike = (0.0, 0.0, 1.0)
    name: str = ""
    e: Floats = field(init=False)
    count = 2

    def __post_init__(self) -> None:
        object.__setattr__(self, "e", _check_up(self.label, self.first, self.up, self.second))
        if self.first.component.variant != "dynamic":
            raise InputError(
                f'{self.label}: a joint follows static modes in the dynamic variant only; take variant = "dynamic", '
                "or a PathSupport, which has their compliance",
                kind="unsupported",
                keyword="variant",
            )
        object.__setattr__(self, "path", self.first)

    def along(self, state: State) -> float | None:
        return _nearest(state, self.first, self.second)

    def rows(self, a: MarkerState, b: MarkerState) -> Rows:
        place = _path(a)
        here = place.at(place.nearest(b.position))
        across, _ = _across(here, self.e)
        Gb = np.zeros((2, len(b.jacobian)))
        Gb[:, :3] = across
        return across @ (b.position - here.position), -across @ here.G, Gb


def _nearest(state: State, path: PathMarker, rider: Marker) -> float:
    a, b = (state.assembly.place(m, state.x) for m in (path, rider))
    return _path(a).nearest(b.position)


@checked
@dataclass(frozen=True, eq=False)
class PathSupport(Force, Slider):
    """``second`` rides on the path of ``first`` on the compliance R(s) of the static modes and slides freely.

    For the quasi-static variant: with amplitudes equal to loads, the point of the path lies W R W' f below that of
    the constant basis, so the force is that of a spring of this compliance (and of ``compliance`` m/N more).
    Only across the directions of the candidates; others are rigid and belong to joints.

    Raises:
        InputError: a negative compliance, or arguments that ``PointOnPath`` refuses.
    """

    first: PathMarker
    second: Marker
    _: KW_ONLY
    up: ArrayLike = (0.0, 0.0, 1.0)
    compliance: NotNegative = 0.0
    name: str = "support"
    e: Floats = field(init=False)
    markers: tuple[Marker, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "e", _check_up(f"support {self.name!r}", self.first, self.up, self.second))
        if self.first.component.variant != "quasi-static":
            raise InputError(
                f"support {self.name!r}: the dynamic variant moves its path already; take a PointOnPath",
                kind="conflict",
                keyword="variant",
            )
        object.__setattr__(self, "path", self.first)
        object.__setattr__(self, "markers", (self.first, self.second))
        place = self.first.place(self.first.component.start()[0])
        self._compliance(place, place.nearest(self.second.place(self.second.component.start()[0]).position))

    def along(self, state: State) -> float | None:
        return _nearest(state, self.first, self.second)

    def _compliance(self, place: PathState, s: float) -> tuple[float, Floats, PointOfPath]:
        """Compliance along the first direction across, that direction, and the point."""
        here = place.at(s)
        normal = _across(here, self.e)[0][0]
        w = (place.axes.T @ normal) @ here.W
        value = float(w @ place.R @ w) + self.compliance
        floor = TOL.rigid_place * float(np.abs(place.switching.stiffness[0]).max()) + self.compliance
        if not value > floor:
            raise InputError(
                f"support {self.name!r}: the active set has lost its rank at s = {s:.9g} m: no static mode moves "
                "along the support there; avoid held nodes, add the direction to the candidates or give a compliance",
                kind="model",
            )
        return value, normal, here

    def _law(self, places: Sequence[MarkerState]) -> tuple[Floats, float, float, PointOfPath]:
        """Force on the rider (3,), gap, compliance, and the point."""
        place, rider = _path(places[0]), places[1].position
        s = place.nearest(rider)
        value, normal, here = self._compliance(place, s)
        gap = float(normal @ (rider - here.position))
        # The compliance changes along the path: this is its part of the gradient of gap^2 / (2 compliance).
        across = place.axes.T @ normal
        w, change = across @ here.W, across @ here.dW
        drift = (gap / value) ** 2 * float(w @ place.R @ change)
        force = -gap / value * normal + drift * here.slope / (here.slope @ here.slope)
        return force, gap, value, here

    def wrenches(self, t: float, places: Sequence[MarkerState], twists: Sequence[Floats]) -> Sequence[Floats]:
        force, _, _, here = self._law(places)
        on_rider = np.zeros(len(places[1].jacobian))
        on_rider[:3] = force
        return here.wrench(-force), on_rider

    def potential_energy(self, places: Sequence[MarkerState]) -> float:
        _, gap, value, _ = self._law(places)
        return 0.5 * gap * gap / value

    def power(self, t: float, places: Sequence[MarkerState], twists: Sequence[Floats]) -> float:
        return 0.0
