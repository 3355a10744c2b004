"""Global modal parameterisation: few coordinates for components with large deflections in the plane."""

from morembs.gmp.body import ParameterisedBody, PlaneJoint
from morembs.gmp.chebyshev import ChebyshevTable, points
from morembs.gmp.data import Formulation, Parameterised
from morembs.gmp.divided import DividedMember, divide_until_within, divided_member
from morembs.gmp.equilibria import Equilibrium, Solver
from morembs.gmp.manifold import Manifold, manifold
from morembs.gmp.member import ReducedMember
from morembs.gmp.modes import BendingModes, bending_modes
from morembs.gmp.plan import AngleRange, Plan, Report
from morembs.gmp.shapes import shapes
from morembs.gmp.solid_member import solid_member
from morembs.moved import renamed

__all__ = [
    "AngleRange",
    "BendingModes",
    "ChebyshevTable",
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
    "divide_until_within",
    "divided_member",
    "manifold",
    "points",
    "shapes",
    "solid_member",
]

__getattr__ = renamed(__name__, {"Envelope": "AngleRange", "Table": "ChebyshevTable"})
