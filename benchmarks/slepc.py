"""Lowest modes of a free body by SLEPc: Krylov-Schur with shift and inversion, its factor by MUMPS through PETSc.

usage: PYTHON slepc.py FOLDER COUNT SHIFT

PYTHON has slepc4py and NumPy and need have nothing else (on Debian that of the system, with python3-slepc4py). FOLDER
holds K and M by rows, ``K_indptr.npy`` and so on, and gets values.npy and vectors.npy (m, N) of the COUNT + 6 lowest;
SHIFT is a negative eigenvalue, in (rad/s)2. The figures are printed as one line of JSON.
"""

from __future__ import annotations

import glob
import json
import sys
import time
from pathlib import Path

import numpy as np

# Where Debian puts them.
sys.path += glob.glob("/usr/lib/petscdir/*/*-real/lib/python3/dist-packages")
sys.path += glob.glob("/usr/lib/slepcdir/*/*-real/lib/python3/dist-packages")
from petsc4py import PETSc  # type: ignore[import-not-found,import-untyped,unused-ignore]
from slepc4py import SLEPc  # type: ignore[import-not-found,import-untyped,unused-ignore]

TOLERANCE, RIGID = 1e-9, 6


def main(folder: Path, count: int, shift: float) -> None:
    """Solve, and print seconds and processor seconds of the factorisation and of all else."""
    K, M = (_matrix(folder, name) for name in "KM")
    solver = SLEPc.EPS().create()
    solver.setOperators(K, M)
    solver.setProblemType(SLEPc.EPS.ProblemType.GHEP)
    solver.setDimensions(count + RIGID)
    solver.setTolerances(TOLERANCE)
    solver.setTarget(shift)
    solver.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
    transform = solver.getST()
    transform.setType(SLEPc.ST.Type.SINVERT)
    inner = transform.getKSP()
    inner.setType(PETSc.KSP.Type.PREONLY)
    inner.getPC().setType(PETSc.PC.Type.CHOLESKY)
    inner.getPC().setFactorSolverType("mumps")
    start = _clock()
    solver.setUp()
    ready = _clock()
    solver.solve()
    done = _clock()
    m = solver.getConverged()
    vectors, values, x = np.empty((m, K.size[0])), np.empty(m), K.createVecRight()
    for k in range(m):
        values[k] = solver.getEigenpair(k, x).real
        vectors[k] = x.array
    np.save(folder / "values.npy", values)
    np.save(folder / "vectors.npy", vectors)
    print(
        json.dumps(
            {
                "ready_seconds": ready[0] - start[0],
                "ready_processor": ready[1] - start[1],
                "seconds": done[0] - ready[0],
                "modes_processor": done[1] - ready[1],
                "solver": f"SLEPc {'.'.join(map(str, SLEPc.Sys.getVersion()))}",
            }
        )
    )


def _matrix(folder: Path, name: str) -> PETSc.Mat:
    indptr, indices, data = (np.load(folder / f"{name}_{part}.npy") for part in ("indptr", "indices", "data"))
    size = len(indptr) - 1
    matrix = PETSc.Mat().createAIJ((size, size), csr=(indptr.astype("i4"), indices.astype("i4"), data))
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    return matrix


def _clock() -> tuple[float, float]:
    return time.perf_counter(), time.process_time()


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]))
