"""M u'' + D u' + K u = B f: a model coupled to its interfaces, with damping and a solver."""

from morembs.fem.fe_model import STRUCTURAL
from morembs.problem.damping import Damping, frequency_domain_only, modal_steps
from morembs.problem.problem import Problem
from morembs.problem.soundness import SOFTER
from morembs.problem.system import System

__all__ = ["SOFTER", "STRUCTURAL", "Damping", "Problem", "System", "frequency_domain_only", "modal_steps"]
