"""Threads of the BLAS libraries in this process."""

from __future__ import annotations

from threadpoolctl import threadpool_info, threadpool_limits

from morembs.errors import InputError


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
