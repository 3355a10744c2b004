"""RSLAB: supernodal factor L D L' of real and complex symmetric matrices, in memory, with the inertia.

Pivots are those of Bunch and Kaufman (1977) within supernodes. It is written in Rust, under the MIT license, in wheels
of a few megabytes that hold all that it needs. The factor is the same to the last bit for any number of threads.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from functools import cache, partial
from types import ModuleType
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import SingularMatrixError
from morembs.base.types import Values
from morembs.linalg.sparse.session import FactorSize, Session, SessionSolver
from morembs.linalg.sparse.solver import MECHANISM, Forecast
from morembs.linalg.sparse.symmetric import Lower
from morembs.linalg.sparse.threads import blas_threads


@cache
def rslab_library() -> ModuleType | str:
    """The package, or why there is none."""
    try:
        return importlib.import_module("rslab")
    except ImportError as error:
        return f"the package rslab cannot be imported ({error}); get it with: pip install 'morembs[rslab]'"


class _RslabSession(Session):
    """The symbolic factor, and a numeric one."""

    title = "RSLAB"

    def __init__(self, solver: SessionSolver, A: Lower, structure: str) -> None:
        super().__init__(solver, A, structure)
        self._symbolic: Any = None
        self._factor: Any = None

    def _analyse(self, A: Lower) -> Forecast:
        triangle = sp.csc_array((A.data, A.indices, A.indptr), shape=(self.n, self.n))
        # Threads of the BLAS are what the user has given to solvers.
        analyse = partial(self.library.analyze, path="ldlt", threads=max(blas_threads(), 1))
        self._symbolic = self.run(analyse, triangle)
        size = self._symbolic.estimate_memory(self.dtype.name)
        # Its analysis and its factor have a copy of the matrix each.
        matrix = 2 * (self.dtype.itemsize + np.dtype(np.int64).itemsize) * self.lower_nnz
        return self.forecast(
            entries=size["factor_nnz"],
            flops=float(size["factor_flops"]),
            memory=size["transient_peak_bytes"] + matrix,
            kept=size["factor_bytes"] + matrix,
        )

    def _factorize(self, A: Lower) -> FactorSize:
        try:
            factor = self.run(self._symbolic.factor, A.data)
        except RuntimeError as error:
            raise SingularMatrixError(f"the matrix is singular ({error}); {MECHANISM}") from None
        if self.structure == "spd" and factor.inertia[1:] != (0, 0):
            raise SingularMatrixError(f"the matrix should be positive definite but is not; {MECHANISM}")
        self._factor = factor
        entries = int(factor.factor_nnz)
        return FactorSize(entries=entries, memory=self.dtype.itemsize * entries)

    def _solve(self, B: Values) -> Values:
        return np.asfortranarray(self.run(self._factor.solve_many, B))

    def _negative_pivots(self) -> int | None:
        return None if self.dtype.kind == "c" else int(self._factor.inertia[1])

    def _forget(self) -> None:
        self._factor = None

    def _free(self) -> None:
        self._symbolic = self._factor = None


@dataclass(frozen=True, kw_only=True)
class Rslab(SessionSolver):
    """RSLAB, in memory; ``scratch`` has no effect."""

    name: ClassVar[str] = "rslab"
    session = _RslabSession
    library = staticmethod(rslab_library)
