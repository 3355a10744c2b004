r"""How far the response of one global basis is from that of the full model, at any p of a box, without a factorisation.

K(p) = sum_q a_q(p) K_q and M(p) = sum_j b_j(p) M_j with K(p) >= 0 and M(p) > 0, H = B' A^-1 B with A = c K(p) + g M(p).
Let (mu_i, v_i) be the Ritz pairs of the basis V at p, M(p)-orthonormal, rigid motions R(p) among them,
rho_i = K v_i - mu_i M v_i, V_L those with mu_i below some limit, a_i = c mu_i + g, and r the residual B - A V y of the
Galerkin response, so that V'r = 0. |.| is the norm of K(p) for motions and its dual for loads that are free of
rigid-body loads.

**The error.** Write A^-1 r = V_L z + w with V_L' M w = 0. As v_i' A w = c rho_i' w and V_L' A e = 0,

    w^H A w - c^2 sum_L |rho_i' w|^2 / a_i = w^H r,    H - H_r = r'w.

Multiplied with any exp(-i psi), the real part of the left side is at least (b - kappa) |w|^2 with

    b = min over 0 <= m <= 1 / Lam of Re exp(-i psi) (c + g m),
    kappa = lambda_max(sum_L max(0, Re exp(-i psi) c^2 / a_i) rho_i rho_i') in the dual norm,

if K >= Lam M on {V_L' M w = 0}. Hence |H - H_r|_F <= |r|_2 |r|_F / (b - kappa). With damping the angle psi takes most
of a resonance out of kappa: 1 / a_i turns through the lower half-plane there. Where b <= kappa there is no bound: it
is infinite, and said to be.

**The dual norm.** Six dofs S are held that determine rigid motion at every p. For loads free of rigid motion the dual
norm is that of K_SS(p)^-1, and K_SS(p) >= alpha(p) K_SS(p_a) gives |r|^2 <= |r|_a^2 / alpha. In a morph alpha is
that of a cell, times the least ratio of the factors of moduli (min-theta).
Where springs alone hold the body beside a morph, the rigid motions R(p) of other values strain the elements of p_a, and
alpha is small. K_SS is that of the elements E then: as V has all R(p), R'r = 0, so that r'w = r'(w - R y) with y from
w_S, and |w - R y| in E_SS(p) is at most |w| in E(p) and in K(p). X below leaves R'(W - M V_L X) = 0.

**Lam.** Let F be columns in span(V), W = M(p_a) F, and K_soft - Lam^ M_heavy + sigma W W' >= 0 for the softest and
heaviest values on a cell. K grows with each modulus, M with each density, so with the least ratio s_K of stiffness
factors to the softest and the largest one s_M of mass factors to the heaviest, K(p) >= s_K Lam^ / s_M M(p) - s_K sigma
W W'. For w with V_L' M w = 0 and any X, W'w = (W - M V_L X)'w, so

    |W'w|^2 <= d |w|^2,  d = lambda_max of W - M V_L X in the dual norm,  Lam(p) = (s_K Lam^ / s_M) / (1 + s_K sigma d).

No mode at p is needed, no count of them, and F need not be of modes.

**Round-off, and a geometry that is interpolated.** The model is known to E = c E_K + g E_M only, with |x'E_K x| <=
x'S x for S from sums of magnitudes (``GlobalSpace``: entries, products and projections), to which a morph adds
eps / (1 - eps) K; that of g / c E_M joins it. With s(x)^2 = x'S x and x = V y + A^-1 r the response,

    |H - H_exact|_F <= |c| s(x)^2 / (1 - |c| G),    s(x) <= s(V y) + (t + sqrt(l kappa)) |r|_F / (b - kappa),
    G = l + (t + sqrt(l kappa))^2 / (b - kappa),    l = lambda_max(|a|^-1/2 V_L'S V_L |a|^-1/2),

kappa of sizes, and t the largest s(w) / |w|. Of t, which enters in second order, the columns beside V_L tell: motions
outside of V are stiffer, and round-off is a smaller part of their energy.

All residuals are held in orthonormal coordinates of the norm of K_SS(p_a)^-1 (Casenave, Ern and Lelievre 2014); what
was cut of them is added by its norm. Sources: the Galerkin identity and min-theta of Rozza, Huynh and Patera (2008),
the deflated residual of ``morembs.responses.residual_bound``; the inequality for Lam is derived here.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from morembs.base.types import Floats
from morembs.parametric.law import LINEAR, SQUARE, Law
from morembs.parametric.proof import BoxCells, proof_of
from morembs.parametric.tolerances import TOL
from morembs.storage.lemma import Lemma
from morembs.storage.table import dataset, table_of

if TYPE_CHECKING:
    from morembs.parametric.bound_at import BoundAt
    from morembs.problem.damping import Damping


@dataclass(frozen=True, kw_only=True, eq=False)
class ParametricBound:
    """All that the bound needs, for a basis of n columns, m loads, Q and J terms of K and M, P parameters.

    ``residual_B`` (q, m), ``residual_K`` (Q, q, n), ``residual_M`` (J, q, n), ``residual_F`` (q, k) are coordinates of
    the scaled loads, of K_q V, M_j V and W = M(p_a) F in the norm of K_SS(p_a)^-1, ``rest_B`` (m,), ``rest_K`` (Q, n),
    ``rest_M`` (J, n), ``rest_F`` (k,) norms of the parts outside these coordinates; ``motion_F`` (n, k) is V'W and
    ``sigma`` its weight in (rad/s)2. ``anchor``, ``soft`` (P,) values of the parameters. ``highest`` upper end of the
    band in rad/s. ``eps`` relative error of K(p) as a quadratic form (a geometry that is interpolated), else 0.
    ``rounding_K`` (Q, n, n), ``rounding_M`` (J, n, n) limit what round-off makes of the quadratic forms of the terms;
    None where it is not known. ``rigid`` (n, 6, 1 + morphs): motions that springs alone hold, where these are not in
    K_SS; else None.
    """

    law_K: Law
    law_M: Law
    anchor: Floats = dataset("real", "P", "parameter values whose supported stiffness defines the norm of loads")
    soft: Floats = dataset("real", "P", "parameter values at which the body is softest and heaviest")
    cells: BoxCells = dataset(table_of(BoxCells), doc="cells of the box, and the bounds of each cell")
    residual_B: Floats = dataset("later", "q m", "coordinates of the loads in the dual norm")
    residual_K: Floats = dataset("later", "Q q n", "coordinates of the terms of the stiffness times the basis")
    residual_M: Floats = dataset("later", "J q n", "coordinates of the terms of the mass times the basis")
    residual_F: Floats = dataset("later", "q k", "coordinates of the mass times the deflated motions")
    rest_B: Floats = dataset("later", "m", "norms of the remainders of the loads")
    rest_K: Floats = dataset("later", "Q n", "norms of the remainders of the terms of the stiffness")
    rest_M: Floats = dataset("later", "J n", "norms of the remainders of the terms of the mass")
    rest_F: Floats = dataset("later", "k", "norms of the remainders of the deflated motions")
    motion_F: Floats = dataset("later", "n k", "the deflated motions in reduced coordinates")
    sigma: float = dataset("real", "", "weight of the deflated motions", "1/s2")
    highest: float = dataset("real", "", "upper end of the band", "rad/s")
    eps: float = dataset("real", "", "relative error of the stiffness of a morph, in every quadratic form", default=0.0)
    rounding_K: Floats | None = dataset(
        "later", "Q n n", "limits of round-off in quadratic forms of the terms of K", default=None, since="0.2"
    )
    rounding_M: Floats | None = dataset("later", "J n n", "the same of the terms of M", default=None, since="0.2")
    rigid: Floats | None = dataset(
        "later",
        "n 6 f",
        "rigid motions, constant and per morph",
        default=None,
        when="where springs alone hold a body with a morph, and the norm of loads omits these springs",
    )

    def in_basis(self, T: Floats) -> ParametricBound:
        """The bound for the basis V ``T`` (n, k), whose span may be smaller."""
        parts = {name: getattr(self, name) for name in self.__dataclass_fields__}
        size = np.abs(T)
        parts.update(
            residual_K=self.residual_K @ T,
            residual_M=self.residual_M @ T,
            rest_K=self.rest_K @ size,
            rest_M=self.rest_M @ size,
            motion_F=T.T @ self.motion_F,
            rounding_K=None if self.rounding_K is None else T.T @ self.rounding_K @ T,
            rounding_M=None if self.rounding_M is None else T.T @ self.rounding_M @ T,
            rigid=None if self.rigid is None else np.einsum("nk,nrs->krs", T, self.rigid),
        )
        return ParametricBound(**parts)

    def compress(self, cut: float = TOL.compression_loss) -> ParametricBound:
        """The same with fewer coordinates: directions along which every column has less than about ``cut`` of its own
        energy are left out, and count by norms."""
        import scipy.linalg as sl

        energy = np.linalg.norm(np.tensordot(self.law_K(self.anchor), self.residual_K, 1), axis=0)
        energy = np.maximum(energy, energy[energy > TOL.rigid_energy * energy.max(initial=0.0)].min(initial=np.inf))
        size = np.linalg.norm(self.residual_B, axis=0)
        ones, reference = (
            np.ones_like(self.anchor),
            np.where(self.anchor == 0, self.cells.high.max(axis=0), self.anchor),
        )
        parts = (
            (self.residual_B[None], np.ones(1), 1 / np.where(size > 0, size, 1.0)),
            (self.residual_K, ratio(self.law_K, reference, ones), 1 / energy),
            (self.residual_M, ratio(self.law_M, reference, ones), energy),
        )
        weighted = np.hstack([np.hstack([*(a[:, None, None] * terms * weight)]) for terms, a, weight in parts])
        U, values, _ = sl.svd(weighted, full_matrices=False)
        keep = int((values > cut).sum())
        new = {name: getattr(self, name) for name in self.__dataclass_fields__}
        for name in ("B", "K", "M", "F"):
            C, norms = getattr(self, f"residual_{name}"), getattr(self, f"rest_{name}")
            new[f"residual_{name}"] = U[:, :keep].T @ C
            new[f"rest_{name}"] = np.hypot(norms, np.linalg.norm(U[:, keep:].T @ C, axis=-2))
        return ParametricBound(**new)

    @cached_property
    def _flat(self) -> tuple[Floats, Floats]:
        """Coordinates of the terms as rows, for one product each."""
        K, M = (np.ascontiguousarray(A.reshape(len(A), -1)) for A in (self.residual_K, self.residual_M))
        return K, M

    def at(self, p: Floats, *, K: Floats, M: Floats, B: Floats, rigid: Floats, damping: Damping) -> BoundAt:
        """What the bound needs at ``p`` (P,): ``K``, ``M`` (n, n) and scaled ``B`` (n, m) of the reduced model there,
        its ``rigid`` motions (n, r) and ``damping``."""
        # Not at the top: files are shown without what evaluates them.
        from morembs.parametric.bound_at import BoundAt, ritz_pairs

        theta_K, theta_M = self.law_K(p), self.law_M(p)
        shape = self.residual_K.shape[1:]
        KV, MV = ((theta @ flat).reshape(shape) for theta, flat in zip((theta_K, theta_M), self._flat, strict=True))
        eK, eM = np.abs(theta_K) @ self.rest_K, np.abs(theta_M) @ self.rest_M
        Z, values, Y = ritz_pairs(K, M, rigid)
        KY, MY, MZ = KV @ Y, MV @ Y, MV @ Z
        b, b_rigid, size = Y.T @ B, Z.T @ B, np.abs(Y)
        rho = KY - MY * values
        truncation = eK @ size + (eM @ size) * values
        # Beside the band motions on soft springs are inertia, K v = mu M v + rho: rho over mu would be round-off.
        soft = 0 if self.rigid is None else int((values[:6] < (TOL.soft_spring * self.highest) ** 2).sum())
        static = np.where(np.arange(len(values))[:, None] < soft, 0.0, b / values[:, None])
        start = self.residual_B - KY @ static - MY[:, :soft] @ b[:soft] - MZ @ b_rigid
        static_truncation = self.rest_B + (eK @ size) @ np.abs(static) + (eM @ np.abs(Z)) @ np.abs(b_rigid)
        static_truncation += (eM @ size)[:soft] @ np.abs(b[:soft])
        alpha_cell, least, _ = self.cells.at(p)
        unsure_K, unsure_M = _form(theta_K, self.rounding_K, Y), _form(theta_M, self.rounding_M, Y)
        alpha = alpha_cell * ratio(self.law_K.monotone, p, self.anchor).min()
        # Without alpha there is no bound; residuals still tell where it is missed most.
        part = alpha if alpha > 0 else 1.0
        gram = np.hstack([start, rho])
        gram = gram.T @ gram / part
        s_K, s_M = ratio(self.law_K.monotone, p, self.soft).min(), ratio(self.law_M.monotone, p, self.soft).max()
        n_low, below, loads = 0, 0.0, self._rigid_loads(p, M)
        # More of them where so few leave no bound at the upper end of the band.
        for far in TOL.shift_ladder if alpha > 0 else TOL.shift_ladder[:1]:
            count = self._low_count(values, np.diag(gram)[len(gram) - len(values) :], far)
            d = self._measure_missed(MZ, MY[:, :count], Z, Y[:, :count], eM, loads) / alpha if alpha > 0 else np.inf
            found = float(s_K / s_M * least / (1 + s_K * self.sigma * d))
            if found > below or far == TOL.shift_ladder[0]:
                n_low, below = count, found
            if below > TOL.least_gap * self.highest**2:
                break
        # Products with K leave round-off in the residuals, too.
        own = np.sqrt(np.maximum(np.diag(unsure_K), 0.0))
        own *= (own / np.sqrt(values))[min(n_low, len(values) - 1) :].max(initial=0.0)
        truncation, static_truncation = (
            truncation / np.sqrt(part) + own,
            static_truncation / np.sqrt(part) + own @ np.abs(static),
        )
        return BoundAt(
            values=values,
            b=b,
            gram=gram,
            truncation=truncation,
            static_truncation=static_truncation,
            n_low=n_low,
            least=below,
            damping=damping,
            soft=soft,
            unsure_K=unsure_K + self.eps / (1 - self.eps) * np.diag(values),
            unsure_M=unsure_M,
            proof=self.proof(damping, p),
        )

    def proof(self, damping: Damping, p: Floats | None = None) -> tuple[Lemma, ...]:
        """The lemmas that the bound of a model with ``damping`` rests on: at the values ``p`` (P,), or at all."""
        return proof_of(
            self.cells,
            damping,
            p,
            residual=self.residual_K.shape,
            highest=self.highest,
            eps=self.eps,
            rounding=self.rounding_K is not None,
        )

    def _low_count(self, values: Floats, own: Floats, far: float) -> int:
        """How many Ritz vectors are V_L, whose residuals have the squares ``own`` (e,) of norms, up to ``far`` times
        the upper frequency: more of them make d smaller and kappa larger."""
        low = int((values < (TOL.low_modes_up_to * self.highest) ** 2).sum())
        end = int((values < (far * self.highest) ** 2).sum())
        return low + int((np.cumsum(own[low:end] / (values[low:end] - self.highest**2)) <= TOL.truncation_share).sum())

    def _rigid_loads(self, p: Floats, M: Floats) -> tuple[Floats, Floats] | None:
        """R' M (6, n) and R' W (6, k) of orthonormal motions R that springs alone hold at ``p``."""
        if self.rigid is None:
            return None
        import scipy.linalg as sl

        morphs = np.array([len(points) > 0 for points in self.law_K.points])
        R = self.rigid @ np.concatenate([[1.0], p[morphs]])
        L = sl.cholesky(R.T @ M @ R, lower=True)
        return sl.solve_triangular(L, R.T @ M, lower=True), sl.solve_triangular(L, R.T @ self.motion_F, lower=True)

    def _measure_missed(
        self, MZ: Floats, MY: Floats, Z: Floats, Y: Floats, eM: Floats, loads: tuple[Floats, Floats] | None
    ) -> float:
        """d at the anchor: what the rigid motions ``Z`` and the Ritz vectors ``Y`` of V_L miss of W, free of the
        rigid ``loads``."""
        import scipy.linalg as sl

        rigid = Z.T @ self.motion_F
        remainder, n_low = self.residual_F - MZ @ rigid, MY.shape[1]
        X, null_space = np.zeros((n_low, remainder.shape[1])), np.eye(n_low)
        if loads is not None:
            C, wanted = loads[0] @ Y, loads[1]
            if np.linalg.matrix_rank(C, tol=TOL.spring_hold) < len(C):
                return np.inf
            X, null_space = np.asarray(np.linalg.pinv(C) @ wanted), np.asarray(sl.null_space(C))
        if null_space.shape[1]:
            X = X + null_space @ sl.lstsq(MY @ null_space, remainder - MY @ X, lapack_driver="gelsy")[0]
        truncation = self.rest_F + (eM @ np.abs(Z)) @ np.abs(rigid) + (eM @ np.abs(Y)) @ np.abs(X)
        return float(np.linalg.norm(remainder - MY @ X, 2) ** 2 + (truncation**2).sum())


def _form(theta: Floats, terms: Floats | None, Y: Floats) -> Floats:
    """(e, e) of Y' sum_q |theta_q| terms_q Y, zero without ``terms``."""
    if terms is None:
        return np.zeros((Y.shape[1],) * 2)
    return np.asarray(Y.T @ np.tensordot(np.abs(theta), terms, 1) @ Y)


def ratio(law: Law, p: Floats, reference: Floats) -> Floats:
    """(Q,) by how much the factors of moduli, densities, springs and preloads differ from those at ``reference``."""
    powers = np.select([law.factors == LINEAR, law.factors == SQUARE], [1.0, 2.0], 0.0)
    used = (powers > 0).any(axis=0)
    if not used.any():
        return np.ones(len(law.factors))
    return np.asarray(np.prod((p[used] / reference[used]) ** powers[:, used], axis=1))
