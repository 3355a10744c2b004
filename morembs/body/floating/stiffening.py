"""Geometric stiffening of an elastic body in its floating frame: its matrices, and which terms are worth keeping.

A body that is pulled grows stiffer, one that is pressed grows softer (the centrifugal load of a rotor blade, the
force in a link). To first order in the load the elastic coordinates q see (Wallrapp and Schwertassek 1991)

    + (sum_a a_a Gt_a + sum_a w'_a Gr_a + sum_ab w_a w_b Go_ab + sum_j f_j Gf_j) q

beside Ke q, with a the acceleration of the frame less gravity, w its angular velocity and f the forces and moments
on the interfaces, all along the axes of the body. Each G = Phi' K_g Phi is the geometric stiffness of the stress that
one unit of its load causes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from morembs.base.arguments import check_options
from morembs.base.errors import InputError, nearest
from morembs.base.limits import Magnitude
from morembs.base.summary import summarised
from morembs.base.types import Floats
from morembs.body.floating.integrals import PAIRS
from morembs.fem import freeze
from morembs.storage.table import dataset, derived, table_of

AXES = "xyz"
_TERMS = "where there are any"


@dataclass(frozen=True, kw_only=True)
class Envelope:
    """The largest loads in use, each the magnitude of one component; what is None has no limit and is kept.

    ``acceleration`` m/s2 of the frame less gravity, ``angular_acceleration`` rad/s2, ``speed`` rad/s, ``force`` N and
    ``moment`` Nm on an interface. A term that changes the stiffness of no shape by the part ``share`` within these
    limits is dropped; each is judged by itself.

    Raises:
        InputError: a negative number or none.

    >>> Envelope(acceleration=20.0, speed=100.0, share=0.05).speed
    100.0
    """

    acceleration: Magnitude | None = None
    angular_acceleration: Magnitude | None = None
    speed: Magnitude | None = None
    force: Magnitude | None = None
    moment: Magnitude | None = None
    share: Magnitude = 0.01

    def __post_init__(self) -> None:
        check_options(self, "envelope: ")

    def limits(self, interfaces: Sequence[str]) -> dict[str, float | None]:
        """Largest value of every load of a body with these ``interfaces``, by name (rad2/s2 for rotations)."""
        limits = {f"acceleration {axis}": self.acceleration for axis in AXES}
        limits |= {f"angular acceleration {axis}": self.angular_acceleration for axis in AXES}
        square = None if self.speed is None else self.speed**2
        limits |= {f"rotation {AXES[a]}{AXES[b]}": square for a, b in PAIRS}
        for name in interfaces:
            limits |= {f"{name} force {axis}": self.force for axis in AXES}
            limits |= {f"{name} moment {axis}": self.moment for axis in AXES}
        return limits


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class Stiffening:
    """Geometric stiffness per unit load, for n elastic coordinates of one floating frame, symmetric matrices.

    ``acceleration`` (3, n, n) per m/s2 along x, y, z; ``angular_acceleration`` (3, n, n) per rad/s2; ``rotation``
    (6, n, n) per w_a w_b in the order xx, yy, zz, xy, yz, zx; ``wrench`` interface -> (6, n, n) per N and Nm (three
    forces, three moments at its point).

    ``share`` maps the name of each load to the largest relative change of the stiffness of any shape under it,
    max |eig(Ke^-1/2 G Ke^-1/2)|, at the value in ``load``: its limit, or one unit where there is none. Terms that are
    ``dropped``, as their share stayed below ``least_share``, are zero; so are those whose share is zero, as the frame
    itself balances their load.

    The terms belong to the conditions of their frame: another frame needs its own.
    """

    acceleration: Floats = dataset("real", "3 ne ne", "geometric stiffness per acceleration of the frame", "s2/m")
    angular_acceleration: Floats = dataset("real", "3 ne ne", "the same per angular acceleration", "s2")
    rotation: Floats = dataset("real", "6 ne ne", "per w_a w_b in the order xx, yy, zz, xy, yz, zx", "s2")
    wrench: Mapping[str, Floats] = dataset(
        "real",
        "6 ne ne",
        "per force (3) and moment (3) of the interface, axes of the body",
        name="wrench/*",
        known="interfaces",
    )
    share: Mapping[str, float] = dataset(
        "any",
        "loads",
        "of each term beside Ke, at its load",
        default_factory=dict,
        when=_TERMS,
        write=lambda own: list(own.share.values()) or None,
    )
    load: Mapping[str, float] = dataset(
        "any",
        "loads",
        "of each term: its largest value in use, or one",
        default_factory=dict,
        when=_TERMS,
        write=lambda own: [own.load.get(name, 1.0) for name in own.share] or None,
    )
    dropped: tuple[str, ...] = dataset(
        "text",
        "any",
        "terms that were left out",
        default=(),
        doc="terms that were left out, which are zero",
        when=_TERMS,
        write=lambda own: own.dropped or None,
    )
    least_share: float = dataset("real", "", "terms below this part of Ke were left out", default=0.0)

    def __post_init__(self) -> None:
        for name in ("acceleration", "angular_acceleration", "rotation"):
            object.__setattr__(self, name, freeze(np.asarray(getattr(self, name), dtype=float)))
        object.__setattr__(self, "wrench", {name: freeze(np.asarray(G)) for name, G in self.wrench.items()})

    @derived("text", "loads", "names of the terms", when=_TERMS, read=True)
    def terms(self) -> list[str] | None:
        """Names of the loads whose share is known."""
        return list(self.share) or None

    def matrix(
        self,
        *,
        acceleration: Sequence[float] = (0.0, 0.0, 0.0),
        angular_acceleration: Sequence[float] = (0.0, 0.0, 0.0),
        velocity: Sequence[float] = (0.0, 0.0, 0.0),
        wrench: Mapping[str, Sequence[float]] | None = None,
    ) -> Floats:
        """Geometric stiffness (n, n) of loads that act together, to be added to Ke.

        ``acceleration`` of the frame less gravity (m/s2), ``angular_acceleration`` (rad/s2), angular ``velocity``
        (rad/s) and for each interface its ``wrench`` (three N, three Nm), along the axes of the body.

        Raises:
            InputError: an interface without terms.
        """
        w = np.asarray(velocity, dtype=float)
        total = np.tensordot(np.asarray(acceleration, dtype=float), self.acceleration, 1)
        total = total + np.tensordot(np.asarray(angular_acceleration, dtype=float), self.angular_acceleration, 1)
        total = total + np.tensordot(np.array([w[a] * w[b] for a, b in PAIRS]), self.rotation, 1)
        for name, loads in (wrench or {}).items():
            if name not in self.wrench:
                raise InputError(f"a wrench on {name!r} was given; {nearest(name, list(self.wrench))}", kind="unknown")
            total = total + np.tensordot(np.asarray(loads, dtype=float), self.wrench[name], 1)
        return np.asarray(total)

    def about(self, d: Floats) -> Stiffening:
        """The same with the origin of the frame moved by ``d`` (3,): its acceleration is then that of the new origin.

        What was dropped stays out, and ``share`` stays that of the old origin.
        """
        eye = np.eye(3)
        turned = np.cross(eye, d)
        pairs = [np.cross(eye[a], turned[b]) + (np.cross(eye[b], turned[a]) if a != b else 0.0) for a, b in PAIRS]
        return replace(
            self,
            angular_acceleration=self.angular_acceleration - np.tensordot(turned, self.acceleration, 1),
            rotation=self.rotation - np.tensordot(np.array(pairs), self.acceleration, 1),
        )


def _build_stiffening(
    terms: Sequence[str] = (), share: Sequence[float] = (), load: Sequence[float] = (), **own: Any
) -> Any:
    shares, loads = (dict(zip(terms, np.asarray(column).tolist(), strict=True)) for column in (share, load))
    return Stiffening(share=shares, load=loads, **own)


STIFFENING = table_of(Stiffening, build=_build_stiffening)
