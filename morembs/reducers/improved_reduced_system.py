"""Improved reduced system (O'Callahan 1989): static condensation, corrected by the inertia that it leaves out.

Let Psi be the constraint modes, M_r and K_r the matrices of static condensation, and G_i the flexibility of the body
held at its interfaces. The free vibrations z of the condensed model have accelerations -M_r^-1 K_r z, whose inertia
deforms the body: V = Psi + G_i M Psi M_r^-1 K_r. The coordinates are still the motions of the interfaces alone.

Each further step takes V and its own matrices in the place of Psi, M_r and K_r (Friswell, Garvey and Penny 1995). The
frequencies converge to frequencies of the full model: the lowest ones, or the lowest of each symmetry.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import scipy.linalg as sl

from morembs.base.limits import number
from morembs.linalg.columns import without_rigid_motion
from morembs.problem import Problem
from morembs.reducers.base import Basis, Reducer
from morembs.reducers.checks import refuse_singular_mass


@dataclass(frozen=True, kw_only=True)
class ImprovedReducedSystem(Reducer):
    """Interface dofs are the only coordinates, as with "guyan", with frequencies that are far better; statics at the
    interfaces are not exact any more.

    Args:
        steps: corrections by inertia. One is that of O'Callahan; more of them converge to modes of the model.

    >>> ImprovedReducedSystem(steps=2).reduce(problem).order
    12
    """

    method: ClassVar[str] = "irs"
    # Frequencies settle within 20 or so; each step is a solution for all interface dofs.
    steps: Annotated[int, number("an integer from 1 to 100", ge=1, le=100)] = 1

    def _basis(self, problem: Problem) -> Basis:
        Psi, condensed = problem.constraint_modes()
        kinds, rigid = ("constraint",) * Psi.shape[1], problem.B.T @ problem.rigid
        V, K = Psi, condensed
        for _ in range(self.steps):
            M = problem.space.project(V, problem.M)
            refuse_singular_mass(self.method, M, kinds)
            accelerations = sl.cho_solve(sl.cho_factor(M), without_rigid_motion(K, M, rigid))
            V = problem.internal.deformation(problem.M @ V, problem.M)
            problem.space.multiply_into(V, accelerations, V)
            V -= Psi @ (problem.B.T @ V)
            # Psi is K-orthogonal to all that leaves the interfaces at rest, and its stiffness is known best.
            K = condensed + problem.space.project(V, problem.K)
            V += Psi
        return Basis(V=V, kinds=kinds, K=K, rigid=rigid, holds_interfaces=True)
