"""Threads of the BLAS libraries in this process, and how fast they are."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

from threadpoolctl import threadpool_info, threadpool_limits

from morembs.base.errors import InputError
from morembs.linalg.sparse.tolerances import TOL

# Binary logarithm of the processor cycles that an idle thread of OpenBLAS keeps asking for work before it
# sleeps; 26 by default, which is 20 ms or more.
_TIMEOUT = "OPENBLAS_THREAD_TIMEOUT"
_SHORTEST = "4"


@dataclass(frozen=True, kw_only=True)
class Speed:
    """Rate of a large dense product in 10^9 operations per second, and of a = b + s c on long vectors in
    10^9 bytes per second, read and written."""

    gemm_gflops: float
    triad_gbs: float


def quiet_idle_threads() -> None:
    """Have idle threads of OpenBLAS sleep at once, unless the environment says otherwise.

    NumPy, SciPy and MUMPS each have a copy of OpenBLAS with threads of its own. After every call the threads of
    one copy keep asking for work for 20 ms and take the cores from the next one: modes by block Lanczos then take
    more than twice the processor time. A copy reads this when it is loaded, so call it before NumPy is imported;
    later it still serves the copy of MUMPS.
    """
    os.environ.setdefault(_TIMEOUT, _SHORTEST)


def blas_threads() -> int:
    """Largest number of threads that a BLAS in this process uses, 0 if there is none."""
    return max((pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"), default=0)


def limit_threads(threads: int | None) -> threadpool_limits:
    """Let every BLAS use up to ``threads`` threads (None: as they are) until the returned context ends.

    Raises:
        InputError: not a positive number.
    """
    if threads is not None and threads < 1:
        raise InputError(f"threads = {threads} was given; expected 1 or more")
    return threadpool_limits(threads, user_api="blas")


def measured_speed() -> Speed:
    """Speed of this process with its present number of threads, measured once for each number in under 0.5 s."""
    return _measured(blas_threads())


@lru_cache(maxsize=16)
def _measured(threads: int) -> Speed:
    # Not at the top: this module has to be imported before NumPy, see quiet_idle_threads.
    import numpy as np

    order = TOL.speed_order
    A = np.ones((order, order))
    product = np.empty_like(A)
    a, b, c = (np.ones(TOL.speed_bytes // 24) for _ in range(3))

    def triad() -> None:
        np.multiply(c, 3.0, out=a)
        np.add(a, b, out=a)

    gemm = shortest_time(lambda: np.matmul(A, A, out=product))
    # The first pass reads c and writes a, the second reads a and b and writes a.
    stream = shortest_time(triad)
    # 2 n^3 operations of the product; five arrays that are read or written: both in units of 1e9.
    return Speed(gemm_gflops=2e-9 * order**3 / gemm, triad_gbs=5e-9 * a.nbytes / stream)


def shortest_time(
    job: Callable[[], object], seconds: float = TOL.speed_seconds, clock: Callable[[], float] = time.perf_counter
) -> float:
    """Shortest of the times in seconds that ``job`` takes, run for so many ``seconds`` in all."""
    best, end = float("inf"), clock() + seconds
    while True:
        start = clock()
        job()
        now = clock()
        best = min(best, now - start)
        if now + best > end:
            return best
