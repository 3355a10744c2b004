"""Free-interface modes with residual attachment modes, in Rubin's form (MacNeal 1971, Rubin 1975).

V = [rigid, elastic modes Phi, Psi], Psi = (G_e - Phi Lam^-1 Phi') B with the elastic flexibility G_e.
Psi is M- and K-orthogonal to the modes, so K_r is block diagonal; Psi is turned to diagonalise its own
block, which gives each attachment coordinate a frequency.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from morembs.problem import Problem
from morembs.reducers.base import Basis, add_residual_modes
from morembs.reducers.families import OfModes


@dataclass(frozen=True, kw_only=True)
class FreeInterface(OfModes):
    """Free-free modes, made statically exact at the interfaces.

    Args:
        modes: number of elastic free-free modes; this or ``up_to_hz``.
        up_to_hz: all free-free modes up to this frequency.

    >>> FreeInterface(modes=6).reduce(problem).rigid_count
    6
    """

    method: ClassVar[str] = "free-interface"

    def _basis(self, problem: Problem) -> Basis:
        free = problem.elastic_modes(count=self.modes, below=self.below)
        rigid, Phi = problem.rigid, free.vectors
        Psi = problem.free_free.flexibility(problem.B.toarray())
        r, m = rigid.shape[1], Phi.shape[1]
        modes = Basis(
            V=problem.space.hstack(rigid, Phi),
            kinds=("rigid",) * r + ("elastic",) * m,
            K=np.diag(np.concatenate([np.zeros(r), free.eigenvalues])),
            rigid=np.eye(r + m, r),
        )
        return add_residual_modes(problem, modes, Psi, modes.V)
