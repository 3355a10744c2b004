"""Tasks on several processes of this machine: the same result for any number of them.

The processes are started afresh, never copied from one that runs threads. What all tasks share goes to them once, its
large arrays as files that are mapped into memory, so that all read the same pages; large results come back alike.
"""

from __future__ import annotations

import contextlib
import gc
import io
import itertools
import logging
import multiprocessing
import os
import pickle
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import connection, util
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Thread
from types import MappingProxyType
from typing import Any

import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits

from morembs.base.closing import Closing
from morembs.base.errors import InputError, MorembsError, OutputError, SolverError
from morembs.base.memory import peak_memory_bytes
from morembs.base.python_warnings import speak_plainly
from morembs.base.scratch import PrivateFolder, ScratchFolder, remove_abandoned
from morembs.base.tolerances import TOL

log = logging.getLogger(__name__)
Work = Callable[[Any, Any], Any]
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
_sockets: list[PrivateFolder] = []
_METHOD = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"


def _view(value: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    # The type itself has no name that pickle could look up.
    return MappingProxyType(value)


class _Packer(pickle.Pickler):
    """Writes large arrays to files in ``folder`` that begin with ``name``, and other objects to ``file``."""

    def __init__(self, file: io.BytesIO, folder: Path, name: str) -> None:
        super().__init__(file, protocol=5)
        self._folder, self._name = folder, name
        self._written: dict[int, str] = {}

    def persistent_id(self, value: Any) -> str | None:
        if type(value) not in (np.ndarray, np.memmap) or value.nbytes < TOL.message_bytes or value.dtype.hasobject:
            return None
        if not value.flags.forc:
            return None
        if id(value) not in self._written:
            name = f"{self._name}-{len(self._written)}.npy"
            np.save(self._folder / name, value, allow_pickle=False)
            self._written[id(value)] = name
        return self._written[id(value)]

    def reducer_override(self, value: Any) -> Any:
        # Models keep their sets in such views, which pickle does not know.
        return (_view, (dict(value),)) if type(value) is MappingProxyType else NotImplemented


class _Unpacker(pickle.Unpickler):
    """Maps the arrays of a ``_Packer``; their files go where they are read ``once``."""

    def __init__(self, file: io.BytesIO, folder: Path, once: bool) -> None:
        super().__init__(file)
        self._folder, self._once = folder, once
        self._read: dict[str, Any] = {}

    def persistent_load(self, name: str) -> Any:
        if name not in self._read:
            path = self._folder / name
            # Whoever writes to such an array gets pages of its own.
            self._read[name] = np.load(path, mmap_mode="c").view(np.ndarray)
            if self._once:
                with contextlib.suppress(OSError):  # Windows keeps files that are mapped
                    path.unlink()
        return self._read[name]


def _pack(value: Any, folder: Path, name: str) -> bytes:
    file = io.BytesIO()
    _Packer(file, folder, name).dump(value)
    return file.getvalue()


def _unpack(message: bytes, folder: Path, once: bool = True) -> Any:
    return _Unpacker(io.BytesIO(message), folder, once).load()


@dataclass(frozen=True, kw_only=True)
class _Done:
    """What came of a task: its ``result``, or the ``error`` that it raised; and the peak memory of the process."""

    number: int
    result: Any = None
    error: BaseException | None = None
    peak: int = 0


@dataclass(eq=False)
class _Worker:
    process: BaseProcess
    channel: Connection


class WorkerPool(Closing):
    """Calls functions of what is ``shared`` and of a task on ``workers`` processes, or here where there is one.

    A context manager: its processes start with the first tasks and end with it.

    Args:
        shared: what all tasks need. It is sent once and stays with each process, which may keep in it what serves
            several tasks; without other processes it is used itself.
        threads: of the BLAS in each process, and here while the pool is open. None: as many as here, but no more than
            there are processors for all.
        scratch: folder for the arrays that are shared (None: the temporary folder of the system).

    Raises:
        InputError: not a positive number of workers.
    """

    def __init__(
        self, shared: Any, workers: int = 1, *, threads: int | None = None, scratch: Path | None = None
    ) -> None:
        if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
            raise InputError(f"workers = {workers!r} was given; expected 1 or more", keyword="workers")
        self.shared, self.workers, self.scratch = shared, workers, scratch
        self.threads = threads if threads is not None else threads_for(workers)
        self.peak_memory_bytes = 0
        self._folder: ScratchFolder | None = None
        self._crew: list[_Worker] = []
        self._names = itertools.count()
        self._limits = threadpool_limits(threads) if threads is not None else contextlib.nullcontext()

    def each(self, function: Work, tasks: Sequence[Any]) -> Iterator[Any]:
        """``function(shared, task)`` of every task, in their order.

        ``function`` is one of a module, that other processes can import.

        Raises:
            SolverError: a process was ended from outside.
            what ``function`` raises: of several failures that of the first task, whichever came first.
        """
        ended: dict[int, Any] = {}
        expected = 0
        for number, result in self.as_ended(function, tasks):
            ended[number] = result
            while expected in ended:
                yield ended.pop(expected)
                expected += 1

    def as_ended(self, function: Work, tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Number and result of every task in the order in which they end; otherwise as ``each``."""
        if min(self.workers, len(tasks)) < 2:
            for number, task in enumerate(tasks):
                yield number, function(self.shared, task)
            return
        busy: dict[Any, tuple[_Worker, int]] = {}
        failure: tuple[int, BaseException] | None = None
        try:
            self._start(function, len(tasks))
            idle, waiting = list(self._crew), list(enumerate(tasks))[::-1]
            while True:
                while idle and waiting and failure is None:
                    worker = idle.pop(0)
                    busy[worker.channel] = worker, self._deal(worker, function, *waiting.pop())
                if not any(failure is None or number < failure[0] for _, number in busy.values()):
                    break
                for channel in connection.wait(list(busy)):
                    worker, _ = busy.pop(channel)
                    done = self._hear(worker)
                    idle.append(worker)
                    if done.error is None:
                        yield done.number, done.result
                    elif failure is None or done.number < failure[0]:
                        failure = done.number, done.error
        except BaseException:
            self._kill()
            raise
        if failure is not None:
            # Others may still work at what nobody wants any more.
            self._kill()
            raise failure[1]

    def close(self) -> None:
        """End the processes, working ones by force."""
        for worker in self._crew:
            worker.channel.close()
        for worker in self._crew:
            worker.process.join(TOL.leaving_seconds)
        self._kill()
        self._limits.__exit__(None, None, None)

    def _start(self, function: Work, tasks: int) -> None:
        if self._crew:
            return
        context: Any = multiprocessing.get_context(_METHOD)
        if _METHOD == "forkserver":
            # Imported once, by the process that the others are copied from.
            context.set_forkserver_preload([__name__, function.__module__])
        self._folder = ScratchFolder(self.scratch)
        folder = self._folder.path
        try:
            message = _pack(self.shared, folder, "shared")
        except OSError as error:
            raise OutputError(
                f"the scratch folder {folder.parent} has no room for what {self.workers} workers share "
                f"({error.strerror}); make room, give another scratch folder, or take workers = 1"
            ) from error
        except (pickle.PicklingError, TypeError, AttributeError) as error:
            raise InputError(
                f"workers = {self.workers} was given, but this work cannot be sent to other processes ({error}); "
                "define its functions and classes in a module, or take workers = 1",
                keyword="workers",
            ) from error
        (folder / "shared").write_bytes(message)
        for _ in range(min(self.workers, tasks)):
            ours, theirs = context.Pipe()
            # Daemons end with this process also where nobody closes the pool.
            process = context.Process(target=_work, args=(theirs, folder, self.threads), daemon=True)
            self._crew.append(_Worker(process, ours))
            with _without_main(b"__main__" in message), _socket_apart():
                process.start()
            theirs.close()

    def _deal(self, worker: _Worker, function: Work, number: int, task: Any) -> int:
        if self._folder is None:
            raise RuntimeError("a pool without a folder")
        message = _pack((number, function, task), self._folder.path, f"task-{next(self._names)}")
        try:
            worker.channel.send_bytes(message)
        except OSError:
            raise self._explain_end(worker) from None
        return number

    def _hear(self, worker: _Worker) -> _Done:
        if self._folder is None:
            raise RuntimeError("a pool without a folder")
        try:
            done: _Done = _unpack(worker.channel.recv_bytes(), self._folder.path)
        except (EOFError, OSError):
            raise self._explain_end(worker) from None
        self.peak_memory_bytes = max(self.peak_memory_bytes, done.peak)
        return done

    def _explain_end(self, worker: _Worker) -> SolverError:
        worker.process.join(TOL.leaving_seconds)
        code, number = worker.process.exitcode, self._crew.index(worker) + 1
        how = f"by signal {-code}" if code is not None and code < 0 else f"with exit code {code}"
        why = "maybe for want of memory; take fewer workers, or give [solver] a memory budget"
        if code == 1:  # of an error of Python, which the worker wrote itself
            why = (
                "its own message tells why; a program whose functions or classes go to workers must start its work "
                'under if __name__ == "__main__":'
            )
        return SolverError(f"worker {number} of {len(self._crew)} was ended {how} before its work was done: {why}")

    def _kill(self) -> None:
        for worker in self._crew:
            if worker.process.pid is not None:
                worker.process.kill()
                worker.process.join()
            worker.channel.close()
        if self._crew:
            log.info(
                "%d workers of %d threads, at most %.3g MB each",
                len(self._crew),
                self.threads,
                self.peak_memory_bytes / 1e6,
            )
        self._crew.clear()
        if self._folder is not None:
            self._folder.close()
            self._folder = None
            # Of those that were killed.
            remove_abandoned(self.scratch)


def threads_for(workers: int) -> int:
    """Threads of the BLAS here, or what ``workers`` processes can have of the processors."""
    here = max((pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"), default=1)
    return max(1, min(here, processors() // workers))


def processors() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextlib.contextmanager
def _without_main(needed: bool) -> Iterator[None]:
    """Processes take over the arguments of the command line, and run the main program again for its definitions.

    The first are none of theirs; the second only if it is ``needed``: few programs guard their actions by __name__.
    """
    arguments, sys.argv = sys.argv, sys.argv[:1]
    main = vars(sys.modules["__main__"])
    hidden: dict[str, Any] = {} if needed else {name: main[name] for name in ("__file__", "__spec__") if name in main}
    main.update(dict.fromkeys(hidden))
    try:
        yield
    finally:
        sys.argv = arguments
        main.update(hidden)


@contextlib.contextmanager
def _socket_apart() -> Iterator[None]:
    """The socket of the process that workers are copied from goes to a private folder, which lives as long as this
    process: the next run removes it where this one is killed."""
    place = next(
        (each for each in (tempfile.gettempdir(), "/tmp") if len(os.fsencode(each)) <= TOL.folder_bytes), "/tmp"
    )
    if _METHOD != "forkserver" or _sockets or not os.access(place, os.W_OK):
        yield
        return
    folder = PrivateFolder(Path(place))
    _sockets.append(folder)
    # Multiprocessing removes its own folder within at the very end, and then this one.
    util.Finalize(None, folder.outlast(), exitpriority=-200)
    before, tempfile.tempdir = tempfile.tempdir, os.path.join(place, folder.path.name)
    try:
        yield
    finally:
        tempfile.tempdir = before


def _follow() -> None:
    """End this process when the one that started it is gone, which nobody else would tell it."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _work(channel: Connection, folder: Path, threads: int) -> None:
    """What a process does until its channel is closed."""
    # Ctrl-C goes to the whole group; the process that started this one answers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_follow, daemon=True).start()
    speak_plainly()
    # Libraries that are loaded later read these.
    os.environ.update(dict.fromkeys(_THREADS, str(threads)))
    # A reference keeps the limit.
    limits = threadpool_limits(threads)
    shared = _unpack((folder / "shared").read_bytes(), folder, once=False)
    for count in itertools.count():
        try:
            number, function, task = _unpack(channel.recv_bytes(), folder)
        except (EOFError, OSError):
            break
        try:
            done = _Done(number=number, result=function(shared, task), peak=peak_memory_bytes())
        except Exception as error:
            done = _Done(number=number, error=_sendable(error))
        with contextlib.suppress(OSError):
            channel.send_bytes(_pack(done, folder, f"result-{os.getpid()}-{count}"))
        done = task = None  # type: ignore[assignment]
    # Its folders go with it: a process that was started in this way runs nothing at its end.
    del shared
    gc.collect()
    limits.restore_original_limits()


def _sendable(error: Exception) -> Exception:
    """``error``, or one in its place where it cannot be sent; with the place in the code if nobody expected it."""
    if not isinstance(error, MorembsError):
        error.add_note("".join(traceback.format_exception(error)).rstrip())
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        words = f"{type(error).__name__}: {error}"
        if isinstance(error, MorembsError):
            return SolverError(words, kind=error.kind, keyword=error.keyword)
        return SolverError(words)
    return error
