"""Transfer functions between interface motions, of the reduced and of the full model.

Both are the elastic part of H(i omega) = B' (K + i omega D - omega^2 M)^-1 B: rigid-body motion, which
both models carry exactly, would hide every difference at low frequency.

The full response comes from a block Krylov space of the elastic flexibility started at the loads. With
proportional damping A(s) = (1 + beta s)(K + f M), f = (s^2 + alpha s)/(1 + beta s), so one real space
serves all frequencies; it grows until the residual, which the Lanczos relation gives exactly, is below
the tolerance everywhere.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.errors import InputError, SolverError
from morembs.linalg.lanczos import BlockLanczos
from morembs.problem import Damping, Problem
from morembs.progress import SILENT, Progress
from morembs.reducers.base import ReducedModel

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
MAX_ORDER = 2000


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
    if damping.modal:
        d = 2 * damping.modal * np.sqrt(lam)
    else:
        d = damping.alpha + damping.beta * lam
    return np.asarray(1.0 / (lam + 1j * w * d - w**2))


def full_response(
    problem: Problem, omega: Floats, *, tolerance: float = 1e-8, progress: Progress = SILENT
) -> Complexes:
    """Elastic part of H (nf, m, m) of the full coupled model at ``omega`` (nf,) in rad/s.

    With modal damping the same ratio is given to every Ritz mode. Peak memory: the Krylov space, up to
    some hundred columns of length N.

    Raises:
        InputError: no interfaces, or a model with its own damping matrix.
        SolverError: the residual does not fall below ``tolerance``.
    """
    m = problem.B.shape[1]
    if not m:
        raise InputError("a frequency response needs interfaces; add at least one [[interface]]")
    if problem.D is not None:
        raise InputError("the full frequency response needs proportional damping; this model has its own D")
    elastic, M = problem.elastic, problem.M
    B = problem.B.toarray()
    start = elastic.flexibility(B)
    # Unit columns: forces and moments differ by orders of magnitude.
    scale = np.sqrt(np.einsum("ij,ij->j", start, M @ start))
    if not (scale > 0).all():
        raise InputError("an interface motion does not deform the body; check the interfaces")
    start /= scale
    lanczos = BlockLanczos(
        elastic.flexibility, M, start, capacity=min(MAX_ORDER, M.shape[0] - problem.rigid.shape[1]), seed=3
    )
    G = None
    while True:
        lanczos.expand()
        k = lanczos.size
        V = lanczos.V[:, :k]
        head = lanczos.V[:, : min(m, k)]
        theta, Y = sl.eigh(lanczos.T[:k, :k])
        good = theta > np.finfo(float).eps * theta[-1]
        theta, Y = theta[good], Y[:, good]
        if G is None:
            G = head.T @ (M @ start)
        first = Y[: len(G)].T @ G
        factors = _factors(problem.damping, omega, 1.0 / theta)
        worst = _residual(lanczos, Y, theta, factors, first)
        progress.update(f"frequency response: order {k}, residual {worst:.1e}")
        if worst <= tolerance or not lanczos.pending.shape[1]:
            break
        if lanczos.full():
            raise SolverError(
                f"the full response reached a residual of only {worst:.1e} with {k} vectors; ask for fewer "
                "frequencies or a lower upper limit"
            )
    # B' V y needs the loads, and start = flexibility(B)/scale equals V[:, :m] G.
    outputs = (problem.B.T @ V) @ Y
    return np.asarray(np.einsum("ik,fk,kj->fij", outputs, factors, first / theta[:, None] * scale, optimize=True))


def _residual(lanczos: BlockLanczos, Y: Floats, theta: Floats, factors: Complexes, first: Floats) -> float:
    """Largest relative residual in M of (I + f G M) u = G B over frequencies and columns."""
    tail = Y[lanczos.last]
    worst = 0.0
    for row in factors:
        # u = V Y diag(row / theta) first;  f u + G^-1-residual: f = 1/row - 1/theta per mode.
        y = (row / theta)[:, None] * first
        f = (1.0 / row - 1.0 / theta)[:, None]
        end = tail @ (f * y)
        residual = np.sqrt(np.abs(np.einsum("ij,ik,kj->j", end.conj(), lanczos.rest, end)))
        worst = max(worst, float((residual / np.linalg.norm(y, axis=0)).max()))
    return worst
