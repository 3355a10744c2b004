"""Dominant directions of the Gramian of a frequency band (Lehner 2007; Fehr and Eberhard 2010): a POD of responses.

Snapshots U_k = A(i omega_k)^-1 B at the points of a quadrature with weights w_k over the band make a factor S of the
position Gramian 1/pi int Re(U U*) d omega. V holds the left singular vectors of S in the energy inner product
X = K + mu M, mu the square of the middle of the band. With Pi the X-orthogonal projector on V,

    sum of sigma_k^2 left out = 1/pi sum_k w_k |U_k - Pi U_k|_X^2 ,

exact for the points of the quadrature; the error of the reduced model between them is not bounded by it.

The elastic part of the loads counts, with moments over the length of the body as forces. Snapshots come from the
modal coordinates of the reference model, where hundreds of points are small dense work, or by factorising the full
matrices ("direct"). Without damping the integral over a resonance does not exist: the path then runs along
s = delta + i omega, and the notes say so.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base import progress
from morembs.base.errors import InputError, SolverError
from morembs.base.limits import PositiveCount, number, one_of
from morembs.base.types import Floats
from morembs.base.units import angular_band
from morembs.base.worker_pool import WorkerPool
from morembs.linalg.columns import m_norms, orthonormal
from morembs.linalg.gramians import StreamedSVD, WeightedSVD, snapshot_factor
from morembs.linalg.quadrature import gauss, modal_poles, resonant
from morembs.linalg.space import Space
from morembs.problem import Problem
from morembs.reducers.base import Basis, elastic_basis
from morembs.reducers.families import OfResponses
from morembs.reducers.problem_summary import ProblemSummary, ShiftedFactorisations
from morembs.reducers.tolerances import TOL
from morembs.responses.band import Band
from morembs.responses.direct import state, states_pool, why_no_response
from morembs.responses.loads import elastic_part, load_scale, unit_loads
from morembs.responses.reference import ModalReference, reference_model

WEIGHTS = ("position", "velocity")
ResponsePart = Annotated[
    float, number(f"a part of the response from {TOL.finest_tolerance:g} to below 1", ge=TOL.finest_tolerance, lt=1)
]


@dataclass(frozen=True, kw_only=True)
class Gramian(OfResponses):
    """Principal directions of the responses within a band.

    ``tolerance`` bounds ``sqrt(1/pi sum w_k |U_k - Pi U_k|_X^2) / sqrt(1/pi sum w_k |U_k|_X^2)``, the part of the
    snapshots that V leaves out.

    Args:
        band_hz: [low, high], the band of the Gramian.
        order: number of elastic directions; this or ``tolerance``.
        tolerance: square root of the part of the energy of the responses that may be omitted.
        weight: "position", or "velocity" for more weight at the upper end of the band.
        direct: solve with the full matrices at each point, in place of the reference model: one factorisation for each
            point, done by the worker pool. Necessary for a model with a damping matrix.
        points: Gauss points over the band; by default so many that each resonance is resolved, or 12 if ``direct``.
        static: keep the response to static interface forces exact: these displacements come first, among the ``order``.
        inertia_loads: also follow the inertia loads of a moving frame. Each load is scaled to the mean static energy of
            the interface forces.

    >>> Gramian(band_hz=[0.0, 5000.0], order=6).reduce(problem).order     # and 6 rigid-body modes
    12
    """

    method: ClassVar[str] = "gramian"
    band_hz: Band
    order: PositiveCount | None = None
    tolerance: ResponsePart | None = None
    weight: Annotated[str, one_of(*WEIGHTS)] = "position"
    direct: bool = False
    points: PositiveCount | None = None
    static: bool = False
    inertia_loads: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.order is None) == (self.tolerance is None):
            raise InputError(
                'method "gramian" needs either order = COUNT or tolerance = PART (one of the two)',
                kind="missing",
                keyword="order",
            )

    def why_no_response(self, facts: ProblemSummary) -> str:
        if not self.direct:
            return super().why_no_response(facts)
        if facts.damping.is_modal and not facts.own_damping:
            return "modal damping is known mode by mode only; take direct = false"
        return why_no_response(facts.damping, facts.own_damping, None)

    def plan_factorisations(self, facts: ProblemSummary) -> Sequence[ShiftedFactorisations]:
        if not self.direct:
            return super().plan_factorisations(facts)
        count = self.points or TOL.direct_points
        # Damped, or beside the imaginary axis.
        return [ShiftedFactorisations(structure="complex-symmetric", count=count, columns=facts.inputs, at_once=count)]

    def _basis(self, problem: Problem) -> Basis:
        low, high = angular_band(self.band_hz)
        mu = (0.5 * (low + high)) ** 2
        notes: dict[str, object] = {}
        make = self._direct if self.direct else self._modal
        X = make(problem, low, high, mu, notes)
        wanted = X.shape[1]
        basis = elastic_basis(problem, X, "gramian", notes)
        lost = wanted + problem.rigid.shape[1] - basis.V.shape[1]
        return replace(basis, notes={**notes, "dependent_directions_dropped": lost}) if lost else basis

    def _reference(self, problem: Problem, omega: Floats) -> ModalReference:
        try:
            return reference_model(problem, omega, tolerance=TOL.state_error, inertia_loads=self.inertia_loads)
        except SolverError:
            if not problem.damping.is_modal:
                raise
            # With modal damping the error is the change of H by the last block, which round-off may keep above that.
            return reference_model(problem, omega, tolerance=TOL.reference_error, inertia_loads=self.inertia_loads)

    def _modal(self, problem: Problem, low: float, high: float, mu: float, notes: dict[str, object]) -> Floats:
        """Basis (Nc, n) from snapshots in the modal coordinates of the reference model, where X is diagonal."""
        reference = self._reference(problem, np.linspace(low, high, TOL.state_samples))
        values = reference.values
        F = reference.F * load_scale(problem.motion_scale, reference.F, reference.F / values[:, None])
        X = sp.diags_array(values + mu).tocsr()
        self._refuse_statics(reference.states(np.array([1j * high]), F)[0], F / values[:, None], X)
        delta = _shift(reference, low, high)
        poles = modal_poles(values, reference.damping_at_resonance()) + 1j * delta
        omega, weights = resonant(low, high, poles) if self.points is None else gauss(low, high, self.points)
        # Blocks four times as wide as long: few decompositions, little memory.
        chunk = 1 + 2 * len(values) // F.shape[1]

        def snapshots() -> Iterator[Floats]:
            for at in range(0, len(omega), chunk):
                s = delta + 1j * omega[at : at + chunk]
                yield self._factor(reference.states(s, F), s, weights[at : at + chunk])

        first, V = self._pod(snapshots(), F / values[:, None], X, WeightedSVD(values + mu), notes)
        notes |= {"quadrature_points": len(omega), "reference_order": len(values), "delta_1_per_s": delta}
        # M is the identity here: orthonormal coordinates are M-orthonormal columns.
        return reference.vectors(np.linalg.qr(np.hstack([first, V]))[0])

    def _direct(self, problem: Problem, low: float, high: float, mu: float, notes: dict[str, object]) -> Floats:
        """Basis (Nc, n) from solutions of the full equations. Peak memory: 2 p points columns of length Nc."""
        M, space = problem.M, problem.space
        damping = problem.damping
        F = elastic_part(problem, unit_loads(problem, self.inertia_loads))
        G = space.map_columns(problem.free_free.flexibility, F)
        scale = load_scale(problem.motion_scale, F, G)
        F *= scale
        G *= scale
        X = sp.csr_array(problem.K + mu * M)
        damped = problem.D is not None or damping.is_rayleigh or damping.structural > 0
        delta = 0.0 if damped else TOL.axis_offset * high
        omega, weights = gauss(low, high, self.points or TOL.direct_points)

        # The highest first: it tells whether there are any dynamics.
        points, weights = [complex(delta, w) for w in omega[::-1]], weights[::-1]

        def snapshots(pool: WorkerPool) -> Iterator[Floats]:
            for k, U in enumerate(pool.each(state, points)):
                progress.update(f"responses of the band: {k + 1} of {len(points)}")
                if not k:
                    self._refuse_statics(U, G, X)
                yield self._factor(U[None], np.array(points[k : k + 1]), weights[k : k + 1])

        svd = StreamedSVD(replace(space, M=X), 2 * F.shape[1] * len(omega))
        with states_pool(problem, points, F) as pool:
            first, V = self._pod(snapshots(pool), G, X, svd, notes)
        notes |= {"quadrature_points": len(omega), "delta_1_per_s": delta}
        return space.hstack(first, V)

    def _factor(self, U: NDArray[Any], s: NDArray[Any], weights: Floats) -> Floats:
        """Snapshot factor of the states ``U`` (ns, n, p) at ``s`` (ns,), or of their velocities."""
        return snapshot_factor(s[:, None, None] * U if self.weight == "velocity" else U, weights)

    def _pod(
        self,
        snapshots: Iterator[Floats],
        statics: Floats,
        X: sp.csr_array,
        svd: WeightedSVD | StreamedSVD,
        notes: dict[str, object],
    ) -> tuple[Floats, Floats]:
        """Static directions that are kept (n, j) and the dominant ones of the remainder, all X-orthonormal."""
        first = orthonormal(statics, X) if self.static else np.zeros((len(statics), 0))
        energy = 0.0
        for S in snapshots:
            energy += float((m_norms(S, X @ S) ** 2).sum())
            Space(X).orthogonalize_in_place(first, S)
            svd.add(S)
        tail = np.sqrt(np.append(np.cumsum(svd.sigma[::-1] ** 2)[::-1], 0.0) / energy)
        fixed, largest_order = first.shape[1], first.shape[1] + len(svd.sigma)
        # Exactly one of the two is given.
        count = int(np.argmax(tail <= self.tolerance)) if self.tolerance else (self.order or 0) - fixed
        if count < 0:
            raise InputError(
                f"order = {self.order} was given, but static = true keeps {fixed} static displacements; expected "
                f"order = {fixed} or more",
                keyword="order",
            )
        if count > len(svd.sigma):
            raise InputError(
                f"order = {self.order} was given, but the responses of the band span {largest_order} directions only; "
                f"take order = {largest_order} or less, a wider band or more points",
                keyword="order",
            )
        notes |= {"part_left_out": float(tail[count]), "static_directions": fixed}
        return first, svd.vectors[:, :count]

    def _refuse_statics(self, U: NDArray[Any], G: Floats, X: sp.csr_array) -> None:
        """Raise where the states ``U`` (n, p) at the upper end of the band are the static ones ``G``."""
        change = U - G
        size = (np.sum((X @ A * A.conj()).real) for A in (change, G))
        if np.sqrt(next(size) / next(size)) < TOL.static_response:
            raise InputError(
                f"the response in the band {list(self.band_hz)} Hz is static to {TOL.static_response:g}: "
                'it holds no dynamics; take method = "guyan", '
                "or raise the upper end of the band towards the first frequency of the body",
                keyword="band_hz",
            )


def _shift(reference: ModalReference, low: float, high: float) -> float:
    """Real part of the path in 1/s: zero unless a mode that resonates in the band is undamped."""
    at, undamped = np.sqrt(reference.values), reference.damping_at_resonance() <= 0
    return (
        TOL.axis_offset * high
        if (undamped & (at > low - TOL.inside_band * high) & (at < high + TOL.inside_band * high)).any()
        else 0.0
    )
