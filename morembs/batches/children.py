"""Processes of this program that work for a batch: what they say comes over pipes, and they end with this process.

Each runs a verb of the command line with ``--json``. Its standard input stays open while this process lives: where that
ends by whatever means, the child reads the end of its input and leaves, so that there are never two writers.
"""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from threading import Thread
from typing import Any

from morembs import stopping
from morembs.batches.plan import Part
from morembs.closing import Closing

_PROGRAM = (sys.executable, "-m", "morembs")
# How long a child may take to leave once it is asked to, in seconds.
_PATIENCE = 10.0
# How often the end of this process is thought of while nobody says anything, in seconds.
_LOOK = 0.5


@dataclass(frozen=True)
class Heard:
    """A line that a child says about its ``parts``."""

    parts: Sequence[Part]
    line: str


@dataclass(frozen=True, kw_only=True)
class Finished:
    """A child that has ended: its exit ``code``, negative by a signal, the documents it printed, and its last words."""

    parts: Sequence[Part]
    code: int
    documents: Sequence[Mapping[str, Any]]
    message: str
    seconds: float

    @property
    def killed(self) -> bool:
        """Whether something else ended it."""
        return self.code < 0 or self.code >= 128


@dataclass(eq=False)
class _Child:
    parts: Sequence[Part]
    process: subprocess.Popen[str]
    begun: float
    lines: list[str] = field(default_factory=list)


class Children(Closing):
    """The processes of a batch; ``close`` ends those that run.

    Args:
        environment: variables that they get besides those of this process.
        program: how the command line is called.
    """

    def __init__(self, environment: Mapping[str, str], program: Sequence[str] = _PROGRAM) -> None:
        self._environment, self._program = {**os.environ, **environment}, program
        self._children: list[_Child] = []
        self._news: queue.Queue[Heard | tuple[_Child, str]] = queue.Queue()

    @property
    def running(self) -> bool:
        """Whether some have not ended."""
        return bool(self._children)

    def start(self, parts: Sequence[Part], arguments: Sequence[str]) -> None:
        """Start ``morembs`` with ``arguments`` for ``parts``."""
        apart: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            apart = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
        process = subprocess.Popen(
            [*self._program, *arguments, "--json", "--attached"], text=True, encoding="utf-8",
            errors="replace", stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            env=self._environment, **apart,
        )  # fmt: skip
        child = _Child(parts, process, time.monotonic())
        self._children.append(child)
        Thread(target=self._listen, args=(child,), daemon=True).start()

    def next(self) -> Heard | Finished:
        """What is heard next of any of them."""
        while True:
            stopping.check()
            try:
                news = self._news.get(timeout=_LOOK)
            except queue.Empty:
                continue
            if isinstance(news, Heard):
                return news
            child, printed = news
            self._children.remove(child)
            return _finished(child, printed)

    def close(self) -> None:
        """End those that run: they may clean up for some seconds, and are killed then."""
        for child in self._children:
            with suppress(OSError):
                _ask_to_end(child.process)
        end = time.monotonic() + _PATIENCE
        for child in self._children:
            try:
                child.process.wait(max(0.0, end - time.monotonic()))
            except subprocess.TimeoutExpired:
                child.process.kill()
                child.process.wait()
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
            self._news.put(Heard(child.parts, line.rstrip()))
        reader.join()
        process.wait()
        for stream in (process.stdin, process.stdout, process.stderr):
            with suppress(OSError):
                stream.close()
        self._news.put((child, "".join(printed)))


def _ask_to_end(process: subprocess.Popen[str]) -> None:
    """The end of its input asks too: on Windows ``terminate`` would leave it no time to clean up."""
    if sys.platform == "win32" and process.stdin is not None:
        process.stdin.close()
    else:
        process.terminate()


def _finished(child: _Child, printed: str) -> Finished:
    code = child.process.returncode
    try:
        documents = json.loads(printed)
    except ValueError:
        documents = []
    message = _last_words(child.lines) or _how_it_ended(code)
    return Finished(
        parts=child.parts, code=code, documents=documents if len(documents) == len(child.parts) else [],
        message=message, seconds=time.monotonic() - child.begun,
    )  # fmt: skip


def _last_words(lines: Sequence[str]) -> str:
    """The message of the error, all of its lines."""
    first = max((at for at, line in enumerate(lines) if line.startswith("error: ")), default=None)
    return "" if first is None else "\n".join(lines[first:]).removeprefix("error: ")


def _how_it_ended(code: int) -> str:
    if code < 0 or code >= 128:
        number = -code if code < 0 else code - 128
        return f"its process was ended by signal {number}, perhaps for want of memory; give [solver] a memory budget"
    return f"its process ended with the exit code {code} and without a word"
