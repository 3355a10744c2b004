"""One tolerance in: the family, the frequencies and the order follow from it.

Everything happens in the modal coordinates of the reference model, where a reduced model of any family is a small
matrix C (k, n). Samples of the band guide and the certificate of the band decides (exchange method). Three families
are searched, each cut to its smallest order that meets the tolerance over the band:

- "gramian": leading vectors of the responses over the band (Lehner 2007; Fehr and Eberhard 2010) in the energy inner
  product, with the best of some weights;
- "krylov": responses at frequencies chosen where the error is largest, one after the other, until the tolerance
  holds (greedy, after Fehr, Fischer, Haasdonk and Eberhard 2013), then compressed;
- "modal": modes of the band with the residual static responses (Rubin 1975).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from morembs.base import progress
from morembs.base.errors import InputError, SolverError
from morembs.base.limits import DampingFloor, RelativeError
from morembs.base.types import Floats
from morembs.base.units import eigenvalue_in_hz, in_hz
from morembs.linalg.sparse.threads import machine_slowness
from morembs.problem import SOFTER, Problem
from morembs.reducers.base import Basis, elastic_basis
from morembs.reducers.cost import search_seconds
from morembs.reducers.families import OfResponses
from morembs.reducers.family_search import FamilySearch
from morembs.reducers.problem_summary import ProblemSummary
from morembs.reducers.tolerances import TOL
from morembs.responses.band import Band, band_frequencies
from morembs.responses.certified import certified_reference, floor_of
from morembs.responses.certified_reference import CertifiedReference
from morembs.responses.measures import Measure
from morembs.responses.tolerances import TOL as RESPONSES

KINDS = {"gramian": "gramian", "krylov": "krylov", "modal": "elastic"}


@dataclass(frozen=True, kw_only=True)
class AutoReducer(OfResponses):
    """The smallest body whose transfer matrix is within a tolerance over a band.

    Args:
        band_hz: [low, high], the band that is certified.
        tolerance: error of the transfer matrix, by ``measure``, at every frequency of the band.
        static_exact: keep the static responses to interface loads, so that statics at the interfaces are exact.
        inertia_loads: also follow the inertia loads of a moving frame. For a supported model this is always done.
        measure: "envelope", "peak" or "pointwise".
        damping_floor: ratio of critical damping that is assumed, as in ``certify``.

    >>> auto = AutoReducer(band_hz=[0.0, 5000.0], tolerance=0.05).reduce(problem)
    >>> auto.order < problem.K.shape[0]
    True
    """

    method: ClassVar[str] = "auto"
    band_hz: Band
    tolerance: RelativeError
    static_exact: bool = False
    inertia_loads: bool = False
    measure: Measure = "envelope"
    damping_floor: DampingFloor | None = None

    def seconds(self, facts: ProblemSummary, factor_entries: int = 0) -> float | None:
        # Modal damping acts on the modes of the reference: it grows until they are sharper than the response asks for.
        sharper = RESPONSES.modal_growth_part if facts.damping.is_modal else 1.0
        error = RESPONSES.growth_part * sharper * self._reference_error
        known = search_seconds(facts.size, facts.inputs, factor_entries, error)
        return known + TOL.auto_seconds * machine_slowness()

    @property
    def computes_modes(self) -> bool:
        return True

    @property
    def certified_band(self) -> Sequence[float]:
        return self.band_hz

    @property
    def _reference_error(self) -> float:
        return min(TOL.reference_part * self.tolerance, RESPONSES.reference_error)

    def _basis(self, problem: Problem) -> Basis:
        floor = floor_of(problem, self.band_hz, self.damping_floor)
        omega = 2 * np.pi * band_frequencies(problem, self.band_hz, floor=floor)
        # A body that is held has no rigid motion to balance the inertia of its frame.
        inertia = self.inertia_loads or problem.rigid.shape[1] < 6
        try:
            certified = certified_reference(
                problem, self.band_hz, tolerance=self._reference_error, damping_floor=floor, inertia_loads=inertia
            )
            self._refuse_lost(certified)
        except SolverError as fault:
            raise SolverError(
                f"tolerance = {self.tolerance:g} cannot be certified: {fault}", kind=fault.kind, keyword="tolerance"
            ) from fault
        search = FamilySearch(certified, omega, self.measure, self.tolerance, self.static_exact)
        if search.cannot_reach_tolerance():
            raise unreachable(self, search)
        coefficients: dict[str, Floats] = {}
        orders: dict[str, object] = {}
        for family in KINDS:
            progress.update(f"order of the {family} basis")
            fewer = min((C.shape[1] for C in coefficients.values()), default=TOL.no_order)
            C = search.smallest(family, fewer)
            orders[family] = "not reached" if search.reached[family] is None else search.reached[family]
            if C is not None:
                coefficients = {family: C}
        if not coefficients:
            raise unreachable(self, search)
        ((best, C),) = coefficients.items()
        notes = {
            "family": best,
            "orders": orders,
            "reference_order": len(certified.values),
            "measure": self.measure,
            "damping_floor": floor,
            "choice": _words(best, orders, self.band_hz, self.tolerance),
        }
        if best == "krylov":
            notes["frequencies_hz"] = [float(in_hz(w)) for w in search.chosen]
        basis = elastic_basis(problem, certified.model.vectors(C), KINDS[best], notes)
        limit = search.limit(C, np.diag(basis.K)[problem.rigid.shape[1] :])
        if limit.upper > self.tolerance:
            raise unreachable(self, search)
        return replace(basis, notes={**notes, "certified": limit.upper})

    def _refuse_lost(self, certified: CertifiedReference) -> None:
        """Refuse what round-off, or resonances without damping, make impossible.

        Raises:
            InputError: an undamped resonance.
            SolverError: a reference without a limit, a tolerance below round-off, or a band far above all modes.
        """
        highest_hz = float(eigenvalue_in_hz(certified.values.max()))
        far, endless = self.band_hz[1] > TOL.far_band * highest_hz, ~np.isfinite(certified.error_bounds)
        if endless.any() and certified.undamped:
            raise InputError(
                "a transfer error of an undamped model has no bound at its resonances; give damping, or a "
                "damping_floor such as 0.01",
                kind="unsupported",
                keyword="damping",
            )
        if endless.any() and not far:
            at_hz = float(in_hz(certified.edges[:-1][endless][0]))
            raise SolverError(
                f"the error of the reference of the full model has no limit from {at_hz:,.6g} Hz on, where its "
                "residual exceeds the damping of a resonance; give more damping, or a damping_floor such as 0.01"
            )
        lost, at_hz = certified.measure_loss()
        least = TOL.roundoff_share * lost
        if far and not self.tolerance >= least:
            raise SolverError(
                f"the band ends at {self.band_hz[1]:,.6g} Hz, and the highest mode of this model lies at "
                f"{highest_hz:,.6g} Hz; beside squares of such frequencies its stiffness is round-off; lower the upper "
                "end of the band"
            )
        if self.tolerance < least:
            # Above it by what two digits may take off.
            raising = (
                f"raise the tolerance to {TOL.advised_margin * least:.1e} or more, or "
                if least < TOL.max_advised_tolerance
                else ""
            )
            raise SolverError(
                f"round-off in the stiffness of this model alone may be {lost:.1e} of its response at {at_hz:,.6g} Hz, "
                f"and {TOL.roundoff_share:g} times that has to be allowed; {raising}{SOFTER}"
            )


def unreachable(wanted: AutoReducer, search: FamilySearch) -> InputError:
    """The error for the tolerance of ``wanted`` where ``search`` ended above it, with what is there instead."""
    at_hz = search.worst.at_hz
    if wanted.measure == "pointwise" and search.zero(at_hz):
        return InputError(
            f"tolerance = {wanted.tolerance:g} cannot be reached pointwise: H has a zero at {at_hz:,.6g} Hz; take "
            'measure = "envelope"',
            kind="result",
            keyword="tolerance",
        )
    least = search.worst.upper
    reason = (
        f"the smallest error found is {least:.1e}, where the round-off of the full model begins"
        if least > wanted.tolerance
        else f"bodies come to {least:.1e} at single frequencies, but round-off keeps their certificate above it"
    )
    return InputError(
        f"tolerance = {wanted.tolerance:g} cannot be reached from {wanted.band_hz[0]:g} to {wanted.band_hz[1]:g} Hz; "
        f"{reason}; raise the tolerance",
        kind="result",
        keyword="tolerance",
    )


def _words(best: str, orders: dict[str, object], band_hz: list[float], tolerance: float) -> str:
    others = ", ".join(f"{name} {order}" for name, order in orders.items() if name != best)
    return (
        f"{best} basis of {orders[best]} elastic coordinates, the smallest found that keeps {tolerance:g} from "
        f"{band_hz[0]:g} to {band_hz[1]:g} Hz ({others})"
    )
