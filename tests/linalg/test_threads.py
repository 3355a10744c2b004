"""Threads of the BLAS and the speed of this machine."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest

from morembs.base.errors import InputError
from morembs.linalg.sparse import threads
from morembs.linalg.sparse.threads import blas_threads, limit_threads, measured_speed, quiet_idle_threads


def test_limit_holds_inside_the_context_only() -> None:
    np.ones((2, 2)) @ np.ones((2, 2))
    before = blas_threads()
    assert before >= 1
    with limit_threads(2):
        assert blas_threads() == 2
        with limit_threads(1):
            assert blas_threads() == 1
            with limit_threads(None):
                assert blas_threads() == 1
        assert blas_threads() == 2
    assert blas_threads() == before


@pytest.mark.parametrize("number", [0, -3])
def test_numbers_that_are_not_positive_are_refused(number: int) -> None:
    with pytest.raises(InputError, match="expected 1 or more"):
        limit_threads(number)


def test_idle_threads_sleep_unless_the_user_says_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENBLAS_THREAD_TIMEOUT", raising=False)
    quiet_idle_threads()
    assert os.environ["OPENBLAS_THREAD_TIMEOUT"] == "4"
    monkeypatch.setenv("OPENBLAS_THREAD_TIMEOUT", "20")
    quiet_idle_threads()
    assert os.environ["OPENBLAS_THREAD_TIMEOUT"] == "20"


class Clock:
    """Time that passes only when a job takes some."""

    def __init__(self) -> None:
        self.now = 0.0

    def perf_counter(self) -> float:
        return self.now


def test_speed_is_measured_once_for_each_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    took = iter([0.05, 0.02, 0.5, 0.1])

    def best(job: Callable[[], object]) -> float:
        job()
        return next(took)

    # Numbers of threads that no machine has, as each is measured once in a process.
    monkeypatch.setattr(threads, "blas_threads", lambda: 100_001)
    monkeypatch.setattr(threads, "shortest_time", best)
    speed = measured_speed()
    # A product of matrices of order 1000 in 0.05 s; two of three vectors of a third of 64 MiB, and one more, in 0.02 s.
    assert speed.gemm_gflops == pytest.approx(2e-9 * 1000**3 / 0.05)
    assert speed.triad_gbs == pytest.approx(5e-9 * 8 * (2**26 // 24) / 0.02)
    assert measured_speed() is speed
    monkeypatch.setattr(threads, "blas_threads", lambda: 100_002)
    assert measured_speed() is not speed


def test_best_of_several_runs_within_the_budget() -> None:
    clock = Clock()
    times: list[float] = []

    def job() -> None:
        times.append(0.0625 if not times else 0.015625)
        clock.now += times[-1]

    assert threads.shortest_time(job, 0.2, clock.perf_counter) == pytest.approx(0.015625)
    # As many runs as end within the budget.
    assert 0.2 - 0.015625 < sum(times) <= 0.2


def test_import_of_the_package_quiets_before_numpy_is_loaded() -> None:
    """An audit hook sees the first import of NumPy, when its OpenBLAS reads the environment."""
    code = """if True:
        import os, sys
        seen = []
        def hook(event, args):
            if event == "import" and args[0] == "numpy":
                seen.append(os.environ.get("OPENBLAS_THREAD_TIMEOUT"))
        sys.addaudithook(hook)
        import morembs, numpy
        assert seen[0] == "4", seen
    """
    clean = {key: value for key, value in os.environ.items() if key != "OPENBLAS_THREAD_TIMEOUT"}
    subprocess.run([sys.executable, "-c", code], check=True, env=clean)
