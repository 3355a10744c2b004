"""Contact as a force: a nonlinear stiffness of the penetration, with a law that gives a wanted restitution.

F = f(d) (1 + chi d') where d is the penetration and d' its rate; chi follows from the restitution e and the speed v0 of
the approach. Each touch keeps the v0 with which it began.
"""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from morembs.base.arguments import checked
from morembs.base.errors import InputError, nearest
from morembs.base.limits import Positive, Restitution
from morembs.base.types import Floats
from morembs.dynamics.multibody.component import Marker, MarkerState, direction
from morembs.dynamics.multibody.forces import Force

# chi v0 by the restitution, of each law.
_FACTORS = {
    # Hunt and Crossley 1975.
    "hunt-crossley": lambda e: 1.5 * (1 - e),
    # Lankarani and Nikravesh 1990.
    "lankarani-nikravesh": lambda e: 0.75 * (1 - e * e),
    "flores": lambda e: 8 * (1 - e) / (5 * e),
}


class ContactStiffness(Protocol):
    """Force of a penetration that is held, and the energy that it takes."""

    def force(self, penetration: float) -> float:
        """N, zero where nothing penetrates."""

    def energy(self, penetration: float) -> float:
        """J, the integral of ``force``."""

    def check(self, penetration: float) -> None:
        """Raise SolverError where ``force`` does not hold any more."""


@checked
@dataclass(frozen=True)
class PowerLaw:
    """F = stiffness d^exponent: Hertz (1882) with exponent 1.5 between bodies without edges.

    ``stiffness`` N/m^exponent.

    Raises:
        InputError: a stiffness or an exponent that is not positive.
    """

    stiffness: Positive
    exponent: Positive = 1.5

    def force(self, penetration: float) -> float:
        return float(self.stiffness * max(penetration, 0.0) ** self.exponent)

    def energy(self, penetration: float) -> float:
        return self.force(penetration) * max(penetration, 0.0) / (self.exponent + 1)

    def check(self, penetration: float) -> None:
        """Holds at any penetration."""


@checked
def damping_factor(law: str, restitution: Restitution) -> float:
    """chi v0 of F = f(d) (1 + chi d'): what the rate of penetration weighs, over the speed of the approach.

    ``hunt-crossley`` (Hunt and Crossley 1975) and ``lankarani-nikravesh`` (Lankarani and Nikravesh 1990) hold for
    restitutions near 1; ``flores`` (Flores, Machado, Silva and Martins 2011) for all above 0.

    Args:
        law: "hunt-crossley", "lankarani-nikravesh" or "flores".
        restitution: ratio of the speeds after and before an impact.

    Raises:
        InputError: another law, a restitution that is not between 0 and 1, or is 0 for ``flores``.
    """
    if law not in _FACTORS:
        raise InputError(
            f"law {law!r} of a contact is not known; {nearest(law, list(_FACTORS))}", kind="unknown", keyword="law"
        )
    if law == "flores" and restitution == 0:
        raise InputError(
            "restitution = 0 was given with the law 'flores', whose damping grows without bound there; expected a "
            "restitution above 0 for this law, such as 0.05",
            kind="conflict",
            keyword="restitution",
        )
    return float(_FACTORS[law](restitution))


@checked
@dataclass(frozen=True, eq=False)
class ContactElement(Force):
    """A point of one body that pushes itself off another, without friction.

    Args:
        first, second: markers of the two bodies.
        stiffness: ``PowerLaw`` or ``ContactTable``.
        direction: (3,) along the axes of ``second``, out of its body; contact begins where ``first`` is nearer to
            ``second`` along it than ``distance``. None for balls: along the line of the markers.
        distance: m, between the markers where the bodies touch; the sum of the radii of two balls.
        restitution: 1 for no dissipation; what of the speed of approach is left after a touch, by ``law``.
        law: ``flores``, ``hunt-crossley`` or ``lankarani-nikravesh``; see ``damping_factor``.

    Raises:
        InputError: numbers out of range, a direction that is none.
    """

    first: Marker
    second: Marker
    _: KW_ONLY
    stiffness: ContactStiffness
    direction: ArrayLike | None = None
    distance: float = 0.0
    restitution: float = 1.0
    law: str = "flores"
    name: str = "contact"
    markers: tuple[Marker, ...] = field(init=False)
    _factor: float = field(init=False)
    # Times at which the contact was open, or the run began, and the speed of approach there.
    _open: tuple[list[float], list[float]] = field(init=False)

    def __post_init__(self) -> None:
        if not np.isfinite(self.distance) or (self.direction is None and not self.distance > 0):
            wanted = "a number" if self.direction is not None else "a positive one, or a direction"
            raise InputError(
                f"contact {self.name!r}: distance = {self.distance} was given; expected {wanted}", keyword="distance"
            )
        if self.direction is not None:
            object.__setattr__(self, "direction", direction(f"direction of {self.name!r}", self.direction))
        object.__setattr__(self, "_factor", damping_factor(self.law, self.restitution))
        object.__setattr__(self, "markers", (self.first, self.second))
        object.__setattr__(self, "_open", ([], []))

    def for_run(self) -> ContactElement:
        copy = replace(self)
        object.__setattr__(copy, "_open", (list(self._open[0]), list(self._open[1])))
        return copy

    def begin_step(self, t: float, places: Sequence[MarkerState], twists: Sequence[Floats]) -> None:
        depth, rate, _, _ = self._penetration(places, twists)
        self.stiffness.check(depth)
        times, speeds = self._open
        # Steps are repeated from where they began.
        del times[(keep := bisect.bisect_left(times, t)) :], speeds[keep:]
        # Where a run begins closed, its speed there counts: at rest there is no approach to restitute.
        if depth <= 0 or not times:
            times.append(t)
            speeds.append(max(rate, 0.0))

    def penetration(self, places: Sequence[MarkerState]) -> float:
        """m, negative where the bodies are apart; ``places`` of both markers."""
        return self._penetration(places, (np.zeros(6), np.zeros(6)))[0]

    def force(self, t: float, places: Sequence[MarkerState], twists: Sequence[Floats]) -> float:
        """N, never negative."""
        depth, rate, _, _ = self._penetration(places, twists)
        return self._push(t, depth, rate)

    def wrenches(self, t: float, places: Sequence[MarkerState], twists: Sequence[Floats]) -> Sequence[Floats]:
        depth, rate, normal, arm = self._penetration(places, twists)
        push = self._push(t, depth, rate) * normal
        return np.concatenate((push, np.zeros(3))), -np.concatenate((push, np.cross(arm, push)))

    def potential_energy(self, places: Sequence[MarkerState]) -> float:
        return self.stiffness.energy(self.penetration(places))

    def power(self, t: float, places: Sequence[MarkerState], twists: Sequence[Floats]) -> float:
        depth, rate, _, _ = self._penetration(places, twists)
        return -(self._push(t, depth, rate) - self.stiffness.force(depth)) * rate

    def _penetration(
        self, places: Sequence[MarkerState], twists: Sequence[Floats]
    ) -> tuple[float, float, Floats, Floats]:
        """Depth and rate, the normal on ``first``, and the arm of its force about ``second``."""
        a, b = places
        gap, speed = a.position - b.position, twists[0][:3] - twists[1][:3]
        if self.direction is None:
            length = float(np.linalg.norm(gap))
            normal = gap / length if length > 0 else b.axes[:, 2]
            return self.distance - length, -float(normal @ speed), normal, np.zeros(3)
        normal = b.axes @ np.asarray(self.direction)
        rate = normal @ speed + np.cross(twists[1][3:], normal) @ gap
        return self.distance - float(normal @ gap), -float(rate), normal, gap

    def _push(self, t: float, depth: float, rate: float) -> float:
        if depth <= 0:
            return 0.0
        held, began = self.stiffness.force(depth), bisect.bisect_right(self._open[0], t)
        speed = self._open[1][began - 1] if began else 0.0
        if not speed > 0:
            # A force that depends on the sign of the rate alone would jump at rest.
            return held
        # A touch that began slowly and is then pushed must not be damped without bound.
        return max(0.0, held * (1 + self._factor * rate / max(speed, abs(rate))))
