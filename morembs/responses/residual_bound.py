"""How far the Galerkin response of a space is from that of the full model, on every frequency of a band.

With its Ritz values theta_p, vectors u_p, M-orthonormal, b_p = F'u_p and the residuals s_p = K u_p - theta_p M u_p, the
residual of the response sum_p u_p b_p' / a_p is

    r = r_0 + sum_p s_p b_p' (g + i w d_p) / (theta_p a_p),   a_p = c theta_p + g + i w d_p,

r_0 = F - K V (V'K V)^-1 V'F,

and U'r = 0. The Lanczos relation G M V = V T + W E' gives G s_p = -theta_p (I - P) W E'y_p, P the K-orthogonal
projection on V, so that T(w), K^-1 r in an orthonormal basis, is a small rational matrix.

Let k Ritz values lie below lam_c, and a Sturm count find k eigenvalues there. On the K-orthogonal complement of their
vectors K >= lam^ M with (Haynsworth 1968)

    1 / lam^ = 1 / lam_c + sum_{p<=k} (sigma_p^2 / theta_p^3) / (1 / theta_p - 1 / lam_c),   sigma_p = |s_p| in K^-1,

and as U'r = 0 the Schur complement of the others gives, with gamma = 1 / (1 - w^2 / lam^),

    |H - H_ref| <= gamma / (1 - gamma kappa) |T|^2,   kappa = sum_{p<=k} |g + i w d_p|^2 sigma_p^2 / (theta_p^2 |a_p|).

It is quadratic as loads and motions are the same (Rozza, Huynh and Patera 2008). Solutions for the columns v_i of V
have residuals too, G M V = V T + W E' - G R, so that G s_p / theta_p is known but for sum_i |G r_i|_K |Y_ip| (``lost``;
``solves`` has these norms).

With modal damping D acts on the exact modes, and r is not orthogonal to U. ``modal_residual`` has mu(w), and then

    |H - H_ref| <= (gamma t^2 + mu^2) / (1 - gamma kappa - nu),   t = |T| + mu (zeta w / lam_1^(1/2))^(1/2),

nu = sum_{p<=k} w d_p sigma_p^2 / (2 theta_p |a_p|), w d_p beside |g + i w d_p| in kappa, and by the same Haynsworth
1 / lam_1 <= max(1 / theta_1, 1 / lam^) + (sum_{p<=k} sigma_p^2 / theta_p^3)^(1/2).

Assumed are the count of modes below lam_c, U'M U = I and U'K U = Theta up to the round-off that ``rounding`` counts,
and K Z = 0 for the rigid motions Z.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from morembs.base.types import Complexes, Floats
from morembs.problem.damping import Damping
from morembs.responses.cells import Bounds, branch_and_bound, initial_partition
from morembs.responses.modal_residual import form, largest
from morembs.responses.rational import POINTS, PoleResidueForm, cell_points, on_grid, squares
from morembs.responses.tolerances import TOL

TINY = np.finfo(float).tiny


@dataclass(frozen=True, kw_only=True, eq=False)
class Residual:
    """What a space with Ritz ``values`` (n,) and loads ``b`` (n, m) leaves of the response: coordinates ``tau`` (q, n)
    of G s_p / theta_p, known but for ``lost`` (n,), and ``start``, |r_0| in K^-1. The first ``k`` values lie below
    ``cut``, and no more modes."""

    values: Floats
    b: Floats
    tau: Floats
    lost: Floats
    start: float
    k: int
    cut: float
    damping: Damping

    @cached_property
    def poles(self) -> PoleResidueForm:
        """The envelope as far as its residues go."""
        stiffness, d = self.values * (1 + 1j * self.damping.structural), self.damping.of_modes(self.values)
        return PoleResidueForm.second_order(stiffness, d, (self.b**2).sum(axis=1, keepdims=True))

    @cached_property
    def slope(self) -> Floats:
        """Damping d_p (n,) without what comes with the stiffness."""
        return slope(self.damping, self.values)

    @cached_property
    def own(self) -> Floats:
        """(n,) of (sigma_p / theta_p)^2."""
        return np.asarray((np.linalg.norm(self.tau, axis=0) + self.lost) ** 2)

    @cached_property
    def softest(self) -> float:
        """Lower limit of the lowest elastic eigenvalue."""
        values = self.values[: self.k]
        coupled = float(np.sqrt((self.own[: self.k] / values).sum()))
        return 1.0 / (1.0 / min(self.least, float(values.min(initial=np.inf))) + coupled)

    @cached_property
    def ratio(self) -> float:
        """Largest ratio of modal damping."""
        return max(ratio for _, ratio in self.damping.steps)

    def _above(self, band: tuple[float, float]) -> float:
        """mu over the root of the frequency, of the modes above the cut."""
        if not self.ratio:
            return 0.0
        above = slice(self.k, None)
        poles, b, values = (
            PoleResidueForm(z=self.poles.z[above], N=self.poles.N[above]),
            self.b[above],
            self.values[above],
        )
        # values are sigma_p^2, and their power is sigma_p^3.
        lost = np.sqrt(self.ratio * values**1.5) * self.lost[above] * np.linalg.norm(b, axis=1)
        least = Residual._away(poles.z, *(np.array([end]) for end in band))[0]
        return largest(poles, b, form(values, self.tau[:, above], self.ratio), band) + float((lost / least).sum())

    @cached_property
    def least(self) -> float:
        """lam^, below which the complement has nothing."""
        values, own = self.values[: self.k], self.own[: self.k]
        share = 1.0 / np.where(values < self.cut, 1.0 / values - 1.0 / self.cut, 1.0)
        return 1.0 / (1.0 / self.cut + float((own / values * share).sum()))

    def bounds(self, band: tuple[float, float], tolerance: float) -> tuple[Floats, Floats]:
        """Edges (nc + 1,) of cells in rad/s, and limits (nc,) of the error over the envelope on them, to begin with
        below ``tolerance``."""
        low, high = band
        poles, slope, k = self.poles, self.slope, self.k
        if not poles.z.imag.any() and ((poles.z.real >= low) & (poles.z.real <= high)).any():
            return np.array(band), np.array([np.inf])
        size, own, numerator_limit = -poles.N[:, 0], self.own, high**2 + high * slope
        # Modes that are as good as exact count one by one: their share in T^2 over their own part of the envelope.
        each = own * numerator_limit**2 / self._weakest(np.array([low]), np.array([high]))[0]
        order = [p for p in np.argsort(each) if p < k]
        fits = [
            p
            for n, p in enumerate(order)
            if 2 * (n + 1) * each[order[: n + 1]].sum() <= TOL.single_modes_part * tolerance
        ]
        others = np.ones(len(size), dtype=bool)
        others[fits] = False
        hidden, modal, above = (self.lost * np.sqrt(size) * numerator_limit)[others], self._modal(), self._above(band)
        coupled = numerator_limit[:k] + (high * slope[:k] if self.ratio else 0.0)
        single_modes, double = float(2 * len(fits) * each[fits].sum()), 2.0 if fits else 1.0
        rows = (self.tau.T[others, :, None] * self.b[others, None, :]).reshape(-1, len(self.tau) * self.b.shape[1])
        T, norms = PoleResidueForm(z=poles.z[others], N=rows), np.linalg.norm(rows, axis=1)[:, None]

        def bounds(lo: Floats, hi: Floats) -> Bounds:
            w = cell_points(lo, hi, POINTS)
            p = on_grid((T.inverse(w) * numerator(w, slope[others])) @ rows)
            here = np.sqrt(squares(p).sum(axis=2))
            spread = np.sqrt(squares(p - p[:, TOL.segments // 2, None]).sum(axis=2)).max(axis=1)
            middle, half = 0.5 * (lo + hi), 0.5 * (hi - lo)
            outside = T.remainder(middle, half, norms, slope[others])[:, 0]
            weakest = self._weakest(lo, hi)
            mu = np.sqrt(hi) * ((modal * np.sqrt(size[:k]) / weakest[:, :k]).sum(axis=1) + above)
            damped = mu * np.sqrt(self.ratio * hi / np.sqrt(self.softest))
            residual_norm = here.max(axis=1) + TOL.bulge * spread + outside + self.start + damped
            residual_norm += (hidden / weakest[:, others]).sum(axis=1)
            ends = np.maximum(*(np.abs(end[:, None, None] - poles.z) for end in (lo, hi))).prod(axis=2)
            kappa = ((coupled**2 * own[:k]) / weakest[:, :k]).sum(axis=1)
            nu = hi * (modal**2 / weakest[:, :k]).sum(axis=1)
            with np.errstate(over="ignore"):
                gamma = 1.0 / np.maximum(1.0 - hi**2 / self.least, TINY)
                left = 1 - gamma * kappa - nu
                gain = np.where(left > 0, gamma / np.maximum(left, TOL.closest_mode), np.inf)
            error = gain * ((double * residual_norm**2 + mu**2) / (1.0 / ends @ size) + single_modes)
            fine = half < TOL.final_cell * T.nearest(middle)
            return Bounds(upper=error[:, None], lower=np.zeros((len(lo), 1)), at=middle[:, None], final=fine[:, None])

        cells = branch_and_bound(
            bounds,
            lambda lo, hi: 0.5 * (hi - lo) < TOL.resolved_cell * T.nearest(0.5 * (lo + hi)),
            initial_partition(low, high, T.z.real.ravel()),
            lambda bounds, _: bounds.upper <= tolerance,
            quantities=1,
            entries_per_cell=4 * TOL.segments * rows.shape[1] + 20 * len(size),
        )
        return np.append(cells.edges[:, 0], high), cells.upper[:, 0]

    def _modal(self) -> Floats:
        """(k,) roots of w d_p sigma_p^2 / (2 theta_p w)."""
        k = self.k
        # values are sigma_p^2, and their power is sigma_p^3.
        return np.sqrt(self.ratio * self.values[:k] ** 1.5 * self.own[:k])

    def _weakest(self, lo: Floats, hi: Floats) -> Floats:
        """(nc, n) least |a_p| on cells."""
        return self._away(self.poles.z, lo, hi)

    @staticmethod
    def _away(z: Complexes, lo: Floats, hi: Floats) -> Floats:
        away = np.maximum(np.abs(0.5 * (lo + hi)[:, None, None] - z.real) - 0.5 * (hi - lo)[:, None, None], 0.0)
        return np.asarray(np.hypot(away, z.imag).prod(axis=2))


def slope(damping: Damping, values: Floats) -> Floats:
    """Damping d_p (n,) of modes with ``values`` (n,), without what comes with the stiffness."""
    return np.asarray(damping.of_modes(values) - damping.beta * values)


def numerator(w: Floats, slope: Floats) -> Complexes:
    """g + i w d_p (..., n) at ``w`` (...)."""
    return np.asarray(1j * w[..., None] * slope - w[..., None] ** 2)
