"""The factor of a static load under which the body buckles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from morembs.base import progress
from morembs.base.types import Floats
from morembs.body.floating.tolerances import TOL
from morembs.problem import Problem


def critical_factor(problem: Problem, geometric: Callable[[Floats], Floats]) -> float | None:
    """Smallest p > 0 with a singular K + p G on the elastic motions; None above ``TOL.far_factor``.

    Lanczos on -K^+ G in the inner product of K, with full reorthogonalisation.
    """
    n = problem.K.shape[0]
    V = problem.budget.empty((n, TOL.buckling_steps), order="F")
    T = np.zeros((TOL.buckling_steps + 1, TOL.buckling_steps + 1))
    start = problem.M @ np.random.default_rng(7).standard_normal(n)
    v = np.asarray(problem.free_free.flexibility(start[:, None])[:, 0])
    theta = 0.0
    v /= np.sqrt(v @ (problem.K @ v))
    for k in range(TOL.buckling_steps):
        V[:, k] = v
        load = -geometric(v)
        w = problem.free_free.flexibility(load[:, None])[:, 0]
        # Inner products in K with elastic motions are the work of the load.
        h = V[:, : k + 1].T @ load
        T[: k + 1, k], T[k, : k + 1] = h, h
        w -= V[:, : k + 1] @ h
        w -= V[:, : k + 1] @ (V[:, : k + 1].T @ (problem.K @ w))
        rest = float(np.sqrt(max(w @ (problem.K @ w), 0.0)))
        values, Y = np.linalg.eigh(T[: k + 1, : k + 1])
        theta, size = float(values[-1]), float(np.abs(values).max())
        error = rest * abs(Y[-1, -1])
        progress.update(f"preload: critical load, step {k + 1}")
        allowed = TOL.buckling_error * max(theta, 1 / TOL.far_factor)
        if rest <= TOL.negligible_term * max(size, np.finfo(float).tiny) or error <= allowed:
            break
        v = np.asarray(w / rest)
    return 1.0 / theta if theta > 1.0 / TOL.far_factor else None
