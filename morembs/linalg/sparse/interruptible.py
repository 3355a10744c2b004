"""Long calls of foreign libraries that a signal can interrupt.

Python handles signals in its main thread between two of its own instructions, so a call that lasts minutes
would hold back Ctrl-C for as long. The call therefore runs in another thread while the main thread waits. It
cannot be stopped: a wait that was interrupted leaves it to itself, with all that it works on.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Generic, TypeVar

from morembs.base import progress
from morembs.base.errors import SolverError
from morembs.linalg.sparse.tolerances import TOL

T = TypeVar("T")
_NAME = "morembs-call"


def calls_running() -> bool:
    """True if an abandoned call is still running: the libraries it uses must not be unloaded then."""
    return any(thread.name == _NAME for thread in threading.enumerate())


class ForeignObject(ABC):
    """What a library holds for one pattern; its long calls can be interrupted, one at a time.

    ``abandoned`` says that the wait for a call was interrupted. The object then belongs to that call, which frees it
    when it has ended; no other code may touch or free it.
    """

    def __init__(self) -> None:
        self.abandoned = False

    @abstractmethod
    def _free(self) -> None:
        """Give everything back to the library."""

    def close(self) -> None:
        """Free everything; a call that was abandoned does so when it has ended."""
        if not self.abandoned:
            self._free()

    def call(self, function: Callable[..., T], *args: object, news: str = "") -> T:
        """``function(*args)``.

        Args:
            news: passed to the listener with the seconds so far, twice a second; nothing without it.

        Raises:
            SolverError: a call before was abandoned.
            what ``function`` raises, or what interrupts the wait (``abandoned`` is then set, unless the
            call had ended by then).
        """
        if self.abandoned:
            raise SolverError(
                "this factorisation was interrupted and cannot be used again; analyse the matrix again",
                keyword="interrupted",
            )
        if threading.current_thread() is not threading.main_thread():
            return function(*args)
        job = _Job(function, args, self._free)
        start = time.perf_counter()
        worker = threading.Thread(target=job.run, daemon=True, name=_NAME)
        try:
            worker.start()
            while not job.done.wait(TOL.news_seconds):
                if news:
                    progress.update(f"{news} {time.perf_counter() - start:.0f} s")
        except BaseException:
            self.abandoned = job.abandon() and worker.ident is not None
            raise
        if job.error is not None:
            raise job.error
        return job.result[0]


class _Job(Generic[T]):
    """One call and its result."""

    def __init__(self, function: Callable[..., T], args: tuple[object, ...], free: Callable[[], object]) -> None:
        self._function, self._args, self._free = function, args, free
        self._guard = threading.Lock()
        self._abandoned = False
        self.done = threading.Event()
        self.result: list[T] = []
        self.error: BaseException | None = None

    def run(self) -> None:
        """In the worker: call, and free the object if the caller no longer waits."""
        try:
            self.result.append(self._function(*self._args))
        except BaseException as error:
            self.error = error
        with self._guard:
            self.done.set()
            abandoned = self._abandoned
        if abandoned:
            self._free()

    def abandon(self) -> bool:
        """In the main thread: stop waiting; whether the call still runs."""
        with self._guard:
            self._abandoned = not self.done.is_set()
            return self._abandoned
