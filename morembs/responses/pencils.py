"""Small second-order models as sums over their poles."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sl

from morembs.base.types import Complexes, Floats
from morembs.linalg.eigen import accurate_eigh
from morembs.responses.layout import BlockIndex
from morembs.responses.rational import PoleResidueForm
from morembs.responses.rounding import EPS, Response, RoundoffBound, absorb_couplings, bound_entry_errors
from morembs.responses.tolerances import TOL

TINY = np.finfo(float).tiny


def modes_of(M: Floats, K: Floats, rigid: int, symmetric: bool) -> tuple[Complexes, Complexes, Complexes]:
    """Eigenvalues (n,) of (K, M) (n, n), right and left vectors (n, n), left' M right = I, the ``rigid`` motions first:
    of a symmetric pencil the lowest modes, otherwise the first coordinates."""
    if symmetric:
        X = accurate_eigh(K, M)[1]
        # What a small eigenproblem leaves of the highest eigenvalue in all of them, quotients do not have.
        X = X / np.sqrt(np.einsum("ij,ij->j", X, M @ X))
        return np.einsum("ij,ij->j", X, K @ X).astype(complex), X.astype(complex), X.astype(complex)
    values, left, right = sl.eig(K[rigid:, rigid:], M[rigid:, rigid:], left=True, right=True)
    order = np.argsort(values.real, kind="stable")
    values, left, right = values[order], left[:, order].conj(), right[:, order]
    weight = np.einsum("ij,ij->j", left, M[rigid:, rigid:] @ right)
    right = right / np.where(weight == 0, TINY, weight)
    still = np.eye(rigid)
    return np.append(np.zeros(rigid), values), sl.block_diag(still, right), sl.block_diag(still, left)


def response_of(
    M: Floats,
    D: Floats,
    K: Floats,
    B: Floats,
    C: Floats,
    layout: BlockIndex,
    *,
    structural: float,
    highest: float,
    rigid: int = 0,
    symmetric: bool = True,
    unsure: tuple[Floats, Floats] | None = None,
) -> Response:
    """C ((1 + i structural) K + i w D - w^2 M)^-1 B without rigid motion: ``M``, ``D``, ``K`` (n, n), ``B`` (n, m),
    ``C`` (m, n), for frequencies up to ``highest`` rad/s.

    Where D couples modes the poles are those of the first-order form. ``unsure`` are roots (n,) of the energies by
    which A is off, with couplings of their products, and what B and C (n, m) are off by, where both are one.
    """
    theta, X, L = modes_of(M, K, rigid, symmetric)
    off_c, off_b = (4 * EPS * np.abs(side).T @ np.abs(modes) for side, modes in ((C.T, X), (B, L)))
    rotations = _towards_rigid(M, K, theta, L, X, rigid), _towards_rigid(M.T, K.T, theta, X, L, rigid)
    outputs, inputs = C @ X, B.T @ L
    off_c, off_b = (
        error[:, rigid:] + np.abs(rows[:, :rigid]) @ turn
        for error, rows, turn in ((off_c, outputs, rotations[0]), (off_b, inputs, rotations[1]))
    )
    outputs, inputs, theta, X, L = outputs[:, rigid:].T, inputs[:, rigid:].T, theta[rigid:], X[:, rigid:], L[:, rigid:]
    loss = abs(1 + 1j * structural)
    s, t = bound_entry_errors(loss * np.abs(K) + highest * np.abs(D) + highest**2 * np.abs(M), L, X)
    if unsure is not None:
        s, t = (np.hypot(own, unsure[0] @ np.abs(modes)) for own, modes in ((s, L), (t, X)))
        off_c, off_b = (off + unsure[1].T @ np.abs(modes) for off, modes in ((off_c, X), (off_b, L)))
    coupled = L.T @ D @ X
    d, stiffness = np.diag(coupled), theta * (1 + 1j * structural)
    left = loss * np.abs(L.T @ K @ X - np.diag(theta)) + highest**2 * np.abs(L.T @ M @ X - np.eye(len(theta)))
    error = np.abs(coupled - np.diag(d))
    if (error.sum(axis=1) <= TOL.uncoupled_damping * np.abs(d) + 4 * len(d) * EPS * np.abs(d).max(initial=0.0)).all():
        N = layout.rows(outputs, inputs)
        return Response(
            terms=PoleResidueForm.second_order(stiffness, d, N.real if symmetric else N),
            rounding=RoundoffBound.of(
                layout, outputs, inputs, *absorb_couplings(s, t, left + highest * error), off_c.T, off_b.T
            ),
        )
    return _first_order(stiffness, coupled, outputs, inputs, absorb_couplings(s, t, left), (off_c.T, off_b.T), layout)


def _towards_rigid(M: Floats, K: Floats, theta: Complexes, L: Complexes, X: Complexes, rigid: int) -> Floats:
    """(r, k) by how much elastic modes ``X`` (n, r + k) turn towards the rigid motions before them, at most."""
    Z, X = np.abs(L[:, :rigid].T), X[:, rigid:]
    stiff, heavy = (np.abs(L[:, :rigid].T @ A @ X) + 4 * EPS * (Z @ np.abs(A) @ np.abs(X)) for A in (K, M))
    return np.asarray(stiff / np.maximum(np.abs(theta[rigid:]), TINY) + heavy)


def _first_order(
    stiffness: Complexes,
    D: Complexes,
    outputs: Complexes,
    inputs: Complexes,
    lost: tuple[Floats, Floats],
    row_errors: tuple[Floats, Floats],
    layout: BlockIndex,
) -> Response:
    """Poles of q'' + D q' + stiffness q = inputs, from the states (omega q, q'); ``lost`` s and t of the modes, and
    ``row_errors`` of their rows."""
    omega = np.sqrt(stiffness)
    k = len(omega)
    A = np.block([[np.zeros((k, k)), np.diag(omega)], [-np.diag(omega), -D]])
    mu, L, X = sl.eig(A, left=True, right=True)
    L = L.conj()
    weight = np.einsum("ij,ij->j", L, X)
    X = _biorthogonal(L, X / np.where(weight == 0, TINY, weight))
    top, bottom = X[:k] / omega[:, None], L[k:]
    s, t = bound_entry_errors(A, L, X)
    # What is not known of the modes' stiffness couples the states too.
    s, t = np.hypot(s, lost[0] @ np.abs(bottom)), np.hypot(t, lost[1] @ np.abs(top))
    s, t = absorb_couplings(s, t, np.abs(L.T @ A @ X - np.diag(mu)) + np.abs(mu) * np.abs(L.T @ X - np.eye(2 * k)))
    c, b = top.T @ outputs, bottom.T @ inputs
    off_c, off_b = (
        np.abs(side).T @ (rows + 4 * EPS * np.abs(values))
        for side, rows, values in ((top, row_errors[0], outputs), (bottom, row_errors[1], inputs))
    )
    return Response(
        terms=PoleResidueForm.first_order(mu, layout.rows(c, b)),
        rounding=RoundoffBound.of(layout, c, b, s, t, off_c, off_b),
    )


def _biorthogonal(L: Complexes, X: Complexes) -> Complexes:
    """``X`` (n, n) with L'X = I for left vectors ``L`` (n, n) of the same poles, also of coincident ones, as the
    bending modes of a square section do: an eigensolver gives any basis of their spaces, on each side another."""
    try:
        return np.asarray(np.linalg.solve((L.T @ X).T, X.T).T)
    except np.linalg.LinAlgError:
        # Critical damping: one vector for two poles.
        return X
