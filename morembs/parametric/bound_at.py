"""The bound at one p: of the Galerkin response with what is known of the residuals there (``bound`` derives it)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl

from morembs.base.types import Complexes, Floats
from morembs.base.units import eigenvalue_in_hz, in_hz
from morembs.linalg.dense import symmetric
from morembs.problem.damping import Damping
from morembs.responses.residual_bound import numerator, slope
from morembs.storage.lemma import PROVEN, Lemma, kind_of

# Angles psi that are tried, in radians.
ANGLES = np.radians([0.0, 20.0, 40.0, 60.0, 75.0, 85.0])
KINDS = ("bound", "estimate", "none")


@dataclass(frozen=True, kw_only=True, eq=False)
class BoundAt:
    """The bound at one p: Ritz ``values`` (e,) in (rad/s)2 and scaled loads ``b`` (e, m) of the elastic part, ``gram``
    (m + e, m + e) of the static residual and of those of the Ritz vectors in the dual norm, ``static_truncation`` (m,)
    and ``truncation`` (e,) the norms of what was cut of them; the first ``n_low`` are V_L, and K >= ``least`` M beside
    them. ``unsure_K``,
    ``unsure_M`` (e, e) limit the quadratic forms of what is not known of K and M. The static residual has the first
    ``soft`` by their inertia. ``proof``: the lemmas that all this rests on."""

    values: Floats
    b: Floats
    gram: Floats
    static_truncation: Floats
    truncation: Floats
    n_low: int
    least: float
    damping: Damping
    unsure_K: Floats
    unsure_M: Floats
    proof: tuple[Lemma, ...]
    soft: int = 0

    @property
    def kind(self) -> str:
        """ "bound" where all of it is proven in exact arithmetic, "estimate", or "none"."""
        return "none" if not self.least > 0 else KINDS[0] if kind_of(self.proof) == PROVEN else KINDS[1]

    def envelope(self, omega: Floats) -> Floats:
        """(nf,) sum of the sizes of all modal contributions to the scaled H at ``omega`` (nf,) in rad/s, in m/N."""
        return np.asarray((1 / np.abs(self._a(omega)[0])) @ (self.b**2).sum(axis=1))

    def error(self, omega: Floats) -> Floats:
        """(nf,) bounds of |H - H_r|_F, scaled, at ``omega`` (nf,) in rad/s, in m/N; infinite where there is none."""
        omega = np.atleast_1d(np.asarray(omega, dtype=float))
        a, c, g = self._a(omega)
        # On a resonance without damping there is no response.
        on = (a == 0).any(axis=1)
        a[on] = c[on, None]
        norm_2, norm_F = self._residual(a, omega)
        best, kappa = self._gain(a, c, g)
        with np.errstate(divide="ignore", invalid="ignore"):
            error = norm_2 * norm_F / best + self._unsure(a, c, g, norm_F / best, kappa / best, 1 / best)
        return np.where((best > 0) & ~on, error, np.inf)

    def explain_infinite(self, alpha: float, omega: float, highest: float) -> str:
        """Which factor of the bound at ``omega`` is infinite, for a band up to ``highest``, in rad/s, and ``alpha``."""
        if not alpha > 0:
            return "no part of the stiffness at nominal values is proven to be left there (alpha)"
        if not self.least > highest**2:
            return (
                "beside the known modes no others are proven to be absent but below "
                f"{eigenvalue_in_hz(self.least):,.4g} Hz (Lam), and the band goes up to "
                f"{in_hz(highest):,.4g} Hz"
            )
        a, c, g = self._a(np.array([omega]))
        if not self._gain(a, c, g)[0][0] > 0:
            return "the residuals of the low modes outweigh the stiffness beside them (kappa)"
        return "the round-off of K and M outweighs what is left of K - omega^2 M beside a resonance"

    def residual(self, omega: Floats) -> Floats:
        """(nf,) |r|_2 |r|_F over the envelope: the bound where there are no resonances."""
        omega = np.atleast_1d(np.asarray(omega, dtype=float))
        norm_2, norm_F = self._residual(self._a(omega)[0], omega)
        return np.asarray(norm_2 * norm_F / self.envelope(omega))

    def _a(self, omega: Floats) -> tuple[Complexes, Complexes, Complexes]:
        """a_i (nf, e), c and g (nf,)."""
        omega = np.atleast_1d(np.asarray(omega, dtype=float))
        c, g = self.damping.proportional(1j * omega)
        c, g = (np.broadcast_to(np.asarray(x, dtype=complex), omega.shape) for x in (c, g))
        return c[:, None] * self.values + numerator(omega, slope(self.damping, self.values)), c, g

    def _residual(self, a: Complexes, omega: Floats) -> tuple[Floats, Floats]:
        """(nf,) norms |r|_2 and |r|_F: r = r_0 + sum_i rho_i b_i' (g + i w d_i) / (mu_i a_i), of the first
        ``soft`` less rho_i b_i' c / a_i instead."""
        m = self.b.shape[1]
        factors = numerator(omega, slope(self.damping, self.values)) / (self.values * a)
        factors[:, : self.soft] = -self.damping.proportional(1j * omega)[0][..., None] / a[:, : self.soft]
        T = factors[:, :, None] * self.b
        G00, G01, G11 = self.gram[:m, :m], self.gram[:m, m:], self.gram[m:, m:]
        cross = G01 @ T
        S = G00 + cross + cross.conj().transpose(0, 2, 1) + T.conj().transpose(0, 2, 1) @ (G11 @ T)
        cut = ((self.static_truncation + np.abs(factors) @ (self.truncation[:, None] * np.abs(self.b))) ** 2).sum(
            axis=1
        )
        # Round-off of sums that cancel.
        size = np.abs(np.trace(G00)) + np.einsum("fi,i->f", (np.abs(T) ** 2).sum(axis=2), np.diag(G11))
        cut = cut + 10 * np.finfo(float).eps * size
        values = np.linalg.eigvalsh(S)
        return np.sqrt(np.maximum(values[:, -1], 0) + cut), np.sqrt(np.maximum(values, 0).sum(axis=1) + cut)

    def _gain(self, a: Complexes, c: Complexes, g: Complexes) -> tuple[Floats, Floats]:
        """(nf,) b - kappa at the best angle, and kappa with the sizes of 1 / a_i."""
        m, n_low = self.b.shape[1], self.n_low
        gram, truncation = self.gram[m : m + n_low, m : m + n_low], self.truncation[:n_low] ** 2
        own = np.diag(gram) + truncation
        turn = np.exp(-1j * ANGLES)
        far = c if not self.least > 0 else c + g / self.least
        b = np.minimum((turn[:, None] * c).real, (turn[:, None] * far).real)
        weight = np.maximum((turn[:, None, None] * (c[:, None] ** 2 / a[:, :n_low])).real, 0.0)
        # The trace chooses the angle, the largest eigenvalue counts.
        chosen = np.argmax(b - weight @ own, axis=0)
        every = np.arange(len(c))
        best = b[chosen, every] - _largest(weight[chosen, every], gram, truncation)
        if not self.least > 0:
            best = np.full(len(c), -np.inf)
        return best, _largest(np.abs(c[:, None] ** 2 / a[:, :n_low]), gram, truncation)

    def _unsure(
        self, a: Complexes, c: Complexes, g: Complexes, residual: Floats, kappa: Floats, amplification: Floats
    ) -> Floats:
        """(nf,) what the error of K and M adds; ``residual`` is |r|_F, ``kappa`` that of sizes and
        ``amplification`` one, each over b - kappa."""
        n_low, part = self.n_low, np.abs(g / c)
        beside = slice(min(n_low, len(self.values) - 1), None)
        outside, low = np.zeros(len(c)), np.zeros(len(c))
        own, y = np.zeros(len(c)), self.b / a[:, :, None]
        for S, weight in ((self.unsure_K, np.ones(len(c))), (self.unsure_M, part)):
            outside += weight * (np.diag(S) / self.values)[beside].max(initial=0.0)
            low += weight * _largest(1 / np.abs(a[:, :n_low]), S[:n_low, :n_low], np.zeros(n_low))
            own += weight * np.einsum("fim,fim->f", y.conj(), S @ y).real
        # (t + sqrt(l kappa)) / sqrt(b - kappa).
        mixed = np.sqrt(outside * amplification) + np.sqrt(low * kappa)
        norm = np.abs(c) * (low + mixed**2)
        full = np.sqrt(own) + mixed * residual / np.sqrt(amplification)
        return np.where(norm < 1, np.abs(c) * full**2 / (1 - norm), np.inf)


def _largest(weight: Floats, gram: Floats, truncation: Floats) -> Floats:
    """(nf,) largest eigenvalue of sum_i weight_i rho_i rho_i' for the Gram matrix of rho, and what was cut of them."""
    if not gram.size:
        return np.zeros(len(weight))
    root = np.sqrt(weight)
    return np.asarray(np.linalg.eigvalsh(root[:, :, None] * gram * root[:, None, :])[:, -1] + weight @ truncation)


def ritz_pairs(K: Floats, M: Floats, rigid: Floats) -> tuple[Floats, Floats, Floats]:
    """M-orthonormal rigid motions Z (n, r) in span(``rigid``), and elastic Ritz values (e,) and vectors (n, e), M-
    orthogonal to them: rigid motion is never what an eigensolver leaves of it."""
    r = rigid.shape[1]
    if not r:
        values, Y = sl.eigh(K, M)
        return rigid, values, Y
    G = rigid.T @ M @ rigid
    Z = sl.solve_triangular(sl.cholesky(symmetric(G), lower=True), rigid.T, lower=True).T
    Q = sl.qr(M @ Z)[0][:, r:]
    values, Y = sl.eigh(Q.T @ K @ Q, Q.T @ M @ Q)
    return Z, values, np.asarray(Q @ Y)
