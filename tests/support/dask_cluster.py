"""A scheduler of dask and workers, each a process of its own on this machine."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import psutil

ROOT = Path(__file__).parents[2]
# Seconds after which a wait for another process counts as endless.
PATIENCE = 300.0
# A worker that waits looks at itself every 10 ms otherwise.
QUIET = {
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "1s",
    "DASK_DISTRIBUTED__ADMIN__SYSTEM_MONITOR__INTERVAL": "10s",
}


class Cluster:
    """A scheduler and the workers that were started for it."""

    def __init__(self, folder: Path) -> None:
        self._file, self._logs = folder / "scheduler.json", folder
        self._processes: list[subprocess.Popen[bytes]] = []
        self._start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")

        def known() -> bool:
            # The file is there before all of the text is.
            with contextlib.suppress(OSError, ValueError):
                self.address = json.loads(self._file.read_text())["address"]
                return True
            return False

        until(known)

    @property
    def jobs(self) -> list[psutil.Process]:
        """The processes that reduce or check jobs for these workers, which start no others."""
        running = []
        for worker in self._processes[1:]:
            with contextlib.suppress(psutil.Error):
                running += psutil.Process(worker.pid).children(recursive=True)
        return running

    def worker(
        self,
        resources: str = "MB=4000 cores=2",
        environment: Mapping[str, str] | None = None,
        prefix: tuple[str, ...] = (),
        forks: bool = False,
    ) -> subprocess.Popen[bytes]:
        """Start a worker without a nurse, so that the process is the worker; whose jobs may be forks of it."""
        log = self._logs / f"worker-{len(self._processes)}.log"
        process = self._start(
            "worker",
            "--no-nanny",
            "--no-dashboard",
            "--nthreads",
            "2",
            "--memory-limit",
            "0",
            "--host",
            "127.0.0.1",
            "--local-directory",
            str(self._logs),
            "--resources",
            resources,
            *(("--preload", "tests.support.processes") if forks else ()),
            environment=environment,
            prefix=prefix,
        )
        until(lambda: b"Registered to" in log.read_bytes() or process.poll() is not None)
        return process

    def _start(
        self, what: str, *options: str, environment: Mapping[str, str] | None = None, prefix: tuple[str, ...] = ()
    ) -> subprocess.Popen[bytes]:
        with open(self._logs / f"{what}-{len(self._processes)}.log", "wb") as log:
            process = subprocess.Popen(
                [
                    *prefix,
                    sys.executable,
                    "-m",
                    f"distributed.cli.dask_{what}",
                    "--scheduler-file",
                    str(self._file),
                    *options,
                ],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                cwd=self._logs,
                env={**os.environ, **QUIET, "PYTHONPATH": str(ROOT), **(environment or {})},
            )
        self._processes.append(process)
        return process

    def end_workers(self) -> None:
        """End the workers."""
        for process in reversed(self._processes[1:]):
            process.kill()
            process.wait()
        del self._processes[1:]

    def close(self) -> None:
        """End all of them."""
        self.end_workers()
        (scheduler,) = self._processes
        scheduler.kill()
        scheduler.wait()


@contextlib.contextmanager
def cluster(folder: Path) -> Iterator[Cluster]:
    """A scheduler without workers; its files are in ``folder``."""
    started = Cluster(folder)
    try:
        yield started
    finally:
        started.close()


def until(true: Callable[[], Any], patience: float = PATIENCE) -> Any:
    """Wait until a function says so; what it says then."""
    end = time.monotonic() + patience
    while not (said := true()):
        if time.monotonic() > end:
            raise TimeoutError
        # Each look at all processes takes milliseconds of those that are waited for.
        time.sleep(0.1)
    return said
