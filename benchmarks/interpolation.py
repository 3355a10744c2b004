"""What children measure about Krylov reduction: ours, pyMOR's, what its solves cost, and responses point by point.

All take the elastic part of a free body with Rayleigh damping: loads of interfaces without their rigid-body part,
moments divided by the radius of gyration of the body. So nothing is singular at zero, and no reduced model has
to follow rigid motion.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from eigen import Timed
from models import interfaces

from morembs import Problem, full_response, make_interface
from morembs.base.errors import MorembsError
from morembs.base.memory import peak_memory_bytes, resident_bytes
from morembs.base.types import Complexes, Floats
from morembs.certificate.response import reduced_response
from morembs.fem import FEModel
from morembs.fem.selection import select_nodes
from morembs.linalg.dynamic_stiffness import DynamicStiffness
from morembs.problem import Damping
from morembs.reducers.krylov import Krylov

Row = dict[str, Any]
Steel = Callable[[str, int], FEModel]
# Rayleigh damping has its ratio at this part of the highest frequency, and there.
LOWEST = 0.1
TIMES = 3


def now() -> Floats:
    """Seconds of the clock, and of all processors that this process has used: other work does not change these."""
    return np.array([time.perf_counter(), time.process_time()])


class OutOfTimeError(MorembsError):
    """The time limit of a measurement."""


def rayleigh(spec: Row) -> tuple[float, float]:
    """alpha (1/s) and beta (s) with the damping ratio ``spec["ratio"]`` at both ends of the band."""
    high = 2 * np.pi * spec["top_hz"]
    low = LOWEST * high
    return 2 * spec["ratio"] * low * high / (low + high), 2 * spec["ratio"] / (low + high)


def body(spec: Row, steel: Steel) -> Problem:
    """The body with the first and the last interface of its shape: 12 loads."""
    model = steel(spec["shape"], spec["dofs"])
    texts = interfaces(spec["shape"])
    names = list(texts)[:: 2 if spec["shape"] == "crankshaft" else 1][:2]
    joints = [make_interface(model, name=n, nodes=select_nodes(model, texts[n])) for n in names]
    alpha, beta = rayleigh(spec)
    return Problem(model, joints, damping=Damping(alpha=alpha, beta=beta))


def loads(problem: Problem) -> Floats:
    """Elastic part (Nc, m) of the loads, forces and moments in one unit."""
    B = problem.B.toarray() / problem.motion_scale
    return np.asarray(B - problem.M @ (problem.rigid @ (problem.rigid.T @ B)))


def band(spec: Row) -> Floats:
    """Frequencies in rad/s that responses are compared at."""
    return np.asarray(2 * np.pi * spec["top_hz"] * np.linspace(0.02, 1.0, spec["points"]))


def direct(spec: Row, steel: Steel) -> Row:
    """Responses by one factorisation per frequency; writes them, and the matrices, to ``spec["file"]``."""
    alpha, beta = rayleigh(spec)
    omega = band(spec)
    with body(spec, steel) as problem:
        F, K, M = loads(problem), problem.K, problem.M
        D = sp.csr_array(alpha * M + beta * K) if spec["ratio"] else None
        resident, start = resident_bytes(), now()
        H = []
        with DynamicStiffness(K, M, D, solver=problem.solver) as pencil:
            for w in omega:
                with pencil.factorize(1j * w) as factor:
                    H.append(F.T @ factor.solve(F.astype(factor.dtype)))
                    backend = factor.stats.backend
        seconds, cpu = (now() - start).tolist()
        A = {name: part for key, X in (("K", K), ("M", M)) for name, part in csr(key, X).items()}
        np.savez(spec["file"], H=np.array(H), F=F, **A)
        return {
            "dofs": K.shape[0],
            "points": len(omega),
            "seconds": seconds,
            "cpu_seconds": cpu,
            "resident_bytes": resident,
            "factorisations": len(omega),
            "solver": backend,
        }


def csr(key: str, A: sp.csr_array) -> dict[str, Any]:
    """Arrays of a matrix under names that begin with ``key``."""
    return {f"{key}_data": A.data, f"{key}_indices": A.indices, f"{key}_indptr": A.indptr}


def stored(spec: Row, key: str) -> sp.csr_array:
    """A matrix that ``direct`` wrote."""
    with np.load(spec["file"]) as file:
        parts = tuple(file[f"{key}_{part}"] for part in ("data", "indices", "indptr"))
    return sp.csr_array(parts, shape=(len(parts[2]) - 1,) * 2)


def error(H: Complexes, spec: Row) -> float:
    """Largest difference to ``direct``, relative to the largest entry at each frequency."""
    with np.load(spec["file"]) as file:
        exact = file["H"]
    return float((np.abs(H - exact).max(axis=(1, 2)) / np.abs(exact).max(axis=(1, 2))).max())


def reference(spec: Row, steel: Steel) -> Row:
    """The same responses from the reference model."""
    with body(spec, steel) as problem:
        resident, start = resident_bytes(), now()
        H = full_response(problem, band(spec), tolerance=spec["tolerance"])
        seconds, cpu = (now() - start).tolist()
        H = H / np.outer(problem.motion_scale, problem.motion_scale)
        return {
            "dofs": problem.K.shape[0],
            "points": len(H),
            "seconds": seconds,
            "cpu_seconds": cpu,
            "resident_bytes": resident,
            "factorisations": 1,
            "solver": problem.solver_name,
            "response_error": error(H, spec),
        }


def ours(spec: Row, steel: Steel) -> Row:
    """Reduction by this package, and its error."""
    with body(spec, steel) as problem:
        problem.stiffness.factorize = factorize = Counted(problem.stiffness.factorize)  # type: ignore[method-assign]
        reducer = Krylov(shifts_hz=spec["shifts_hz"], moments=spec["moments"])
        resident, start = resident_bytes(), now()
        reduced = reducer.reduce(problem)
        (seconds, cpu), peak = (now() - start).tolist(), peak_memory_bytes()
        H = reduced_response(reduced, band(spec)) / np.outer(problem.motion_scale, problem.motion_scale)
        return {
            "dofs": problem.K.shape[0],
            "seconds": seconds,
            "cpu_seconds": cpu,
            "resident_bytes": resident,
            "peak_rise_bytes": peak - resident,
            "factorisations": factorize.calls,
            "factor_seconds": factorize.seconds,
            "order": reduced.order - reduced.rigid_count,
            "response_error": error(H, spec),
        }


class Counted(Timed):
    """``Timed`` with the number of calls, of functions of any arguments."""

    calls = 0

    def __call__(self, *given: Any, **named: Any) -> Any:
        self.calls += 1
        start = time.perf_counter()
        try:
            return self.function(*given, **named)
        finally:
            self.seconds += time.perf_counter() - start


def pymor(spec: Row) -> Row:
    """Reduction by pyMOR with its own solver at the same points.

    ``spec["block"]`` False: SOBHIReductor with unit vectors for directions, as it is offered; it factorises for
    each vector. True: all loads of a point with one factorisation, from the parts of pyMOR.
    """
    try:
        import pymor.bindings.scipy as bindings
        from pymor.core.logger import set_log_levels
        from pymor.models.iosys import SecondOrderModel
    except ImportError:
        return {"error": "not installed: pip install pymor"}
    set_log_levels({"pymor": "ERROR"})
    alpha, beta = rayleigh(spec)
    K, M = stored(spec, "K"), stored(spec, "M")
    with np.load(spec["file"]) as file:
        F = file["F"]
    bindings.splu = factorize = Counted(bindings.splu)
    model = SecondOrderModel.from_matrices(M, sp.csr_array(alpha * M + beta * K), K, F, F.T)
    points = [2j * np.pi * f for f in spec["shifts_hz"]]
    planned = len(points) if spec["block"] else 2 * F.shape[1] * len(points)
    resident, start = resident_bytes(), now()
    signal.signal(signal.SIGALRM, _stop)
    signal.setitimer(signal.ITIMER_REAL, spec["limit_seconds"])
    try:
        reduced = _block(model, points) if spec["block"] else _tangential(model, points, F.shape[1])
    except OutOfTimeError:
        (seconds, cpu), part = (now() - start).tolist(), factorize.calls / planned
        return {
            "dofs": K.shape[0],
            "more_than_seconds": seconds,
            "estimated_seconds": seconds / part,
            "estimated_cpu_seconds": cpu / part,
            "resident_bytes": resident,
            "factorisations": factorize.calls,
            "planned_factorisations": planned,
            "peak_rise_bytes": peak_memory_bytes() - resident,
        }
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    (seconds, cpu), peak = (now() - start).tolist(), peak_memory_bytes()
    H = np.array([reduced.transfer_function.eval_tf(1j * w) for w in band(spec)])
    return {
        "dofs": K.shape[0],
        "seconds": seconds,
        "cpu_seconds": cpu,
        "resident_bytes": resident,
        "peak_rise_bytes": peak - resident,
        "factorisations": factorize.calls,
        "factor_seconds": factorize.seconds,
        "order": reduced.order,
        "response_error": error(H, spec),
    }


def _stop(number: int, frame: object) -> None:
    raise OutOfTimeError("out of time")


def _tangential(model: Any, points: list[complex], width: int) -> Any:
    from pymor.reductors.interpolation import SOBHIReductor

    # It wants the points with their conjugates, and takes each pair once.
    sigma = np.repeat([s for point in points for s in (point, point.conjugate())], width)
    directions = np.tile(np.eye(width, dtype=complex), (2 * len(points), 1))
    return SOBHIReductor(model).reduce(sigma, directions, directions)


def _block(model: Any, points: list[complex]) -> Any:
    from pymor.algorithms.gram_schmidt import gram_schmidt
    from pymor.parameters.base import Mu
    from pymor.reductors.basic import SOLTIPGReductor

    transfer, F = model.transfer_function, model.B.as_range_array()
    V = model.solution_space.empty(reserve=2 * len(F) * len(points))
    for s in points:
        X = transfer.K.assemble(Mu(s=s)).apply_inverse(F)
        V.append(X.real)
        V.append(X.imag)
    gram_schmidt(V, atol=0, rtol=0, copy=False)
    return SOLTIPGReductor(model, V, V).reduce()


def cost(spec: Row, steel: Steel) -> Row:
    """Krylov reduction at one point against one factorisation and solve with the same solver, then at ten points.

    "cold": with the analysis of the pattern, which the first factorisation makes.
    """
    row = one_point(spec, steel)
    for clock in ("", "cpu_"):
        parts = row[f"factor_{clock}seconds"] + row[f"solve_{clock}seconds"]
        row[f"one_{clock}ratio"] = row[f"one_{clock}seconds"] / parts
        row[f"cold_{clock}ratio"] = row[f"cold_{clock}seconds"] / parts
    with body(spec, steel) as problem:
        pencil = problem.stiffness
        pencil.factorize = factorize = Counted(pencil.factorize)  # type: ignore[method-assign]
        start = now()
        reduced = Krylov(shifts_hz=(np.linspace(0.1, 1.0, 10) * spec["top_hz"]).tolist()).reduce(problem)
        seconds, cpu = (now() - start).tolist()
        return {
            **row,
            "ten_seconds": seconds,
            "ten_cpu_seconds": cpu,
            "ten_factor_seconds": factorize.seconds,
            "ten_factorisations": factorize.calls,
            "ten_analyses": len(pencil.analysed),
            "ten_order": reduced.order - reduced.rigid_count,
        }


def one_point(spec: Row, steel: Steel) -> Row:
    """Median seconds of a factorisation, of the solve for all loads, and of a reduction at one point."""
    top = spec["top_hz"]
    with body(spec, steel) as problem:
        F = loads(problem)
        timings: dict[str, list[Floats]] = {"factor": [], "solve": [], "one": [], "cold": []}
        resident, start = resident_bytes(), now()
        Krylov(shifts_hz=[0.32 * top]).reduce(problem)
        timings["cold"].append(now() - start)
        # Each time at another point: what a point gave is kept.
        for part in 0.41 + 0.03 * np.arange(TIMES):
            start = now()
            with problem.stiffness.factorize(2j * np.pi * part * top) as factor:
                timings["factor"].append(now() - start)
                start = now()
                factor.solve(F)
                timings["solve"].append(now() - start)
                stats = factor.stats
            start = now()
            Krylov(shifts_hz=[float(part + 0.015) * top]).reduce(problem)
            timings["one"].append(now() - start)
        row = {
            "dofs": len(F),
            "loads": F.shape[1],
            "solver": stats.backend,
            "factor_entries": stats.factor_entries,
            "resident_bytes": resident,
        }
        for name, times in timings.items():
            row[f"{name}_seconds"], row[f"{name}_cpu_seconds"] = np.median(times, axis=0).tolist()
        return row


def measure(spec: Row, steel: Steel) -> Row:
    """The measurement that ``spec["what"]`` names."""
    if spec["what"] == "pymor":
        return pymor(spec)
    tasks = {"direct": direct, "reference": reference, "ours": ours, "cost": cost}
    return tasks[spec["what"]](spec, steel)
