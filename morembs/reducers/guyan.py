"""Static condensation (Guyan 1965): V = constraint modes, unit motions of the interfaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from morembs.problem import Problem
from morembs.reducers.base import Basis, Reducer


@dataclass(frozen=True, kw_only=True)
class Guyan(Reducer):
    """Exact in statics; use it below about 0.3 of the lowest fixed-interface frequency.

    >>> Guyan().reduce(problem).order
    12
    """

    method: ClassVar[str] = "guyan"

    def _basis(self, problem: Problem) -> Basis:
        V, K = problem.fixed_interface.solve_constraint_modes()
        return Basis(
            V=V, kinds=("constraint",) * V.shape[1], K=K, rigid=problem.B.T @ problem.rigid, holds_interfaces=True
        )
