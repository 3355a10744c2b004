"""A reference model whose error is known: bounds of |H - H_ref| on every frequency of a band.

The reference is the Galerkin projection on V, a block Krylov space of the flexibility G started at the loads, and the
modes below lam_c that no load excites. It grows until ``residual_bound`` is below a tolerance on all of the band: what
modes and solutions leave is part of it. Modal damping acts on the exact modes of the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base import progress
from morembs.base.arguments import check_value
from morembs.base.errors import InputError, SolverError
from morembs.base.limits import DampingFloor
from morembs.base.types import Floats
from morembs.base.units import angular_band, eigenvalue_in_hz
from morembs.linalg.congruence import scaled_row_sums
from morembs.linalg.tolerances import TOL as LINALG
from morembs.problem import Problem
from morembs.problem.damping import Damping
from morembs.responses.band import beyond, checked_band
from morembs.responses.certified_reference import CertifiedReference, inside_band
from morembs.responses.damped_residual import damped_residual
from morembs.responses.direct import refuse_skew_parts
from morembs.responses.krylov_space import ReferenceBasis, RitzModes, root
from morembs.responses.loads import unit_loads
from morembs.responses.rational import squares
from morembs.responses.reference import ModalReference, ReferenceSpace, has_stagnated, reference_model, reference_space
from morembs.responses.residual_bound import Residual, numerator, slope
from morembs.responses.rounding import EPS, absorb_couplings
from morembs.responses.tolerances import TOL


def floor_of(
    problem: Problem, band_hz: Sequence[float], given: float | None = None, damping: Damping | None = None
) -> float:
    """The ratio of critical damping that is assumed in a model and its bodies: ``given``, or what models need that
    have no damping at some frequencies of the band. ``damping`` is that of ``problem``, or the least of a parameter.

    Raises:
        InputError: not a ratio.
    """
    if given is not None:
        check_value("damping_floor", given, DampingFloor)
        return float(given)
    damping, (low, high) = damping or problem.damping, angular_band(band_hz)
    if damping.is_rayleigh or damping.structural or problem.D is not None:
        return 0.0
    jumps = damping.jumps
    return 0.0 if damping.ratio(np.append(jumps[(jumps > low) & (jumps < high)], low)).all() else TOL.damping_floor


def certified_reference(
    problem: Problem,
    band_hz: Sequence[float],
    *,
    tolerance: float = TOL.reference_error,
    damping_floor: float | None = None,
    inertia_loads: bool = False,
) -> CertifiedReference:
    """Reference whose error is below ``tolerance`` times the envelope of the response on all of ``band_hz``, or as
    small as the space of the loads allows; kept for later calls.

    ``damping_floor`` is a ratio of critical damping: the stiffness gets 2 i ``damping_floor`` of itself beside the
    damping there is; by default 0.01 without any, otherwise 0. ``inertia_loads`` follows those in the space too.
    Peak memory: as ``reference_model``, and its modes below 1.25 times the upper frequency.

    Args:
        problem: the full model with its interfaces.
        band_hz: (low, high) in Hz.
        tolerance: largest error, as a part of the envelope.
        damping_floor: ratio of critical damping.
        inertia_loads: whether the space follows accelerations of the body as well.

    Raises:
        InputError: no interfaces, not a band or a ratio, or modal damping beside a damping matrix of the model.
        SolverError: the count of modes contradicts the reference, or it does not become good enough.

    >>> certified_reference(problem, [0.0, 3000.0]).band_hz
    (0.0, 3000.0)
    """
    low, high = checked_band(band_hz)
    refuse_skew_parts(problem)
    floor = floor_of(problem, (low, high), damping_floor)
    if not problem.B.shape[1]:
        raise InputError(
            "a frequency response needs interfaces; add at least one [[interface]]",
            kind="missing",
            keyword="interfaces",
        )
    references: dict[object, tuple[float, CertifiedReference]] = problem.compute_once("certified references", dict)
    # What follows inertia loads too serves others as well.
    key = low, high, floor, inertia_loads or (low, high, floor, True) in references
    if key not in references or references[key][0] > tolerance:
        damping = replace(problem.damping, structural=problem.damping.structural + 2 * floor)
        build = _Build(problem, (low, high), damping, floor, tolerance, key[-1])
        references[key] = (
            tolerance,
            (build.within_tolerance() if problem.D is None else build.with_own_damping(problem.D)),
        )
    return references[key][1]


class _Build:
    """Makes a certified reference from the Krylov space of the loads."""

    def __init__(
        self,
        problem: Problem,
        band_hz: tuple[float, float],
        damping: Damping,
        floor: float,
        tolerance: float,
        inertia: bool,
    ) -> None:
        self.problem, self.band_hz, self.damping, self.floor = problem, band_hz, damping, floor
        self.tolerance, self.inertia = tolerance, inertia
        self.band = angular_band(band_hz)
        self.modes = problem.elastic_modes(below=beyond(band_hz[1]))
        self.cut = beyond(band_hz[1]) * (1 + LINALG.eigenvalue_gap)
        # Whether nothing but the residuals of solutions keeps the error above the tolerance.
        self.hidden = False

    def with_own_damping(self, D: sp.csr_array) -> CertifiedReference:
        """The space of a damping matrix ``D`` (Nc, Nc) of the model's own."""
        problem, omega = self.problem, np.linspace(*self.band, TOL.growth_samples)
        omega = np.unique(np.concatenate([omega, inside_band(np.sqrt(self.modes.eigenvalues), self.band)]))
        model = reference_model(problem, omega, tolerance=TOL.damped_error, inertia_loads=self.inertia)
        k, structural = len(self.modes.eigenvalues), self.damping.structural
        D_modes = np.zeros((len(model.values), len(model.values))) if model.D is None else model.D
        residual, proven = damped_residual(problem, model, (D, D_modes), k, self.cut, structural)
        edges, bounds = residual.bounds(self.band, TOL.damped_error)
        doubts: tuple[str, ...] = ()
        if int((model.values < self.cut).sum()) != k or not proven or not np.isfinite(bounds).all():
            doubts += ("the error of the full response, with the model's own damping, is an estimate",)
            edges, bounds = np.array(self.band), np.array([max(model.error, TOL.damped_error)])
        damped = np.linalg.eigvalsh(D_modes)
        if damped.min(initial=0.0) < -TOL.negative_damping * np.abs(damped).max(initial=0.0):
            doubts += ("the damping matrix of the model drives some motions, so that limits are estimates",)
        return CertifiedReference(
            model=replace(model, damping=self.damping),
            band_hz=self.band_hz,
            floor=self.floor,
            unsure=self._rounding(model),
            b_off=np.zeros((len(model.values), problem.B.shape[1])),
            vectors=self.modes.vectors,
            sigma=(model.values * np.sqrt(residual.own))[:k],
            cut=self.cut,
            edges=edges,
            error_bounds=bounds,
            doubts=doubts,
            solve_errors=residual.lost[0],
            start=residual.start,
            counted=self.modes.counted,
            least=residual.least,
            solutions=residual.solutions,
            # K (G M U - U / theta) = M U - K U / theta, and that of D as it is.
            coefficients=np.diag(np.repeat([-1.0, 1.0], len(model.values)))[: residual.solutions.shape[1]],
        )

    def _rounding(self, model: ModalReference) -> Floats:
        """What round-off in K and D, that of stiff links and dampers too, makes of the energies (n,) of all modes, with
        what the eigensolver leaves of couplings."""
        problem, n = self.problem, len(model.values)
        weights, width = scaled_row_sums(problem.D), problem.budget.columns(len(model.V))
        parts = [np.zeros(0)]
        for at in range(0, n, width):
            X = model.vectors(np.eye(n, min(width, n - at), -at))
            parts.append(problem.system.roundoff(X) + EPS * self.band[1] * np.einsum("i,ij,ij->j", weights, X, X))
        unsure = np.maximum(np.concatenate(parts), 4 * EPS * (model.values + self.band[1] ** 2))
        U = model.vectors(np.eye(n))
        coupled = np.abs(problem.space.dot(U, problem.K @ U) - np.diag(model.values))
        coupled += self.band[1] ** 2 * np.abs(problem.space.dot(U, problem.M @ U) - np.eye(n))
        return absorb_couplings(np.sqrt(unsure), np.sqrt(unsure), coupled)[0] ** 2

    def within_tolerance(self) -> CertifiedReference:
        """The space, grown until the error is below the tolerance."""
        krylov, errors = reference_space(self.problem, self.inertia), list[float]()
        # Modal damping acts on the computed modes: they are closer to the true ones than the response asks for.
        enough = TOL.growth_part * self.tolerance * (TOL.modal_growth_part if self.damping.is_modal else 1.0)
        while True:
            error = self._guess(krylov)
            progress.update(f"reference: order {krylov.lanczos.size}, error {error:.1e}")
            if error <= enough or not krylov.lanczos.pending.shape[1]:
                reference = self._reference(krylov)
                # A larger space has no part in what solutions are off by.
                if reference.error_bounds.max() <= self.tolerance or reference.undamped or self.hidden:
                    return reference
                error = float(reference.error_bounds.max())
            errors.append(error)
            # Where round-off hides the rest, limits say how much.
            if has_stagnated(errors) or not krylov.extend(error):
                return self._reference(krylov)

    def _guess(self, krylov: ReferenceSpace) -> float:
        """Largest error at some frequencies, relative to the envelope, where all modes are excited by the loads."""
        problem, lanczos, S = self.problem, krylov.lanczos, krylov.stiffness
        values, Y = sl.eigh(S)
        g = np.zeros((lanczos.size, problem.B.shape[1]))
        g[: len(krylov.loads)] = (krylov.loads * krylov.scale)[:, : g.shape[1]]
        b = Y.T @ (S @ g) * problem.motion_scale
        W = lanczos.rest_vectors
        KW = problem.K @ W
        cross = problem.space.dot(lanczos.V[:, : lanczos.size], KW)
        gram = W.T @ KW - cross.T @ np.linalg.solve(S, cross)
        tau = root(gram) @ Y[lanczos.last]
        w = np.linspace(*self.band, TOL.growth_samples)
        g = numerator(w, slope(self.damping, values))
        a = values * (1 + 1j * self.damping.structural + 1j * w[:, None] * self.damping.beta) + g
        e = (1 / np.abs(a)) @ (b**2).sum(axis=1)
        T = (tau * (g / a)[:, None, :]) @ b
        return float((squares(T).sum(axis=(1, 2)) / (1 - w**2 / self.cut) / e).max())

    def _reference(self, krylov: ReferenceSpace) -> CertifiedReference:
        """The reference on the space as it is, with the modes that it misses."""
        problem, k = self.problem, len(self.modes.eigenvalues)
        space, values, Y = self._ritz_pairs(krylov)
        modes = space.modes(Y, values, k, self.band[1])
        start = self._start(krylov, space, modes)
        modes, residual, edges, bounds = self._bound_modes(space, modes, start)
        sigma = modes.values * np.sqrt(residual.own)
        model = ModalReference(
            values=modes.values,
            D=None,
            damping=self.damping,
            F=self._loads(space, modes),
            inputs=problem.B.shape[1],
            V=space.V,
            Y=modes.Y,
            error=float(bounds.max()),
            problem=problem,
        )
        return CertifiedReference(
            model=model,
            band_hz=self.band_hz,
            floor=self.floor,
            unsure=modes.unsure,
            b_off=modes.b_off,
            vectors=modes.vectors,
            sigma=sigma[:k],
            cut=self.cut,
            edges=edges,
            error_bounds=bounds,
            doubts=self._doubts(krylov, modes, residual, sigma),
            solve_errors=modes.lost,
            start=start,
            counted=self.modes.counted,
            least=residual.least,
            solutions=space.Z,
            coefficients=-modes.Y[space.rows],
        )

    def _ritz_pairs(self, krylov: ReferenceSpace) -> tuple[ReferenceBasis, Floats, Floats]:
        """The space with the modes that it misses, its Ritz values, as many below the cut as modes, and coordinates.

        Raises:
            SolverError: there are more or fewer.
        """
        for everything in (False, True):
            space = ReferenceBasis(self.problem, krylov, self.modes, everything)
            values, Y = sl.eigh(space.stiffness)
            if (k := int((values < self.cut).sum())) == len(self.modes.eigenvalues):
                return space, values, Y
        raise SolverError(
            f"{len(self.modes.eigenvalues)} modes lie below {eigenvalue_in_hz(self.cut):,.6g} Hz and the "
            f"reference has {k}; move the upper end of the band by a percent",
            keyword="band_hz",
        )

    def _bound_modes(
        self, space: ReferenceBasis, modes: RitzModes, start: float
    ) -> tuple[RitzModes, Residual, Floats, Floats]:
        """The modes, refined where that decides, their residual, and its bounds on cells between edges."""
        residual = Residual(
            values=modes.values,
            b=modes.b,
            tau=modes.tau,
            lost=modes.lost,
            start=start,
            k=len(self.modes.eigenvalues),
            cut=self.cut,
            damping=self.damping,
        )
        edges, bounds = residual.bounds(self.band, self.tolerance)
        self.hidden = False
        if bounds.max() > self.tolerance and residual.poles.z.imag.any():
            modes = space.refine(modes)
            residual = replace(residual, lost=modes.lost)
            edges, bounds = residual.bounds(self.band, self.tolerance)
            without = replace(residual, lost=np.zeros(len(residual.lost))).bounds(self.band, self.tolerance)[1]
            self.hidden = bounds.max() > self.tolerance >= without.max()
        return modes, residual, edges, bounds

    def _loads(self, space: ReferenceBasis, modes: RitzModes) -> Floats:
        """(n, p) of the modes, those of inertia behind those of the interfaces."""
        problem = self.problem
        F = modes.b / problem.motion_scale
        if self.inertia:
            others = unit_loads(problem, inertia=True)[:, F.shape[1] :]
            F = np.hstack([F, modes.Y.T @ problem.space.dot(space.V, others)])
        return F

    def _start(self, krylov: ReferenceSpace, space: ReferenceBasis, modes: RitzModes) -> float:
        """|r_0| in the norm of K^-1: what the space misses of the static responses, round-off."""
        problem = self.problem
        X, left = krylov.statics
        lost = float(np.linalg.norm(left * problem.motion_scale)) * modes.softness.value
        X = X * problem.motion_scale
        problem.space.subtract(space.V, modes.Y @ (modes.b / modes.values[:, None]), X)
        return float(np.sqrt(max((X * (problem.K @ X)).sum(), 0.0))) + lost

    def _doubts(self, krylov: ReferenceSpace, modes: RitzModes, left: Residual, sigma: Floats) -> tuple[str, ...]:
        """Why limits are estimates, in words."""
        doubts: tuple[str, ...] = ()
        if not modes.softness.proven:
            doubts += ("the solver is too inexact to say how far its solutions are off, so that limits are estimates",)
        values, jumps = left.values, self.damping.jumps**2
        jumps = jumps[jumps >= left.softest]
        deviation = values * (sigma / np.sqrt(np.maximum(values, TOL.closest_mode)) + TOL.closest_mode)
        near_step = (np.abs(values[:, None] - jumps) <= deviation[:, None]).any()
        if len(jumps) and (near_step or len(values) < krylov.room):
            doubts += (
                "the modal damping table jumps among modes that the reference does not know one by one, so that "
                "limits are estimates",
            )
        return doubts
