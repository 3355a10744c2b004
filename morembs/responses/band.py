"""The frequencies at which a band is looked at."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.linalg.eigen import Modes
from morembs.problem import Problem

Floats = NDArray[np.float64]
POINTS = 200
MOST_HZ = 1e12
# The full model's modes are known up to this multiple of the upper frequency; bounds take the worst case beyond it.
BEYOND = 1.25
# Resonances are sampled at these multiples of their half-power width away, at least NEAR of their frequency.
FLANKS, NEAR = (-1.0, 0.0, 1.0), 1e-3
# Round-off adds up at random: part of its bound that is seen as a rule.
AS_A_RULE = 0.1
_ROWS = 1 << 14


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
        raise InputError(f"band_hz = {list(band_hz)} was given; expected [LOW, HIGH] in Hz with 0 <= LOW < HIGH")
    return float(band_hz[0]), float(band_hz[1])


def uncertainty(problem: Problem, modes: Modes) -> Floats:
    """How far round-off in K moves the eigenvalues (k,) of ``modes`` at most, in (rad/s)2: eps |phi|' |K| |phi|.

    Row sums of |K| stand for its products, so that no copy of K is made.
    """
    weights = problem.shared("row sums of |K|", lambda: _row_sums(problem.K))
    return np.asarray(np.finfo(float).eps * np.einsum("i,ij,ij->j", weights, modes.vectors, modes.vectors))


def round_off(problem: Problem, modes: Modes, omega: Floats) -> Floats:
    """Error (nf,) of responses at ``omega`` that round-off in K causes as a rule, relative to their size."""
    damping, values = problem.damping, modes.eigenvalues
    stiff = values * (1 + 1j * damping.structural)
    a = np.abs(stiff + 1j * omega[:, None] * damping.of_modes(values) - omega[:, None] ** 2)
    off = uncertainty(problem, modes) / np.maximum(a, np.finfo(float).tiny)
    return np.asarray(AS_A_RULE * off.max(axis=1, initial=0.0))


def _row_sums(K: sp.csr_array) -> Floats:
    sums = np.empty(K.shape[0])
    for first in range(0, K.shape[0], _ROWS):
        starts = K.indptr[first : first + _ROWS + 1]
        part = np.abs(K.data[starts[0] : starts[-1]])
        sums[first : first + len(starts) - 1] = np.add.reduceat(part, starts[:-1] - starts[0])
    return sums


def beyond(high_hz: float) -> float:
    """Eigenvalue in (rad/s)2 up to which modes are known for a band that ends at ``high_hz``."""
    return float((2 * np.pi * BEYOND * high_hz) ** 2)
