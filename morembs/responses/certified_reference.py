"""The reference that errors are certified against: modes of the full model, and by how much H by them may be off."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from morembs.base.summary import summarised, upwards
from morembs.base.types import Complexes, Floats
from morembs.base.units import angular_band, in_hz
from morembs.problem import Problem
from morembs.responses.clusters import clusters, damping_of_clusters
from morembs.responses.layout import BlockIndex
from morembs.responses.measures import ReferenceResponse
from morembs.responses.pencils import response_of
from morembs.responses.rational import PoleResidueForm
from morembs.responses.reference import ModalReference
from morembs.responses.rounding import EPS, RoundoffBound
from morembs.responses.tolerances import TOL


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class CertifiedReference:
    """Elastic part of the full model over ``band_hz``, forces and moments scaled by the radius of gyration.

    ``model`` are its n modes, with the damping ``floor``; their stiffness is uncertain by ``unsure`` (n,), and with
    couplings of the square root of its products, and their scaled loads ``b`` (n, m) are by ``b_off`` (n, m).
    ``vectors`` (Nc, k) and ``sigma`` (k,) are those of the modes below ``cut``, all of which are there; ``edges``
    (nc + 1,) in rad/s and ``error_bounds`` (nc,) limits of ``|H - H_ref|`` over the envelope. ``solve_errors`` (n,)
    limit the errors of solutions in the modes, in the energy of G s_p / theta_p, and ``start`` the norm of r_0 in that
    of K^-1 (``residual_bound``). ``error_bounds`` are estimates where there are ``doubts``, which say why. Modes below
    ``cut`` are ``counted``, or LAPACK found all modes; beside their vectors K >= ``least`` M. ``solutions`` (Nc, q)
    times ``coefficients`` (q, n) are G s_p / theta_p; with a damping matrix of the model's own (q, 2 n), beside G D u_p
    outside of the space.

    >>> reference = certified_reference(problem, [0.0, 3000.0])
    >>> reference.proven, bool(reference.error_bounds.max() < 1e-6)
    (True, True)
    """

    model: ModalReference
    band_hz: tuple[float, float]
    floor: float
    unsure: Floats
    b_off: Floats
    vectors: Floats
    sigma: Floats
    cut: float
    edges: Floats
    error_bounds: Floats
    doubts: tuple[str, ...]
    solve_errors: Floats
    start: float
    counted: bool
    least: float = 0.0
    solutions: Floats | None = None
    coefficients: Floats | None = None

    def _facts(self) -> dict[str, object]:
        return {
            "band": list(self.band_hz),
            "modes": len(self.values),
            "error": upwards(float(self.error_bounds.max(initial=0.0))),
            "proven": self.proven,
            "damping floor": self.floor or None,
        }

    @property
    def proven(self) -> bool:
        """True if ``error_bounds`` are limits."""
        return not self.doubts

    @property
    def problem(self) -> Problem:
        """What it is the reference of."""
        return self.model.problem

    @property
    def values(self) -> Floats:
        """Eigenvalues (n,) in (rad/s)2."""
        return self.model.values

    @cached_property
    def b(self) -> Floats:
        """Scaled loads (n, m) of the modes."""
        return np.asarray(self.model.B * self.problem.motion_scale)

    def standard(self, symmetric: bool = True) -> ReferenceResponse:
        """What bodies, ``symmetric`` or not, are measured against."""
        return self._for_symmetric if symmetric else self._for_any

    @cached_property
    def _for_symmetric(self) -> ReferenceResponse:
        return self._standard(symmetric=True)

    @cached_property
    def _for_any(self) -> ReferenceResponse:
        return self._standard(symmetric=False)

    def _standard(self, symmetric: bool) -> ReferenceResponse:
        layout = BlockIndex(self.b.shape[1], list(self.problem.coupling.columns.values()), symmetric)
        damping, D = self.model.damping, self.model.D
        stiffness = self.values * (1 + 1j * damping.structural)
        d = damping.of_modes(self.values) if D is None else damping_of_clusters(self.values, D)[0]
        modes = PoleResidueForm.second_order(stiffness, d, layout.rows(self.b, self.b))
        H = modes
        highest = abs(1 + 1j * (damping.structural + damping.beta * 2 * np.pi * self.band_hz[1]))
        lost = np.sqrt(highest * self.unsure)
        if D is None:
            rounding = RoundoffBound.of(layout, self.b, self.b, lost, lost, self.b_off, self.b_off)
        else:
            response = response_of(
                np.eye(len(self.values)),
                D,
                np.diag(self.values),
                self.b,
                self.b.T,
                layout,
                structural=damping.structural,
                highest=2 * np.pi * self.band_hz[1],
                unsure=(lost, self.b_off),
            )
            H, rounding = response.terms, response.rounding
        # What the small eigenproblem leaves of the couplings between modes above the cut, of which the band may be far
        # below the first.
        above = self.values[self.values >= self.cut]
        floor = TOL.small_eigen_eps * EPS * float(above.max(initial=0.0)) / float(above.min(initial=np.inf))
        return ReferenceResponse(
            H=H,
            modes=modes,
            residue_norms=layout.sizes(self.b, clusters(self.values)),
            rounding=rounding,
            layout=layout,
            floor=floor,
            edges=self.edges,
            cell_uncertainty=self.error_bounds,
        )

    def H(self, omega: Floats) -> Complexes:
        """(nf, m, m) scaled response at ``omega`` (nf,) in rad/s."""
        standard = self.standard(symmetric=False)
        return standard.H.at(np.asarray(omega, dtype=float)).reshape(len(omega), *self.b.shape[1:] * 2)

    def uncertainty(self, omega: Floats) -> Floats:
        """(nf,) limits of ``|H - H_ref|`` at ``omega`` (nf,) of the band, round-off included, in m/N."""
        return self._measure_loss_at(omega)[0]

    def measure_loss(self) -> tuple[float, float]:
        """What is not known of the response at the resonances of the band, as part of its envelope, at most, and the
        frequency in Hz where that is."""
        low, high = angular_band(self.band_hz)
        inside = inside_band(np.sqrt(self.values), (low, high))
        omega = np.concatenate([[low, high], inside])
        loss, e = self._measure_loss_at(omega)
        part = loss / e
        return float(part.max()), float(in_hz(omega[part.argmax()]))

    def _measure_loss_at(self, omega: Floats) -> tuple[Floats, Floats]:
        """``uncertainty`` and envelope (nf,) at ``omega`` (nf,)."""
        standard = self.standard()
        size = standard.modes.moduli(omega)[0]
        e = size @ standard.residue_norms[:, 0]
        loss = standard.lost_to_rounding(omega, size)
        return np.asarray(loss + (standard.uncertainty(omega, omega) + standard.floor) * e), e

    @property
    def undamped(self) -> bool:
        """True if resonances are infinite."""
        damping = self.model.damping
        return self.model.D is None and not (damping.is_viscous or damping.structural)


def inside_band(omega: Floats, band: tuple[float, float]) -> Floats:
    """Those of ``omega`` that lie in the ``band``, all in rad/s."""
    return omega[(omega >= band[0]) & (omega <= band[1])]
