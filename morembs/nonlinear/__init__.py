"""Geometrically nonlinear components: exact beams, solids, their static equilibria, and motion in the plane."""

from morembs.moved import renamed
from morembs.nonlinear.beam_body import BeamBody, beam_pieces
from morembs.nonlinear.chain import Chain, Link
from morembs.nonlinear.component import NonlinearComponent
from morembs.nonlinear.continuation import EquilibriumPath, follow_equilibrium
from morembs.nonlinear.mechanism import Angle, Mechanism, Point
from morembs.nonlinear.member import FullMember, Member, MemberState
from morembs.nonlinear.nodal import LeftTablesError, MechanismMotion, simulate
from morembs.nonlinear.planar_beam import PlanarBeam, Section
from morembs.nonlinear.solid import NonlinearSolid
from morembs.nonlinear.spatial_beam import SpatialBeam, SpatialSection
from morembs.nonlinear.statics import equilibrium
from morembs.nonlinear.tube import BeamInTube, CurvedTube

_OLD_NAMES = {
    "Moment": "MemberState",
    "Motion": "MechanismMotion",
    "Settled": "EquilibriumPath",
    "Tube": "CurvedTube",
    "settle": "follow_equilibrium",
}

__all__ = [
    "Angle",
    "BeamBody",
    "BeamInTube",
    "Chain",
    "CurvedTube",
    "EquilibriumPath",
    "FullMember",
    "LeftTablesError",
    "Link",
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
    "beam_pieces",
    "equilibrium",
    "follow_equilibrium",
    "simulate",
]

__getattr__ = renamed(__name__, _OLD_NAMES)
