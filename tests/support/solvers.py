"""Solvers that can be watched, and that are wrong."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from morembs.base.types import Values
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


class InexactFactor(Factorization):
    """Solutions of ``factor`` for blocks, every dof of which is off by another part of up to ``error``.

    Those for single columns, by which a factor is checked, are not.
    """

    def __init__(self, factor: Factorization, error: float) -> None:
        super().__init__(factor.stats, factor.dtype)
        self.factor, self.error = factor, error

    def _solve(self, B: Values) -> Values:
        X = self.factor.solve(B)
        off = self.error * np.cos(7.0 * np.arange(len(X)))[:, None]
        return np.asfortranarray(X * (1 + off)) if X.shape[1] > 1 else X

    def _negative_pivots(self) -> int | None:
        return self.factor.negative_pivots()

    def _release(self) -> None:
        self.factor.close()


@dataclass(frozen=True, kw_only=True)
class InexactSolver(SuperLU):
    """SuperLU with the solutions of ``InexactFactor``."""

    error: float = 1e-4

    def _analyse(self, A: Lower, structure: str) -> Analysis:
        analysis = super()._analyse(A, structure)
        factorize = analysis.factorize_unchecked
        vars(analysis)["factorize_unchecked"] = lambda A: InexactFactor(factorize(A), self.error)
        return analysis
