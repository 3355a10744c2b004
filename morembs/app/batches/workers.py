"""Workers of a batch: needs of a task, resources of workers, and events that they report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, kw_only=True)
class Task:
    """A call of the command line with ``arguments`` in a process of its own, with ``threads`` for linear algebra, that
    takes ``cores`` and ``bytes`` of memory of the worker; ``number`` is its own alone."""

    number: int
    arguments: tuple[str, ...]
    threads: int = 1
    cores: int = 1
    bytes: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Worker:
    """What a worker has for tasks: memory in bytes, cores, and how many processes it runs at once; ``seconds`` until it
    ends."""

    bytes: float
    cores: int
    slots: int
    seconds: float = float("inf")

    def holds(self, other: Worker) -> bool:
        """True if a task with the needs of ``other`` has room."""
        return self.slots > 0 and all(
            getattr(self, name) >= getattr(other, name) for name in ("bytes", "cores", "seconds")
        )


@dataclass(frozen=True, kw_only=True)
class Heard:
    """A line that the process of the task ``number`` says."""

    number: int
    line: str


@dataclass(frozen=True, kw_only=True)
class Finished:
    """How the process of the task ``number`` ended: exit ``code``, negative by a signal, its output (``printed``), its
    last words, and its peak memory as the system counts it, 0 where nobody knows. ``lost``: its worker is gone."""

    number: int
    code: int
    printed: str
    message: str
    seconds: float
    peak_memory_bytes: int = 0
    lost: bool = False

    @property
    def killed(self) -> bool:
        """True if something else ended it."""
        return self.lost or self.code < 0 or self.code >= 128


class Workers(Protocol):
    """Workers of a batch: processes of this machine, or of others. ``limits``: a task that needs more than the largest
    has is refused; else it runs alone."""

    limits: bool

    @property
    def present(self) -> Mapping[str, Worker]:
        """Those that are there now, by name, with all that each has."""

    @property
    def largest(self) -> Worker:
        """The most that one of them has."""

    @property
    def count(self) -> int:
        """How many there are, or will be."""

    def threads(self, asked: int | None, tasks: int) -> int:
        """Threads of each of ``tasks`` that want ``asked``."""

    def want(self, needs: Iterable[Worker]) -> None:
        """Say what the running and waiting tasks need, for a cluster that grows or shrinks with them."""

    def start(self, task: Task, worker: str) -> None:
        """Begin a task."""

    def next(self) -> Heard | Finished | None:
        """What is heard next of any task; None from time to time, as the workers may be others now."""

    def close(self) -> None:
        """End what runs."""
