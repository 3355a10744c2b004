"""Memory of this process and machine: present use, peak, free and installed memory, and the release of free pages."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from collections.abc import Callable
from functools import cache
from threading import Event, Lock, Thread
from types import TracebackType
from typing import TYPE_CHECKING, Self, cast

from morembs.base.errors import InputError
from morembs.base.tolerances import TOL

if TYPE_CHECKING:
    import psutil

try:
    import resource
except ImportError:  # Windows, whose own figure is taken
    resource = None  # type: ignore[assignment]


def resident_bytes() -> int:
    """Resident memory of this process now."""
    return int(_process(os.getpid()).memory_info().rss)


def available_bytes() -> int:
    """Memory that this machine has free."""
    # Not at the top, here and below: short commands need not know how much memory there is.
    import psutil

    return int(psutil.virtual_memory().available)


def installed_bytes() -> int:
    """Memory that this machine has: the same at every call."""
    import psutil

    return int(psutil.virtual_memory().total)


def refuse_too_large(source: str, size: float) -> None:
    """Packed zeros take no room in a file, and all of the memory when they are read: ask before.

    Args:
        size: bytes of the arrays of ``source`` once they are unpacked.

    Raises:
        InputError: so much memory is not free.
    """
    free = available_bytes()
    if size > free:
        raise InputError(
            f"{source} holds arrays of {size:.3g} bytes; {free:.3g} bytes of memory are free; check the file, or give "
            "more memory",
            kind="file",
        )


def peak_memory_bytes() -> int:
    """Peak resident memory of this process so far, as the operating system counts it."""
    if resource is None:
        info = _process(os.getpid()).memory_info()
        return int(getattr(info, "peak_wset", info.rss))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def trim() -> None:
    """Return memory that was freed to the system, where the C library keeps it."""
    call = _malloc_trim()
    if call is not None:
        call(0)


def release() -> None:
    """Free what only cycles of references hold, and return it to the system: after a piece of work."""
    gc.collect()
    trim()


@cache
def _process(number: int) -> psutil.Process:
    import psutil

    return psutil.Process(number)


@cache
def _malloc_trim() -> Callable[[int], int] | None:
    """The call of the GNU C library that returns freed memory to the system; None elsewhere."""
    try:
        call = ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError, TypeError):
        return None
    call.argtypes = [ctypes.c_size_t]
    return cast(Callable[[int], int], call)


class PeakMemory:
    """Peak resident memory of the process within a ``with``.

    The operating system counts the peak since the process began: where that rises it is the peak of this piece of work
    too, and exact. Where it does not, because work before took more, a thread looks at the resident memory a hundred
    times a second; what is there for a shorter time can be missed.
    """

    def __init__(self, resident: Callable[[], int] = resident_bytes, so_far: Callable[[], int] = peak_memory_bytes):
        self._resident, self._so_far = resident, so_far
        self._lock, self._end = Lock(), Event()
        self._before = self._seen = 0
        self._watcher: Thread | None = None

    def take(self) -> int:
        """Bytes at most since the last call, or since the ``with`` began; begins again."""
        self._look()
        with self._lock:
            counted = self._so_far()
            peak = counted if counted > self._before else self._seen
            self._before, self._seen = counted, self._resident()
        return peak

    def _look(self) -> None:
        now = self._resident()
        with self._lock:
            self._seen = max(self._seen, now)

    def _watch(self) -> None:
        while not self._end.wait(TOL.memory_seconds):
            self._look()

    def __enter__(self) -> Self:
        self._before, self._seen = self._so_far(), self._resident()
        self._watcher = Thread(target=self._watch, daemon=True, name="morembs-memory")
        self._watcher.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end.set()
        if self._watcher is not None:
            self._watcher.join()
