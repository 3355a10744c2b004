"""Petrov-Galerkin projection: equations tested with another space than that of the motion."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.linalg as sl

from morembs.base.errors import SolverError
from morembs.base.types import Floats
from morembs.base.units import in_hz
from morembs.problem import Problem
from morembs.reducers.base import Basis
from morembs.reducers.tolerances import TOL


def two_sided_basis(
    problem: Problem,
    V: Floats,
    W: Floats,
    kind: str,
    notes: Mapping[str, object],
    *,
    V_velocity: Floats | None = None,
    what: str,
    instead: str,
) -> Basis:
    """Rigid-body modes and elastic columns ``V``, tested with the rigid-body modes and the span of ``W``, all (Nc, n).

    ``V_velocity`` (Nc, n) expands velocities and accelerations where V does not. ``what`` was made and what to take
    ``instead`` are words for the message.

    Raises:
        SolverError: the reduced model is unstable.
    """
    Z, space = problem.rigid, problem.space
    r, n = Z.shape[1], V.shape[1]
    velocity = V if V_velocity is None else V_velocity
    mass = space.project(velocity, problem.M, W)
    if np.linalg.eigvalsh(mass + mass.T).min(initial=1.0) <= 0:
        # The same equations, solved for the accelerations: simulations want a positive mass.
        W = space.multiply(W, np.asarray(np.linalg.inv(mass).T, dtype=np.float64))
        mass = space.project(velocity, problem.M, W)
    K = np.zeros((r + n, r + n))
    K[r:, r:] = space.project(V, problem.K, W)
    # Stiffness damping acts on the columns of velocities.
    stiffness = K[r:, r:] if V_velocity is None else space.project(V_velocity, problem.K, W)
    D = problem.damping.matrix(mass, stiffness, np.zeros((n, 0)), symmetric=False)
    if problem.D is not None:
        D = D + space.project(velocity, problem.D, W)
    refuse_unstable(mass, D, K[r:, r:], what, instead)
    return Basis(
        V=space.hstack(Z, V),
        W=space.hstack(Z, W),
        V_velocity=None if V_velocity is None else space.hstack(Z, V_velocity),
        K=K,
        kinds=("rigid",) * r + (kind,) * n,
        rigid=np.eye(r + n, r),
        notes=notes,
    )


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
    if growth[worst] > TOL.unstable_growth:
        pole = poles[worst]
        raise SolverError(
            f"{what} gives an unstable reduced model at order {n}: a motion of {in_hz(abs(pole.imag)):.6g} Hz "
            f"grows at {pole.real:.6g} per second; {instead}",
            keyword="order",
        )
