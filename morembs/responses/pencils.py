"""Small second-order models as sums over their poles."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.linalg.eigen import graded_modes
from morembs.responses.measures import EPS, Layout
from morembs.responses.rational import Terms

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
# Damping that couples modes by less than this part of their own counts as round-off.
UNCOUPLED = 1e-8
TINY = np.finfo(float).tiny


def modes_of(M: Floats, K: Floats, rigid: int, symmetric: bool) -> tuple[Complexes, Complexes, Complexes]:
    """Elastic eigenvalues (k,) of (K, M) (n, n), right and left vectors (n, k), left' M right = I.

    ``rigid`` motions are left out: of a symmetric pencil the lowest modes, otherwise the first coordinates.
    """
    if symmetric:
        X = graded_modes(K, M)[1][:, rigid:]
        # What a small eigenproblem leaves of the highest eigenvalue in all of them, quotients do not have.
        weight = np.einsum("ij,ij->j", X, M @ X)
        X = X / np.sqrt(weight)
        return np.einsum("ij,ij->j", X, K @ X).astype(complex), X.astype(complex), X.astype(complex)
    values, left, right = sl.eig(K[rigid:, rigid:], M[rigid:, rigid:], left=True, right=True)
    order = np.argsort(values.real, kind="stable")
    values, left, right = values[order], left[:, order].conj(), right[:, order]
    weight = np.einsum("ij,ij->j", left, M[rigid:, rigid:] @ right)
    right = right / np.where(weight == 0, TINY, weight)
    pad = np.zeros((rigid, len(values)))
    return values, np.vstack([pad, right]), np.vstack([pad, left])


def terms_of(
    M: Floats, D: Floats, K: Floats, B: Floats, C: Floats, layout: Layout, *, structural: float, highest: float,
    rigid: int = 0, symmetric: bool = True,
) -> Terms:  # fmt: skip
    """C ((1 + i structural) K + i w D - w^2 M)^-1 B without rigid motion: ``M``, ``D``, ``K`` (n, n), ``B`` (n, m),
    ``C`` (m, n), for frequencies up to ``highest`` rad/s.

    Where D couples modes the poles are those of the first-order form.
    """
    theta, X, L = modes_of(M, K, rigid, symmetric)
    sizes = [np.abs(L).T, np.abs(X)]
    unsure = 4 * EPS * _diagonal(sizes[0], np.abs(K) @ sizes[1])
    unsure = unsure + 4 * EPS * np.abs(theta) * _diagonal(sizes[0], np.abs(M) @ sizes[1])
    outputs, inputs = (C @ X).T, L.T @ B
    coupled = L.T @ D @ X
    d = np.diag(coupled)
    off = np.abs(coupled - np.diag(d)).sum(axis=1)
    stiffness = theta * (1 + 1j * structural)
    if (off <= UNCOUPLED * np.abs(d) + 4 * len(d) * EPS * np.abs(d).max(initial=0.0)).all():
        N = layout.rows(outputs, inputs)
        return Terms.second_order(stiffness, d, N.real if symmetric else N, unsure + highest * off)
    return _first_order(stiffness, coupled, outputs, inputs, unsure, layout)


def _first_order(
    stiffness: Complexes, D: Complexes, outputs: Complexes, inputs: Complexes, unsure: Floats, layout: Layout
) -> Terms:
    """Poles of q'' + D q' + stiffness q = inputs, from the states (omega q, q')."""
    omega = np.sqrt(stiffness)
    k = len(omega)
    A = np.block([[np.zeros((k, k)), np.diag(omega)], [-np.diag(omega), -D]])
    mu, left, right = sl.eig(A, left=True, right=True)
    left = left.conj()
    weight = np.einsum("ij,ij->j", left, right)
    right = right / np.where(weight == 0, TINY, weight)
    top, bottom = np.abs(left), np.abs(right)
    lost = 4 * EPS * _diagonal(top.T, np.abs(A) @ bottom)
    # What is not known of the stiffness moves the poles.
    lost += (top[k:] * bottom[:k] * (unsure / np.maximum(np.abs(omega), TINY))[:, None]).sum(axis=0)
    N = layout.rows((right[:k] / omega[:, None]).T @ outputs, left[k:].T @ inputs)
    return Terms.first_order(mu, N, lost)


def _diagonal(left: Floats, right: Floats) -> Floats:
    """Diagonal (k,) of ``left`` (k, n) times ``right`` (n, k)."""
    return np.asarray(np.einsum("ji,ij->j", left, right))
