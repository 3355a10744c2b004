"""What reducers are asked about before any work."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

from morembs.interface import Coupling, Interface
from morembs.model import FEModel
from morembs.problem import Damping, Problem


@dataclass(frozen=True, kw_only=True, eq=False)
class Facts:
    """What is known of a problem before anything is factorised; K and M of the model may be empty."""

    model: FEModel
    interfaces: Sequence[Interface]
    coupling: Coupling
    damping: Damping

    @classmethod
    def of(cls, problem: Problem) -> Self:
        """Those of ``problem``."""
        return cls(
            model=problem.model, interfaces=problem.interfaces, coupling=replace(problem.coupling, B=problem.B),
            damping=problem.damping,
        )  # fmt: skip

    @property
    def size(self) -> int:
        """Number of coupled dofs."""
        return int(self.coupling.T.shape[1])

    @property
    def inputs(self) -> int:
        """Number of interface degrees of freedom."""
        return int(self.coupling.B.shape[1])

    @property
    def own_damping(self) -> bool:
        """Whether the model has a damping, gyroscopic or circulatory matrix."""
        return self.model.D is not None or not self.symmetric

    @property
    def symmetric(self) -> bool:
        """Whether the model has neither a gyroscopic nor a circulatory matrix."""
        return self.model.G is None and self.model.N is None
