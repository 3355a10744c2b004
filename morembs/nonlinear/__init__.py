"""Geometrically nonlinear components: exact beams, solids, their static equilibria, and motion in the plane."""

from morembs.nonlinear.component import NonlinearComponent
from morembs.nonlinear.continuation import Settled, settle
from morembs.nonlinear.mechanism import Angle, Mechanism, Point
from morembs.nonlinear.member import FullMember, Member, Moment
from morembs.nonlinear.nodal import Motion, simulate
from morembs.nonlinear.planar_beam import PlanarBeam, Section
from morembs.nonlinear.solid import NonlinearSolid
from morembs.nonlinear.spatial_beam import SpatialBeam, SpatialSection
from morembs.nonlinear.statics import equilibrium

__all__ = [
    "Angle",
    "FullMember",
    "Mechanism",
    "Member",
    "Moment",
    "Motion",
    "NonlinearComponent",
    "NonlinearSolid",
    "PlanarBeam",
    "Point",
    "Section",
    "Settled",
    "SpatialBeam",
    "SpatialSection",
    "equilibrium",
    "settle",
    "simulate",
]
