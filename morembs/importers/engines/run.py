"""External programs that assemble models: finding them, running them within limits, and their output."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from morembs.base.errors import InputError
from morembs.importers.tolerances import TOL

# Where the runtime of Fortran, C or Python begins to say where a program crashed.
_TRACEBACK = re.compile(r"Program received signal|Backtrace for this error|forrtl: severe|\*\*\* stack smashing|#0 +0x")


@dataclass(frozen=True, kw_only=True)
class Program:
    """An external program: its name for people, ``path``, and its own ``version``."""

    name: str
    path: Path
    version: str = ""


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run of a program that has ended: the end of its ``output``, and its exit ``status``, below 0 the signal that
    ended it."""

    output: str
    status: int

    @property
    def last_words(self) -> str:
        """How it ended and the last line that it printed before any traceback, for a message."""
        lines = [line.strip() for line in self.output.splitlines() if line.strip()]
        crash = next((i for i, line in enumerate(lines) if _TRACEBACK.match(line)), len(lines))
        words = (
            f"its last words are {lines[:crash][-1][: TOL.shown_last_line]!r}" if lines[:crash] else "it says nothing"
        )
        if self.status >= 0:
            return f"it ended with exit status {self.status}; {words}"
        with suppress(ValueError):
            number = signal.Signals(-self.status)
            return f"it crashed with {number.name} ({signal.strsignal(number)}); {words}"
        return f"it crashed with signal {-self.status}; {words}"


def find_executable(name: str, given: str, variable: str, executables: Sequence[str], cure: str) -> Path:
    """The executable: ``given``, or what the environment ``variable`` names, or the first of ``executables`` in PATH.

    Raises:
        InputError: none is there, or one that was named cannot be run.
    """
    named = given or os.environ.get(variable, "")
    if named:
        path = Path(named).expanduser()
        if not (path.is_file() and os.access(path, os.X_OK)):
            whence = f"{name}:{given}" if given else f"the variable {variable} = {named}"
            raise InputError(
                f"{whence} was given, which is no file that can be run; give the path of the executable",
                kind="program",
                keyword=whence,
            )
        return path.resolve()
    for executable in executables:
        path_of = shutil.which(executable)
        if path_of:
            return Path(path_of).resolve()
    raise InputError(cure, kind="program", keyword="engine")


def run(
    command: Sequence[str | Path],
    folder: Path,
    *,
    seconds: float,
    memory: int | None = None,
    environment: Mapping[str, str] | None = None,
    late: str,
    stop: threading.Event | None = None,
) -> Run:
    """Run a program in ``folder`` to its end, whatever its exit status is.

    Args:
        seconds: time after which it and its children are ended.
        memory: bytes of address space that it may have, within the limits of this process; None for no limit.
        environment: variables beside those of this process.
        late: the message when the time is over.
        stop: another thread sets it to end the program, None for none.

    Raises:
        InputError: it cannot be started, did not finish in time, or was ended.
    """
    log = folder / "output.txt"
    disk = int(TOL.disk_part * shutil.disk_usage(folder).free)

    def limits() -> None:
        # Only what exists on this system, and without anything that could wait for another thread.
        import resource

        wanted = {resource.RLIMIT_CORE: 0, resource.RLIMIT_FSIZE: disk, resource.RLIMIT_AS: memory}
        for kind, limit in wanted.items():
            if limit is not None:
                # Nobody may go beyond a hard limit, such as that of a queue.
                hard = resource.getrlimit(kind)[1]
                limit = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
                resource.setrlimit(kind, (limit, limit))

    with log.open("wb") as out:
        try:
            process = subprocess.Popen(
                [str(part) for part in command],
                cwd=folder,
                stdout=out,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env={**os.environ, **(environment or {})},
                start_new_session=True,
                preexec_fn=limits if os.name == "posix" else None,
            )
        except OSError as error:
            raise InputError(
                f"{command[0]} cannot be started ({error.strerror}); check the executable", kind="program"
            ) from error
        try:
            _wait(process, seconds, late, stop)
        finally:
            _end(process)
    with log.open("rb") as text:
        text.seek(max(log.stat().st_size - TOL.log_bytes, 0))
        return Run(output=text.read().decode("utf-8", "replace"), status=process.returncode)


def _wait(process: subprocess.Popen[bytes], seconds: float, late: str, stop: threading.Event | None) -> None:
    """Wait for the end of a program, in pieces where another thread may end it."""
    end = time.monotonic() + seconds
    while True:
        left = end - time.monotonic()
        try:
            process.wait(timeout=left if stop is None else min(left, TOL.look_seconds))
            return
        except subprocess.TimeoutExpired as error:
            if stop is not None and stop.is_set():
                raise InputError("ended, as another run of the program failed", kind="program") from error
            if time.monotonic() >= end:
                raise InputError(late, kind="result", keyword="engine_timeout") from error


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the process and its children, also where this one is being ended."""
    if process.poll() is not None:
        return
    try:
        if os.name == "posix":
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    except ProcessLookupError:
        pass
    process.wait()
