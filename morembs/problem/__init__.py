"""M u'' + D u' + K u = B f: a model coupled to its interfaces, with damping and a solver."""

from morembs.fem.fe_model import STRUCTURAL
from morembs.problem.damping import Damping, frequency_domain_only, modal_steps
from morembs.problem.dynamics import Dynamics, crew_of
from morembs.problem.problem import AS_A_RULE, LOST, SOFTER, Problem

__all__ = [
    "AS_A_RULE",
    "LOST",
    "SOFTER",
    "STRUCTURAL",
    "Damping",
    "Dynamics",
    "Problem",
    "crew_of",
    "frequency_domain_only",
    "modal_steps",
]
