"""Improved reduced system (O'Callahan 1989): static condensation, corrected by the inertia that it leaves out.

Let Psi be the constraint modes, M_r and K_r the matrices of static condensation, and G_i the flexibility of the body
held at its interfaces. The free vibrations z of the condensed model have accelerations -M_r^-1 K_r z, whose inertia
deforms the body: V = Psi + G_i M Psi M_r^-1 K_r. The coordinates are still the motions of the interfaces alone.

Each further step takes V and its own matrices in the place of Psi, M_r and K_r (Friswell, Garvey and Penny 1995). The
frequencies converge to frequencies of the full model: the lowest ones, or the lowest of each symmetry.

Lower modes z with B'z = 0, of which the interfaces see nothing, are in V by round-off alone. A step multiplies them by
the eigenvalue of the highest mode of V over their own, which is above one, and the distance of other vectors in V to
their limit by ratios below one. So the largest change of a frequency falls from step to step until such modes, or the
round-off of K and M, take over: the iteration ends with the last step before it rises.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
import scipy.linalg as sl

from morembs.base.limits import number
from morembs.base.types import Floats
from morembs.linalg.columns import without_rigid_motion
from morembs.problem import Problem
from morembs.reducers.base import Basis, Reducer
from morembs.reducers.checks import refuse_singular_mass


@dataclass(frozen=True, kw_only=True)
class ImprovedReducedSystem(Reducer):
    """Interface dofs are the only coordinates, as with "guyan", with frequencies that are far better; statics at the
    interfaces are not exact any more.

    Args:
        steps: maximum number of inertia corrections. One is the method of O'Callahan. With more corrections the modes
            converge to modes of the model. The corrections end when the frequencies settle (``steps_made`` in the
            recipe).

    >>> ImprovedReducedSystem(steps=2).reduce(problem).order
    12
    """

    method: ClassVar[str] = "irs"
    # Each step is a solution for all interface dofs.
    steps: Annotated[int, number("an integer from 1 to 100", ge=1, le=100)] = 1

    def _basis(self, problem: Problem) -> Basis:
        Psi, condensed = problem.constraint_modes()
        kinds, rigid = ("constraint",) * Psi.shape[1], problem.B.T @ problem.rigid
        V, K, M = Psi, condensed, problem.space.project(Psi, problem.M)
        refuse_singular_mass(self.method, M, kinds)
        values, change, made = self._values(K, M, rigid), np.inf, 0
        while made < self.steps:
            accelerations = sl.cho_solve(sl.cho_factor(M), without_rigid_motion(K, M, rigid))
            U = problem.fixed_interface.deformation(problem.M @ V, problem.M)
            problem.space.multiply_into(U, accelerations, U)
            U -= Psi @ (problem.B.T @ U)
            # Psi is K-orthogonal to all that leaves the interfaces at rest, and its stiffness is known best.
            K_next = condensed + problem.space.project(U, problem.K)
            U += Psi
            M_next = problem.space.project(U, problem.M)
            refuse_singular_mass(self.method, M_next, kinds)
            before, values = values, self._values(K_next, M_next, rigid)
            last, change = change, float((np.abs(values - before) / values).max(initial=0.0))
            if not change < last:
                break
            V, K, M, made = U, K_next, M_next, made + 1
        notes = {"steps_made": made} if made < self.steps else {}
        return Basis(V=V, kinds=kinds, K=K, rigid=rigid, holds_interfaces=True, notes=notes)

    @staticmethod
    def _values(K: Floats, M: Floats, rigid: Floats) -> Floats:
        """Elastic eigenvalues in (rad/s)2."""
        values = sl.eigh(K, M, eigvals_only=True)[rigid.shape[1] :]
        return np.asarray(np.maximum(values, np.finfo(float).tiny))
