"""Orthonormal columns in the inner product of M, with an explicit rank decision."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import NDArray

Floats = NDArray[np.float64]
# A column that keeps less than this part of its norm after orthogonalisation is dependent.
DEPENDENT = 1e-10
# Eigenvalues of a Gram matrix of unit columns below this are round-off.
NOISE = 1e-14


def m_norms(W: Floats, MW: Floats) -> Floats:
    """Norms (k,) of the columns of ``W`` in M, given M W."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,ij->j", W, MW), 0.0)))


def remove(V: Floats, W: Floats, M: sp.sparray, MW: Floats | None = None) -> Floats:
    """Take span(V) (M-orthonormal) out of ``W`` in place, twice; returns the coefficients V' M W.

    ``MW`` saves the first product where it is known.
    """
    if V.shape[1] == 0:
        return np.zeros((0, W.shape[1]))
    first = V.T @ (M @ W if MW is None else MW)
    W -= V @ first
    second = V.T @ (M @ W)
    W -= V @ second
    return np.asarray(first + second)


def m_orthonormal(
    W: Floats, M: sp.sparray, reference: Floats | None = None, gram: Floats | None = None
) -> Floats:
    """M-orthonormal basis of the columns of ``W``, dependent ones dropped (SVQB, Stathopoulos and Wu 2002).

    ``reference`` gives the norms that the columns had before anything was taken out of them, ``gram``
    W' M W where it is known.
    """
    G = W.T @ (M @ W) if gram is None else gram
    norms = np.sqrt(np.maximum(np.diag(G), 0.0))
    start = norms if reference is None else reference
    keep = (norms > DEPENDENT * start) & (norms > 0)
    Q = W[:, keep] / norms[keep]
    G = G[np.ix_(keep, keep)] / np.outer(norms[keep], norms[keep])
    for _ in range(4):
        if not Q.shape[1] or np.abs(G - np.eye(len(G))).max() < 1e-14 * len(G):
            return Q
        values, U = sl.eigh(0.5 * (G + G.T))
        good = values > NOISE * values[-1]
        Q = Q @ (U[:, good] / np.sqrt(values[good]))
        G = Q.T @ (M @ Q)
    return Q
