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
    # Change of a frequency since an earlier report, over the old value, that is red unless another is asked for;
    # chosen: a tenth of a per cent, beyond what another machine or solver changes.
    changed_frequency: float = 1e-3
    # The same of the mass.
    changed_mass: float = 1e-3
    # Growth of an error since then, over the old value; chosen: limits are sharp to 5 %.
    grown_error: float = 0.1
    # The same of the time; chosen: times of one job vary by tens of per cents.
    grown_time: float = 0.5
    # Seconds by which a job has to be slower, as short ones are timed by what else runs.
    noticed_seconds: float = 1.0
    # Change of a frequency or an error that is none: reports have all digits, solvers differ in the last ones.
    same_frequency: float = 1e-9
    # Share from which no digit stands behind the point of a percentage.
    whole_percent_share: float = 0.1


TOL = ReportTolerances()
