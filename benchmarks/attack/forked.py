"""Runs in forked children: the program is imported once, and each run begins where its ``main`` begins.

A child behaves as a process of its own does: it is the leader of its process group, has its own temporary folder, and
leaves through the ends that the interpreter has (finalizers, threads, exit codes).
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import multiprocessing.util
import os
import resource
import signal
import sys
import tempfile
import threading
import time
import traceback
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NoReturn

import typer
import typer.main

OUTPUT, ERRORS, TEMPORARY = "stdout", "stderr", "tmp"
# Seconds between two looks at a child.
_LOOK = 0.003


@dataclass(frozen=True)
class Ended:
    """A child that has ended: exit code (negative: the signal), what it printed, seconds, growth of its memory.

    ``hung``: its time was up, and it was ended.
    """

    code: int
    output: str
    errors: str
    seconds: float
    growth: int
    hung: bool


@dataclass
class Child:
    """A running child, the leader of its process group. What it prints goes to files in ``logs``."""

    pid: int
    logs: Path
    start: float
    resident: int
    limit: int

    def send(self, number: int, *, group: bool) -> None:
        """A signal to it, or to its whole group."""
        (os.killpg if group else os.kill)(self.pid, number)

    def wait(self) -> Ended:
        """Wait for its end, which comes at the limit at the latest; a program may stop an alarm clock of its own."""
        hung = False
        try:
            while not (ended := os.wait4(self.pid, 0 if hung else os.WNOHANG))[0]:
                hung = time.perf_counter() - self.start > self.limit
                if hung:
                    self.send(signal.SIGKILL, group=True)
                else:
                    time.sleep(_LOOK)
        except BaseException:
            self.send(signal.SIGKILL, group=True)
            raise
        _, status, usage = ended
        seconds = time.perf_counter() - self.start
        peak = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
        texts = [(self.logs / name).read_text("utf-8", "replace") for name in (OUTPUT, ERRORS)]
        return Ended(os.waitstatus_to_exitcode(status), *texts, seconds, peak - self.resident, hung)


def begin(
    work: Callable[[], object], folder: Path, logs: Path, *, seconds: int = 600, space: int = 0, processor: int = 0
) -> Child:
    """Fork a child that does ``work`` in ``folder``, at most ``seconds``; ``space``: bytes of addresses above ours.

    ``processor``: seconds of the processor of it and of each of its children, which no load of the machine shortens.
    """
    (logs / TEMPORARY).mkdir(parents=True, exist_ok=True)
    for name in (OUTPUT, ERRORS):
        (logs / name).write_bytes(b"")
    gc.freeze()
    resident, start = _memory(1), time.perf_counter()
    pid = os.fork()
    if pid == 0:
        _live(work, folder, logs, space, processor)
    # Here too, as nobody knows who comes first.
    _lead(pid)
    return Child(pid, logs, start, resident, seconds)


def run(
    work: Callable[[], object], folder: Path, logs: Path, *, seconds: int = 600, space: int = 0, processor: int = 0
) -> Ended:
    """As ``begin``, to its end."""
    return begin(work, folder, logs, seconds=seconds, space=space, processor=processor).wait()


@cache
def _built() -> Any:
    """The tree of commands, which typer builds from its signatures in a third of the time of a short run."""
    from morembs.app.cli.commands import app

    return typer.main.get_command(app)


def program(arguments: Sequence[str]) -> Callable[[], None]:
    """The command line of morembs."""
    from morembs.app.cli import console

    built, tree_of = _built(), typer.main.get_command

    def work() -> None:
        typer.main.get_command = lambda given: built if given.info.name == "morembs" else tree_of(given)
        sys.argv = ["morembs", *arguments]
        console()

    return work


def _memory(place: int) -> int:
    """Bytes of addresses (0) or of resident memory (1) of this process; 0 where the system does not tell."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[place]) * resource.getpagesize()
    except OSError:
        return 0


def _lead(pid: int) -> None:
    # It may lead already, or have ended.
    with contextlib.suppress(OSError):
        os.setpgid(pid, pid)


def _live(work: Callable[[], object], folder: Path, logs: Path, space: int, processor: int) -> NoReturn:
    code = 1
    try:
        _lead(0)
        code = _code(folder, logs, space, processor, work)
        try:
            threading._shutdown()  # type: ignore[attr-defined]
            atexit._run_exitfuncs()
            sys.stdout.flush()
            sys.stderr.flush()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
    except BaseException:
        os.write(2, traceback.format_exc().encode())
    finally:
        os._exit(code)


def _own(folder: Path, logs: Path, space: int, processor: int) -> None:
    """What a new process has of its own; nothing of the parent may be ended or removed by the child."""
    atexit._clear()
    weakref.finalize._registry.clear()  # type: ignore[attr-defined]
    weakref.finalize._registered_with_atexit = False  # type: ignore[attr-defined]
    atexit.register(multiprocessing.util._exit_function)
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGALRM):
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if space and sys.platform == "linux":
        used = _memory(0)
        resource.setrlimit(resource.RLIMIT_AS, (used + space, used + space))
    if processor:
        # The child has used nothing yet, whatever its parent has: times are its own.
        resource.setrlimit(resource.RLIMIT_CPU, (processor, processor + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.chdir(folder)
    os.environ["TMPDIR"] = tempfile.tempdir = str(logs / TEMPORARY)
    streams = os.open(os.devnull, os.O_RDONLY), *(os.open(logs / name, os.O_WRONLY) for name in (OUTPUT, ERRORS))
    for place, stream in enumerate(streams):
        os.dup2(stream, place)
        os.close(stream)
    sys.stdin, sys.stdout, sys.stderr = (os.fdopen(i, "w" if i else "r", 1, closefd=False) for i in range(3))


def _code(folder: Path, logs: Path, space: int, processor: int, work: Callable[[], object]) -> int:
    """The exit code as the interpreter gives it, from the start of the child on."""
    try:
        _own(folder, logs, space, processor)
        work()
    except SystemExit as end:
        if isinstance(end.code, int) or end.code is None:
            return end.code or 0
        print(end.code, file=sys.stderr, flush=True)
        return 1
    except KeyboardInterrupt:
        # A second signal may not break into this.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        traceback.print_exc()
        sys.stderr.flush()
        os.kill(os.getpid(), signal.SIGINT)
    except BaseException:
        traceback.print_exc()
        return 1
    return 0
