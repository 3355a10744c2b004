"""A solver that can be watched."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from morembs.linalg.sparse.solver import Analysis, Factorization
from morembs.linalg.sparse.superlu import SuperLU
from morembs.linalg.sparse.symmetric import Lower


@dataclass(frozen=True, kw_only=True)
class CountingSolver(SuperLU):
    """SuperLU that counts its analyses by their structure, and its factorisations."""

    analyses: Counter[str] = field(default_factory=Counter, compare=False, repr=False)
    factorisations: list[str] = field(default_factory=list, compare=False, repr=False)

    def _analyse(self, A: Lower, structure: str) -> Analysis:
        self.analyses[structure] += 1
        analysis = super()._analyse(A, structure)
        factorize = analysis.factorize_unchecked

        def counted(A: Lower) -> Factorization:
            self.factorisations.append(structure)
            return factorize(A)

        vars(analysis)["factorize_unchecked"] = counted
        return analysis
