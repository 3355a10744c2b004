"""Limits and times of batches."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BatchTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # Part of the memory of a worker, or of this machine, that jobs may take; chosen: a tenth is left to all else.
    memory_share: float = 0.9
    # Cores where the number of jobs at once is given: as many as nobody has.
    unlimited_cores: int = 1 << 20
    # Memory over a forecast of it: what that is taken to be wrong by.
    forecast_margin: float = 1.15
    # Memory that a killed process may have needed, over the most that was seen of it.
    killed_margin: float = 1.5
    # Bytes of the first line of a manifest at most: a hundred are written.
    first_line_bytes: int = 1000
    # Jobs that one process checks at most.
    jobs_per_check: int = 50
    # Lines of a manifest from which it is written anew, where more than twice the jobs are history too.
    manifest_lines: int = 200

    # Seconds until a file that is written on another machine is seen: network disks may remember that it was not there.
    file_seconds: float = 10.0
    # Seconds between two looks for it.
    file_look_seconds: float = 0.1
    # Seconds that a child may take to leave once it is asked to.
    leaving_seconds: float = 10.0
    # Seconds between two looks whether it has left.
    leaving_look_seconds: float = 0.01
    # Seconds between thoughts of the end of this process while nobody says anything.
    news_seconds: float = 0.5
    # Seconds until a scheduler or its first worker has to be there.
    scheduler_seconds: float = 10.0
    # Seconds between two looks for its first worker.
    scheduler_look_seconds: float = 0.2
    # Seconds between two looks at its workers.
    workers_look_seconds: float = 1.0
    # Seconds until the processes of a batch that is ended are gone: one more than a child may take.
    ended_seconds: float = leaving_seconds + 1.0
    # Seconds between two looks whether they are.
    ended_look_seconds: float = 0.1


TOL = BatchTolerances()
