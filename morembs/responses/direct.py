"""Responses of the full model by factorising A(s) itself, frequency by frequency, with one symbolic analysis.

Frequencies that are known in advance are shared out among the workers of the problem.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from morembs.base import progress
from morembs.base.errors import InputError, SingularMatrixError
from morembs.base.types import Complexes, Floats, Values
from morembs.base.units import in_hz
from morembs.base.worker_pool import WorkerPool
from morembs.problem import Damping, Problem, System
from morembs.responses.tolerances import TOL


def why_no_response(damping: Damping, own: bool, size: int | None) -> str:
    """Why a model of ``size`` coupled dofs has no frequency response with this ``damping``; "" where it has one.

    ``own`` says that the model has a damping matrix; ``size`` None stands for direct solutions, which take Rayleigh
    damping beside a matrix at no size.
    """
    small = size is not None and size <= TOL.dense_order
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
        InputError: in these cases.
    """
    if not problem.symmetric:
        raise InputError(
            "a model with a gyroscopic or circulatory matrix was given; reference models need symmetric matrices: take "
            "direct_response, which solves the full equations at each frequency",
            kind="unsupported",
            keyword="model",
        )


def elastic_states(system: System, s: complex, F: Values, *, transposed: bool = False) -> Values:
    """Elastic part (Nc, p) of A(s)^-1 F, or of A(s)'^-1 F, for loads ``F`` (Nc, p), at complex ``s`` in 1/s, not zero.

    Peak memory: 2 p columns and the factor.

    Raises:
        InputError: modal damping, which has no matrix, or Rayleigh damping beside a matrix of the model's own.
        SingularMatrixError: ``s`` is an eigenvalue.
        SolverError: as ``System.inverse``.
    """
    damping, M, Z = system.damping, system.M, system.rigid
    if damping.is_modal:
        raise InputError(
            "modal damping is known mode by mode only; a direct solution needs Rayleigh damping or none",
            kind="unsupported",
            keyword="damping",
        )
    reason = why_no_response(damping, system.velocity_matrix is not None or system.N is not None, None)
    if reason:
        raise InputError(reason, kind="unsupported", keyword="damping")
    try:
        with system.inverse(s) as solve:
            U = solve(F, transposed=transposed)
            if not system.damps_rigid_motion:
                return U
            # Damping couples rigid motion to the rest: it is held by forces M Z, as the mean axes of the body hold it.
            X = solve(M @ Z, transposed=transposed)
    except SingularMatrixError as error:
        raise SingularMatrixError(
            f"{in_hz(abs(s)):.9g} Hz is an eigenfrequency of the undamped model, where its response is "
            "infinite; move the frequency or give the model damping"
        ) from error
    return np.asarray(U - X @ np.linalg.solve(Z.T @ (M @ X), Z.T @ (M @ U)))


def states_pool(problem: Problem, s: Sequence[complex], F: Values) -> WorkerPool:
    """Processes that make ``elastic_states`` at all of ``s`` (none of it zero) or at other values of their kind.

    Work for them is ``state``, which gives U (Nc, p), and ``transfer_matrix``, which gives F'U (p, p).
    """
    return problem.system.worker_pool(F, s, workers=problem.workers, columns=F.shape[1])


def state(shared: tuple[System, Values], s: complex) -> Values:
    """``elastic_states`` (Nc, p) at ``s`` of the system and the loads that are ``shared``."""
    system, F = shared
    return elastic_states(system, s, F)


def transfer_matrix(shared: tuple[System, Values], s: complex) -> Complexes:
    """F'U (p, p) of ``state``."""
    return np.asarray(shared[1].T @ state(shared, s))


def elastic_statics(problem: Problem, F: Values, *, transposed: bool = False) -> Values:
    """Elastic displacements (Nc, p) under loads ``F`` (Nc, p), dense or sparse: of K + N, or of its transpose."""
    if problem.N is None:
        return problem.space.map_columns(problem.free_free.flexibility, F)
    with problem.system.inverse(0.0) as solve:
        return solve(F, transposed=transposed)


def direct_response(problem: Problem, omega: Floats) -> Complexes:
    """Elastic part of H (nf, m, m) at ``omega`` (nf,) in rad/s, one factorisation for each frequency, on the workers of
    the problem.

    It owes nothing to any reduction, and is what to check reductions against. ``full_response`` is many times faster.

    Args:
        problem: the full model with its interfaces.
        omega: (nf,) in rad/s.

    Raises:
        InputError: as ``elastic_states``, or no interfaces.
        SingularMatrixError: an undamped eigenfrequency among ``omega``.

    >>> H = direct_response(held, 2 * np.pi * np.array([50.0, 100.0]))
    >>> H.shape
    (2, 6, 6)
    """
    if not problem.B.shape[1]:
        raise InputError(
            "a frequency response needs interfaces; add at least one [[interface]]",
            kind="missing",
            keyword="interfaces",
        )
    m = problem.B.shape[1]
    H = np.empty((len(omega), m, m), dtype=complex)
    moving, still = np.flatnonzero(omega), np.flatnonzero(np.asarray(omega) == 0.0)
    if len(still):
        # Structural damping acts at the lower end of the frequencies too.
        H[still] = problem.B.T @ elastic_statics(problem, problem.B) / (1 + 1j * problem.damping.structural)
    s = [1j * float(omega[j]) for j in moving]
    with states_pool(problem, s, problem.B) as pool:
        for count, (j, found) in enumerate(zip(moving, pool.each(transfer_matrix, s), strict=True)):
            progress.update(f"direct response: {count + 1} of {len(s)}")
            H[j] = found
    return H
