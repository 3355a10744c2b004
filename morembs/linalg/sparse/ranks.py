"""The processes of a parallel MUMPS, started by mpirun, which run commands together.

This process never becomes one of MPI. Commands go to rank 0 over a socket, arrays through files in a private folder
that rank 0 maps into memory. One group of processes serves all instances of MUMPS with the same ranks, from the first
to the end of this process, as its start takes a second; between commands it sleeps.
"""

from __future__ import annotations

import json
import logging
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import weakref
from contextlib import suppress
from pathlib import Path
from typing import Any

from morembs.base.errors import InputError, SolverError
from morembs.base.scratch import ScratchFolder
from morembs.base.worker_pool import processors, threads_for
from morembs.linalg.sparse.mumps_library import rank_files
from morembs.linalg.sparse.rank import SOCKET
from morembs.linalg.sparse.tolerances import TOL

log = logging.getLogger(__name__)
_PROGRAM = "morembs.linalg.sparse.rank"
_AS_ROOT = ("OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM")
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")


def why_not() -> str:
    """Why no ranks can be started here; empty: they can."""
    if not sys.platform.startswith("linux"):
        return "ranks run on Linux only; leave ranks out"
    if shutil.which("mpirun") is None:
        return "mpirun was not found; get it with: sudo apt-get install openmpi-bin"
    if os.geteuid() == 0 and not all(os.environ.get(name) == "1" for name in _AS_ROOT):
        return f"mpirun refuses to run as root; run as another user, or set {' and '.join(f'{n}=1' for n in _AS_ROOT)}"
    files = rank_files()
    return files if isinstance(files, str) else ""


class Ranks:
    """``count`` processes of MPI; ``call`` runs a command in all of them.

    Raises:
        InputError: they cannot be started, or header and library of MUMPS differ.
        SolverError: one of them was ended.
    """

    def __init__(self, count: int, scratch: Path | None) -> None:
        self.count = count
        self.threads = threads_for(count)
        self._guard = threading.RLock()
        self._waiting = False
        self._later: list[dict[str, Any]] = []
        self._folder = ScratchFolder(scratch)
        self.folder = self._folder.path
        self.peak_memory_bytes: list[int] = []
        self._log = self.folder / "log"
        listener = self._listener()
        with listener, self._log.open("wb") as words:
            self._mpirun = subprocess.Popen(
                self._arguments(),
                stdin=subprocess.DEVNULL,
                stdout=words,
                stderr=words,
                env=self._environment(),
                start_new_session=True,
            )
            # Before the folder is removed at the end of this process.
            self._finalize = weakref.finalize(self, _end, self._mpirun, self._folder, os.getpid())
            try:
                self._lifeline, self._channel = (self._accept(listener) for _ in range(2))
                self._lines = self._channel.makefile("r", encoding="utf-8", newline="\n")
                hello = self._answer()
                self._refuse_other(hello)
            except BaseException:
                self.kill()
                raise
        self.local: int = hello["local"]
        self.pids: list[int] = hello["pids"]
        log.info("%d ranks of %d threads, processes %s", count, self.threads, self.pids)

    @property
    def alive(self) -> bool:
        """True if commands can be sent."""
        return self._finalize.alive and self._mpirun.poll() is None

    def call(self, command: dict[str, Any]) -> dict[str, Any]:
        """What the ranks answer to ``command``."""
        with self._guard:
            if self._waiting:
                # The garbage collector closes an instance while this thread waits for an answer.
                self._later.append(command)
                return {}
            while self._later:
                self._exchange(self._later.pop())
            return self._exchange(command)

    def kill(self) -> None:
        """End the ranks now."""
        self._finalize()
        for name in ("_lines", "_channel", "_lifeline"):
            with suppress(OSError, AttributeError):
                getattr(self, name).close()

    def _exchange(self, command: dict[str, Any]) -> dict[str, Any]:
        self._waiting = True
        try:
            self._channel.sendall(json.dumps(command).encode() + b"\n")
            answer = self._answer()
        except OSError:
            raise self.died() from None
        finally:
            self._waiting = False
        if "fault" in answer:
            raise InputError(
                f"ranks = {self.count} cannot run here: {answer['fault']}", kind="program", keyword="ranks"
            )
        self.peak_memory_bytes = answer["peak"]
        return answer

    def _answer(self) -> dict[str, Any]:
        text = self._lines.readline()
        if not text.endswith("\n"):
            raise self.died()
        answer: dict[str, Any] = json.loads(text)
        return answer

    def _listener(self) -> socket.socket:
        # The path of a socket may be short only.
        opened = os.open(self.folder, os.O_RDONLY)
        try:
            listener = socket.socket(socket.AF_UNIX)
            listener.bind(f"/proc/self/fd/{opened}/{SOCKET}")
        finally:
            os.close(opened)
        listener.listen()
        listener.settimeout(TOL.news_seconds)
        return listener

    def _accept(self, listener: socket.socket) -> socket.socket:
        while True:
            try:
                connection, _ = listener.accept()
            except TimeoutError:
                if self._mpirun.poll() is not None:
                    raise self._not_started() from None
                continue
            connection.setblocking(True)
            return connection

    def _arguments(self) -> list[str]:
        # What mpirun and the ranks share lies in the private folder, which goes however they end.
        folder = str(self.folder)
        settings = {"orte_tmpdir_base": folder, "btl_vader_backing_directory": folder}
        # Ranks that wait for each other leave the processors to others, and none is bound to one that is busy.
        settings |= {"mpi_yield_when_idle": "1", "hwloc_base_binding_policy": "none"}
        given = [word for name, value in settings.items() for word in ("--mca", name, value)]
        return ["mpirun", "-n", str(self.count), *given, sys.executable, "-m", _PROGRAM, str(self.folder)]

    def _environment(self) -> dict[str, str]:
        return {**os.environ, **dict.fromkeys(_THREADS, str(self.threads))}

    def _words(self) -> str:
        return self._log.read_text(errors="replace") if self._log.exists() else ""

    def _not_started(self) -> InputError:
        words = self._words()
        if "not enough slots" in words:
            return InputError(
                f"ranks = {self.count} was given, and mpirun has room for fewer here ({processors()} processors); take "
                "fewer, or set OMPI_MCA_rmaps_base_oversubscribe=1",
                kind="program",
                keyword="ranks",
            )
        last = [line.strip() for line in words.splitlines() if line.strip(" -\n")]
        # A message has 300 characters of it at most.
        last_words = " ".join(last)[:300] or "without a word"
        return InputError(
            f"ranks = {self.count}: mpirun could not start them: {last_words}", kind="program", keyword="ranks"
        )

    def died(self) -> SolverError:
        """The error for ranks that are gone, once mpirun has said which."""
        with suppress(subprocess.TimeoutExpired):
            self._mpirun.wait(TOL.leaving_seconds)
        words = self._words()
        self.kill()
        rank = re.search(r"process rank (\d+) .*?on signal (\d+)", words, flags=re.DOTALL)
        who = f"mpirun or one of {self.count} ranks was ended"
        if rank:
            who = f"rank {rank[1]} of {self.count} was ended by signal {rank[2]}"
        return SolverError(f"{who}, maybe for want of memory; take more machines, or leave ranks out")

    def _refuse_other(self, hello: dict[str, Any]) -> None:
        if hello["header"] != hello["library"]:
            library = f"version {hello['library']}" if hello["library"] else "none"
            raise InputError(
                f"ranks = {self.count}: the header of MUMPS says {hello['header']}, its library {library}; install "
                "both of one version",
                kind="program",
                keyword="ranks",
            )


def _end(mpirun: subprocess.Popen[bytes], folder: ScratchFolder, owner: int) -> None:
    """End mpirun, which ends the ranks, and remove their folder; a copy of the process leaves both alone."""
    if os.getpid() != owner:
        return
    if mpirun.poll() is None:
        with suppress(OSError):
            mpirun.terminate()
        try:
            mpirun.wait(TOL.leaving_seconds)
        except subprocess.TimeoutExpired:
            with suppress(OSError):
                os.killpg(mpirun.pid, signal.SIGKILL)
            mpirun.wait()
    folder.close()
