"""A reference model whose error is known: bounds of |H - H_ref| on every frequency of a band.

The reference is the Galerkin projection on V, a block Krylov space of the flexibility G started at the loads, and the
modes below lam_c that no load excites. With its Ritz values theta_p, vectors u_p, M-orthonormal, b_p = F'u_p and the
residuals s_p = K u_p - theta_p M u_p, the residual of the response sum_p u_p b_p' / a_p is

    r = r_0 + sum_p s_p b_p' (g + i w d_p) / (theta_p a_p),   a_p = c theta_p + g + i w d_p,

r_0 = F - K V (V'K V)^-1 V'F,

and U'r = 0. The Lanczos relation G M V = V T + W E' gives G s_p = -theta_p (I - P) W E'y_p, P the K-orthogonal
projection on V, so that T(w), K^-1 r in an orthonormal basis, is a small rational matrix.

Let k Ritz values lie below lam_c, and a Sturm count find k eigenvalues there. On the K-orthogonal complement of their
vectors K >= lam^ M with (Haynsworth 1968)

    1 / lam^ = 1 / lam_c + sum_{p<=k} (sigma_p^2 / theta_p^3) / (1 / theta_p - 1 / lam_c),   sigma_p = |s_p| in K^-1,

and as U'r = 0 the Schur complement of the others gives, with gamma = 1 / (1 - w^2 / lam^),

    |H - H_ref| <= gamma / (1 - gamma kappa) |T|^2,   kappa = sum_{p<=k} |g + i w d_p|^2 sigma_p^2 / (theta_p^2 |a_p|).

It is quadratic as loads and motions are the same (Rozza, Huynh and Patera 2008), and assumes nothing of the accuracy
of modes or solver. Modal damping acts on the modes of the reference: D = M U diag(d) U'M.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.errors import InputError, SolverError
from morembs.linalg.columns import dot, m_norms, multiply, multiply_into, subtract
from morembs.linalg.eigen import GAP, Modes
from morembs.problem import Problem
from morembs.problem.damping import Damping
from morembs.progress import SILENT, Progress
from morembs.responses.band import beyond, checked_band
from morembs.responses.cells import Bounds, first_edges, search
from morembs.responses.krylov_space import KrylovSpace, root, static_response, symmetric
from morembs.responses.layout import Layout
from morembs.responses.measures import Standard
from morembs.responses.pencils import response_of
from morembs.responses.rational import BULGE, POINTS, SEGMENTS, Terms, cell_points, on_grid, squares
from morembs.responses.reference import ReferenceSpace, reference_model, reference_space
from morembs.responses.rounding import EPS, Rounding, with_left

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
# Error of the reference, as part of the envelope of the response.
TOLERANCE = 1e-9
# Ratio of critical damping that is given to the stiffness of models without any.
FLOOR = 0.01
# Part of the tolerance to which the reference grows with modal damping.
MODAL = 1e-3
# Frequencies at which a growing space is looked at.
LOOKED_AT = 24
# A model with a damping matrix of its own is known to this.
DAMPED = 1e-8
CLOSE = 1e-12
# Backward error of a small eigenproblem, in eps of its highest eigenvalue, over 1 - (1 / 1.25)^2.
SMALL = 10.0


def floor_of(problem: Problem, band_hz: Sequence[float], given: float | None = None) -> float:
    """The ratio of critical damping that is assumed in a model and its bodies: ``given``, or what models need that
    have no damping at some frequencies of the band.

    Raises:
        InputError: not a ratio.
    """
    if given is not None:
        return checked_floor(given)
    damping, (low, high) = problem.damping, (2 * np.pi * f for f in band_hz)
    if damping.is_rayleigh or damping.structural or problem.D is not None:
        return 0.0
    jumps = damping.jumps
    return 0.0 if damping.ratio(np.append(jumps[(jumps > low) & (jumps < high)], low)).all() else FLOOR


def checked_floor(given: float) -> float:
    """``given`` if it is a ratio of critical damping.

    Raises:
        InputError: it is not.
    """
    if not 0 <= given < 1:
        raise InputError(
            f"damping_floor = {given} was given; expected a part of critical damping from 0 to below 1, such as 0.01"
        )
    return float(given)


@dataclass(frozen=True, kw_only=True, eq=False)
class CertifiedReference:
    """Elastic part of the full model over ``band_hz``, forces and moments scaled by the radius of gyration.

    ``values`` (n,) in (rad/s)2 and ``b`` (n, m) of its modes, whose stiffness is uncertain by ``unsure`` (n,), and
    with couplings of the square root of its products, and whose b is by ``b_off`` (n, m);
    ``damping`` and ``D`` (n, n), if any, as in ``Reference``, with the ``floor``. ``vectors`` (Nc, k) and ``sigma``
    (k,) are those of the modes below ``cut``, all of which are there; ``edges`` (nc + 1,) in rad/s and ``off`` (nc,)
    limits of |H - H_ref| over the envelope. ``proven`` is False where ``off`` is an estimate.
    """

    problem: Problem
    band_hz: tuple[float, float]
    damping: Damping
    floor: float
    values: Floats
    b: Floats
    D: Floats | None
    unsure: Floats
    b_off: Floats
    vectors: Floats
    sigma: Floats
    cut: float
    edges: Floats
    off: Floats
    proven: bool

    def standard(self, symmetric: bool = True) -> Standard:
        """What bodies, ``symmetric`` or not, are measured against."""
        layout = Layout(self.b.shape[1], list(self.problem.coupling.columns.values()), symmetric)
        stiffness, d = self.values * (1 + 1j * self.damping.structural), self.damping.of_modes(self.values)
        if self.D is not None:
            d = d + np.diag(self.D)
        modes = Terms.second_order(stiffness, d, layout.rows(self.b, self.b))
        H = modes
        if self.D is not None:
            H = response_of(
                np.eye(len(self.values)), self.D + np.diag(self.damping.of_modes(self.values)), np.diag(self.values),
                self.b, self.b.T, layout, structural=self.damping.structural, highest=2 * np.pi * self.band_hz[1],
            ).terms  # fmt: skip
        highest = abs(1 + 1j * (self.damping.structural + self.damping.beta * 2 * np.pi * self.band_hz[1]))
        lost = np.sqrt(highest * self.unsure)
        rounding = Rounding.of(layout, self.b, self.b, lost, lost, self.b_off, self.b_off)
        # What the small eigenproblem leaves of the couplings between modes above the cut.
        floor = SMALL * EPS * float(self.values.max(initial=0.0)) / self.cut
        return Standard(
            H=H, modes=modes, sizes=layout.sizes(self.b), rounding=rounding, layout=layout, floor=floor,
            edges=self.edges, off=self.off,
        )  # fmt: skip

    def H(self, omega: Floats) -> Complexes:
        """(nf, m, m) scaled response at ``omega`` (nf,) in rad/s."""
        standard = self.standard(symmetric=False)
        return standard.H.at(np.asarray(omega, dtype=float)).reshape(len(omega), *self.b.shape[1:] * 2)

    def uncertainty(self, omega: Floats) -> Floats:
        """(nf,) limits of |H - H_ref| at ``omega`` (nf,) of the band, round-off included, in m/N."""
        return self._lost(omega)[0]

    def lost(self) -> tuple[float, float]:
        """What is not known of the response at the resonances of the band, as part of its envelope, at most, and the
        frequency in Hz where that is."""
        low, high = (2 * np.pi * f for f in self.band_hz)
        inside = _inside(np.sqrt(self.values), (low, high))
        omega = np.concatenate([[low, high], inside])
        off, e = self._lost(omega)
        part = off / e
        return float(part.max()), float(omega[part.argmax()] / (2 * np.pi))

    def _lost(self, omega: Floats) -> tuple[Floats, Floats]:
        """``uncertainty`` and envelope (nf,) at ``omega`` (nf,)."""
        standard = self.standard()
        size = standard.modes.moduli(omega)[0]
        e = size @ standard.sizes[:, 0]
        off = standard.rounding.at(size).size()[:, 0]
        return np.asarray(off + (standard.uncertain(omega, omega) + standard.floor) * e), e

    @property
    def undamped(self) -> bool:
        """Whether resonances are infinite."""
        return self.D is None and not (self.damping.is_viscous or self.damping.structural)


def certified_reference(
    problem: Problem, band_hz: Sequence[float], *, tolerance: float = TOLERANCE, damping_floor: float | None = None,
    inertia_loads: bool = False, progress: Progress = SILENT,
) -> CertifiedReference:  # fmt: skip
    """Reference whose error is below ``tolerance`` times the envelope of the response on all of ``band_hz``, or as
    small as the space of the loads allows; kept for later calls.

    ``damping_floor`` is a ratio of critical damping: the stiffness gets 2 i ``damping_floor`` of itself beside the
    damping there is; by default 0.01 without any, otherwise 0. ``inertia_loads`` follows those in the space too.
    Peak memory: as ``reference_model``, and its modes below 1.25 times the upper frequency.

    Raises:
        InputError: no interfaces, not a band or a ratio, or modal damping beside a damping matrix of the model.
        SolverError: the count of modes contradicts the reference, or it does not become good enough.
    """
    low, high = checked_band(band_hz)
    floor = floor_of(problem, (low, high), damping_floor)
    if not problem.B.shape[1]:
        raise InputError("a frequency response needs interfaces; add at least one [[interface]]")
    found: dict[object, tuple[float, CertifiedReference]] = problem.shared("certified references", dict)
    key = low, high, floor
    if key not in found or found[key][0] > tolerance:
        damping = replace(problem.damping, structural=problem.damping.structural + 2 * floor)
        build = _Build(problem, (low, high), damping, floor, tolerance, inertia_loads, progress)
        found[key] = tolerance, build.with_own_damping() if problem.D is not None else build.grown()
    return found[key][1]


class _Build:
    """Makes a certified reference from the Krylov space of the loads."""

    def __init__(
        self, problem: Problem, band_hz: tuple[float, float], damping: Damping, floor: float, tolerance: float,
        inertia: bool, progress: Progress,
    ) -> None:  # fmt: skip
        self.problem, self.band_hz, self.damping, self.floor = problem, band_hz, damping, floor
        self.tolerance, self.inertia, self.progress = tolerance, inertia, progress
        self.band = 2 * np.pi * band_hz[0], 2 * np.pi * band_hz[1]
        self.modes = problem.elastic_modes(below=beyond(band_hz[1]))
        self.cut = beyond(band_hz[1]) * (1 + GAP)

    def with_own_damping(self) -> CertifiedReference:
        """The space of a damping matrix of the model's own, whose error is an estimate."""
        problem, omega = self.problem, np.linspace(*self.band, LOOKED_AT)
        omega = np.unique(np.concatenate([omega, _inside(np.sqrt(self.modes.eigenvalues), self.band)]))
        made = reference_model(problem, omega, tolerance=DAMPED, progress=self.progress)
        D = np.zeros((len(made.values), len(made.values))) if made.D is None else made.D
        below = made.values < self.cut
        return CertifiedReference(
            problem=problem, band_hz=self.band_hz, damping=self.damping, floor=self.floor, values=made.values,
            b=(made.B.T * problem.motion_scale[:, None]).T, D=D - np.diag(problem.damping.of_modes(made.values)),
            unsure=np.concatenate([problem.uncertainty(self.modes), made.values[below.sum() :] * EPS])[: len(below)],
            b_off=np.zeros((len(made.values), problem.B.shape[1])),
            vectors=self.modes.vectors, sigma=np.zeros(len(self.modes.eigenvalues)), cut=self.cut,
            edges=np.array(self.band), off=np.array([max(made.error, DAMPED)]), proven=False,
        )  # fmt: skip

    def grown(self) -> CertifiedReference:
        """The space, grown until the error is below the tolerance."""
        growth = reference_space(self.problem, self.inertia)
        # Modal damping acts on the computed modes: they are closer to the true ones than the response asks for.
        enough = 0.1 * self.tolerance * (MODAL if self.damping.is_modal else 1.0)
        while True:
            error = self._guess(growth)
            self.progress.update(f"reference: order {growth.lanczos.size}, error {error:.1e}")
            if error <= enough or not growth.lanczos.pending.shape[1]:
                made = self._made(growth)
                if made.off.max() <= self.tolerance or made.undamped:
                    return made
                error = float(made.off.max())
            if not growth.grow(error):
                return self._made(growth)

    def _guess(self, growth: ReferenceSpace) -> float:
        """Largest error at some frequencies, relative to the envelope, where all modes are excited by the loads."""
        problem, lanczos, S = self.problem, growth.lanczos, growth.stiffness
        values, Y = sl.eigh(S)
        g = np.zeros((lanczos.size, problem.B.shape[1]))
        g[: len(growth.loads)] = (growth.loads * growth.scale)[:, : g.shape[1]]
        b = Y.T @ (S @ g) * problem.motion_scale
        W = lanczos.rest_vectors
        KW = problem.K @ W
        cross = dot(lanczos.V[:, : lanczos.size], KW, problem.budget)
        gram = W.T @ KW - cross.T @ np.linalg.solve(S, cross)
        tau = root(gram) @ Y[lanczos.last]
        worst = 0.0
        for w in np.linspace(*self.band, LOOKED_AT):
            a = values * (1 + 1j * self.damping.structural) + 1j * w * self.damping.of_modes(values) - w**2
            e = ((b**2).sum(axis=1) / np.abs(a)).sum()
            T = (tau * (self._numerator(values, w) / a)) @ b
            worst = max(worst, float(squares(T).sum()) / (1 - w**2 / self.cut) / e)
        return worst

    def _numerator(self, values: Floats, w: Floats | float) -> Complexes:
        """g + i w d_p (..., k) at ``w`` (...)."""
        w = np.asarray(w)[..., None] if np.ndim(w) else w
        return np.asarray(1j * w * self._slope(values) - w**2)

    def _slope(self, values: Floats) -> Floats:
        """Damping (k,) of the modes without what comes with the stiffness."""
        return np.asarray(self.damping.of_modes(values) - self.damping.beta * values)

    def _made(self, growth: ReferenceSpace) -> CertifiedReference:
        """The reference on the space as it is, with the modes that it misses."""
        problem, budget, K, M = self.problem, self.problem.budget, self.problem.K, self.problem.M
        space = KrylovSpace(problem, growth, self.modes)
        values, Y = sl.eigh(space.stiffness)
        k = int((values < self.cut).sum())
        if k != len(self.modes.eigenvalues):
            space = KrylovSpace(problem, growth, self.modes, everything=True)
            values, Y = sl.eigh(space.stiffness)
            k = int((values < self.cut).sum())
        if k != len(self.modes.eigenvalues):
            raise SolverError(
                f"{len(self.modes.eigenvalues)} modes lie below {np.sqrt(self.cut) / (2 * np.pi):,.6g} Hz and the "
                f"reference has {k}; move the upper end of the band by a percent"
            )
        U = multiply(space.V, Y[:, :k], budget)
        # Couplings that the small eigenproblem leaves, in parts of the highest eigenvalue, would hide light damping.
        turn = sl.eigh(symmetric(dot(U, K @ U, budget)), symmetric(dot(U, M @ U, budget)))[1]
        multiply_into(U, turn, U, budget)
        U /= m_norms(U, M @ U)
        Y = np.hstack([Y[:, :k] @ turn, Y[:, k:]])
        KU = K @ U
        coupled = np.hstack([dot(U, KU, budget), dot(space.V, KU, budget).T @ Y[:, k:]])
        values = np.concatenate([np.diag(coupled), values[k:]])
        scale = problem.motion_scale
        b = np.vstack([(problem.B.T @ U).T, (problem.B.T @ space.V @ Y[:, k:]).T]) * scale
        known = Modes(eigenvalues=values[:k], vectors=U, verified_below=self.cut)
        unsure = np.concatenate([problem.uncertainty(known), space.uncertain(Y[:, k:])])
        unsure = np.maximum(unsure, 4 * EPS * (values + self.band[1] ** 2))
        b_off = self._off_rows(U, space, Y[:, k:], values, unsure)
        rest = np.zeros((len(values), len(values)))
        rest[:k], rest[k:, :k] = coupled, coupled[:, k:].T
        np.fill_diagonal(rest, 0.0)
        unsure = with_left(np.sqrt(unsure), np.sqrt(unsure), rest)[0] ** 2
        tau = space.residual(Y)
        sigma = values[:k] * np.linalg.norm(tau[:, :k], axis=0)
        start = self._start(space, Y, values, b)
        edges, off = self._off(values, b, tau, k, start)
        return CertifiedReference(
            problem=problem, band_hz=self.band_hz, damping=self.damping, floor=self.floor, values=values, b=b, D=None,
            unsure=unsure, b_off=b_off, vectors=U, sigma=sigma, cut=self.cut, edges=edges, off=off,
            proven=not self._straddled(values[:k], sigma),
        )  # fmt: skip

    def _off_rows(self, U: Floats, space: KrylovSpace, Y: Floats, values: Floats, unsure: Floats) -> Floats:
        """(n, m) how far the loads of the modes ``U`` and V ``Y`` may be off.

        Sums of products, and what modes take up of the rigid motions Z: z'K u_p / lam_p of each.
        """
        problem, B = self.problem, abs(self.problem.B)
        Z = problem.rigid
        sums = np.vstack([(B.T @ np.abs(U)).T, ((B.T @ np.abs(space.V)) @ np.abs(Y)).T])
        rigid = np.abs(problem.B.T @ Z)
        turned = rigid @ np.sqrt(problem.rounding(Z))
        off = EPS * (sums + rigid.sum(axis=1)) + (np.sqrt(unsure) / values)[:, None] * turned
        return np.asarray(off * problem.motion_scale)

    def _start(self, space: KrylovSpace, Y: Floats, values: Floats, b: Floats) -> float:
        """|r_0| in the norm of K^-1: what the space misses of the static responses, round-off."""
        problem = self.problem
        X = static_response(problem) * problem.motion_scale
        subtract(space.V, Y @ (b / values[:, None]), X, problem.budget)
        return float(np.sqrt(max((X * (problem.K @ X)).sum(), 0.0)))

    def _straddled(self, values: Floats, sigma: Floats) -> bool:
        """Whether a mode may lie on either side of a jump of the modal table."""
        jumps = self.damping.jumps**2
        off = values * (sigma / np.sqrt(np.maximum(values, CLOSE)) + CLOSE)
        return bool((np.abs(values[:, None] - jumps) <= off[:, None]).any())

    def _off(self, values: Floats, b: Floats, tau: Floats, k: int, start: float) -> tuple[Floats, Floats]:
        """Edges of cells in rad/s, and limits of the error over the envelope on them."""
        low, high = self.band
        size, slope = (b**2).sum(axis=1), self._slope(values)
        own = (tau**2).sum(axis=0)
        stiffness = values * (1 + 1j * self.damping.structural)
        poles = Terms.second_order(stiffness, self.damping.of_modes(values), size[:, None])
        if not poles.z.imag.any() and ((poles.z.real >= low) & (poles.z.real <= high)).any():
            return np.array([low, high]), np.array([np.inf])
        share = 1.0 / np.where(values[:k] < self.cut, 1.0 / values[:k] - 1.0 / self.cut, 1.0)
        least = 1.0 / (1.0 / self.cut + float((own[:k] / values[:k] * share).sum()))
        most = high**2 + high * slope

        def weakest(lo: Floats, hi: Floats) -> Floats:
            """(nc, n) least |a_p| on cells."""
            away = np.maximum(np.abs(0.5 * (lo + hi)[:, None, None] - poles.z.real) - 0.5 * (hi - lo)[:, None, None], 0)
            return np.asarray(np.hypot(away, poles.z.imag).prod(axis=2))

        # Modes that are as good as exact count one by one: their share in T^2 over their own part of the envelope.
        each = own * most**2 / weakest(np.array([low]), np.array([high]))[0]
        order = [p for p in np.argsort(each) if p < k]
        fits = [p for n, p in enumerate(order) if 2 * (n + 1) * each[order[: n + 1]].sum() <= 0.1 * self.tolerance]
        apart = np.zeros(len(values), dtype=bool)
        apart[fits] = True
        rest = float(2 * len(fits) * each[apart].sum())
        double = 2.0 if fits else 1.0
        rows = (tau.T[~apart, :, None] * b[~apart, None, :]).reshape(-1, len(tau) * b.shape[1])
        T = Terms(z=poles.z[~apart], N=rows)
        norms = np.linalg.norm(rows, axis=1)[:, None]

        def bounds(lo: Floats, hi: Floats) -> Bounds:
            w = cell_points(lo, hi, POINTS)
            p = on_grid((T.inverse(w) * self._numerator(values[~apart], w)) @ rows)
            here = np.sqrt(squares(p).sum(axis=2))
            spread = np.sqrt(squares(p - p[:, SEGMENTS // 2, None]).sum(axis=2)).max(axis=1)
            middle, half = 0.5 * (lo + hi), 0.5 * (hi - lo)
            outside = T.remainder(middle, half, norms, slope[~apart])[:, 0]
            whole = here.max(axis=1) + BULGE * spread + outside + start
            ends = np.maximum(*(np.abs(end[:, None, None] - poles.z) for end in (lo, hi))).prod(axis=2)
            kappa = ((most[:k] ** 2 * own[:k]) / weakest(lo, hi)[:, :k]).sum(axis=1)
            gamma = 1.0 / np.maximum(1.0 - hi**2 / least, np.finfo(float).tiny)
            gain = np.where(gamma * kappa < 1, gamma / np.maximum(1 - gamma * kappa, CLOSE), np.inf)
            off = gain * (double * whole**2 / (1.0 / ends @ size) + rest)
            fine = half < 0.1 * T.nearest(middle)
            return Bounds(upper=off[:, None], lower=np.zeros((len(lo), 1)), at=middle[:, None], final=fine[:, None])

        cells = search(
            bounds, lambda lo, hi: 0.5 * (hi - lo) < 0.7 * T.nearest(0.5 * (lo + hi)),
            first_edges(low, high, T.z.real.ravel()), lambda found, _: found.upper <= self.tolerance, quantities=1,
            per_cell=4 * SEGMENTS * rows.shape[1] + 20 * len(values),
        )  # fmt: skip
        return np.append(cells.edges[:, 0], high), cells.upper[:, 0]


def _inside(omega: Floats, band: tuple[float, float]) -> Floats:
    return omega[(omega >= band[0]) & (omega <= band[1])]
