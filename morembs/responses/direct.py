"""Responses of the full model by factorising A(s) itself, frequency by frequency, with one symbolic analysis.

Frequencies that are known in advance are shared out among the workers of the problem.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from morembs.base import progress
from morembs.base.crew import Crew
from morembs.base.errors import InputError, SingularMatrixError
from morembs.base.former_names import with_progress_argument
from morembs.base.types import Complexes, Floats, Values
from morembs.linalg.columns import map_columns
from morembs.linalg.sparse.solver import STRUCTURES
from morembs.problem import Damping, Dynamics, Problem, crew_of

# Models with a damping matrix are taken whole up to this size.
DENSE = 400


def why_no_response(damping: Damping, own: bool, size: int | None) -> str:
    """Why a model of ``size`` coupled dofs has no frequency response with this ``damping``; "" where it has one.

    ``own`` says that the model has a damping matrix; ``size`` None stands for direct solutions, which take Rayleigh
    damping beside a matrix at no size.
    """
    small = size is not None and size <= DENSE
    if not own or not (damping.is_modal or (damping.is_rayleigh and not small)):
        return ""
    kind = "modal" if damping.is_modal else "Rayleigh"
    return (
        f"{kind} damping beside a damping matrix of the model has no frequency response here; add alpha M + beta K to "
        "the matrix, or leave one of them out"
    )


def refuse_skew_parts(problem: Problem) -> None:
    """Refuse models with a gyroscopic or circulatory matrix, of which there is no reference model.

    Raises:
        InputError: as said.
    """
    if not problem.symmetric:
        raise InputError(
            "reference models are of symmetric matrices, and this model has a gyroscopic or circulatory one; take "
            "direct_response, which solves the full equations at each frequency"
        )


def elastic_states(problem: Problem | Dynamics, s: complex, F: Values, *, transposed: bool = False) -> Values:
    """Elastic part (Nc, p) of A(s)^-1 F, or of A(s)'^-1 F, for loads ``F`` (Nc, p), at complex ``s`` in 1/s, not zero.

    Rayleigh and structural damping need no damping matrix: A(s) = c K + g M = c (K + f M), see ``damping``.
    Factor and solution are real where A(s) is. Peak memory: 2 p columns and the factor.

    Raises:
        InputError: modal damping, which has no matrix, or Rayleigh damping beside a matrix of the model's own.
        SingularMatrixError: ``s`` is an eigenvalue.
    """
    damping, M, Z = problem.damping, problem.M, problem.rigid
    if damping.is_modal:
        raise InputError("modal damping is known mode by mode only; a direct solution needs Rayleigh damping or none")
    reason = why_no_response(damping, problem.velocity_matrix is not None or problem.N is not None, None)
    if reason:
        raise InputError(reason)
    c, at = _solved_at(damping, s)
    try:
        factor = problem.stiffness.factorize(at)
    except SingularMatrixError as error:
        raise SingularMatrixError(
            f"{abs(s) / (2 * np.pi):.9g} Hz is an eigenfrequency of the undamped model, where its response is "
            "infinite; move the frequency or give the model damping"
        ) from error
    solve = partial(factor.solve, transposed=transposed)
    U = map_columns(solve, F, problem.budget, factor.dtype)
    if not Z.shape[1]:
        return U if c == 1 else U / c
    if not problem.damps_rigid_motion:
        # Rigid motion is a solution of its own, and is left out.
        U -= Z @ (Z.T @ (M @ U))
        return U if c == 1 else U / c
    # Damping couples it to the rest: it is held by forces M Z, as the mean axes of the body hold it.
    X = map_columns(solve, M @ Z, problem.budget, factor.dtype)
    return np.asarray(U - X @ np.linalg.solve(Z.T @ (M @ X), Z.T @ (M @ U)))


def states_crew(problem: Problem, s: Sequence[complex], F: Values) -> Crew:
    """Processes that make ``elastic_states`` at all of ``s`` (none of it zero) or at other values of their kind.

    Work for them is ``state``, which gives U (Nc, p), and ``seen``, which gives F'U (p, p).
    """
    structures = [problem.stiffness.structure_at(_solved_at(problem.damping, x)[1]) for x in s]
    structure = max(structures, key=STRUCTURES.index, default=STRUCTURES[0])
    return crew_of(problem, F, tasks=len(s), columns=F.shape[1], structure=structure)


def _solved_at(damping: Damping, s: complex) -> tuple[Any, complex]:
    """c and sqrt(f) of A(s) = c (K + f M): what is solved at sqrt(f) instead, which is ``s`` for c = 1."""
    c, g = damping.proportional(s)
    at = s if not (damping.is_rayleigh or damping.structural) else np.sqrt(complex(g / c))
    return c, at if complex(at).imag else complex(at).real


def state(shared: tuple[Problem | Dynamics, Values], s: complex) -> Values:
    """``elastic_states`` (Nc, p) at ``s`` of the problem and the loads that are ``shared``."""
    problem, F = shared
    return elastic_states(problem, s, F)


def seen(shared: tuple[Problem | Dynamics, Values], s: complex) -> Complexes:
    """F'U (p, p) of ``state``."""
    return np.asarray(shared[1].T @ state(shared, s))


def elastic_statics(problem: Problem, F: Values, *, transposed: bool = False) -> Values:
    """Elastic displacements (Nc, p) under loads ``F`` (Nc, p), dense or sparse: of K + N, or of its transpose."""
    if problem.N is None:
        return map_columns(problem.elastic.flexibility, F, problem.budget)
    factor = problem.stiffness.factorize(0.0, "unsymmetric")
    return map_columns(partial(factor.solve, transposed=transposed), F, problem.budget)


@with_progress_argument
def direct_response(problem: Problem, omega: Floats) -> Complexes:
    """Elastic part of H (nf, m, m) at ``omega`` (nf,) in rad/s, one factorisation for each frequency, on the workers of
    the problem.

    It owes nothing to any reduction, and is what to check reductions against. ``full_response`` is many times faster.

    Raises:
        InputError: as ``elastic_states``, or no interfaces.
        SingularMatrixError: an undamped eigenfrequency among ``omega``.

    >>> H = direct_response(held, 2 * np.pi * np.array([50.0, 100.0]))
    >>> H.shape
    (2, 6, 6)
    """
    if not problem.B.shape[1]:
        raise InputError("a frequency response needs interfaces; add at least one [[interface]]")
    m = problem.B.shape[1]
    H = np.empty((len(omega), m, m), dtype=complex)
    moving, still = np.flatnonzero(omega), np.flatnonzero(np.asarray(omega) == 0.0)
    if len(still):
        # Structural damping acts at the lower end of the frequencies too.
        H[still] = problem.B.T @ elastic_statics(problem, problem.B) / (1 + 1j * problem.damping.structural)
    s = [1j * float(omega[j]) for j in moving]
    with states_crew(problem, s, problem.B) as crew:
        for count, (j, found) in enumerate(zip(moving, crew.each(seen, s), strict=True)):
            progress.update(f"direct response: {count + 1} of {len(s)}")
            H[j] = found
    return H
