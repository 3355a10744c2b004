"""Values of parameters and frequencies at which a bound is looked at, and the range in which it is finite."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from morembs.base.types import Floats
from morembs.parametric.parameter import Box
from morembs.parametric.tolerances import TOL
from morembs.problem.damping import Damping


def training_points(box: Box, count: int, seed: int = 1) -> Floats:
    """The nominal values, the corners of boxes that have few, and ``count`` Sobol points (k, P)."""
    # Not at the top: it loads much that other methods do without.
    from scipy.stats import qmc

    sobol = qmc.Sobol(d=len(box.low), seed=seed).random(1 << max(count - 1, 0).bit_length())[:count]
    inside = box.low + sobol * (box.high - box.low)
    corners = list(product(*zip(box.low, box.high, strict=True))) if len(box.low) <= TOL.max_corner_parameters else []
    return np.vstack([box.nominal, *corners, inside])


def frequencies(values: Floats, damping: Damping, low: float, high: float) -> Floats:
    """Frequencies (nf,) in rad/s over a band where the bound is looked at: steps, and flanks of resonances."""
    inside = values[(values > low**2) & (values < high**2)]
    omega = np.sqrt(inside)
    width = np.maximum(0.5 * damping.at_resonance(inside), TOL.least_flank * omega)
    flanks = (omega + width * np.array([[-1.0], [0.0], [1.0]])).ravel()
    return np.concatenate([np.linspace(low, high, TOL.band_samples), flanks[(flanks > low) & (flanks < high)]])


def narrower(box: Box, points: Floats, finite: NDArray[np.bool_]) -> str:
    """Which range of which parameter has ``finite`` (k,) bounds at all ``points`` (k, P) in it."""
    best, words = 0.0, "narrow the ranges of the parameters, or the band"
    for k, x in enumerate(points.T):
        at = box.nominal[k]
        low, high = x[~finite & (x <= at)].max(initial=-np.inf), x[~finite & (x >= at)].min(initial=np.inf)
        good = x[(x > low) & (x < high)]
        left = np.ptp(good) / (box.high[k] - box.low[k]) if len(good) else 0.0
        if best < left < 1.0:
            best, ends = left, f"{good.min():.4g} ... {good.max():.4g} {box.units[k]}".rstrip()
            words = (
                f"narrow the range of {box.names[k]} to {ends} (SI units; the bound is finite at all sampled values "
                "there), or the band"
            )
    return words
