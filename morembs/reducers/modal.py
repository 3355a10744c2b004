"""Modal truncation: V = [rigid modes, lowest modes] of the free body, or of the body held at its interfaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from morembs.base.limits import one_of
from morembs.linalg.columns import hstack
from morembs.problem import Problem
from morembs.reducers.base import Basis
from morembs.reducers.families import OfModes
from morembs.reducers.problem_summary import ProblemSummary


@dataclass(frozen=True, kw_only=True)
class Modal(OfModes):
    """Lowest modes.

    Args:
        modes: number of elastic modes; this or ``up_to_hz``.
        up_to_hz: all modes up to this frequency.
        interfaces: "free" (rigid-body modes come on top) or "fixed" (none are left).

    >>> Modal(modes=4).reduce(problem).mode_kind.count("elastic")
    4
    """

    method: ClassVar[str] = "modal"
    interfaces: Annotated[str, one_of("free", "fixed")] = "free"

    @property
    def takes_unsymmetric(self) -> bool:
        return True

    @property
    def needs_interfaces(self) -> bool:
        return self.interfaces == "fixed"

    def why_not(self, facts: ProblemSummary) -> str:
        if self.needs_interfaces and not facts.inputs:
            return 'interfaces = "fixed" needs interfaces; add at least one [[interface]], or leave it out'
        return super().why_not(facts)

    def _basis(self, problem: Problem) -> Basis:
        if self.interfaces == "fixed":
            modes = problem.fixed_modes(count=self.modes, below=self.below)
            rigid, kind = problem.rigid[:, :0], "fixed-interface"
        else:
            modes = problem.elastic_modes(count=self.modes, below=self.below)
            rigid, kind = problem.rigid, "elastic"
        r, m = rigid.shape[1], len(modes.eigenvalues)
        return Basis(
            V=hstack(rigid, modes.vectors, budget=problem.budget),
            kinds=("rigid",) * r + (kind,) * m,
            K=np.diag(np.concatenate([np.zeros(r), modes.eigenvalues])),
            rigid=np.eye(r + m, r),
            holds_interfaces=self.interfaces == "fixed",
        )
