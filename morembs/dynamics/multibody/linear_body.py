"""A body of small motion in the inertial frame, as its reduced matrices are."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.dynamics.multibody.component import Marker, VectorComponent, numbers, vector


@checked
class LinearBody(VectorComponent):
    """M q'' + D q' + K q = loads, in the inertial frame: a body that is held, or whose motion is small.

    Rows of ``M``, ``K``, ``D`` (n, n) are generalised forces of q; ``weight`` (n, 3) are its loads under a gravity of
    1 m/s2 along each axis; ``start`` and ``rate`` (n,) are q and dq/dt at the start, zero unless given.

    Raises:
        InputError: shapes that do not fit, a mass matrix that is not positive definite.
    """

    def __init__(
        self,
        M: ArrayLike,
        K: ArrayLike,
        D: ArrayLike | None = None,
        *,
        weight: ArrayLike | None = None,
        start: ArrayLike | None = None,
        rate: ArrayLike | None = None,
        name: str = "body",
    ) -> None:
        label, n = f"body {name!r}", len(np.atleast_1d(K))
        self.name, self.size, self.configuration_size = name, n, n
        self.M, self.K = numbers(f"{label}: M", M, (n, n)), numbers(f"{label}: K", K, (n, n))
        self.D = np.zeros((n, n)) if D is None else numbers(f"{label}: D", D, (n, n))
        self.weight = np.zeros((n, 3)) if weight is None else numbers(f"{label}: weight", weight, (n, 3))
        x, v = (np.zeros(n) if value is None else vector(f"{label}: start", value, n) for value in (start, rate))
        self._start = x, v
        if n and np.linalg.eigvalsh(self.M)[0] <= 0:
            raise InputError(f"{label}: its mass matrix is not positive definite", kind="model")

    def start(self) -> tuple[Floats, Floats]:
        return self._start

    def dynamics(self, t: float, x: Floats, v: Floats, gravity: Floats) -> tuple[Floats, Floats]:
        return self.M, self.K @ x + self.D @ v - self.weight @ gravity

    def energy(self, x: Floats, v: Floats, gravity: Floats) -> tuple[float, float]:
        return 0.5 * float(v @ self.M @ v), float(0.5 * x @ self.K @ x - x @ (self.weight @ gravity))

    def power(self, x: Floats, v: Floats) -> float:
        # The skew part of K stores nothing.
        return -float(v @ (self.D @ v + 0.5 * (self.K - self.K.T) @ x))

    def marker(self, name: str) -> Marker:
        raise InputError(f"body {self.name!r} has no markers; take those of its path")
