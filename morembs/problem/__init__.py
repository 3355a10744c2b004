"""M u'' + D u' + K u = B f: a model coupled to its interfaces, with damping and a solver."""

from morembs.problem.damping import STRUCTURAL, Damping, frequency_domain_only, modal_steps
from morembs.problem.problem import STRAIN_FREE, Problem

__all__ = ["STRAIN_FREE", "STRUCTURAL", "Damping", "Problem", "frequency_domain_only", "modal_steps"]
