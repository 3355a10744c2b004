"""Progress of long work: an injected object, so that libraries never print."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Protocol


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


def peak_memory_bytes() -> int:
    """Peak resident memory of this process so far, as the operating system counts it."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


@dataclass(frozen=True, kw_only=True)
class Stage:
    """Cost of one finished stage; ``peak_memory_bytes`` is that of the process up to its end."""

    name: str
    seconds: float
    peak_memory_bytes: int


@dataclass(eq=False)
class Stopwatch:
    """Measures stages and passes them on to a ``Progress``."""

    progress: Progress = SILENT
    stages: list[Stage] = field(default_factory=list)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure what happens inside the ``with``."""
        self.progress.stage(name)
        start = time.perf_counter()
        yield
        self.stages.append(Stage(name=name, seconds=time.perf_counter() - start, peak_memory_bytes=peak_memory_bytes()))
