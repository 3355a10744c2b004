"""Petrov-Galerkin projection: equations tested with another space than that of the motion."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.errors import SolverError
from morembs.linalg.columns import hstack, projected
from morembs.problem import Problem
from morembs.reducers.base import Basis

Floats = NDArray[np.float64]
# A pole this far to the right, as part of its size, is unstable.
GROWING = 1e-8


def two_sided_basis(
    problem: Problem, V: Floats, W: Floats, kind: str, notes: Mapping[str, object], *, inertial: Floats | None = None,
    what: str, instead: str,
) -> Basis:  # fmt: skip
    """Rigid-body modes and elastic columns ``V``, tested with the rigid-body modes and ``W``, all (Nc, n).

    ``inertial`` (Nc, n) expands velocities and accelerations where V does not. ``what`` was made and what to take
    ``instead`` are words for the message.

    Raises:
        SolverError: the reduced model is unstable.
    """
    Z, budget = problem.rigid, problem.budget
    r, n = Z.shape[1], V.shape[1]
    K = np.zeros((r + n, r + n))
    K[r:, r:] = projected(V, problem.K, budget, W)
    moved = V if inertial is None else inertial
    mass = projected(moved, problem.M, budget, W)
    # Velocities are expanded with the inertial columns, so stiffness damping acts on those.
    slow = K[r:, r:] if inertial is None else projected(inertial, problem.K, budget, W)
    D = problem.damping.matrix(mass, slow, np.zeros((n, 0)), symmetric=False)
    if problem.D is not None:
        D = D + projected(moved, problem.D, budget, W)
    refuse_unstable(mass, D, K[r:, r:], what, instead)
    return Basis(
        V=hstack(Z, V, budget=budget), W=hstack(Z, W, budget=budget),
        V_velocity=None if inertial is None else hstack(Z, inertial, budget=budget),
        K=K, kinds=("rigid",) * r + (kind,) * n, rigid=np.eye(r + n, r), notes=notes,
    )  # fmt: skip


def refuse_unstable(M: Floats, D: Floats, K: Floats, what: str, instead: str) -> None:
    """Raise where M q'' + D q' + K q = 0 grows.

    Raises:
        SolverError: the message names the pole.
    """
    n = len(M)
    # Time in units of the mean frequency, or K and M differ by many powers of ten.
    unit = np.sqrt(np.linalg.norm(K) / np.linalg.norm(M))
    inverse = np.linalg.solve(M, np.hstack([K / unit**2, D / unit]))
    poles = unit * sl.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-inverse[:, :n], -inverse[:, n:]]]))
    growth = poles.real / np.maximum(np.abs(poles), np.finfo(float).tiny)
    worst = int(np.argmax(growth))
    if growth[worst] > GROWING:
        pole = poles[worst]
        raise SolverError(
            f"{what} gives an unstable reduced model at order {n}: a motion of {abs(pole.imag) / (2 * np.pi):.6g} Hz "
            f"grows at {pole.real:.6g} per second; {instead}"
        )
