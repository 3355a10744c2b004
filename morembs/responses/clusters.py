"""Modes whose frequencies are equal: any rotation among them is a basis as good as the one that was computed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from morembs.base.types import Floats
from morembs.responses.tolerances import TOL


def clusters(values: Floats) -> list[slice]:
    """Runs of modes whose eigenvalues (k,), ascending, belong to equal frequencies."""
    omega = np.sqrt(np.maximum(values, 0.0))
    starts = (
        np.flatnonzero(np.diff(omega, prepend=-np.inf) > TOL.equal_modes * omega) if len(omega) else np.zeros(0, int)
    )
    return [slice(*ends) for ends in pairwise([*starts.tolist(), len(omega)])]


def damping_of_clusters(values: Floats, D: Floats) -> tuple[Floats, Floats]:
    """Mean and least damping (k,) in the clusters of modes with ``values`` (k,) and the damping matrix ``D`` (k, k).

    The mean is the trace over the number of modes. No rotation within a cluster changes either.
    """
    mean, least = np.empty(len(values)), np.empty(len(values))
    for cluster in clusters(values):
        own = np.linalg.eigvalsh(D[cluster, cluster])
        mean[cluster], least[cluster] = own.mean(), own[0]
    return mean, least
