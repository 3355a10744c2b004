"""Gramians of a frequency band: quadrature that resolves resonances, snapshot factors, their SVD block by block.

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
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.budget import UNLIMITED, Budget
from morembs.errors import InputError
from morembs.linalg.columns import complement, m_norms, multiply_into, project_out

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
# Singular values below this part of the largest are round-off.
NEGLIGIBLE = 1e-12
# A panel is at most so many times longer than its nearest pole is away: Gauss points converge by 2.9^2 each.
PANEL = 2.0
MAX_PANELS = 20_000
# Passes in which the columns that an earlier pass took for dependent are scaled up and tried again.
_PASSES = 4


def gauss(edges: Floats, points: int) -> tuple[Floats, Floats]:
    """Nodes and weights (n,) of ``points`` Gauss-Legendre points on each panel between ``edges`` (ascending)."""
    x, w = np.polynomial.legendre.leggauss(points)
    half = 0.5 * np.diff(edges)[:, None]
    middle = 0.5 * (edges[1:] + edges[:-1])[:, None]
    return (middle + half * x).ravel(), (half * w).ravel()


def resonant_panels(low: float, high: float, poles: Complexes) -> Floats:
    """Edges (n,) of panels of [low, high], each short against its distance to the nearest pole.

    A resonance omega_k with half-width d_k = zeta_k omega_k is the pole omega_k + i d_k; ``poles`` (k,) may lie
    outside the band. Panels meet at the resonances inside and halve towards them down to their width.

    Raises:
        InputError: an empty band, or a pole on it, where the integral does not exist.
    """
    if not low < high:
        raise InputError(f"a band from {low} to {high} was given; expected the lower end first")
    at, width = poles.real, np.abs(poles.imag)
    if ((at >= low) & (at <= high) & (width == 0)).any():
        raise InputError("a pole lies on the band; give it damping, or integrate along a shifted line")
    todo = np.unique(np.concatenate([[low, high], at[(at > low) & (at < high)]]))
    first, last = todo[:-1], todo[1:]
    done = [todo]
    count = len(first)
    while len(first):
        apart = np.maximum(np.maximum(first[:, None] - at, at - last[:, None]), 0.0)
        near = np.hypot(apart, width).min(axis=1, initial=np.inf)
        long = last - first > PANEL * near
        first, last = first[long], last[long]
        middle = 0.5 * (first + last)
        done.append(middle)
        count += len(middle)
        if count > MAX_PANELS:
            raise InputError(
                f"more than {MAX_PANELS} panels are needed to resolve the resonances; narrow the band or add damping"
            )
        first, last = np.concatenate([first, middle]), np.concatenate([middle, last])
    return np.unique(np.concatenate(done))


def modal_poles(values: Floats, damping: Floats) -> Complexes:
    """Poles omega + i width (k,) of 1 / (values + s damping + s^2) in s = i omega; of two overdamped ones the slow."""
    half = 0.5 * damping
    inside = values - half**2
    # The slow one of two real roots, free of cancellation.
    fast = half + np.sqrt(np.maximum(-inside, 0.0))
    width = np.where(inside >= 0, half, values / np.where(fast > 0, fast, 1.0))
    return np.asarray(np.sqrt(np.maximum(inside, 0.0)) + 1j * width)


def snapshot_factor(U: NDArray[Any], weights: Floats) -> Floats:
    """S (n, 2 p ns) with S S' = 1/pi sum of w_k Re(U_k U_k*), of ``U`` (ns, n, p) and ``weights`` (ns,)."""
    scaled = U * np.sqrt(weights / np.pi)[:, None, None]
    columns = np.concatenate([scaled.real, scaled.imag], axis=2)
    return np.asarray(columns.transpose(1, 0, 2).reshape(U.shape[1], -1))


class WeightedSVD:
    """SVD of snapshots of a small length n that arrive in blocks, in the inner product of ``weights`` (n,).

    ``vectors`` (n, r) orthonormal in it, ``sigma`` (r,) descending and above ``NEGLIGIBLE`` of the first;
    ``energy`` is the sum of the squared norms of all columns. Peak memory: a few arrays (n, n) and one block.
    """

    def __init__(self, weights: Floats) -> None:
        self.root = np.sqrt(weights)
        self.scaled: Floats = np.zeros((len(weights), 0))
        self.sigma: Floats = np.zeros(0)
        self.energy = 0.0

    @property
    def vectors(self) -> Floats:
        """Left singular vectors (n, r)."""
        return np.asarray(self.scaled / self.root[:, None])

    def add(self, S: Floats) -> None:
        """Merge the columns of ``S`` (n, j) and truncate."""
        block = self.root[:, None] * S
        self.energy += float((block**2).sum())
        merged = np.hstack([self.scaled * self.sigma, block])
        if merged.shape[1] > len(merged):
            merged = sl.qr(merged.T, mode="r", overwrite_a=True)[0][: len(merged)].T
        self.scaled, sigma, _ = sl.svd(merged, full_matrices=False)
        keep = sigma > NEGLIGIBLE * sigma.max(initial=0.0)
        self.scaled, self.sigma = self.scaled[:, keep], sigma[keep]


class StreamedSVD:
    """SVD of snapshots of length N that arrive in blocks, in the inner product of the sparse SPD ``X`` (N, N).

    Every block is split by an orthogonalisation into its part in the known span and the rest, and the SVD of the
    small triangle of coefficients turns and truncates the basis (Brand 2006): the Gram matrix of the snapshots,
    which would square their condition, is never formed. At most ``capacity`` columns come in all.
    Peak memory: min(capacity, N) columns of length N where ``budget`` wants them, and four times one block.
    """

    def __init__(self, X: sp.sparray, capacity: int, budget: Budget = UNLIMITED) -> None:
        self.X, self.budget = X, budget
        n: int = X.shape[0]
        self.V: Floats = budget.empty((n, min(capacity, n)), order="F")
        self.sigma: Floats = np.zeros(0)
        self.energy = 0.0

    @property
    def vectors(self) -> Floats:
        """Left singular vectors (N, r), X-orthonormal: a view."""
        return self.V[:, : len(self.sigma)]

    def add(self, S: Floats) -> None:
        """Merge the columns of ``S`` (N, j), which is overwritten, and truncate."""
        r, X = len(self.sigma), self.X
        norms = m_norms(S, X @ S)
        self.energy += float((norms**2).sum())
        largest = max(float(norms.max(initial=0.0)), float(self.sigma.max(initial=0.0)))
        C = project_out(self.V[:, :r], S, X, budget=self.budget)
        rows, used = [C], r
        for _ in range(_PASSES):
            size = m_norms(S, X @ S)
            active = size > 0.1 * NEGLIGIBLE * largest
            room = self.V.shape[1] - used
            if not active.any() or not room:
                break
            # Columns scaled up hold round-off of what was taken out before.
            W = complement(self.V[:, :used], S[:, active] / size[active], X, self.budget)[:, :room]
            rows.append(project_out(W, S, X))
            self.V[:, used : used + W.shape[1]] = W
            used += W.shape[1]
            self.budget.release_if_tight()
        left = np.zeros((used, r))
        np.fill_diagonal(left, self.sigma)
        U, sigma, _ = sl.svd(np.hstack([left, np.vstack(rows)]), full_matrices=False)
        keep = int((sigma > NEGLIGIBLE * sigma.max(initial=0.0)).sum())
        multiply_into(self.V[:, :used], U[:, :keep], self.V[:, :keep], self.budget)
        self.sigma = sigma[:keep]
