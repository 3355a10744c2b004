"""Limits and times of the command line."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CommandTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # MAC below which a message counts a mode of the full model as missing: the body then
    # holds less of it than it misses.
    missing_mac: float = 0.5
    # Frequency of a coordinate that follows responses beside one of the full model, as a part of it:
    # both are in one row.
    same_row: float = 0.01
    # Ratio that is printed as 0; chosen.
    zero_ratio: float = 1e-11
    # Entry over the largest one that is printed as 0: below the digits shown.
    zero_entry: float = 1e-7
    # Share from which no digit stands behind the point of a percentage.
    whole_percent_share: float = 0.1

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
