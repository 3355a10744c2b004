"""Transfer functions between interface motions, of the reduced and of the full model.

Both are the elastic part of H(i omega) = B' (K + i omega D - omega^2 M)^-1 B: rigid-body motion, which
both models carry exactly, would hide every difference at low frequency.

The full response is the Galerkin solution on a block Krylov space V of the elastic flexibility G started
at the loads. With proportional damping A(s) = (1 + beta s)(K + f M), f = (s^2 + alpha s)/(1 + beta s), so
one real space serves all frequencies. With rho = G (B - (K + f M) V y), which the Lanczos relation
G M V = V T + W E' gives in small matrices, the error is dH = rho' K (K + f M)^-1 K rho, hence
|dH| <= max_k |lam_k / (lam_k + f)| |rho|_K^2: quadratic in the residual. The space grows until this is
below the tolerance everywhere; the maximum is taken over the Ritz values, which makes it an estimate.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.errors import InputError, SolverError
from morembs.linalg.lanczos import BlockLanczos
from morembs.linalg.orthogonal import dot
from morembs.problem import Damping, Problem
from morembs.progress import SILENT, Progress
from morembs.reducers.base import ReducedModel

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
MAX_ORDER = 2000
# Room for the space to begin with.
FIRST_ORDER = 250


def reduced_response(reduced: ReducedModel, omega: Floats) -> Complexes:
    """Elastic part of H (nf, m, m) of a reduced model at ``omega`` (nf,) in rad/s."""
    values, Y = sl.eigh(reduced.K, reduced.M)
    r = reduced.rigid_count
    E = Y[:, r:]
    B = E.T @ reduced.B
    K = np.diag(values[r:])
    D = E.T @ reduced.D @ E
    eye = np.eye(len(K))
    H = [B.T @ np.linalg.solve(K + 1j * w * D - w**2 * eye, B.astype(complex)) for w in omega]
    return np.array(H).reshape(len(omega), B.shape[1], B.shape[1])


def _factors(damping: Damping, omega: Floats, values: Floats) -> Complexes:
    """1 / (lambda_k + i omega d_k - omega^2) (nf, k) of modes with eigenvalues ``values``."""
    w, lam = omega[:, None], values[None, :]
    d = 2 * damping.modal * np.sqrt(lam) if damping.modal else damping.alpha + damping.beta * lam
    return np.asarray(1.0 / (lam + 1j * w * d - w**2))


def full_response(
    problem: Problem, omega: Floats, *, tolerance: float = 1e-8, progress: Progress = SILENT
) -> Complexes:
    """Elastic part of H (nf, m, m) of the full coupled model at ``omega`` (nf,) in rad/s.

    Forces and moments are scaled to equal static energy; the estimated error of every entry is below
    ``tolerance`` times the largest scaled entry at that frequency. With modal damping the same ratio is
    given to every Ritz mode. Peak memory: the Krylov space, up to some hundred columns of length N.

    Raises:
        InputError: no interfaces, or a model with its own damping matrix.
        SolverError: the error does not fall below ``tolerance``.
    """
    if not problem.B.shape[1]:
        raise InputError("a frequency response needs interfaces; add at least one [[interface]]")
    if problem.D is not None:
        raise InputError("the full frequency response needs proportional damping; this model has its own D")
    M = problem.M
    start = problem.elastic.flexibility(problem.B.toarray())
    scale = np.sqrt(np.maximum(np.asarray(problem.B.T @ start).diagonal(), 0.0))
    if not (scale > 0).all():
        raise InputError("an interface motion does not deform the body; check the interfaces")
    start /= scale
    room = M.shape[0] - problem.rigid.shape[1]
    capacity = min(FIRST_ORDER, room)
    lanczos = BlockLanczos(problem.elastic.flexibility, M, start, capacity=capacity, seed=3, budget=problem.budget)
    loads = lanczos.pending.T @ (M @ start)
    stiffness = np.zeros((0, 0))
    while True:
        lanczos.expand()
        stiffness = _bordered(problem, lanczos, stiffness)
        H, error = _projected(problem, lanczos, stiffness, loads, omega)
        progress.update(f"frequency response: order {lanczos.size}, error {error:.1e}")
        if error <= tolerance or not lanczos.pending.shape[1]:
            return np.asarray(scale[:, None] * H * scale)
        if lanczos.full() and lanczos.capacity < min(MAX_ORDER, room):
            lanczos.enlarge(min(2 * lanczos.capacity, MAX_ORDER, room))
        if lanczos.full():
            raise SolverError(
                f"the full response reached an error of only {error:.1e} with {lanczos.size} vectors; lower the "
                "upper frequency"
            )


def _bordered(problem: Problem, lanczos: BlockLanczos, known: Floats) -> Floats:
    """V' K V with the newest block of V added to what is ``known``."""
    k = lanczos.size
    new = lanczos.V[:, lanczos.last]
    columns = dot(lanczos.V[:, :k], problem.K @ new, problem.budget)
    result = np.zeros((k, k))
    result[: len(known), : len(known)] = known
    result[:, lanczos.last] = columns
    result[lanczos.last] = columns.T
    return result


def _projected(
    problem: Problem, lanczos: BlockLanczos, stiffness: Floats, loads: Floats, omega: Floats
) -> tuple[Complexes, float]:
    """Scaled H (nf, m, m) on the Krylov space and its largest estimated relative error."""
    k = lanczos.size
    values, Y = sl.eigh(stiffness)
    V, W, T = lanczos.V[:, :k], lanczos.rest_vectors, lanczos.T[:k, :k]
    KW = problem.K @ W
    cross = dot(V, KW, problem.budget)
    energy = np.block([[stiffness, cross], [cross.T, W.T @ KW]])
    # G B = V g, so B seen by the modes is V' K V g.
    g = np.zeros((k, loads.shape[1]))
    g[: len(loads)] = loads
    modal = Y.T @ (stiffness @ g)
    factors = _factors(problem.damping, omega, values)
    H, worst = np.empty((len(omega), g.shape[1], g.shape[1]), dtype=complex), 0.0
    for j, row in enumerate(factors):
        H[j] = modal.T @ (row[:, None] * modal)
        # K carries c = 1 + i omega beta; the rest of A is f M, and f y follows from the modal equation.
        c = 1 + 1j * omega[j] * problem.damping.beta
        y = Y @ (row[:, None] * modal)
        fy = Y @ ((1.0 - c * row * values)[:, None] * modal)
        rho = np.vstack([g - c * y - T @ fy, -fy[lanczos.last]])
        residual = np.abs(np.einsum("ij,ik,kj->j", rho.conj(), energy, rho))
        gain = max(1.0, float(np.abs(values * row).max()))
        worst = max(worst, gain * float(residual.max()) / float(np.abs(H[j]).max()))
    return H, worst
