"""How far the response of a space is from that of a model with a damping matrix D of its own, on all of a band.

U are the Ritz vectors of the space, U'M U = I, U'K U = Theta, and A(w) = c K + i w D - w^2 M. Its response is b'y,
y = A_r^-1 b with A_r = U'A U, and r = F - A U y is its residual, U'r = 0. On the K-orthogonal complement C of U, in
coordinates of the energy, A couples C with U by X = i w X_D - w^2 X_M, the parts of G D U and G M U outside of U, as
K does not; so r is T = T_0 - X y there. By the Schur complement of A_r

    H - H_ref = T' (A_CC - X A_r^-1 X')^-1 T,   |H - H_ref| <= gamma |T|^2 / (1 - gamma kappa),

kappa = |X||A_r^-1 X'| and gamma = 1 / (1 - w^2 / lam^): D and the loss factor are in the imaginary part of x^H A x
alone, so that its real part on C is that of K - w^2 M (``residual_bound`` has lam^). D is asked for no more than to be
real and symmetric. The forces of dampers are loads of the space, so that heavy ones leave nothing in X_D.

Between the middle m of a cell and its ends A_r^-1 b is a Taylor series, A_m y_j = -A' y_{j-1} - A'' y_{j-2}; with
alpha = |A_m^-1 A'|, beta = |A_m^-1 A''| and rho^2 = h alpha rho + h^2 beta, h^j |y_j| <= rho^j |y_0|, which bounds the
remainder. All of this is in coordinates scaled by the roots of Theta.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.types import Complexes, Floats
from morembs.linalg.columns import m_norms
from morembs.linalg.congruence import scaled_row_sums
from morembs.problem import Problem
from morembs.responses.cells import Bounds, branch_and_bound, initial_partition
from morembs.responses.clusters import clusters, damping_of_clusters
from morembs.responses.krylov_space import root
from morembs.responses.loads import static_response
from morembs.responses.rational import PoleResidueForm
from morembs.responses.reference import ModalReference
from morembs.responses.solves import Solves
from morembs.responses.tolerances import TOL

TINY = np.finfo(float).tiny


@dataclass(frozen=True, kw_only=True, eq=False)
class DampedResidual:
    """Of a space with Ritz ``values`` (n,), damping ``D`` (n, n) and loads ``b`` (n, m), with the loss factor
    ``structural``: coordinates ``heavy`` and ``damped`` (q, n) of G M U and G D U outside, known but for ``lost``
    (2, n), and ``start``, |T_0|. The first ``k`` values lie below ``cut``, and no more modes. ``solutions`` (Nc, 2 n)
    are the parts of G M U and G D U outside."""

    values: Floats
    D: Floats
    b: Floats
    structural: float
    heavy: Floats
    damped: Floats
    lost: Floats
    start: float
    k: int
    cut: float
    solutions: Floats

    @cached_property
    def own(self) -> Floats:
        """(n,) of (sigma_p / theta_p)^2."""
        return np.asarray((np.linalg.norm(self.heavy, axis=0) + self.lost[0]) ** 2)

    @cached_property
    def least(self) -> float:
        """lam^, below which the complement has nothing."""
        values, own = self.values[: self.k], self.own[: self.k]
        share = 1.0 / np.where(values < self.cut, 1.0 / values - 1.0 / self.cut, 1.0)
        return 1.0 / (1.0 / self.cut + float((own / values * share).sum()))

    def bounds(self, band: tuple[float, float], tolerance: float) -> tuple[Floats, Floats]:
        """Edges (nc + 1,) of cells in rad/s, and limits (nc,) of the error over the envelope on them."""
        if not len(self.heavy):
            return np.array(band), np.zeros(1)
        d, size = damping_of_clusters(self.values, self.D)[0], (self.b**2).sum(axis=1)
        for cluster in clusters(self.values):
            size[cluster] = size[cluster].mean()
        envelope = PoleResidueForm.second_order(self.values * (1 + 1j * self.structural), d, size[:, None])
        n = len(self.values)
        stiff = np.diag(self.values * (1 + 1j * self.structural))
        states = np.block([[np.zeros((n, n)), np.eye(n)], [-stiff, -self.D]])
        # Where cells are worth a look, no more.
        poles = PoleResidueForm(z=-1j * np.asarray(sl.eigvals(states))[:, None], N=np.zeros((2 * n, 1)))

        def bounds(lo: Floats, hi: Floats) -> Bounds:
            ends = np.maximum(*(np.abs(end[:, None, None] - envelope.z) for end in (lo, hi))).prod(axis=2)
            found = np.array([self._on_cell(*cell) for cell in zip(lo, hi, strict=True)])
            upper = found[:, :1] / (1.0 / ends @ size)[:, None]
            fine = (found[:, 1:] <= 0.5 * TOL.taylor_ratio) & np.isfinite(upper)
            return Bounds(upper=upper, lower=np.zeros_like(upper), at=0.5 * (lo + hi)[:, None], final=fine)

        cells = branch_and_bound(
            bounds,
            lambda lo, hi: 0.5 * (hi - lo) < TOL.taylor_ratio * poles.nearest(0.5 * (lo + hi)),
            initial_partition(*band, poles.z.real.ravel()),
            lambda bounds, _: bounds.upper <= tolerance,
            quantities=1,
            max_cells=TOL.max_damped_cells,
        )
        return np.append(cells.edges[:, 0], band[1]), cells.upper[:, 0]

    @cached_property
    def _scaled(self) -> tuple[Floats, Floats, Floats, Floats, float, float]:
        """1 / theta^(1/2), D, X_M and X_D in scaled coordinates, and the norms of the last two."""
        r = 1 / np.sqrt(self.values)
        heavy, damped = self.heavy * r, self.damped * r
        size_M, size_D = (
            float(np.linalg.norm(X, 2) + np.linalg.norm(lost * r))
            for X, lost in zip((heavy, damped), self.lost, strict=True)
        )
        return r, r[:, None] * self.D * r, heavy, damped, size_M, size_D

    def _on_cell(self, lo: float, hi: float) -> tuple[float, float]:
        """A limit of |H - H_ref| from ``lo`` to ``hi`` rad/s, infinite where the series does not say, and its rho."""
        r, D, heavy, damped, size_M, size_D = self._scaled
        m, h = 0.5 * (lo + hi), 0.5 * (hi - lo)
        A = 1j * m * D
        A[np.diag_indices(len(r))] += 1 + 1j * self.structural - (m * r) ** 2
        inverse = np.linalg.inv(A)
        first, second = 1j * D - np.diag(2 * m * r**2), -(r**2)
        alpha, beta = float(np.linalg.norm(inverse @ first)), float(np.linalg.norm(inverse * r**2))
        rho = 0.5 * h * (alpha + float(np.sqrt(alpha**2 + 4 * beta)))
        if not rho <= TOL.taylor_ratio:
            return np.inf, rho
        X = [1j * m * damped - m**2 * heavy, 1j * damped - 2 * m * heavy, -heavy]
        y: list[Complexes] = [inverse @ (r[:, None] * self.b).astype(complex)]
        length = np.linalg.norm(y[0])
        rest = float(length * rho ** (TOL.taylor_degree + 1) / (1 - rho))
        t, rows = 0.0, np.full(len(r), rest)
        for j in range(TOL.taylor_degree + 1):
            if j:
                y.append(-inverse @ (first @ y[j - 1] + (second[:, None] * y[j - 2] if j > 1 else 0.0)))
            t += h**j * float(np.linalg.norm(sum(X[i] @ y[j - i] for i in range(min(j, 2) + 1))))
            rows += h**j * np.linalg.norm(y[j], axis=1)
        # h / rho <= 1 / alpha: each derivative of X costs a power of rho.
        step = h / max(rho, TINY)
        t += rest * (m**2 * size_M + m * size_D + step * (size_D + 2 * m * size_M) + step**2 * size_M)
        lost = (hi**2 * self.lost[0] + hi * self.lost[1]) * r
        t += self.start + float(lost @ rows)
        moved = h * (size_D + (2 * m + h) * size_M) + float(np.linalg.norm(lost))
        outside = float(np.linalg.norm(inverse @ X[0].T)) + float(np.linalg.norm(inverse)) * moved
        kappa = (hi**2 * size_M + hi * size_D) * outside / (1 - h * alpha - h**2 * beta)
        real = 1.0 - hi**2 / self.least
        if not real > kappa:
            return np.inf, rho
        return t**2 / (real - kappa), rho


def damped_residual(
    problem: Problem,
    model: ModalReference,
    matrices: tuple[sp.csr_array, Floats],
    k: int,
    cut: float,
    structural: float,
) -> tuple[DampedResidual, bool]:
    """What the space of ``model`` leaves of ``problem``, whose ``k`` modes lie below ``cut``.

    ``matrices`` are its damping matrix (Nc, Nc) and that of the space (n, n), beside the loss factor ``structural``.
    The second result tells whether the solver is exact enough to say so.
    """
    n, b = len(model.values), np.asarray(model.B * problem.motion_scale)
    parts, start, proven = [np.zeros((0, n)), np.zeros((0, n))], 0.0, True
    lost, Z = np.zeros((2, n)), np.zeros((problem.K.shape[0], 0))
    # A space of all elastic motions leaves nothing.
    if n < problem.K.shape[0] - problem.rigid.shape[1]:
        solves, space = Solves(problem), problem.space
        U = model.vectors(np.eye(n))
        lowest = U[:, :k] / m_norms(U[:, :k], problem.M @ U[:, :k])
        softness = solves.softness(lowest, model.values[:k])
        proven = softness.proven
        solved = []
        for row, A in enumerate((problem.M, matrices[0])):
            X, left = solves.flexibility(A @ U)
            lost[row] = softness.value * (left + solves.product(scaled_row_sums(A), A, U))
            solved.append(X)
        Z = np.hstack(solved)
        S, left = solves.checked(static_response(problem), problem.B.toarray())
        S = S * problem.motion_scale
        for W in (Z, S):
            for _ in range(2):
                space.subtract(U, (U.T @ (problem.K @ W)) / model.values[:, None], W)
        start = float(np.sqrt(max((S * (problem.K @ S)).sum(), 0.0)))
        start += float(np.linalg.norm(left * problem.motion_scale)) * softness.value
        coordinates = root(Z.T @ (problem.K @ Z))
        parts = [coordinates[:, :n], coordinates[:, n:]]
    residual = DampedResidual(
        values=model.values,
        D=matrices[1],
        b=b,
        structural=structural,
        heavy=parts[0],
        damped=parts[1],
        lost=lost,
        start=start,
        k=k,
        cut=cut,
        solutions=Z,
    )
    return residual, proven
