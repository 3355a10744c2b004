"""Processes of their own: forks of this one, which saves them the seconds that imports take."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from threading import Lock
from typing import IO, Any, ClassVar

import pytest

from benchmarks.attack import preload
from benchmarks.attack.forked import Ended, begin, program, run

# Once for all children, of which each would load it anew.
load = cache(preload.package)


def apart(work: Callable[[], object], folder: Path, logs: Path | None = None) -> Ended:
    """How ``work`` ends in a child that runs in ``folder``: exit code and what it printed.

    ``logs / "tmp"`` is its folder for temporary files.
    """
    load()
    with tempfile.TemporaryDirectory() as other:
        return run(work, folder, logs or Path(other))


def morembs(*arguments: object, folder: Path, logs: Path | None = None) -> Ended:
    """How the command ``morembs`` ends."""
    return apart(program([str(argument) for argument in arguments]), folder, logs)


def python(code: str, folder: Path) -> Ended:
    """How a program ends that is nothing but ``code``."""
    return apart(lambda: exec(compile(code, "<program>", "exec", dont_inherit=True), {"__name__": "__main__"}), folder)


@cache
def _logs() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory()


class ForkedCommand:
    """A command ``morembs`` with pipes for all that it says and hears, as ``subprocess.Popen`` has it for a batch."""

    open_ends: ClassVar[list[IO[str]]] = []
    # A worker of dask starts jobs in several threads: a child that is forked between the pipes of another and its fork
    # would keep those open.
    one_by_one: ClassVar[Lock] = Lock()

    def __init__(self, arguments: Sequence[str], env: dict[str, str]) -> None:
        with self.one_by_one:
            self._start(arguments, env)

    def _start(self, arguments: Sequence[str], env: dict[str, str]) -> None:
        command, (heard, said), *told = program(arguments), os.pipe(), os.pipe(), os.pipe()

        def work() -> None:
            # An end that is open here too would keep the others from seeing that the parent has gone. The descriptor
            # alone is closed: a thread of the parent may hold the lock of the file.
            for end in self.open_ends:
                if not end.closed:
                    os.close(end.fileno())
            for place, descriptor in enumerate((heard, *(write for _, write in told))):
                os.dup2(descriptor, place)
            for descriptor in (heard, said, *(end for pipe in told for end in pipe)):
                os.close(descriptor)
            sys.stdin, sys.stdout, sys.stderr = (os.fdopen(i, "w" if i else "r", closefd=False) for i in range(3))
            os.environ.update(env)
            command()

        self.pid, self.returncode = begin(work, Path.cwd(), Path(_logs().name)).pid, None
        for descriptor in (heard, *(write for _, write in told)):
            os.close(descriptor)
        self.stdin = os.fdopen(said, "w")
        self.stdout, self.stderr = (os.fdopen(read, "r") for read, _ in told)
        self.open_ends[:] = [end for end in self.open_ends if not end.closed] + [self.stdin, self.stdout, self.stderr]


def fork_jobs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fork the commands that a batch starts, which would be processes of their own."""
    started = subprocess.Popen
    load()

    def begun(words: Any, **options: Any) -> Any:
        of_batch = "--attached" in words
        return ForkedCommand(words[3:], options["env"]) if of_batch else started(words, **options)

    monkeypatch.setattr(subprocess, "Popen", begun)


def dask_setup(worker: object) -> None:
    """Called by a worker of dask that preloads this module: what it starts for jobs are forks of it."""
    fork_jobs(pytest.MonkeyPatch())
