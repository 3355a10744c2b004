"""Records of the jobs of a batch, and listeners that hear of them while it runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from morembs.app.batches.plan import Part

State = Literal["done", "unchanged", "failed", "sound", "waits"]


@dataclass(frozen=True, kw_only=True)
class Record:
    """How a job of a batch went: ``state`` and ``output``; of a failed job the ``message``, the ``kind`` and
    ``keyword`` of its error, and the exit ``code``.

    ``facts`` are the plain values of ``morembs reduce --json``, of ``morembs check --json`` for a checked job.
    """

    name: str
    job: str
    output: str = ""
    state: State
    message: str = ""
    kind: str = ""
    keyword: str = ""
    code: int = 0
    seconds: float = 0.0
    facts: Mapping[str, Any]


class Listener(Protocol):
    """What a batch tells while it goes on; ``count`` is the number of its jobs."""

    def begin_checks(self, count: int) -> None:
        """The jobs that are due are checked."""

    def began(self, part: Part, count: int) -> None:
        """A job begins."""

    def report_step(self, part: Part, count: int, line: str) -> None:
        """A job says its present step."""

    def end_job(self, part: Part, count: int, record: Record) -> None:
        """A job is done, is found unchanged, or has failed."""

    def report_event(self, line: str) -> None:
        """Something about the workers, or about an attempt that is made again."""


class Nobody:
    """The default: nobody listens."""

    def begin_checks(self, count: int) -> None: ...

    def began(self, part: Part, count: int) -> None: ...

    def report_step(self, part: Part, count: int, line: str) -> None: ...

    def end_job(self, part: Part, count: int, record: Record) -> None: ...

    def report_event(self, line: str) -> None: ...
