"""Progress of long work: an injected object, so that libraries never print."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Protocol

from morembs.base.memory import PeakMemory


class Progress(Protocol):
    """What a long calculation calls; both calls are cheap and may be ignored."""

    def stage(self, name: str) -> None:
        """A new stage begins."""

    def update(self, text: str) -> None:
        """News within the stage, such as converged modes so far."""


class Silent:
    """The default: nobody listens."""

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
    """Measures stages and passes them on to a ``Progress``; ``peak_memory_bytes`` is that of all since the first."""

    progress: Progress = SILENT
    memory: PeakMemory = field(default_factory=PeakMemory)
    stages: list[Stage] = field(default_factory=list)
    peak_memory_bytes: int = 0

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure what happens inside the ``with``."""
        self.progress.stage(name)
        self._take()
        start = time.perf_counter()
        yield
        seconds = time.perf_counter() - start
        self.stages.append(Stage(name=name, seconds=seconds, peak_memory_bytes=self._take()))

    def _take(self) -> int:
        peak = self.memory.take()
        self.peak_memory_bytes = max(self.peak_memory_bytes, peak)
        return peak


def duration_words(seconds: float) -> str:
    """``40 s``, ``12 min``, ``1.8 h``."""
    if seconds < 90:
        return f"{max(seconds, 1):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
