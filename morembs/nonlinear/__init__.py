"""Geometrically nonlinear components: exact beams, solids, their static equilibria, and motion in the plane."""

import warnings
from typing import Any

from morembs.nonlinear.component import NonlinearComponent
from morembs.nonlinear.continuation import EquilibriumPath, follow_equilibrium
from morembs.nonlinear.mechanism import Angle, Mechanism, Point
from morembs.nonlinear.member import FullMember, Member, MemberState
from morembs.nonlinear.nodal import MechanismMotion, simulate
from morembs.nonlinear.planar_beam import PlanarBeam, Section
from morembs.nonlinear.solid import NonlinearSolid
from morembs.nonlinear.spatial_beam import SpatialBeam, SpatialSection
from morembs.nonlinear.statics import equilibrium

_OLD_NAMES: dict[str, Any] = {
    "Moment": MemberState,
    "Motion": MechanismMotion,
    "Settled": EquilibriumPath,
    "settle": follow_equilibrium,
}

__all__ = [
    "Angle",
    "EquilibriumPath",
    "FullMember",
    "Mechanism",
    "MechanismMotion",
    "Member",
    "MemberState",
    "NonlinearComponent",
    "NonlinearSolid",
    "PlanarBeam",
    "Point",
    "Section",
    "SpatialBeam",
    "SpatialSection",
    "equilibrium",
    "follow_equilibrium",
    "simulate",
]


def __getattr__(name: str) -> object:
    if name not in _OLD_NAMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    new = _OLD_NAMES[name]
    warnings.warn(f"morembs.nonlinear.{name} is now {new.__name__}", DeprecationWarning, stacklevel=2)
    return new
