"""A package for morembs as it was written for 0.1: a reducer, a solver, an exporter and an importer."""

import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.linalg as sl

from morembs.exporters.base import Exported, Exporter
from morembs.importers import Importer, import_file
from morembs.linalg.sparse.solver import Analysis, Factorization, Forecast, LinearSolver
from morembs.reducers.base import Reducer, elastic_basis
from morembs.storage.safefile import replacing_all


@dataclass(frozen=True, kw_only=True)
class StaticResponses(Reducer):
    """Rigid-body modes and the static responses to the interface loads, or the first ``count`` of them."""

    method: ClassVar[str] = "static-responses"
    count: int | None = None

    def why_not(self, facts):
        if self.count is not None and not 0 < self.count <= facts.inputs:
            return f"count = {self.count} was given; expected 1 to {facts.inputs}, the number of interface motions"
        return super().why_not(facts)

    def _basis(self, problem, progress):
        F = problem.B.toarray()[:, : self.count]
        return elastic_basis(problem, problem.free_free.flexibility(F), "attachment")


class DenseFactor(Factorization):
    def __init__(self, A, stats):
        super().__init__(stats, A.dtype)
        self.A, self.lu = A, sl.lu_factor(A)

    def _solve(self, B):
        return np.asfortranarray(sl.lu_solve(self.lu, B))

    def _negative_pivots(self):
        return int((sl.eigvalsh(self.A) < 0).sum())

    def _release(self):
        self.A = self.lu = None


class DenseAnalysis(Analysis):
    @property
    def forecast(self):
        n = self.n
        return Forecast(
            backend="dense", size=n, factor_entries=n * n, flops=n**3 / 1.5, memory=16 * n * n, kept=16 * n * n
        )

    def _factorize(self, A):
        start = time.perf_counter()
        return DenseFactor(A.full().toarray(), self._stats(start, 2 * self.n**2))

    def _release(self):
        pass


@dataclass(frozen=True, kw_only=True)
class Dense(LinearSolver):
    """LU of the full matrix."""

    name: ClassVar[str] = "dense"
    structures: ClassVar[tuple[str, ...]] = ("spd", "symmetric")

    @classmethod
    def unavailable(cls):
        return ""

    def _analyse(self, A, structure):
        return DenseAnalysis(A, structure)


@dataclass(frozen=True, kw_only=True)
class Table(Exporter):
    """Reduced mass and stiffness as text, ``digits`` digits each."""

    name: ClassVar[str] = "table"
    suffix: ClassVar[str] = ".txt"
    about: ClassVar[str] = "reduced mass and stiffness as text"
    lossless: ClassVar[bool] = False
    needs_frame: ClassVar[bool] = False
    digits: int = 9

    def _write(self, task):
        with replacing_all([task.path]) as (file,):
            model = task.body.reduced()
            for matrix in (model.M, model.K):
                rows = (" ".join(f"{x:.{self.digits}e}" for x in row) for row in matrix)
                file.write(("\n".join(rows) + "\n").encode())
        return Exported(paths=(task.path,))


def read_brick(path, *, dialect: str = "auto"):
    """An Abaqus deck by another name."""
    return import_file(path, "abaqus", {"dialect": dialect})


brick = Importer(about="Abaqus deck by another name", endings=(".brick",), read=read_brick)
