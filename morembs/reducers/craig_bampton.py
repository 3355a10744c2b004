"""Craig and Bampton 1968: V = [constraint modes, fixed-interface modes].

Both kinds are K-orthogonal, so K_r = blockdiag(condensed stiffness, eigenvalues) is known exactly and
its six zeros are not blurred by projecting. With an average coupling the boundary is z = T u, which
constrains the patch only in the mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.linalg as sl

from morembs.problem import Problem
from morembs.progress import Progress
from morembs.reducers.base import Basis, Reducer, chosen_modes
from morembs.reducers.guyan import require_interfaces


@dataclass(frozen=True, kw_only=True)
class CraigBampton(Reducer):
    """Interface motions stay coordinates; ``modes`` fixed-interface modes or all up to ``up_to_hz``."""

    method: ClassVar[str] = "craig-bampton"
    modes: int | None = None
    up_to_hz: float | None = None

    def _basis(self, problem: Problem, progress: Progress) -> Basis:
        chosen_modes(self.modes, self.up_to_hz, self.method)
        require_interfaces(problem, self.method)
        below = None if self.up_to_hz is None else (2 * np.pi * self.up_to_hz) ** 2
        fixed = problem.fixed_modes(count=self.modes, below=below)
        constraint, condensed = problem.internal.impose()
        return Basis(
            V=np.hstack([constraint, fixed.vectors]),
            kinds=("constraint",) * constraint.shape[1] + ("fixed-interface",) * len(fixed.eigenvalues),
            K=sl.block_diag(condensed, np.diag(fixed.eigenvalues)),
        )
