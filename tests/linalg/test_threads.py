"""Threads of the BLAS and the speed of this machine."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from morembs.base.cache import cache_folder
from morembs.linalg.sparse import threads
from morembs.linalg.sparse.threads import blas_threads, limit_threads, measured_speed, quiet_idle_threads
from tests.support.refusals import refusal


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
    with refusal("value", "threads"):
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

    def processor(self) -> float:
        return self.now


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[list[str]]:
    """The jobs that were timed; the cache folder is not there yet."""
    took, jobs = {"product": 0.05, "triad": 0.02, "_loop": 0.01}, list[str]()

    def best(job: Callable[[], object]) -> float:
        job()
        jobs.append(job.__name__ if job.__name__ in took else "product")
        return took[jobs[-1]]

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(threads, "processor_time", best)
    threads.kept_speed.cache_clear()
    yield jobs
    threads.kept_speed.cache_clear()


def test_speed_is_measured_once_for_each_number_of_threads(
    measured: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(threads, "blas_threads", lambda: 100_001)
    speed = measured_speed()
    # A product of matrices of order 1000 in 0.05 s a thread; two of three vectors of a third of 64 MiB, and one more,
    # in 0.02 s; 100,000 rounds in 0.01 s.
    assert speed.gemm_gflops == pytest.approx(2e-9 * 1000**3 / 0.05 * 100_001)
    assert speed.triad_gbs == pytest.approx(5e-9 * 8 * (2**26 // 24) / 0.02)
    assert speed.python_mhz == pytest.approx(10.0)
    assert measured_speed() is speed and len(measured) == 3
    monkeypatch.setattr(threads, "blas_threads", lambda: 100_002)
    assert measured_speed() is not speed and len(measured) == 6


def test_speed_is_kept_for_later_runs(measured: list[str]) -> None:
    speed = measured_speed()
    threads.kept_speed.cache_clear()
    assert measured_speed() == speed and len(measured) == 3
    (kept,) = cache_folder().iterdir()
    if os.name == "posix":
        assert kept.stat().st_mode & 0o077 == 0 and cache_folder().stat().st_mode & 0o077 == 0


@pytest.mark.parametrize(
    "damage",
    [
        b"",
        b"\xff{",
        b"[" * 100_000,
        b"[1]",
        b'{"gemm_gflops": 1.0}',
        b'{"gemm_gflops": 1.0, "triad_gbs": 0.0, "python_mhz": 1.0}',
        b'{"gemm_gflops": NaN, "triad_gbs": 1.0, "python_mhz": 1.0}',
        b'{"gemm_gflops": "1", "triad_gbs": 1.0, "python_mhz": 1.0}',
    ],
)
def test_damaged_cache_is_measured_again(measured: list[str], damage: bytes) -> None:
    speed = measured_speed()
    (kept,) = cache_folder().iterdir()
    kept.write_bytes(damage)
    threads.kept_speed.cache_clear()
    assert measured_speed() == speed and len(measured) == 6
    threads.kept_speed.cache_clear()
    # The damaged file is replaced.
    assert measured_speed() == speed and len(measured) == 6


@pytest.mark.skipif(os.name != "posix", reason="pipes and devices of POSIX systems")
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_what_is_no_file_in_the_cache_is_replaced(measured: list[str], kind: str) -> None:
    speed = measured_speed()
    (kept,) = cache_folder().iterdir()
    kept.unlink()
    if kind == "pipe":
        os.mkfifo(kept)
    else:
        kept.symlink_to("/dev/zero")
    threads.kept_speed.cache_clear()
    assert measured_speed() == speed and len(measured) == 6 and stat.S_ISREG(kept.lstat().st_mode)


@pytest.mark.parametrize("where", ["under a file", "file is a folder"])
def test_cache_that_cannot_be_written_is_no_error(measured: list[str], where: str) -> None:
    if where == "under a file":
        cache_folder().parent.write_text("")
    else:
        (cache_folder() / f"{threads.speed_name(blas_threads())}.json").mkdir(parents=True)
    speed = measured_speed()
    threads.kept_speed.cache_clear()
    assert measured_speed() == speed and len(measured) == 6
    assert where == "under a file" or len(list(cache_folder().iterdir())) == 1


@pytest.mark.skipif(os.name != "posix", reason="folders of POSIX systems")
def test_cache_folder_is_that_of_the_system(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.delenv("LOCALAPPDATA", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "linux")
    assert cache_folder() == tmp_path / ".cache" / "morembs"
    monkeypatch.setattr(sys, "platform", "darwin")
    assert cache_folder() == tmp_path / "Library" / "Caches" / "morembs"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "own"))
    assert cache_folder() == tmp_path / "own" / "morembs"


def test_speed_is_that_of_the_processor_whoever_works_beside() -> None:
    clock, times = Clock(), list[float]()

    def job() -> None:
        times.append(0.25 if not times else 0.03125 if len(times) % 2 else 0.015625)
        clock.now += times[-1]

    # The first run is not counted; the mean of the others.
    assert threads.processor_time(job, 0.2, clock.processor) == pytest.approx(sum(times[1:]) / len(times[1:]))
    assert 0.2 <= sum(times[1:]) < 0.2 + 0.03125
    start = time.perf_counter()
    assert threads.processor_time(lambda: (time.sleep(0.01), sum(range(20_000))), 0.005) < 0.005
    assert time.perf_counter() - start > 0.02


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
