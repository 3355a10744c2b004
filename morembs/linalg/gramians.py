"""Gramians of a frequency band: snapshot factors and their SVD block by block.

With U(s) = (s^2 M + s D + K)^-1 B the position Gramian of the band [a, b] is

    P = 1/pi int_a^b Re(U U*) d omega  ~  S S',   S = [sqrt(w_k/pi) Re U_k, sqrt(w_k/pi) Im U_k]_k ,

the velocity Gramian that of s U(s) (Moore 1981; Meyer and Srinivasan 1996). Left singular vectors of S in an inner
product X are the POD basis of the band, with sum of sigma_k^2 over what is left out = 1/pi sum of
w_k |U_k - Pi U_k|_X^2 (Pi projects X-orthogonally): an identity for the quadrature points.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.base.types import Floats
from morembs.linalg.columns import m_norms
from morembs.linalg.space import Space
from morembs.linalg.tolerances import TOL


def snapshot_factor(U: NDArray[Any], weights: Floats) -> Floats:
    """S (n, 2 p ns) with S S' = 1/pi sum of w_k Re(U_k U_k*), of ``U`` (ns, n, p) and ``weights`` (ns,)."""
    scaled = U * np.sqrt(weights / np.pi)[:, None, None]
    columns = np.concatenate([scaled.real, scaled.imag], axis=2)
    return np.asarray(columns.transpose(1, 0, 2).reshape(U.shape[1], -1))


class WeightedSVD:
    """SVD of snapshots of a small length n that arrive in blocks, in the inner product of ``weights`` (n,).

    ``vectors`` (n, r) orthonormal in it, ``sigma`` (r,) descending and above ``TOL.dropped_snapshot`` of the first.
    Peak memory: a few arrays (n, n) and one block.
    """

    def __init__(self, weights: Floats) -> None:
        self.root = np.sqrt(weights)
        self.scaled: Floats = np.zeros((len(weights), 0))
        self.sigma: Floats = np.zeros(0)

    @property
    def vectors(self) -> Floats:
        """Left singular vectors (n, r)."""
        return np.asarray(self.scaled / self.root[:, None])

    def add(self, S: Floats) -> None:
        """Merge the columns of ``S`` (n, j) and truncate."""
        merged = np.hstack([self.scaled * self.sigma, self.root[:, None] * S])
        if merged.shape[1] > len(merged):
            merged = sl.qr(merged.T, mode="r", overwrite_a=True)[0][: len(merged)].T
        self.scaled, sigma, _ = sl.svd(merged, full_matrices=False)
        keep = sigma > TOL.dropped_snapshot * sigma.max(initial=0.0)
        self.scaled, self.sigma = self.scaled[:, keep], sigma[keep]


class StreamedSVD:
    """SVD of snapshots of length N that arrive in blocks, in the inner product of ``space``, a sparse SPD X (N, N).

    Every block is split by an orthogonalisation into its part in the known span and the remainder, and the SVD of the
    small triangle of coefficients turns and truncates the basis (Brand 2006): the Gram matrix of the snapshots,
    which would square their condition, is never formed. At most ``capacity`` columns come in all.
    Peak memory: min(capacity, N) columns of length N where its budget wants them, and four times one block.
    """

    def __init__(self, space: Space, capacity: int) -> None:
        self.space, self.X = space, space.M
        n: int = self.X.shape[0]
        self.V: Floats = space.budget.empty((n, min(capacity, n)), order="F")
        self.sigma: Floats = np.zeros(0)

    @property
    def vectors(self) -> Floats:
        """Left singular vectors (N, r), X-orthonormal: a view."""
        return self.V[:, : len(self.sigma)]

    def add(self, S: Floats) -> None:
        """Merge the columns of ``S`` (N, j), which is overwritten, and truncate."""
        r, X = len(self.sigma), self.X
        norms = m_norms(S, X @ S)
        largest = max(float(norms.max(initial=0.0)), float(self.sigma.max(initial=0.0)))
        C = self.space.orthogonalize_in_place(self.V[:, :r], S)
        rows, used = [C], r
        for _ in range(TOL.snapshot_passes):
            size = m_norms(S, X @ S)
            # A tenth of what is dropped in the end: several of them may add up.
            active = size > 0.1 * TOL.dropped_snapshot * largest
            room = self.V.shape[1] - used
            if not active.any() or not room:
                break
            # Columns scaled up hold round-off of what was taken out before.
            W = self.space.complement(self.V[:, :used], S[:, active] / size[active])[:, :room]
            rows.append(self.space.orthogonalize_in_place(W, S))
            self.V[:, used : used + W.shape[1]] = W
            used += W.shape[1]
            self.space.budget.release_if_tight()
        left = np.zeros((used, r))
        np.fill_diagonal(left, self.sigma)
        U, sigma, _ = sl.svd(np.hstack([left, np.vstack(rows)]), full_matrices=False)
        keep = int((sigma > TOL.dropped_snapshot * sigma.max(initial=0.0)).sum())
        self.space.multiply_into(self.V[:, :used], U[:, :keep], self.V[:, :keep])
        self.sigma = sigma[:keep]
