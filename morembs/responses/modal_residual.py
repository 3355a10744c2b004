"""What modal damping of the exact modes adds to the residual of a response whose Ritz vectors have it.

The full model has D = 2 zeta M A^(1/2), A = M^-1 K: the ratio zeta of each of its own modes. The response of a
space is sum_p u_p z_p', z_p = b_p / a_p, with d_p = 2 zeta theta_p^(1/2) and U'M U = I, U'K U = Theta,
s_p = K u_p - theta_p M u_p, so that

    (D - d_p M) u_p = 2 zeta M (A^(1/2) + theta_p^(1/2))^-1 M^-1 s_p,
    u_p'D u_q - d_p delta_pq = -2 zeta sum_k s_pk s_qk / ((l + x) (l + y) (x + y)),

l = lam_k^(1/2) of the exact modes, of which s_pk are the coordinates of s_p, x and y the roots of theta_p and theta_q.
By 1 / (x + y) = int_0^inf exp(-x t) exp(-y t) dt both are bounded by one positive semidefinite form,

    N_pq = 2 zeta (s_p' K^-1 s_q) / (x + y) = 2 zeta theta_p theta_q (tau_p'tau_q) / (x + y):

with mu(w)^2 = w |Z'N Z|, the second sum makes |Z'(D - D_ref) Z| w <= mu^2 (as 1 / l^2 - 1 / ((l + x) (l + y)), over
x + y, is positive semidefinite), and by Cauchy the first a residual

    w |(D - D_ref) U Z| <= mu (zeta w / lam_1^(1/2))^(1/2)   in the norm of K^-1.

The modes below the cut are taken one by one; the sum over the others, which cancel, is a function whose poles are far
from the band: it is known at the points of a grid, and in between by the theorems of ``rational``.
"""

from __future__ import annotations

import numpy as np

from morembs.base.types import Floats
from morembs.responses.rational import PoleResidueForm
from morembs.responses.tolerances import TOL

# Parts of the way to the nearest pole that Bernstein ellipses take.
REACH = np.linspace(0.3, 0.95, 14)


def form(values: Floats, tau: Floats, ratio: float) -> Floats:
    """N (n, n) of Ritz ``values`` (n,), ``tau`` (q, n) and the ``ratio``."""
    root = np.sqrt(values)
    return np.asarray(2 * ratio * np.outer(values, values) / (root[:, None] + root) * (tau.T @ tau))


def largest(poles: PoleResidueForm, b: Floats, N: Floats, band: tuple[float, float]) -> float:
    """Upper limit of |Z'N Z|^(1/2) on the band, for modes with ``poles`` and loads ``b`` (n, m)."""
    if not len(b):
        return 0.0
    middle, half = 0.5 * (band[0] + band[1]), 0.5 * (band[1] - band[0])
    w = middle + half * np.cos(np.pi * np.arange(TOL.modal_steps + 1) / TOL.modal_steps)
    inverse = poles.inverse(w)
    # Real and imaginary parts of Z one after the other: N is real.
    squared_norms = sum(
        np.einsum("wp,pq,wq->w", part, N * (b @ b.T), part, optimize=True) for part in (inverse.real, inverse.imag)
    )
    norms = np.sqrt(np.maximum(np.diag(N), 0.0)) * np.linalg.norm(b, axis=1)
    remainder = _remainder(poles, norms, middle, half)
    return float(
        (np.sqrt(squared_norms.max().clip(0)) + remainder) / np.cos(0.5 * TOL.modal_degree * np.pi / TOL.modal_steps)
        + remainder
    )


def _remainder(poles: PoleResidueForm, norms: Floats, middle: float, half: float) -> float:
    """By how much the interpolant on the band is off (Trefethen 2013, theorem 8.2)."""
    away = float(np.abs(poles.z - middle).min())
    best = np.inf
    for A in half + REACH * (away - half):
        rho = A / half + np.sqrt((A / half) ** 2 - 1)
        least = (np.abs(poles.z - middle) - A).prod(axis=1)
        best = min(best, 4 * rho**-TOL.modal_degree / (rho - 1) * float((norms / least).sum()))
    return best
