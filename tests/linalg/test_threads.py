"""Threads of the BLAS and the speed of this machine."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import numpy as np
import pytest

from morembs.errors import InputError
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


def test_speed_is_plausible_short_and_measured_once(monkeypatch: pytest.MonkeyPatch) -> None:
    threads._measured.cache_clear()
    monkeypatch.setattr(threads, "blas_threads", lambda: 1)
    start = time.process_time()
    with limit_threads(1):
        speed = measured_speed()
        assert time.process_time() - start < 0.7
        assert 0.1 < speed.gemm_gflops < 2000 and 0.1 < speed.triad_gbs < 2000
        assert measured_speed() is speed
        monkeypatch.setattr(threads, "blas_threads", lambda: 2)
        assert measured_speed() is not speed


def test_best_of_several_runs_within_the_budget() -> None:
    times = []

    def job() -> None:
        times.append(time.sleep(0.05 if len(times) == 0 else 0.01))

    assert 0.01 <= threads._best(job) < 0.04
    assert 3 < len(times) < 25


def test_import_of_the_package_quiets_before_numpy_is_loaded() -> None:
    """An audit hook sees the first import of NumPy, when its OpenBLAS reads the environment."""
    code = """if True:
        import os, sys
        seen = []
        def hook(event, args):
            if event == "import" and args[0] == "numpy":
                seen.append(os.environ.get("OPENBLAS_THREAD_TIMEOUT"))
        sys.addaudithook(hook)
        import morembs
        assert seen[0] == "4", seen
    """
    clean = {key: value for key, value in os.environ.items() if key != "OPENBLAS_THREAD_TIMEOUT"}
    subprocess.run([sys.executable, "-c", code], check=True, env=clean)
