"""The eigen-solution that a child measures: the lowest modes of a free body, step by step, and those of ARPACK."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from stages import Stages

from morembs.base.memory import peak_memory_bytes, resident_bytes
from morembs.base.types import Floats
from morembs.fem import FEModel
from morembs.linalg import eigen
from morembs.linalg.eigen import lowest_modes
from morembs.linalg.statics import ConstrainedStatics
from morembs.linalg.sturm import ShiftedInverse
from morembs.problem import Problem

Row = dict[str, Any]
_TOLERANCE, _RIGID = 1e-9, 6
# The Python that has slepc4py, if there is one: Debian's packages belong to that of the system.
SLEPC_PYTHON = os.environ.get("SLEPC_PYTHON", "/usr/bin/python3")


@dataclass
class Timed:
    """Seconds, processor seconds, calls and columns of all calls of a function; 0 columns where it takes no array."""

    function: Callable[..., Any]
    seconds: float = 0.0
    processor: float = 0.0
    calls: int = 0
    columns: int = 0

    def __call__(self, *given: Any, **options: Any) -> Any:
        start, processor = time.perf_counter(), time.process_time()
        try:
            return self.function(*given, **options)
        finally:
            self.seconds += time.perf_counter() - start
            self.processor += time.process_time() - processor
            self.calls += 1
            self.columns += given[-1].shape[1] if given and isinstance(given[-1], np.ndarray) else 0

    def method(self) -> Callable[..., Any]:
        """As a method of a class."""
        return lambda *given, **options: self(*given, **options)


def measure_modes(spec: Row, model: FEModel) -> Row:
    """Modes of the free body with the Sturm count and, by the same factor, those of ARPACK without one."""
    count = spec["count"]
    with Problem(model) as problem:
        resident, made = resident_bytes(), Timed(lambda: problem.statics)
        factor = made().factor
        row, pencil = {"dofs": problem.K.shape[0], "modes": count, "solver": factor.stats.backend}, problem.free_free
        eigen.count_below = counted = Timed(eigen.count_below)  # type: ignore[attr-defined]
        pencil.flexibility = solves = Timed(pencil.flexibility)  # type: ignore[method-assign]
        # The factor of the count, and the solves with it.
        second, again = Timed(ShiftedInverse.__init__), Timed(ShiftedInverse.apply)
        ShiftedInverse.__init__, ShiftedInverse.apply = second.method(), again.method()  # type: ignore[method-assign]
        found, stages = Timed(lambda: lowest_modes(pencil, problem.M, count=count)), Stages()
        with stages.watched():
            modes = found()
        row |= {f"{stage}_stage": seconds for stage, seconds in stages.seconds.items()}
        row |= {f"{stage}_stage_processor": seconds for stage, seconds in stages.processor.items()}
        row |= {
            "resident_bytes": resident,
            "modes_peak_bytes": peak_memory_bytes() - resident,
            "factor_seconds": factor.stats.seconds,
            "ready_seconds": made.seconds,
            "all_seconds": made.seconds + found.seconds,
            "count_seconds": counted.seconds + second.seconds,
            "lanczos_seconds": found.seconds - counted.seconds - second.seconds,
            "solve_seconds": solves.seconds + again.seconds,
            "solve_columns": solves.columns + again.columns,
            "passes": solves.calls + again.calls,
            "ready_processor": made.processor,
            "all_processor": made.processor + found.processor,
            "modes_processor": found.processor,
            "flops": None,
            "factor_entries": factor.stats.factor_entries,
            "threads": factor.stats.threads,
            "verified_hz": float(np.sqrt(modes.verified_below) / (2 * np.pi)),
            "last_hz": float(modes.frequencies_hz[-1]),
            "residual": residual(problem.K, problem.M, modes.eigenvalues, modes.vectors),
        }
        first = modes.eigenvalues[0]
        del modes
        return row | arpack(problem, pencil, count) | slepc(problem, count, -first)


def arpack(problem: Problem, pencil: ConstrainedStatics, count: int) -> Row:
    """The same modes by ARPACK: shift and inversion about zero, rigid motion taken out of every solution."""
    K, M = problem.K, problem.M
    solves = Timed(pencil.flexibility)
    operator = spla.LinearOperator(M.shape, matvec=lambda f: solves(f.reshape(-1, 1))[:, 0], dtype=np.float64)
    v0 = pencil.flexibility(M @ np.random.default_rng(0).standard_normal((M.shape[0], 1)))[:, 0]
    found = Timed(lambda: spla.eigsh(K, count, M, sigma=0.0, OPinv=operator, v0=v0, tol=_TOLERANCE))
    values, vectors = found()
    return {
        "arpack_seconds": found.seconds,
        "arpack_modes_processor": found.processor,
        "arpack_solve_seconds": solves.seconds,
        "arpack_solve_columns": solves.columns,
        "arpack_passes": solves.calls,
        "arpack_last_hz": float(np.sqrt(values.max()) / (2 * np.pi)),
        "arpack_residual": residual(K, M, values, vectors),
    }


def slepc(problem: Problem, count: int, shift: float) -> Row:
    """The same modes by SLEPc, with a factor of its own at a negative shift; its error where it cannot run."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for letter, matrix in (("K", problem.K), ("M", problem.M)):
            for part in ("indptr", "indices", "data"):
                np.save(folder / f"{letter}_{part}.npy", getattr(sp.csr_array(matrix), part))
        command = [SLEPC_PYTHON, str(Path(__file__).with_name("slepc.py")), name, str(count), str(shift)]
        # Its own libraries, and not those of this environment.
        clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
        ended = subprocess.run(command, capture_output=True, text=True, env=clean)
        if ended.returncode:
            return {"slepc_error": (ended.stderr.strip().splitlines() or ["no SLEPc"])[-1]}
        values, vectors = np.load(folder / "values.npy"), np.load(folder / "vectors.npy")
    elastic = np.argsort(values)[_RIGID : _RIGID + count]
    row = json.loads(ended.stdout) | {
        "last_hz": float(np.sqrt(values[elastic[-1]]) / (2 * np.pi)),
        "residual": residual(problem.K, problem.M, values[elastic], vectors[elastic].T),
    }
    return {f"slepc_{key}": value for key, value in row.items()}


def residual(K: Any, M: Any, values: Floats, vectors: Floats) -> float:
    """Largest over the modes of |K x - lambda M x| / |K x|, in the Euclidean norm."""
    worst = 0.0
    for value, x in zip(values, vectors.T, strict=True):
        stiff = K @ x
        worst = max(worst, float(np.linalg.norm(stiff - value * (M @ x)) / np.linalg.norm(stiff)))
    return worst
