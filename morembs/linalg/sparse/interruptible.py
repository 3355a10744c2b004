"""Long calls of foreign libraries that a signal can interrupt.

Python handles signals in its main thread between two of its own instructions, so a call that lasts minutes
would hold back Ctrl-C for as long. The call therefore runs in another thread while the main thread waits. It
cannot be stopped: a wait that was interrupted leaves it to itself, with all that it works on.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

from morembs.progress import SILENT, Progress

T = TypeVar("T")
# How often news of a long call is given, in seconds.
_TICK = 0.5
_NAME = "morembs-call"


def calls_running() -> bool:
    """Whether a call goes on that nobody waits for: the libraries it uses must not be unloaded then."""
    return any(thread.name == _NAME for thread in threading.enumerate())


class LongCalls:
    """Runs the calls that work on one foreign object, one at a time.

    ``abandoned`` says that the wait for a call was interrupted. The object then belongs to that call, and its
    ``free`` is run when the call has ended; nobody else may touch or free the object.
    """

    def __init__(self) -> None:
        self.abandoned = False

    def call(
        self,
        function: Callable[..., T],
        *args: object,
        free: Callable[[], object],
        progress: Progress = SILENT,
        news: str = "",
    ) -> T:
        """``function(*args)``; ``free`` releases the foreign object if the wait is interrupted.

        Args:
            progress: told ``news`` and the seconds so far, twice a second.

        Raises:
            what ``function`` raises, or what interrupts the wait (``abandoned`` is then set, unless the
            call had ended by then).
        """  # fmt: skip
        if threading.current_thread() is not threading.main_thread():
            return function(*args)
        job = _Job(function, args, free)
        start = time.perf_counter()
        worker = threading.Thread(target=job.run, daemon=True, name=_NAME)
        try:
            worker.start()
            while not job.done.wait(_TICK):
                progress.update(f"{news} {time.perf_counter() - start:.0f} s".strip())
        except BaseException:
            self.abandoned = job.abandon() and worker.ident is not None
            raise
        if job.error is not None:
            raise job.error
        return job.result[0]


class _Job(Generic[T]):
    """One call and what it gave."""

    def __init__(self, function: Callable[..., T], args: tuple[object, ...], free: Callable[[], object]) -> None:
        self._function, self._args, self._free = function, args, free
        self._guard = threading.Lock()
        self._abandoned = False
        self.done = threading.Event()
        self.result: list[T] = []
        self.error: BaseException | None = None

    def run(self) -> None:
        """In the worker: call, and free the object if nobody waits any more."""
        try:
            self.result.append(self._function(*self._args))
        except BaseException as error:
            self.error = error
        with self._guard:
            self.done.set()
            mine = self._abandoned
        if mine:
            self._free()

    def abandon(self) -> bool:
        """In the main thread: stop waiting; whether the call still runs."""
        with self._guard:
            self._abandoned = not self.done.is_set()
            return self._abandoned
