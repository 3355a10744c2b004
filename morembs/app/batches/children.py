"""Processes of this program that work for a batch: their output comes over pipes, and they end with this process.

Each runs a verb of the command line with ``--json``. Its standard input stays open while this process lives: where that
ends by whatever means, the child reads the end of its input and leaves, so that there are never two writers.
"""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from threading import Thread
from typing import Any

from morembs.app.batches.tolerances import TOL
from morembs.app.batches.workers import Finished, Heard, Task, Worker
from morembs.base import stopping
from morembs.base.closing import Closing

_PROGRAM = (sys.executable, "-m", "morembs")
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(eq=False)
class _Child:
    task: Task
    process: subprocess.Popen[str]
    begun: float
    lines: list[str] = field(default_factory=list)
    peak: int = 0


class Children(Closing):
    """The processes of a batch on this machine; ``close`` ends the running ones.

    Args:
        room: memory for all of them together.
        cores: processors of this machine, dealt among the processes that run at once.
        program: how the command line is called.
    """

    count, limits = 1, False

    def __init__(self, room: Worker, cores: int, program: Sequence[str] = _PROGRAM) -> None:
        self.largest, self._cores, self._program = room, cores, program
        self.present: Mapping[str, Worker] = {"here": room}
        self._children: list[_Child] = []
        self._news: queue.Queue[Heard | tuple[_Child, str]] = queue.Queue()

    @property
    def running(self) -> bool:
        """True if some have not ended."""
        return bool(self._children)

    def threads(self, asked: int | None, tasks: int) -> int:
        """More for each where few run at once; a job's own setting goes before."""
        return asked or max(1, self._cores // max(1, min(self.largest.slots, tasks)))

    def want(self, needs: Iterable[Worker]) -> None:
        """There is this machine and no other."""

    def start(self, task: Task, worker: str = "here") -> None:
        """Start the process of ``task``."""
        group_options: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            group_options = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
        # A signal that came between would leave a process that nobody ends.
        with stopping.whole_step():
            process = subprocess.Popen(
                [*self._program, *task.arguments, "--json", "--attached"],
                text=True,
                encoding="utf-8",
                errors="replace",
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env={**os.environ, **dict.fromkeys(_THREADS, str(task.threads))},
                **group_options,
            )
            child = _Child(task, process, time.monotonic())
            self._children.append(child)
            Thread(target=self._listen, args=(child,), daemon=True).start()

    def next(self) -> Heard | Finished | None:
        """What is heard next of any of them; None where nobody says anything for a while."""
        stopping.check()
        try:
            news = self._news.get(timeout=TOL.news_seconds)
        except queue.Empty:
            return None
        if isinstance(news, Heard):
            return news
        child, printed = news
        self._children.remove(child)
        return _collect_result(child, printed)

    def close(self) -> None:
        """End the running processes: they may clean up for some seconds, and are killed then."""
        for child in self._children:
            _ask_to_end(child.process)
        end = time.monotonic() + TOL.leaving_seconds
        for child in self._children:
            # Each has a thread that waits for its end, which alone may do so.
            while child.process.returncode is None and time.monotonic() < end:
                time.sleep(TOL.leaving_look_seconds)
            while child.process.returncode is None:
                _kill(child.process)
                time.sleep(TOL.leaving_look_seconds)
        self._children.clear()

    def _listen(self, child: _Child) -> None:
        """Hear a child to its end; two pipes are read at once, as a full one would stop it."""
        printed: list[str] = []
        process = child.process
        if process.stdout is None or process.stderr is None or process.stdin is None:
            raise RuntimeError("a child without pipes")
        reader = Thread(target=lambda stream: printed.append(stream.read()), args=(process.stdout,), daemon=True)
        reader.start()
        for line in process.stderr:
            child.lines.append(line.rstrip())
            self._news.put(Heard(number=child.task.number, line=line.rstrip()))
        reader.join()
        child.peak = _wait(process)
        for stream in (process.stdin, process.stdout, process.stderr):
            with suppress(OSError):
                stream.close()
        self._news.put((child, "".join(printed)))


def _wait(process: subprocess.Popen[str]) -> int:
    """Peak memory in bytes of a process that has ended, as the system counts it, 0 where that does not say it."""
    try:
        import resource  # noqa: F401
    except ImportError:
        process.wait()
        return 0
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def _ask_to_end(process: subprocess.Popen[str]) -> None:
    """The end of its input asks too: on Windows ``terminate`` would leave it no time to clean up."""
    if sys.platform == "win32":
        if process.stdin is not None:
            process.stdin.close()
    else:
        _send(process, signal.SIGTERM)


def _kill(process: subprocess.Popen[str]) -> None:
    if sys.platform == "win32":
        process.kill()
    else:
        _send(process, signal.SIGKILL)


def _send(process: subprocess.Popen[str], number: signal.Signals) -> None:
    """A signal; ``Popen`` would look first whether the process has ended, and take that from the thread that waits."""
    if process.returncode is None:
        with suppress(OSError):
            os.kill(process.pid, number)


def _collect_result(child: _Child, printed: str) -> Finished:
    code = child.process.returncode
    return Finished(
        number=child.task.number,
        code=code,
        printed=printed,
        message=_last_words(child.lines) or _how_it_ended(code),
        seconds=time.monotonic() - child.begun,
        peak_memory_bytes=child.peak,
    )


def _last_words(lines: Sequence[str]) -> str:
    """The message of the error, all of its lines."""
    first = max((at for at, line in enumerate(lines) if line.startswith("error: ")), default=None)
    return "" if first is None else "\n".join(lines[first:]).removeprefix("error: ")


def _how_it_ended(code: int) -> str:
    if code < 0 or code >= 128:
        number = -code if code < 0 else code - 128
        return f"its process was ended by signal {number}, perhaps for want of memory; give [solver] a memory budget"
    return f"its process ended with the exit code {code} and without a word"
