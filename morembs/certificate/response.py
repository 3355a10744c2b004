"""Transfer functions between interface degrees of freedom, of the reduced and of the full model.

Both are the elastic part of H(i omega) = B' (K + i omega D - omega^2 M)^-1 B: rigid-body motion, which
both models carry exactly, would hide every difference at low frequency.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from morembs.problem import Problem
from morembs.progress import SILENT, Progress
from morembs.reducers.base import ReducedModel
from morembs.responses.reference import reference_model

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


def reduced_response(reduced: ReducedModel, omega: Floats) -> Complexes:
    """Elastic part of H (nf, m, m) of a reduced model at ``omega`` (nf,) in rad/s."""
    r = reduced.rigid_count
    if reduced.symmetric:
        E = reduced.modes()[1][:, r:]
        M, D, K = (E.T @ A @ E for A in (reduced.M, reduced.D, reduced.K))
        B, C = E.T @ reduced.B, reduced.C @ E
    else:
        M, D, K = (A[r:, r:] for A in (reduced.M, reduced.D, reduced.K))
        B, C = reduced.B[r:], reduced.C[:, r:]
    # As in the full model: the limit of falling frequencies at zero, where the loss factor stays.
    c = 1 + 1j * reduced.structural
    H = [C @ np.linalg.solve(c * K + 1j * w * D - w**2 * M, B.astype(complex)) for w in omega]
    return np.array(H, dtype=complex).reshape(len(omega), *C.shape[:1], *B.shape[1:])


def full_response(
    problem: Problem, omega: Floats, *, tolerance: float = 1e-8, progress: Progress = SILENT
) -> Complexes:
    """Elastic part of H (nf, m, m) of the full coupled model at ``omega`` (nf,) in rad/s.

    Forces and moments are scaled to equal static energy; the estimated error of every entry is below
    ``tolerance`` times the largest scaled entry at that frequency. Peak memory: as ``reference_model``.

    Raises:
        InputError: no interfaces, or modal damping beside a damping matrix of the model.
        SolverError: the error does not fall below ``tolerance``.
    """
    return reference_model(problem, omega, tolerance=tolerance, progress=progress).response(omega)
