"""The eigen-solution that a child measures: the lowest modes of a free body, step by step, and those of ARPACK."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse.linalg as spla
from numpy.typing import NDArray

from morembs.linalg.dynamic_stiffness import grounded
from morembs.linalg.eigen import lowest_modes
from morembs.linalg.statics import ConstrainedStatics, support_dofs
from morembs.memory import peak_memory_bytes, resident_bytes
from morembs.model import FEModel
from morembs.problem import Problem

Floats = NDArray[np.float64]
Row = dict[str, Any]
_TOLERANCE = 1e-9


@dataclass
class Timed:
    """Seconds and columns of all calls of a function; 0 columns where it takes no array."""

    function: Callable[..., Any]
    seconds: float = 0.0
    columns: int = 0

    def __call__(self, given: Any) -> Any:
        start = time.perf_counter()
        try:
            return self.function(given)
        finally:
            self.seconds += time.perf_counter() - start
            self.columns += given.shape[1] if isinstance(given, np.ndarray) else 0


def measure_modes(spec: Row, model: FEModel) -> Row:
    """Modes of the free body with the Sturm count and, by the same factor, those of ARPACK without one."""
    count = spec["count"]
    with Problem(model) as problem:
        resident, start = resident_bytes(), time.perf_counter()
        factor = problem.statics.factor
        ready = time.perf_counter()
        row, pencil = {"dofs": problem.K.shape[0], "modes": count, "solver": factor.stats.backend}, problem.elastic
        pencil.count_below = counted = Timed(pencil.count_below)  # type: ignore[method-assign]
        pencil.flexibility = solves = Timed(pencil.flexibility)  # type: ignore[method-assign]
        modes = lowest_modes(pencil, problem.M, count=count)
        end = time.perf_counter()
        row |= {
            "resident_bytes": resident, "modes_peak_bytes": peak_memory_bytes() - resident,
            "factor_seconds": factor.stats.seconds, "ready_seconds": ready - start, "all_seconds": end - start,
            "count_seconds": counted.seconds, "lanczos_seconds": end - ready - counted.seconds,
            "solve_seconds": solves.seconds, "solve_columns": solves.columns, "flops": None,
            "factor_entries": factor.stats.factor_entries, "threads": factor.stats.threads,
            "verified_hz": float(np.sqrt(modes.verified_below) / (2 * np.pi)),
            "last_hz": float(modes.frequencies_hz[-1]),
            "residual": residual(problem.K, problem.M, modes.eigenvalues, modes.vectors),
        }  # fmt: skip
        del modes
        return row | arpack(problem, pencil, count)


def arpack(problem: Problem, pencil: ConstrainedStatics, count: int) -> Row:
    """The lowest modes of the body on the springs of the factor, by shift and inversion about zero."""
    statics, M = pencil.statics, problem.M
    K = grounded(problem.stiffness.lower, support_dofs(problem.rigid)).full()
    solves = Timed(statics.apply)
    operator = spla.LinearOperator(M.shape, matvec=lambda f: solves(f.reshape(-1, 1))[:, 0], dtype=np.float64)
    v0 = np.random.default_rng(0).standard_normal(M.shape[0])
    start = time.perf_counter()
    values, vectors = spla.eigsh(K, count, M, sigma=0.0, OPinv=operator, v0=v0, tol=_TOLERANCE)
    return {
        "arpack_seconds": time.perf_counter() - start, "arpack_solve_seconds": solves.seconds,
        "arpack_solve_columns": solves.columns, "arpack_last_hz": float(np.sqrt(values.max()) / (2 * np.pi)),
        "arpack_residual": residual(K, M, values, vectors),
    }  # fmt: skip


def residual(K: Any, M: Any, values: Floats, vectors: Floats) -> float:
    """Largest over the modes of |K x - lambda M x| / |K x|, in the Euclidean norm."""
    worst = 0.0
    for value, x in zip(values, vectors.T, strict=True):
        stiff = K @ x
        worst = max(worst, float(np.linalg.norm(stiff - value * (M @ x)) / np.linalg.norm(stiff)))
    return worst
