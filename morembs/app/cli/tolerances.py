"""Limits and times of the command line."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CommandTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # Seconds of work up to which a terminal shows no progress.
    progress_patience_seconds: float = 1.0
    # Seconds of work up to which no lines of progress are written.
    lines_patience_seconds: float = 5.0
    # Seconds until a new stage is told after the last line.
    stage_seconds: float = 1.0
    # Seconds after which a stage that goes on is told again.
    repeat_seconds: float = 15.0
    # Seconds for each run of a program that assembles a deck, where none are given: as those programs have here.
    engine_seconds: float = 600.0


TOL = CommandTolerances()
