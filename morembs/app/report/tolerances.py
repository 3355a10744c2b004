"""Tolerances of reports."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ReportTolerances:
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


TOL = ReportTolerances()
