"""Global modal parameterisation: few coordinates for components with large deflections in the plane."""

from morembs.dynamics.gmp.body import ParameterisedBody, PlaneJoint
from morembs.dynamics.gmp.chebyshev import ChebyshevTable, points
from morembs.dynamics.gmp.configuration import Configuration, configuration
from morembs.dynamics.gmp.data import Formulation, Parameterised
from morembs.dynamics.gmp.divided import DividedMember, divide_until_within, divided_member
from morembs.dynamics.gmp.equilibria import Equilibrium, Solver
from morembs.dynamics.gmp.manifold import Manifold, manifold
from morembs.dynamics.gmp.member import ReducedMember
from morembs.dynamics.gmp.modes import BendingModes, bending_modes
from morembs.dynamics.gmp.plan import AngleRange, Plan, Report
from morembs.dynamics.gmp.shapes import shapes
from morembs.dynamics.gmp.solid_member import solid_member

__all__ = [
    "AngleRange",
    "BendingModes",
    "ChebyshevTable",
    "Configuration",
    "DividedMember",
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
    "bending_modes",
    "configuration",
    "divide_until_within",
    "divided_member",
    "manifold",
    "points",
    "shapes",
    "solid_member",
]
