"""Checks of a basis: its mass is that of motions that a simulation can follow, its stiffness is that of the model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from morembs.base.errors import InputError, SolverError
from morembs.base.types import Floats
from morembs.linalg.eigen import modes_without_mass_last
from morembs.linalg.tolerances import TOL as LINALG
from morembs.problem import SOFTER, Problem
from morembs.problem.tolerances import TOL as PROBLEM
from morembs.reducers.tolerances import TOL
from morembs.responses.massless import loaded_without_mass


def without_roundoff_mass(problem: Problem, M: Floats, K: Floats) -> Floats:
    """``M`` (n, n) of a basis with zeros where a coordinate has round-off for mass, in a model with dofs without mass.

    Columns of the basis are known to N eps of their size, and mass has the square: below (N eps)^2 of the stiffness
    over the lowest eigenvalue of a single dof, there is none.
    """
    if not loaded_without_mass(problem):
        return M
    full, stiff = problem.M.diagonal(), problem.K.diagonal()
    alone = float(np.divide(full, stiff, out=np.zeros_like(full), where=stiff > 0).max(initial=0.0))
    none = np.abs(np.diag(M)) <= (len(full) * np.finfo(float).eps) ** 2 * alone * np.abs(np.diag(K))
    M = np.array(M)
    M[none], M[:, none] = 0.0, 0.0
    return M


def refuse_negative_mass(method: str, M: Floats, kinds: Sequence[str]) -> None:
    """Refuse motions of the basis that have negative mass. Motions without mass stay: they are static compliance.

    Raises:
        InputError: in these cases.
    """
    d = np.sqrt(np.abs(np.diag(M)))
    d[d == 0] = 1.0
    S = M / np.outer(d, d)
    shifted = S + LINALG.negative_mass * np.eye(len(S))
    try:
        np.linalg.cholesky(shifted)
    except np.linalg.LinAlgError as error:
        values, Y = np.linalg.eigh(S)
        raise InputError(
            f'method "{method}" gives a body with motions of negative mass ({values[0]:.1e} of the others, most of it '
            f"in its {_coordinate(kinds, Y[:, 0])}); the mass matrix of the model is indefinite, check it",
            kind="model",
            keyword="method",
        ) from error


def refuse_singular_mass(method: str, M: Floats, kinds: Sequence[str]) -> None:
    """Refuse motions of the basis that have no mass, such as rotations of interfaces beside lumped masses.

    Raises:
        InputError: in these cases.
    """
    try:
        np.linalg.cholesky(M)
    except np.linalg.LinAlgError as error:
        d = np.sqrt(np.abs(np.diag(M)))
        values, Y = np.linalg.eigh(M / np.outer(d, d) if (d > 0).all() else M)
        raise InputError(
            f'method "{method}" takes accelerations of all interface dofs, and some move no mass ({values[0]:.1e} of '
            f"the others, most of it in {_coordinate(kinds, Y[:, 0])}), as rotations beside lumped masses; give these "
            'dofs mass, leave them out of the interface (components = [...]), or take method = "craig-bampton"',
            kind="model",
            keyword="method",
        ) from error


def _coordinate(kinds: Sequence[str], vector: Floats) -> str:
    """Words for the coordinate that has most of a ``vector`` (n,)."""
    worst = int(np.argmax(np.abs(vector)))
    return f"{kinds[worst]} coordinate {1 + kinds[:worst].count(kinds[worst])}"


def refuse_wrong_stiffness(
    method: str, problem: Problem, rigid: Floats, *, V: Floats, W: Floats | None, K: Floats, M: Floats
) -> None:
    """Compare ``K`` (n, n) of a basis with W' K V for one combination of its modes, its round-off with each of them.

    Modes count alike, each at the scale of its stiffness, rigid motion at that of the lowest mode. Where W is not V,
    and where K does not couple them, coordinates stand for modes.

    Raises:
        SolverError: they differ, or K in double precision does not hold a mode or a rigid motion.
    """
    n, r, eps = len(K), rigid.shape[1], float(np.finfo(float).eps)
    if n == r:
        # Nothing but rigid motion, whose stiffness is zero and has no size.
        return
    coupled = W is None and np.count_nonzero(K) > np.count_nonzero(np.diag(K))
    values, Y = modes_without_mass_last(K, M) if coupled else (np.abs(np.diag(K)), np.eye(n))
    # Motions without mass as stiff as the highest mode.
    highest = values[np.isfinite(values)].max(initial=1.0)
    Y = Y * np.where(np.isfinite(values), 1.0, np.sqrt(highest))
    values = np.minimum(values, highest)
    # Round-off in K V y, at most: the norms of columns add up.
    noise = (np.sqrt(problem.system.roundoff(V)) @ np.abs(Y)) ** 2 / TOL.stiffness_error
    lowest = values[r]
    scale = 1.0 / np.sqrt(np.maximum(np.maximum(np.maximum(values, lowest), noise), np.finfo(float).tiny))
    # Signs that no structure of a basis has.
    x = Y @ (scale * np.where(np.arange(1, n + 1) ** 2 * 0.6180339887 % 1 < 0.5, -1.0, 1.0))
    Vx = problem.space.multiply_into(V, x[:, None], np.empty((len(V), 1)))
    given = K @ x
    true = problem.space.dot(V if W is None else W, problem.K @ Vx)[:, 0]
    error = float(np.linalg.norm(scale * (Y.T @ (true - given))))
    if not error <= TOL.stiffness_error * max(np.linalg.norm(scale * (Y.T @ given)), np.sqrt(n)):
        raise SolverError(
            f"method {method!r} gave a reduced stiffness that is not W' K V of its basis: {error / np.sqrt(n):.1e} of "
            "it is missing or too much; take another method, and report this with the model",
            keyword="method",
        )
    if not coupled:
        return
    lost = PROBLEM.usual_roundoff * eps * np.einsum("ij,ij->j", np.abs(Y), np.abs(K) @ np.abs(Y))
    # Rigid motion has no stiffness: what is there is lost.
    lost[:r] = np.maximum(lost[:r], np.abs(values[:r]))
    size = np.maximum(values, TOL.rigid_frequency**2 * lowest)
    if not (lost <= PROBLEM.lost_digits * size).all():
        k = int(np.argmax(lost / size))
        what = (
            f"its mode {k - r + 1}"
            if k >= r
            else f"its rigid motion at {TOL.rigid_frequency:g} of its lowest frequency"
        )
        raise SolverError(
            f"round-off in the reduced stiffness hides {what}: it amounts to {lost[k]:.1e} (rad/s)2 of {size[k]:.1e} "
            f"(allowed {PROBLEM.lost_digits:.0e} of it); {SOFTER}"
        )
