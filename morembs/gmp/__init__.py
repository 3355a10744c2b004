"""Global modal parameterisation: few coordinates for components with large deflections in the plane."""

from morembs.gmp.body import ParameterisedBody, PlaneJoint
from morembs.gmp.chebyshev import Table, points
from morembs.gmp.data import Formulation, Parameterised
from morembs.gmp.equilibria import Equilibrium, Solver
from morembs.gmp.manifold import Manifold, manifold
from morembs.gmp.member import ReducedMember
from morembs.gmp.modes import BendingModes, bending_modes
from morembs.gmp.plan import Envelope, Plan, Report
from morembs.gmp.shapes import shapes
from morembs.gmp.solid_member import solid_member

__all__ = [
    "BendingModes",
    "Envelope",
    "Equilibrium",
    "Formulation",
    "Manifold",
    "Parameterised",
    "ParameterisedBody",
    "Plan",
    "PlaneJoint",
    "ReducedMember",
    "Report",
    "Solver",
    "Table",
    "bending_modes",
    "manifold",
    "points",
    "shapes",
    "solid_member",
]
