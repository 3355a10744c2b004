"""Progress of long work: a listener in the context of the calculation, so that libraries never print.

``with listening(bar): ...`` has ``bar`` hear all calculations inside; they call ``progress.stage`` and
``progress.update`` of this module.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from typing import Protocol

from morembs.base.memory import PeakMemory


class Progress(Protocol):
    """What a long calculation calls; both calls are cheap and may be ignored."""

    def stage(self, name: str) -> None:
        """A new stage begins."""

    def update(self, text: str) -> None:
        """News within the stage, such as converged modes so far."""


_LISTENER: ContextVar[Progress | None] = ContextVar("listener", default=None)


@contextmanager
def listening(listener: Progress | None) -> Iterator[None]:
    """Have ``listener`` hear the work inside the ``with``; None leaves the listener that is there.

    Threads that are started inside hear nothing of it, unless they run in a copy of the context.
    """
    token = _LISTENER.set(listener if listener is not None else _LISTENER.get())
    try:
        yield
    finally:
        _LISTENER.reset(token)


def listener() -> Progress | None:
    """Who listens here; None where nobody does."""
    return _LISTENER.get()


def stage(name: str) -> None:
    """Tell the listener that a new stage begins."""
    hearer = _LISTENER.get()
    if hearer is not None:
        hearer.stage(name)


def update(text: str) -> None:
    """Tell the listener news within the stage."""
    hearer = _LISTENER.get()
    if hearer is not None:
        hearer.update(text)


class Silent:
    """A listener that ignores all it hears."""

    def stage(self, name: str) -> None:
        """Ignore the stage."""

    def update(self, text: str) -> None:
        """Ignore the news."""


SILENT = Silent()


@dataclass(frozen=True, kw_only=True)
class Stage:
    """Cost of one finished stage; ``peak_memory_bytes`` is the peak resident memory of the process during it."""

    name: str
    seconds: float
    peak_memory_bytes: int


@dataclass(eq=False)
class Stopwatch:
    """Measures stages and announces them; ``peak_memory_bytes`` is that of all since the first."""

    memory: PeakMemory = field(default_factory=PeakMemory)
    stages: list[Stage] = field(default_factory=list)
    peak_memory_bytes: int = 0

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure what happens inside the ``with``."""
        stage(name)
        self._take()
        start = time.perf_counter()
        yield
        seconds = time.perf_counter() - start
        self.stages.append(Stage(name=name, seconds=seconds, peak_memory_bytes=self._take()))

    @contextmanager
    def more(self) -> Iterator[None]:
        """Count what happens inside the ``with`` to the last stage."""
        self._take()
        start = time.perf_counter()
        yield
        last, seconds = self.stages.pop(), time.perf_counter() - start
        peak = max(last.peak_memory_bytes, self._take())
        self.stages.append(replace(last, seconds=last.seconds + seconds, peak_memory_bytes=peak))

    def _take(self) -> int:
        peak = self.memory.take()
        self.peak_memory_bytes = max(self.peak_memory_bytes, peak)
        return peak


def duration_words(seconds: float) -> str:
    """``40 s``, ``12 min``, ``1.8 h``."""
    if seconds < 90:
        return f"{max(seconds, 1):.0f} s"
    # Minutes up to 90 of them.
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
