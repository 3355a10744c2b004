"""Craig and Bampton 1968: V = [constraint modes, fixed-interface modes].

Both kinds are K-orthogonal, so K_r = blockdiag(condensed stiffness, eigenvalues) is known exactly and
its six zeros are not blurred by projecting. With an average coupling the boundary is z = T u, which
constrains the patch only in the mean.

With ``inertia_modes`` the deformation under the inertia of the constraint modes, K_ii^-1 M psi, joins the
basis (quasi-static mode compensation, Shyu, Ma and Hulbert 1997): what the cut fixed-interface modes
would have contributed at low frequency. It usually lowers the errors by orders of magnitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.linalg as sl

from morembs.errors import InputError
from morembs.linalg.orthogonal import beside
from morembs.problem import Problem
from morembs.progress import Progress
from morembs.reducers.base import Basis, Reducer, add_residual_modes, chosen_modes
from morembs.reducers.guyan import require_interfaces


@dataclass(frozen=True, kw_only=True)
class CraigBampton(Reducer):
    """Interface motions stay coordinates; ``modes`` internal ones, or fixed-interface modes up to ``up_to_hz``.

    ``inertia_modes`` takes as many internal coordinates as there are interface motions for the inertia
    deformation, and the rest for fixed-interface modes; with ``up_to_hz`` it adds them.
    """

    method: ClassVar[str] = "craig-bampton"
    modes: int | None = None
    up_to_hz: float | None = None
    inertia_modes: bool = False

    def _basis(self, problem: Problem, progress: Progress) -> Basis:
        chosen_modes(self.modes, self.up_to_hz, self.method)
        require_interfaces(problem, self.method)
        below = None if self.up_to_hz is None else (2 * np.pi * self.up_to_hz) ** 2
        count = self.modes
        inputs = problem.B.shape[1]
        if self.inertia_modes and count is not None:
            count -= inputs
            if count < 0:
                raise InputError(
                    f"modes = {self.modes} was given with inertia_modes; expected at least {inputs}, one for each "
                    "interface motion"
                )
        fixed = problem.fixed_modes(count=count, below=below)
        constraint, condensed = problem.internal.impose()
        basis = Basis(
            V=beside(constraint, fixed.vectors, budget=problem.budget),
            kinds=("constraint",) * inputs + ("fixed-interface",) * len(fixed.eigenvalues),
            K=sl.block_diag(condensed, np.diag(fixed.eigenvalues)),
            # Rigid motion is that of the interfaces, without any internal coordinate.
            rigid=np.vstack([problem.B.T @ problem.rigid, np.zeros((fixed.vectors.shape[1], problem.rigid.shape[1]))]),
            holds_interfaces=True,
        )
        if not self.inertia_modes:
            return basis
        deformation = problem.internal.flexibility(problem.M @ constraint)
        return add_residual_modes(problem, basis, deformation, fixed.vectors)
