"""What reducers are asked about before any work."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Self

from morembs.fem import FEModel
from morembs.fem.interface import Coupling, Interface
from morembs.linalg.dynamic_stiffness import structure_at
from morembs.linalg.sparse.solver import STRUCTURES
from morembs.problem import Damping, Problem
from morembs.responses.tolerances import TOL as RESPONSES


@dataclass(frozen=True, kw_only=True)
class ShiftedFactorisations:
    """Factorisations of A(s) beside the one of K: ``count`` of them, each solved with for so many ``columns``, and how
    many are known ``at_once``, so that workers share them; the largest ``structure`` among them."""

    structure: str
    count: int
    columns: int
    at_once: int


@dataclass(frozen=True, kw_only=True, eq=False)
class ProblemSummary:
    """What is known of a problem before anything is factorised; K and M of the model may be empty."""

    model: FEModel
    interfaces: Sequence[Interface]
    coupling: Coupling
    damping: Damping

    @classmethod
    def of(cls, problem: Problem) -> Self:
        """Those of ``problem``."""
        return cls(
            model=problem.model,
            interfaces=problem.interfaces,
            coupling=replace(problem.coupling, B=problem.B),
            damping=problem.damping,
        )

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
        """True if the model has a damping, gyroscopic or circulatory matrix."""
        return self.model.D is not None or not self.symmetric

    @property
    def symmetric(self) -> bool:
        """True if the model has neither a gyroscopic nor a circulatory matrix."""
        return self.model.G is None and self.model.N is None

    def at_shifts(self, s: Iterable[complex], columns: int, at_once: bool = True) -> list[ShiftedFactorisations]:
        """A(s) at each of ``s`` in 1/s; nothing where K serves for all of them."""
        model = self.model
        D, G, N = (A is not None for A in (model.D, model.G, model.N))
        structures = [structure_at(x, D=D, G=G, N=N) for x in s if x or N]
        if not structures:
            return []
        largest, count = max(structures, key=STRUCTURES.index), len(structures)
        return [ShiftedFactorisations(structure=largest, count=count, columns=columns, at_once=count if at_once else 1)]

    def at_frequencies(self, count: int) -> list[ShiftedFactorisations]:
        """What the response of the full model at ``count`` frequencies is made of: a reference model takes few of them,
        and none without a damping matrix of its own."""
        if not self.symmetric:
            return self.at_shifts([1j] * count, self.inputs)
        if self.model.D is None or self.size <= RESPONSES.dense_order:
            return []
        return self.at_shifts([1j] * RESPONSES.shifts_at_once, self.inputs)
