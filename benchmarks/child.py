"""What a child process does: one task of the table at the end, whose figures it prints as one line of JSON.

usage: python benchmarks/child.py TASK JSON

Started by measure.child. "resident_bytes" is the memory of the process before the work that is measured.
"""

from __future__ import annotations

# First, as in any program that uses it: it quiets the idle threads of OpenBLAS before NumPy loads its copy.
import morembs  # noqa: F401

# isort: split
import gzip
import json
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse.linalg as spla
from threadpoolctl import threadpool_info

from morembs.base.errors import MorembsError
from morembs.base.memory import peak_memory_bytes, resident_bytes
from morembs.base.types import Floats
from morembs.fem import ElementBlock, FEModel, Mesh, Nodes
from morembs.linalg.dynamic_stiffness import with_springs
from morembs.linalg.sparse.mixed import Mixed
from morembs.linalg.sparse.mumps import Mumps
from morembs.linalg.sparse.mumps_ranks import RankedMumps
from morembs.linalg.sparse.select import SOLVERS, select_solver
from morembs.linalg.sparse.solver import LinearSolver
from morembs.linalg.sparse.symmetric import Lower
from morembs.linalg.sparse.threads import blas_threads
from morembs.linalg.statics import support_dofs

Row = dict[str, Any]
Spec = dict[str, Any]
MESHES = Path(__file__).resolve().parent.parent / "data" / "small_meshes"
STEEL = {"set": "all", "young": 2.1e11, "poisson": 0.3, "density": 7850.0}
# Columns whose residuals are held at once: fewer than any solver works on.
_RESIDUALS = 4


def machine(spec: Spec) -> Row:
    """Cores, threads, and versions of the libraries."""
    from morembs.linalg.sparse.cholmod_library import cholmod_library
    from morembs.linalg.sparse.mumps_library import embedded_library, system_library

    libraries = {"mumps": system_library("float64"), "mumps-embedded": embedded_library("float64")}
    libraries["cholmod"] = cholmod_library()
    versions = {name: library.version for name, library in libraries.items() if not isinstance(library, str)}
    packages = {name: metadata.version(name) for name in ("morembs", "numpy", "scipy", "pyamg", "scikit-fem")}
    blas = sorted({f"{pool['internal_api']} {pool['version']}" for pool in threadpool_info()})
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "cores": cores,
        "blas_threads": blas_threads(),
        "system": platform.system(),
        "processor": platform.machine(),
        "model": processor_model(),
        "versions": {"python": platform.python_version(), **packages, **versions, "blas": blas},
    }


def processor_model() -> str:
    """Name of the processor where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")


def dgemm(spec: Spec) -> Row:
    """Speed of a large product in double precision."""
    A = np.random.default_rng(3).standard_normal((spec["order"], spec["order"]))
    product, seconds = np.matmul(A, A), []
    for _ in range(3):
        start = time.perf_counter()
        np.matmul(A, A, out=product)
        seconds.append(time.perf_counter() - start)
    return {"gflops": 2e-9 * len(A) ** 3 / min(seconds), "threads": blas_threads()}


def connecting_rod(dofs: int) -> Mesh:
    """Mesh of the demo, or below 50,000 dofs a coarse one."""
    from morembs import read_mesh

    if dofs < 50_000:
        return read_mesh(MESHES / "conrod.msh", "mm-t-s")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "connecting_rod.msh"
        path.write_bytes(gzip.decompress((MESHES / "connecting_rod.msh.gz").read_bytes()))
        return read_mesh(path, "mm-t-s")


def steel(shape: str, dofs: int) -> FEModel:
    """Assembled model of a shape of models.py, or of the connecting "rod"."""
    from models import make

    from morembs import assemble, isotropic

    if shape == "rod":
        return assemble(connecting_rod(dofs), [isotropic(**STEEL)])
    xyz, cells = make(shape, dofs)
    block = ElementBlock(type="tet10", nodes=cells, ids=np.arange(len(cells)))
    mesh = Mesh(nodes=Nodes(ids=np.arange(len(xyz)), xyz=xyz), blocks=(block,))
    return assemble(mesh, [isotropic(**STEEL)])


def matrix(spec: Spec) -> Row:
    """Write the stiffness of a shape on springs that hold its rigid-body modes, as its lower triangle."""
    from morembs import Problem

    path = Path(spec["file"])
    if not path.exists():
        with Problem(steel(spec["shape"], spec["dofs"])) as problem:
            A = with_springs(problem.stiffness.lower, support_dofs(problem.rigid))
            rigid = problem.rigid
        norm = (Lower(A.indptr, A.indices, np.abs(A.data)) @ np.ones(A.n)).max()
        part = path.with_suffix(".part.npz")
        np.savez(part, indptr=A.indptr, indices=A.indices, data=A.data, rigid=rigid, norm=norm)
        part.replace(path)
    with np.load(path) as data:
        return {"dofs": len(data["indptr"]) - 1, "lower_entries": len(data["indices"])}


def load(path: str) -> tuple[Lower, Floats, float]:
    """What ``matrix`` wrote: the triangle, the rigid-body modes (n, 6), the maximum norm of the matrix."""
    with np.load(path) as data:
        return Lower(data["indptr"], data["indices"], data["data"]), data["rigid"], float(data["norm"])


def configured(spec: Spec, near: Floats) -> LinearSolver:
    """The solver that a measurement asks for."""
    scratch = Path(spec["folder"]) / "scratch"
    scratch.mkdir(exist_ok=True)
    disk = spec.get("out_of_core")
    if spec["solver"] == Mumps.name:
        return Mumps(out_of_core=disk, scratch=scratch)
    if spec["solver"] == Mixed.name:
        return Mixed(out_of_core=disk, scratch=scratch)
    return select_solver(spec["solver"], scratch=scratch).with_near_null_space(near)


def factor(spec: Spec) -> Row:
    """Analyse, factorise and solve; ``columns`` lists the numbers of right-hand sides, ``cold`` whether the
    operating system is to forget the files of the factor before each solve."""
    if spec["solver"] in SOLVERS and (reason := SOLVERS[spec["solver"]].unavailable()):
        return {"error": f"not installed: {reason}" if "not found" in reason else reason}
    A, near, norm = load(spec["matrix"])
    B = right_hand_sides(A.n, max(spec["columns"]))
    solver = configured(spec, near)
    resident, start = resident_bytes(), time.perf_counter()
    with solver.analyse(A, "spd") as analysis:
        analysed, plan, used = time.perf_counter(), analysis.forecast, time.process_time()
        factorisation = analysis.factorize(A)
        ready, peak, used = time.perf_counter(), peak_memory_bytes(), time.process_time() - used
        stats = factorisation.stats
        solves, X = solved(factorisation.solve, B, spec)
        if spec["solver"] == "auto":
            solves["choice"] = stats.backend
    return {
        "dofs": A.n,
        "resident_bytes": resident,
        "analyse_seconds": analysed - start,
        "factor_seconds": stats.seconds,
        "factor_cpu_seconds": used,
        "ready_seconds": ready - start,
        "factor_peak_bytes": peak - resident,
        "forecast_bytes": plan.memory,
        "flops": None if spec["solver"] == "amg" else plan.flops,
        "factor_entries": stats.factor_entries,
        "factor_bytes": stats.memory_bytes,
        "disk_bytes": stats.disk_bytes,
        "threads": stats.threads,
        "precision": stats.precision,
        **solves,
        "backward_error": backward_error(A, norm, X, B),
    }


def splu(spec: Spec) -> Row:
    """As ``factor``, by SuperLU as SciPy offers it; the order of the columns is part of the factorisation."""
    A, _, norm = load(spec["matrix"])
    B = right_hand_sides(A.n, max(spec["columns"]))
    whole = A.full()
    options = {"permc_spec": spec["order"]} if spec.get("order") else {}
    resident, start = resident_bytes(), time.perf_counter()
    lu = spla.splu(whole, **options)
    seconds, peak = time.perf_counter() - start, peak_memory_bytes()
    solves, X = solved(lu.solve, B, spec)
    return {
        "dofs": A.n,
        "resident_bytes": resident,
        "factor_seconds": seconds,
        "ready_seconds": seconds,
        "factor_peak_bytes": peak - resident,
        "flops": None,
        "factor_entries": int(lu.nnz),
        "threads": 1,
        **solves,
        "backward_error": backward_error(A, norm, X, B),
    }


def right_hand_sides(n: int, count: int) -> Floats:
    """Loads (n, count) in Fortran order, the same in every run."""
    return np.asfortranarray(np.random.default_rng(5).standard_normal((count, n)).T)


def solved(solve: Callable[[Floats], Floats], B: Floats, spec: Spec) -> tuple[Row, Floats]:
    """Seconds of the solves, and the solution of the widest, which is the last."""
    row: Row = {}
    for count in sorted(spec["columns"]):
        X = None
        if spec.get("cold"):
            row["dropped_bytes"] = forget_files(Path(spec["folder"]) / "scratch")
        read, start = bytes_read(), time.perf_counter()
        X = solve(B[:, :count])
        row[f"solve_{count}_seconds"] = time.perf_counter() - start
        if spec.get("cold"):
            row["read_bytes"] = bytes_read() - read
    row["columns"], row["solve_seconds"] = count, row[f"solve_{count}_seconds"]
    return row, X


def forget_files(folder: Path) -> int:
    """Have the operating system write the files below ``folder`` and forget their pages; returns their size."""
    size = 0
    for path in folder.rglob("*"):
        if path.is_file():
            handle = os.open(path, os.O_RDONLY)
            try:
                os.fsync(handle)
                os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)
                size += os.fstat(handle).st_size
            finally:
                os.close(handle)
    return size


def bytes_read() -> int:
    """Bytes that this process had fetched from disks so far; 0 where the system does not tell."""
    try:
        lines = Path("/proc/self/io").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0
    return int(dict(line.split(": ", 1) for line in lines)["read_bytes"])


def backward_error(A: Lower, norm: float, X: Floats, B: Floats) -> float:
    """Largest over the columns of |B - A X| / (|A| |X| + |B|), in the maximum norm."""
    worst = 0.0
    for first in range(0, X.shape[1], _RESIDUALS):
        x, b = X[:, first : first + _RESIDUALS], B[:, first : first + _RESIDUALS]
        residual = np.abs(b - A @ np.ascontiguousarray(x)).max(axis=0)
        worst = max(worst, float((residual / (norm * np.abs(x).max(axis=0) + np.abs(b).max(axis=0))).max()))
    return worst


def write_job(spec: Spec) -> Row:
    """Write mesh and job of a shape, with ``more`` tables."""
    from models import job

    given = {key: spec[key] for key in ("memory", "scratch", "reduction") if key in spec}
    path = job(spec["shape"], spec["dofs"], Path(spec["to"]), **given)
    with path.open("a", encoding="utf-8") as file:
        file.write("\n" + spec.get("more", ""))
    return {"job": str(path)}


def same(spec: Spec) -> Row:
    """Largest differences of two bodies, relative to the largest entries of the ``first``."""
    from morembs import read_body

    first, second = (next(iter(read_body(spec[key]).bodies.values())) for key in ("first", "second"))

    def off(a: Floats, b: Floats) -> float:
        return float(np.abs(a - b).max() / np.abs(a).max())

    pairs = list(zip(first.matrices[:2], second.matrices[:2], strict=True))
    return {
        "frequency_difference": off(first.frequencies_hz, second.frequencies_hz),
        "matrix_difference": max(float(np.linalg.norm(a - b) / np.linalg.norm(a)) for a, b in pairs),
    }


def pivots(spec: Spec) -> Row:
    """Negative pivots of a held stiffness less a multiple of its diagonal, on ``ranks`` processes."""
    A, _, _ = load(spec["matrix"])
    shifted = Lower(A.indptr, A.indices, A.data.copy())
    first = A.indptr[:-1]
    shifted.data[first] -= 0.05 * np.median(A.diagonal())
    solver = Mumps() if spec["ranks"] == 1 else RankedMumps(ranks=spec["ranks"])
    return {"negative_pivots": solver.negative_eigenvalues(shifted)}


def modes(spec: Spec) -> Row:
    """See eigen.py."""
    from eigen import measure_modes

    return measure_modes(spec, steel(spec["shape"], spec["dofs"]))


def products(spec: Spec) -> Row:
    """See products.py."""
    from products import measure_products

    return measure_products(spec, steel)


def interpolation(spec: Spec) -> Row:
    """See interpolation.py."""
    from interpolation import measure

    return measure(spec, steel)


def published(spec: Spec) -> Row:
    """See published.py."""
    from published_models import measure

    return measure(spec)


def frames(spec: Spec) -> Row:
    """See frames.py."""
    from frames import measure

    return measure(spec, steel)


def switching(spec: Spec) -> Row:
    """See switching.py."""
    from switching import measure

    return measure(spec, steel)


def startup(spec: Spec) -> Row:
    """See startup.py."""
    from startup import bar_body

    bar_body(Path(spec["file"]), modes=10)
    return {}


def certificates(spec: Spec) -> Row:
    """See certify.py."""
    from certify import measure

    return measure(spec, steel)


def fmu(spec: Spec) -> Row:
    """See fmus.py."""
    from fmus import measure

    return measure(spec)


def mechanism(spec: Spec) -> Row:
    """See mechanisms.py."""
    from mechanisms import measure

    return measure(spec)


def deck(spec: Spec) -> Row:
    """See deck_text.py."""
    from deck_text import read

    return read(spec)


def part(spec: Spec) -> Row:
    """See parts.py."""
    from parts import PARTS, prepare

    entry, folder = PARTS[spec["part"]], Path(spec["folder"])
    if not spec["prepare"]:
        return entry.measure(folder, spec["quick"])
    prepare(entry, folder, spec["quick"])
    return {}


TASKS: dict[str, Callable[[Spec], Row]] = {
    "machine": machine,
    "dgemm": dgemm,
    "matrix": matrix,
    "factor": factor,
    "splu": splu,
    "modes": modes,
    "products": products,
    "job": write_job,
    "interpolation": interpolation,
    "frames": frames,
    "published": published,
    "switching": switching,
    "certify": certificates,
    "fmu": fmu,
    "deck": deck,
    "part": part,
    "startup": startup,
    "mechanism": mechanism,
    "same": same,
    "pivots": pivots,
}


def main() -> None:
    """Do the task that the command line names."""
    try:
        row = TASKS[sys.argv[1]](json.loads(sys.argv[2]))
    except (MorembsError, MemoryError) as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from error
    print(json.dumps(row))


if __name__ == "__main__":
    main()
