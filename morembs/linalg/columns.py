"""Columns N x k, in memory or in files: products, orthonormalisation and complements, a block at a time.

Columns are real or complex, and orthonormal in x^H M y (M None: the identity). Ranks are decided explicitly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.budget import UNLIMITED, Budget
from morembs.base.types import Floats, Values
from morembs.linalg.tolerances import TOL


def m_norms(W: Values, MW: Values) -> Floats:
    """Norms (k,) of the columns of ``W`` in M, given M W."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,ij->j", W.conj(), MW).real, 0.0)))


def dot(V: Values, W: Values, budget: Budget = UNLIMITED) -> Values:
    """V^H W, a block of columns of ``V`` at a time."""
    parts = []
    budget.release_if_tight()
    for block in _blocks(V, budget):
        parts.append(V[:, block].conj().T @ W)
        budget.release_if_tight()
    return np.vstack(parts) if parts else np.zeros((0, W.shape[1]))


def subtract(V: Values, C: Values, W: Values, budget: Budget = UNLIMITED) -> None:
    """W -= V C in place, a block of columns of ``V`` at a time."""
    real = V.dtype == W.dtype == C.dtype == np.float64 and W.size > 0 and V.flags.f_contiguous
    for block in _blocks(V, budget):
        # Without an array for the product, where the BLAS can take it from W itself.
        if real and W.flags.f_contiguous:
            sl.blas.dgemm(-1.0, V[:, block], C[block], beta=1.0, c=W, overwrite_c=1)
        elif real and W.flags.c_contiguous:
            sl.blas.dgemm(-1.0, C[block], V[:, block], beta=1.0, c=W.T, trans_a=1, trans_b=1, overwrite_c=1)
        else:
            W -= V[:, block] @ C[block]
        budget.release_if_tight()


def multiply_into(V: Floats, Y: Floats, out: Floats, budget: Budget = UNLIMITED) -> Floats:
    """V Y into ``out`` (N, k), which may be the first columns of ``V``: a block of rows at a time."""
    budget.release_if_tight()
    for first in range(0, len(V), TOL.product_rows):
        rows = slice(first, first + TOL.product_rows)
        out[rows] = V[rows] @ Y
        budget.release_if_tight()
    return out


def multiply(V: Floats, Y: Floats, budget: Budget) -> Floats:
    """V Y (N, k), where the budget wants it."""
    return multiply_into(V, Y, budget.empty((len(V), Y.shape[1]), order="F"), budget)


def hstack(*parts: Floats, budget: Budget) -> Floats:
    """Columns of the ``parts`` (N, .) side by side, in memory or in a scratch file as the budget decides."""
    V = budget.empty((len(parts[0]), sum(part.shape[1] for part in parts)), order="F")
    at = 0
    for part in parts:
        V[:, at : at + part.shape[1]] = part
        at += part.shape[1]
        budget.release_if_tight()
    return V


def map_columns(
    apply: Callable[[Values], Values],
    F: Values | sp.csc_array,
    budget: Budget,
    dtype: Any = np.float64,
    width: int | None = None,
) -> Values:
    """apply(F) (N, k) where the budget wants it, the columns of ``F`` (N, k) made dense ``width`` at a time, by default
    as many as the budget has room for."""
    X = budget.empty(F.shape, dtype, order="F")
    width = budget.columns(F.shape[0]) if width is None else width
    for at in range(0, F.shape[1], width):
        X[:, at : at + width] = apply(dense(F[:, at : at + width]))
        budget.release_if_tight()
    return X


def dense(C: Values | sp.csc_array) -> Values:
    """``C`` as a dense array."""
    return np.asarray(C if isinstance(C, np.ndarray) else C.toarray())


def projected(V: Floats, A: sp.csr_array, budget: Budget, W: Floats | None = None) -> Floats:
    """V' A V or ``W``' A V (n, n) of a symmetric ``A``, a block of columns of ``V`` (Nc, n) at a time."""
    width = budget.columns(len(V))
    test = V if W is None else W
    parts = [dot(test, A @ V[:, at : at + width], budget) for at in range(0, V.shape[1], width)]
    whole = np.hstack(parts) if parts else np.zeros((0, 0))
    return symmetric(whole) if W is None else whole


def symmetric(A: Floats) -> Floats:
    """The symmetric part of ``A`` (n, n)."""
    return np.asarray(0.5 * (A + A.T))


def fix_signs(V: Floats, budget: Budget = UNLIMITED) -> Floats:
    """``V`` with the first large entry of each column made positive, in place: equal input gives equal signs."""
    for column in V.T:
        size = np.abs(column)
        if len(size) and column[(size >= TOL.large_entry * size.max()).argmax()] < 0:
            # Not np.negative with out: NumPy 2.4 gives wrong values for strided columns.
            column *= -1.0
        budget.release_if_tight()
    return V


def project_out(
    V: Values | Sequence[Values], W: Values, M: sp.sparray, MW: Values | None = None, budget: Budget = UNLIMITED
) -> Values:
    """Take span(V) (M-orthonormal, in one or several blocks) out of ``W`` in place; returns the coefficients V^H M W.

    Done twice, or what is left of ``W`` would keep the round-off of what was taken out. ``MW`` saves the first product
    where it is known.
    """
    known = [V] if isinstance(V, np.ndarray) else [*V]
    if not sum(Q.shape[1] for Q in known):
        return np.zeros((0, W.shape[1]))
    first = take_out(known, W, M @ W if MW is None else MW, budget)
    return np.asarray(first + take_out(known, W, M @ W, budget))


def complement(
    V: Values | Sequence[Values], W: Values, M: sp.sparray, budget: Budget = UNLIMITED, *, passes: int = 1
) -> Values:
    """M-orthonormal columns of what ``W`` (overwritten) adds to the M-orthonormal ``V``, in one or several blocks."""
    return split(V, W, M, budget, passes=passes)[1]


def split(
    V: Values | Sequence[Values], W: Values, M: sp.sparray, budget: Budget = UNLIMITED, *, passes: int = 1
) -> tuple[Values, Values]:
    """Coefficients V^H M W, and ``complement``; ``W`` becomes what V leaves of it."""
    MW = M @ W
    before = m_norms(W, MW)
    coefficients = project_out(V, W, M, MW, budget)
    Q = orthonormal(W, M, before, passes=passes)
    # Scaling up what was small scaled up its part along V too.
    project_out(V, Q, M, budget=budget)
    return coefficients, orthonormal(Q, M, np.ones(Q.shape[1]), passes=passes)


def orthonormal(
    W: Values,
    M: sp.sparray | None,
    reference: Floats | None = None,
    gram: Values | None = None,
    *,
    passes: int = 1,
    least: float = TOL.dependent_column,
) -> Values:
    """Basis of the columns of ``W`` (n, k), orthonormal in x^H M y; dependent columns are dropped.

    By eigenvectors of the Gram matrix (SVQB, Stathopoulos and Wu 2002). ``reference`` (k,) gives the norms that the
    columns had before anything was taken out of them, ``gram`` W^H M W where it is known. What keeps less than the part
    ``least`` of its norm is dependent. What one pass cannot tell from round-off beside larger directions, the next one
    sees alone: of use where columns have no other round-off.
    """
    G = W.conj().T @ _weighted(W, M) if gram is None else gram
    start = np.sqrt(np.maximum(np.diag(G).real, 0.0)) if reference is None else reference
    Q = orthonormal_pair(W, M, start, G, least=least)[0]
    for _ in range(passes - 1):
        if not 0 < Q.shape[1] < W.shape[1]:
            break
        for _ in range(2):
            W = W - Q @ (Q.conj().T @ _weighted(W, M))
        norms = m_norms(W, _weighted(W, M))
        keep = (norms > least * start) & (norms > 0)
        if not keep.any():
            break
        Q = np.hstack([Q, _by_gram(W[:, keep] / norms[keep], M, least)[0]])[:, : W.shape[1]]
    return Q


def orthonormal_pair(
    W: Values,
    M: sp.sparray | None,
    reference: Floats | None = None,
    gram: Values | None = None,
    *,
    MW: Values | None = None,
    least: float = TOL.dependent_column,
) -> tuple[Values, Values]:
    """``orthonormal`` in one pass, and M times it; ``MW`` is M W where that is known."""
    if gram is None:
        MW = _weighted(W, M) if MW is None else MW
        gram = W.conj().T @ MW
    norms = np.sqrt(np.maximum(np.diag(gram).real, 0.0))
    start = norms if reference is None else reference
    keep = (norms > least * start) & (norms > 0)
    Q = W[:, keep]
    Q /= norms[keep]
    MQ = None if MW is None else MW[:, keep] / norms[keep]
    return _by_gram(Q, M, least, gram[np.ix_(keep, keep)] / np.outer(norms[keep], norms[keep]), MQ)


def _by_gram(
    Q: Values, M: sp.sparray | None, least: float, G: Values | None = None, MQ: Values | None = None
) -> tuple[Values, Values]:
    """Orthonormal basis of unit columns ``Q`` (n, k) and M times it; their Gram matrix is ``G`` and M Q is ``MQ``
    where they are known."""
    for _ in range(4):
        if G is None:
            MQ = _weighted(Q, M)
            G = Q.conj().T @ MQ
        if not Q.shape[1] or np.abs(G - np.eye(len(G))).max() < TOL.orthonormality * len(G):
            break
        values, U = sl.eigh(0.5 * (G + G.conj().T))
        good = values > max(TOL.gram_noise, least**2) * values[-1]
        Q, MQ, G = Q @ (U[:, good] / np.sqrt(values[good])), None, None
    return Q, _weighted(Q, M) if MQ is None else MQ


def take_out(known: Sequence[Values], W: Values, MW: Values, budget: Budget) -> Values:
    """Take span(known) out of ``W`` in place, once, given M W; returns the coefficients."""
    parts = [dot(Q, MW, budget) for Q in known]
    for Q, C in zip(known, parts, strict=True):
        subtract(Q, C, W, budget)
    return parts[0] if len(parts) == 1 else np.vstack(parts)


def _weighted(W: Values, M: sp.sparray | None) -> Values:
    return W if M is None else np.asarray(M @ W)


def _blocks(V: Values, budget: Budget) -> list[slice]:
    width = budget.read_at_once(len(V))
    return [slice(first, first + width) for first in range(0, V.shape[1], width)]


def without_rigid_motion(K: Floats, M: Floats, rigid: Floats) -> Floats:
    """P' K P with P = I - R (R' M R)^-1 R' M for the rigid motions R = ``rigid`` (n, r).

    What K holds of them is round-off of the stiffest parts, which would hold a soft or free body.
    """
    if not rigid.shape[1] or not (E := K @ rigid).any():
        return K
    W = sl.solve(rigid.T @ M @ rigid, rigid.T @ M, assume_a="pos").T
    E -= 0.5 * W @ (rigid.T @ E)
    off = E @ W.T
    # In one sum, so that symmetry holds to the last bit.
    return np.asarray(K - (off + off.T))
