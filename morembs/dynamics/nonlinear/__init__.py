"""Geometrically nonlinear components: exact beams, solids, their static equilibria, and motion in the plane."""

from morembs.dynamics.nonlinear.beam_body import BeamBody, beam_pieces
from morembs.dynamics.nonlinear.chain import Chain, Link
from morembs.dynamics.nonlinear.component import NonlinearComponent
from morembs.dynamics.nonlinear.continuation import EquilibriumPath, follow_equilibrium
from morembs.dynamics.nonlinear.mechanism import Angle, Mechanism, Point
from morembs.dynamics.nonlinear.member import FullMember, Member, MemberState
from morembs.dynamics.nonlinear.nodal import LeftTablesError, MechanismMotion, simulate
from morembs.dynamics.nonlinear.planar_beam import PlanarBeam, Section
from morembs.dynamics.nonlinear.solid import NonlinearSolid
from morembs.dynamics.nonlinear.spatial_beam import SpatialBeam, SpatialSection
from morembs.dynamics.nonlinear.statics import equilibrium
from morembs.dynamics.nonlinear.tube import BeamInTube, CurvedTube

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
