"""The frequencies at which a band is looked at."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.linalg.eigen import SOFT, Modes
from morembs.problem import AS_A_RULE, Problem

Floats = NDArray[np.float64]
POINTS = 200
MOST_HZ = 1e12
# The full model's modes are known up to this multiple of the upper frequency; bounds take the worst case beyond it.
BEYOND = 1.25
# Eigenvalues of a dense symmetric matrix are known to this times eps of the highest, or of themselves over SOFT.
EIGEN = 4.0
# Resonances are sampled at these multiples of their half-power width away, at least NEAR of their frequency.
FLANKS, NEAR = (-1.0, 0.0, 1.0), 1e-3


def band_frequencies(problem: Problem, band_hz: Sequence[float], points: int = POINTS) -> Floats:
    """Frequencies (nf,) in Hz: ``points`` over the band, half of them in equal steps, half in equal ratios, and the
    flanks of every resonance in it.

    Raises:
        InputError: not a band.
    """
    low, high = checked_band(band_hz)
    first = low if low > 0 else 1e-3 * high
    grid = [np.linspace(low, high, points - points // 2), np.geomspace(first, high, points // 2)]
    modes = problem.elastic_modes(below=beyond(high))
    omega = np.sqrt(modes.eigenvalues)
    width = 0.5 * problem.damping.at_resonance(modes.eigenvalues)
    if problem.D is not None:
        width = width + 0.5 * np.einsum("ij,ij->j", modes.vectors, problem.D @ modes.vectors)
    # At its top an undamped resonance is infinite.
    damped = (width > 0) | (problem.D is not None)
    width = np.maximum(width, NEAR * omega)
    for flank in FLANKS:
        found = (omega + flank * width) / (2 * np.pi)
        grid.append(found[(found > low) & (found < high) & (damped | bool(flank))])
    return np.unique(np.concatenate(grid))


def checked_band(band_hz: Sequence[float]) -> tuple[float, float]:
    """The two ends of a band.

    Raises:
        InputError: not two ascending frequencies.
    """
    if len(band_hz) != 2 or not 0 <= band_hz[0] < band_hz[1] < MOST_HZ:
        raise InputError(
            f"band_hz = {list(band_hz)} was given; expected [LOW, HIGH] in Hz with 0 <= LOW < HIGH < {MOST_HZ:g}, such "
            "as [0, 500]"
        )
    return float(band_hz[0]), float(band_hz[1])


def round_off(problem: Problem, modes: Modes, omega: Floats, highest: float) -> Floats:
    """Error (nf,) of responses at ``omega`` that round-off causes as a rule, relative to their size.

    In K, and in the eigenvalues of a small model (the reference) that reach up to ``highest``, in (rad/s)2.
    """
    damping, values = problem.damping, modes.eigenvalues
    stiff = values * (1 + 1j * damping.structural)
    viscous = damping.of_modes(values)
    if problem.D is not None:
        viscous = viscous + np.einsum("ij,ij->j", modes.vectors, problem.D @ modes.vectors)
    a = np.abs(stiff + 1j * omega[:, None] * viscous - omega[:, None] ** 2)
    off = AS_A_RULE * problem.uncertainty(modes) + EIGEN * np.finfo(float).eps * np.minimum(highest, values / SOFT)
    return np.asarray((off / np.maximum(a, np.finfo(float).tiny)).max(axis=1, initial=0.0))


def beyond(high_hz: float) -> float:
    """Eigenvalue in (rad/s)2 up to which modes are known for a band that ends at ``high_hz``."""
    return float((2 * np.pi * BEYOND * high_hz) ** 2)
