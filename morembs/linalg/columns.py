"""Columns N x k in memory: norms, orthonormalisation. ``space`` has what works a block at a time.

Columns are real or complex, and orthonormal in x^H M y (M None: the identity). Ranks are decided explicitly.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.types import Floats, Values
from morembs.linalg.tolerances import TOL


def m_norms(W: Values, MW: Values) -> Floats:
    """Norms (k,) of the columns of ``W`` in M, given M W."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,ij->j", W.conj(), MW).real, 0.0)))


def dense(C: Values | sp.csc_array) -> Values:
    """``C`` as a dense array."""
    return np.asarray(C if isinstance(C, np.ndarray) else C.toarray())


def fix_signs(V: Floats) -> Floats:
    """``V`` with the first large entry of each column made positive, in place: equal input gives equal signs."""
    for column in V.T:
        size = np.abs(column)
        if len(size) and column[(size >= TOL.large_entry * size.max()).argmax()] < 0:
            # Not np.negative with out: NumPy 2.4 gives wrong values for strided columns.
            column *= -1.0
    return V


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
    G = W.conj().T @ _weight(W, M) if gram is None else gram
    start = np.sqrt(np.maximum(np.diag(G).real, 0.0)) if reference is None else reference
    Q = orthonormal_pair(W, M, start, G, least=least)[0]
    for _ in range(passes - 1):
        if not 0 < Q.shape[1] < W.shape[1]:
            break
        for _ in range(2):
            W = W - Q @ (Q.conj().T @ _weight(W, M))
        norms = m_norms(W, _weight(W, M))
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
        MW = _weight(W, M) if MW is None else MW
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
            MQ = _weight(Q, M)
            G = Q.conj().T @ MQ
        if not Q.shape[1] or np.abs(G - np.eye(len(G))).max() < TOL.orthonormality * len(G):
            break
        values, U = sl.eigh(0.5 * (G + G.conj().T))
        good = values > max(TOL.gram_noise, least**2) * values[-1]
        Q, MQ, G = Q @ (U[:, good] / np.sqrt(values[good])), None, None
    return Q, _weight(Q, M) if MQ is None else MQ


def _weight(W: Values, M: sp.sparray | None) -> Values:
    return W if M is None else np.asarray(M @ W)


def without_rigid_motion(K: Floats, M: Floats, rigid: Floats) -> Floats:
    """P' K P with P = I - R (R' M R)^-1 R' M for the rigid motions R = ``rigid`` (n, r).

    What K holds of them is round-off of the stiffest parts, which would hold a soft or free body.
    """
    if not rigid.shape[1] or not (E := K @ rigid).any():
        return K
    W = sl.solve(rigid.T @ M @ rigid, rigid.T @ M, assume_a="pos").T
    E -= 0.5 * W @ (rigid.T @ E)
    half = E @ W.T
    # In one sum, so that symmetry holds to the last bit.
    return np.asarray(K - (half + half.T))
