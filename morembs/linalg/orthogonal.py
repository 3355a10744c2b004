"""Orthonormal columns in the inner product of M, with an explicit rank decision."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.budget import UNLIMITED, Budget

Floats = NDArray[np.float64]
# A column that keeps less than this part of its norm after orthogonalisation is dependent.
DEPENDENT = 1e-10
# Eigenvalues of a Gram matrix of unit columns below this are round-off.
NOISE = 1e-14
# Arrays that may lie in files are read in pieces: of columns, or of rows across all columns.
_COLUMNS = 64
_ROWS = 1 << 16


def m_norms(W: Floats, MW: Floats) -> Floats:
    """Norms (k,) of the columns of ``W`` in M, given M W."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,ij->j", W, MW), 0.0)))


def remove(V: Floats, W: Floats, M: sp.sparray, MW: Floats | None = None, budget: Budget = UNLIMITED) -> Floats:
    """Take span(V) (M-orthonormal) out of ``W`` in place, twice; returns the coefficients V' M W.

    ``MW`` saves the first product where it is known. ``V`` is read in blocks of columns, twice each time.
    """
    if V.shape[1] == 0:
        return np.zeros((0, W.shape[1]))
    first = dot(V, M @ W if MW is None else MW, budget)
    subtract(V, first, W, budget)
    second = dot(V, M @ W, budget)
    subtract(V, second, W, budget)
    return np.asarray(first + second)


def dot(V: Floats, W: Floats, budget: Budget = UNLIMITED) -> Floats:
    """V' W, a block of columns of ``V`` at a time."""
    parts = []
    for block in _blocks(V):
        parts.append(V[:, block].T @ W)
        budget.relax()
    return np.vstack(parts) if parts else np.zeros((0, W.shape[1]))


def subtract(V: Floats, C: Floats, W: Floats, budget: Budget = UNLIMITED) -> None:
    """W -= V C in place, a block of columns of ``V`` at a time."""
    for block in _blocks(V):
        W -= V[:, block] @ C[block]
        budget.relax()


def combine(V: Floats, Y: Floats, out: Floats, budget: Budget = UNLIMITED) -> Floats:
    """V Y into ``out`` (N, k), which may be the first columns of ``V``: a block of rows at a time."""
    for first in range(0, len(V), _ROWS):
        rows = slice(first, first + _ROWS)
        out[rows] = V[rows] @ Y
        budget.relax()
    return out


def beside(*parts: Floats, budget: Budget) -> Floats:
    """Columns of the ``parts`` (N, .) beside each other, where the budget wants them."""
    V = budget.empty((len(parts[0]), sum(part.shape[1] for part in parts)), order="F")
    at = 0
    for part in parts:
        V[:, at : at + part.shape[1]] = part
        at += part.shape[1]
        budget.relax()
    return V


def _blocks(V: Floats) -> list[slice]:
    return [slice(first, first + _COLUMNS) for first in range(0, V.shape[1], _COLUMNS)]


def m_orthonormal(W: Floats, M: sp.sparray, reference: Floats | None = None, gram: Floats | None = None) -> Floats:
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
