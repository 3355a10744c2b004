"""The frequencies at which a band is looked at."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from morembs.base.arguments import check_value
from morembs.base.limits import Domain
from morembs.base.tolerances import TOL as BASE
from morembs.base.types import Floats
from morembs.base.units import in_hz
from morembs.problem import Problem
from morembs.responses.clusters import damping_of_clusters
from morembs.responses.tolerances import TOL


def band_frequencies(
    problem: Problem, band_hz: Sequence[float], points: int = TOL.band_points, floor: float = 0.0
) -> Floats:
    """Frequencies (nf,) in Hz: ``points`` over the band, half of them in equal steps, half in equal ratios, and the
    flanks of every resonance in it, damped by the ratio ``floor`` at least. None is an undamped resonance.

    Args:
        problem: gives the resonances.
        band_hz: (low, high) in Hz.
        points: number of frequencies beside the flanks.
        floor: least damping ratio of a flank.

    Raises:
        InputError: not a band.

    >>> hz = band_frequencies(problem, [0.0, 3000.0], points=20)
    >>> hz[0], hz[-1]
    (np.float64(0.0), np.float64(3000.0))
    """
    low, high = checked_band(band_hz)
    first = low if low > 0 else TOL.least_band_part * high
    grid = [np.linspace(low, high, points - points // 2), np.geomspace(first, high, points // 2)]
    modes = problem.elastic_modes(below=beyond(high))
    omega = np.sqrt(modes.eigenvalues)
    width = 0.5 * problem.damping.at_resonance(modes.eigenvalues) + floor * omega
    least, own = width, 0.0
    if problem.D is not None:
        D = modes.vectors.T @ (problem.D @ modes.vectors)
        (mean, lowest), own = damping_of_clusters(modes.eigenvalues, D), float(np.diag(D).max(initial=0.0))
        width, least = width + 0.5 * mean, width + 0.5 * lowest
    # At its top an undamped resonance is infinite.
    damped = least > TOL.no_damping * (omega + own)
    width = np.maximum(width, TOL.least_flank * omega)
    for flank in TOL.flank_widths:
        flanks = in_hz(omega + flank * width)
        grid.append(flanks[(flanks > low) & (flanks < high) & (damped | bool(flank))])
    hz = np.unique(np.concatenate(grid))
    on = np.abs(hz[:, None] - in_hz(omega[~damped])) <= TOL.on_resonance * hz[:, None]
    # At the top of an undamped resonance there is no response: its flank within the band takes its place.
    moved = np.where(hz * (1 + TOL.least_flank) <= high, 1 + TOL.least_flank, 1 - TOL.least_flank)
    return np.unique(np.where(on.any(axis=1), hz * moved, hz))


def _is_band(band_hz: Sequence[float]) -> bool:
    return len(band_hz) == 2 and 0 <= band_hz[0] < band_hz[1] < BASE.largest_hz and band_hz[1] >= TOL.least_upper_hz


_BAND_WORDS = (
    f"[LOW, HIGH] in Hz with 0 <= LOW < HIGH, such as [0, 500], and HIGH from "
    f"{TOL.least_upper_hz:g} to {BASE.largest_hz:g}"
)
Band = Annotated[list[float], Domain(_BAND_WORDS, _is_band, {"minItems": 2, "maxItems": 2})]


def checked_band(band_hz: Sequence[float]) -> tuple[float, float]:
    """The two ends of a band.

    Raises:
        InputError: not two ascending frequencies, or an upper one that no body has.
    """
    check_value("band_hz", list(band_hz), Band)
    return float(band_hz[0]), float(band_hz[1])


def beyond(high_hz: float) -> float:
    """Eigenvalue in (rad/s)2 up to which modes are known for a band that ends at ``high_hz``."""
    return float((2 * np.pi * TOL.modes_beyond * high_hz) ** 2)
