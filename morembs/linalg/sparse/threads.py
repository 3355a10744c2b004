"""Threads of the BLAS libraries in this process, and how fast they and the interpreter are."""

from __future__ import annotations

import hashlib
import math
import os
import platform
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from pathlib import Path

from threadpoolctl import threadpool_info, threadpool_limits

from morembs.base.cache import keep_cached, read_cached
from morembs.base.errors import InputError
from morembs.linalg.sparse.tolerances import TOL
from morembs.version import VERSION

# Binary logarithm of the processor cycles that an idle thread of OpenBLAS keeps asking for work before it
# sleeps; 26 by default, which is 20 ms or more.
_TIMEOUT = "OPENBLAS_THREAD_TIMEOUT"
_SHORTEST = "4"


@dataclass(frozen=True, kw_only=True)
class Speed:
    """Rate of a large dense product in 10^9 operations per second, of a = b + s c on long vectors in 10^9 bytes per
    second, read and written, and of a loop of Python in 10^6 rounds per second."""

    gemm_gflops: float
    triad_gbs: float
    python_mhz: float = TOL.usual_python_mhz

    @classmethod
    def of(cls, values: object) -> Speed | None:
        """The speed that such plain values are, None where they are none."""
        names = [field.name for field in fields(cls)]
        if not isinstance(values, Mapping) or set(values) != set(names):
            return None
        rates = [values[name] for name in names]
        if not all(isinstance(rate, float) and 0 < rate < math.inf for rate in rates):
            return None
        return cls(**values)


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
        raise InputError(f"threads = {threads} was given; expected 1 or more", keyword="threads")
    return threadpool_limits(threads, user_api="blas")


def measured_speed() -> Speed:
    """Speed of this machine with the present number of threads, measured once for each number, in 0.7 s of processor.

    It is kept in the cache folder of the user for each version, processor and number of threads.
    """
    import numpy as np  # noqa: F401, whose BLAS is counted

    return kept_speed(blas_threads())


def machine_slowness() -> float:
    """How much longer Python takes here than where the times of stages were measured."""
    return TOL.usual_python_mhz / measured_speed().python_mhz


@lru_cache(maxsize=16)
def kept_speed(threads: int) -> Speed:
    """As ``measured_speed``, of so many ``threads``, which are those of now."""
    name = speed_name(threads)
    kept = Speed.of(read_cached(name))
    if kept is None:
        kept = _measure(max(threads, 1))
        keep_cached(name, asdict(kept))
    return kept


def speed_name(threads: int) -> str:
    """Name of the speed of this version, processor and Python with so many ``threads`` in the cache folder."""
    machine = f"{_processor()} {os.cpu_count()} {platform.python_implementation()} {platform.python_version()}"
    return f"speed-{VERSION}-{threads}-{hashlib.sha256(machine.encode()).hexdigest()[:12]}"


def _processor() -> str:
    """Name of the processor, as well as the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    models = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(models, "") or platform.processor() or platform.machine()


def _measure(threads: int) -> Speed:
    # Not at the top: this module has to be imported before NumPy, see quiet_idle_threads.
    import numpy as np

    order = TOL.speed_order
    A = np.ones((order, order))
    product = np.empty_like(A)
    a, b, c = (np.ones(TOL.speed_bytes // 24) for _ in range(3))

    def triad() -> None:
        np.multiply(c, 3.0, out=a)
        np.add(a, b, out=a)

    # Several threads would wait for each other, and busily, where others work beside.
    with limit_threads(1):
        gemm = processor_time(lambda: np.matmul(A, A, out=product)) / threads
    # The first pass reads c and writes a, the second reads a and b and writes a.
    stream = processor_time(triad)
    loop = processor_time(_loop)
    # 2 n^3 operations of the product; five arrays that are read or written: both in units of 1e9.
    gflops, gbs = 2e-9 * order**3 / gemm, 5e-9 * a.nbytes / stream
    # In units of 1e6.
    return Speed(gemm_gflops=gflops, triad_gbs=gbs, python_mhz=1e-6 * TOL.speed_rounds / loop)


def _loop() -> dict[int, int]:
    """Rounds of what Python does most: a call, a look-up, a sum."""
    found, keys = dict[int, int](), TOL.speed_keys
    for i in range(TOL.speed_rounds):
        found[i % keys] = found.get(i % keys, 0) + i
    return found


def processor_time(
    job: Callable[[], object], seconds: float = TOL.speed_seconds, clock: Callable[[], float] = time.process_time
) -> float:
    """Processor time in seconds that all threads of this process take for ``job``, the mean of many runs after a first.

    The kept value is the speed of the machine, other work beside it or not.
    """
    job()
    start, runs = clock(), 0
    while (used := clock() - start) < seconds:
        job()
        runs += 1
    return used / runs
