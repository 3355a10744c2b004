"""Products of K and M with blocks of columns: SciPy, MKL and Numba, and M as a scalar matrix times I3.

MKL (packages mkl and sparse-dot-mkl, MKL_RT names its library) and Numba are measured where they are installed.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from typing import Any

Row = dict[str, Any]
WIDTHS = (1, 8, 32, 64)
THREADS = (1, 2)
_REPEATED = 7
_COLUMNS = tuple((f"ms_{width}", f"{width} columns", "f") for width in WIDTHS)


def products(settings: Any) -> None:
    """Milliseconds of K X and M X for blocks of columns, on one and on two threads, all in one process."""
    from measure import Report, required

    dofs = 6_000 if settings.quick else 104_000
    rounds: dict[str, list[Row]] = {}
    for _ in range(settings.repeat):
        for kind, row in required("products", settings, dofs=dofs)["kinds"].items():
            rounds.setdefault(kind, []).append(row)
    report = Report("products", settings)
    report.add(rounds)
    report.table(f"products: milliseconds, best of {_REPEATED}, cube of {dofs:,} dofs; X by rows or as told", _COLUMNS)
    report.write()


def measure_products(spec: Row, steel: Callable[[str, int], Any]) -> Row:
    """Milliseconds of all kinds of products that can run here, for all widths: the best of some."""
    import numpy as np

    from morembs.problem import Problem

    rows: dict[str, Row] = {}
    with Problem(steel("cube", spec["dofs"])) as problem:
        rng = np.random.default_rng(0)
        blocks = {width: rng.standard_normal((problem.K.shape[0], width)) for width in WIDTHS}
        for kind, (needs, parallel, prepare) in KINDS.items():
            if needs and not importlib.util.find_spec(needs):
                continue
            for threads in THREADS if parallel else THREADS[:1]:
                try:
                    apply = prepare(problem, threads)
                except ImportError:
                    # The package is there without the library that it loads.
                    break
                order = np.asfortranarray if "by columns" in kind else np.ascontiguousarray
                rows[f"{kind}, {threads} threads" if parallel else kind] = {
                    f"ms_{width}": 1e3 * _best(apply, order(X)) for width, X in blocks.items()
                }
    return {"kinds": rows}


def _best(apply: Callable[[Any], Any], X: Any) -> float:
    """Least seconds of some calls."""
    seconds = []
    for _ in range(_REPEATED):
        start = time.perf_counter()
        apply(X)
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def _by_scalar(problem: Any, threads: int) -> Callable[[Any], Any]:
    import scipy.sparse as sp

    # The matrix S of M = S times I3.
    S = sp.csr_array(problem.M[::3, ::3])
    return lambda X: (S @ X.reshape(S.shape[0], -1)).reshape(X.shape)


def _bsr(A: Any) -> Any:
    import scipy.sparse as sp

    return sp.bsr_array(A, blocksize=(3, 3))


def _mkl(A: Any, threads: int) -> Callable[[Any], Any]:
    from sparse_dot_mkl import dot_product_mkl, mkl_set_num_threads

    mkl_set_num_threads(threads)
    return lambda X: dot_product_mkl(A, X)


def _numba(A: Any, threads: int) -> Callable[[Any], Any]:
    import numba
    import numpy as np

    @numba.njit(parallel=True)  # type: ignore[untyped-decorator]
    def multiply(indptr: Any, indices: Any, data: Any, X: Any, Y: Any) -> None:
        for row in numba.prange(len(indptr) - 1):
            for column in range(X.shape[1]):
                Y[row, column] = 0.0
            for k in range(indptr[row], indptr[row + 1]):
                for column in range(X.shape[1]):
                    Y[row, column] += data[k] * X[indices[k], column]

    def apply(X: Any) -> Any:
        Y = np.empty_like(X)
        multiply(A.indptr, A.indices, A.data, X, Y)
        return Y

    numba.set_num_threads(threads)
    return apply


# What each kind needs besides SciPy, whether it takes threads, and how it is set up.
KINDS: dict[str, tuple[str, bool, Callable[[Any, int], Callable[[Any], Any]]]] = {
    "K, SciPy CSR": ("", False, lambda problem, threads: lambda X: problem.K @ X),
    "K, SciPy CSR, X by columns": ("", False, lambda problem, threads: lambda X: problem.K @ X),
    "K, SciPy BSR": ("", False, lambda problem, threads: _bsr(problem.K).__matmul__),
    "K, lower triangle": ("", False, lambda problem, threads: problem.stiffness.lower.__matmul__),
    "K, MKL CSR": ("sparse_dot_mkl", True, lambda problem, threads: _mkl(problem.K, threads)),
    "K, MKL BSR": ("sparse_dot_mkl", True, lambda problem, threads: _mkl(_bsr(problem.K), threads)),
    "K, Numba CSR": ("numba", True, lambda problem, threads: _numba(problem.K, threads)),
    "M, SciPy CSR": ("", False, lambda problem, threads: lambda X: problem.M @ X),
    "M, SciPy scalar": ("", False, _by_scalar),
    "M, MKL CSR": ("sparse_dot_mkl", True, lambda problem, threads: _mkl(problem.M, threads)),
}


CASES = {"products": products}
