"""Families of bases in the modal coordinates of a reference model, each cut to its smallest certified order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.base.types import Floats
from morembs.base.units import angular_band, in_hz
from morembs.linalg.eigen import accurate_eigh
from morembs.linalg.quadrature import trapezoid
from morembs.problem.damping import Damping
from morembs.reducers.tolerances import TOL
from morembs.responses.certified_reference import CertifiedReference
from morembs.responses.loads import load_scale
from morembs.responses.measures import Limit, compare, decide
from morembs.responses.pencils import response_of
from morembs.responses.rational import product
from morembs.responses.rounding import Response


@dataclass(frozen=True, kw_only=True, eq=False)
class ModalModel:
    """A model in its modal coordinates: eigenvalues ``theta`` (n,), loads ``B`` (n, p), ``D`` (n, n) if ``damping``
    does not say all."""

    theta: Floats
    B: Floats
    D: Floats | None
    damping: Damping

    def states(self, omega: Floats) -> NDArray[Any]:
        """(nf, n, p) at ``omega`` (nf,) in rad/s, real where there is no damping."""
        stiffness = self.theta * (1 + 1j * self.damping.structural)
        if self.D is not None:
            B = self.B.astype(complex)
            return np.array([np.linalg.solve(np.diag(stiffness - w**2) + 1j * w * self.D, B) for w in omega])
        return np.asarray(self.B / self.dynamic(omega)[:, :, None])

    def response(self, omega: Floats) -> NDArray[Any]:
        """(nf, p, p) at ``omega`` (nf,) in rad/s."""
        if self.D is not None:
            return np.asarray(self.B.T @ self.states(omega))
        p = self.B.shape[1]
        rows = (self.B[:, :, None] * self.B[:, None, :]).reshape(-1, p * p)
        return product(1.0 / self.dynamic(omega), rows).reshape(-1, p, p)

    def dynamic(self, omega: Floats) -> NDArray[Any]:
        """(nf, n) dynamic stiffness, but for what ``D`` couples; real where there is no damping."""
        w, d = omega[:, None], self.damping.of_modes(self.theta) if self.D is None else np.diag(self.D)
        a = self.theta * (1 + 1j * self.damping.structural) + 1j * w * d - w**2
        return a if a.imag.any() else a.real


class FamilySearch:
    """Families of bases (k, n) in the coordinates of a reference model, and their errors.

    Samples guide and the certificate decides (exchange method): a basis that is cut at the samples is certified over
    the band, and where it fails the worst frequency joins the samples.
    """

    def __init__(
        self, certified: CertifiedReference, omega: Floats, measure: str, tolerance: float, static: bool
    ) -> None:
        problem, reference = certified.problem, certified.model
        self.certified, self.standard, self.reference = certified, certified.standard(), reference
        self.measure, self.tolerance = measure, tolerance
        self.F = reference.F * load_scale(problem.motion_scale, reference.F, reference.F / reference.values[:, None])
        # Inertia loads must not make the errors between interface motions look small, nor the other way round.
        self.counted = (reference.inputs, *([self.F.shape[1]] if self.F.shape[1] > reference.inputs else []))
        self.full_model = ModalModel(theta=reference.values, B=self.F, D=reference.D, damping=reference.damping)
        self.samples: Floats = np.zeros(0)
        self._look_at(omega)
        # In narrow bands some of ``omega`` are equal: those that are looked at are not.
        self.omega = self.samples
        self.size = self._norms(self.full)[:, -1]
        self.fixed = self._orthonormal(self.F / reference.values[:, None]) if static else self.F[:, :0]
        self.chosen: list[float] = []
        self.greedy: Floats | None = None
        self.reached: dict[str, int | None] = {}
        self.worst = Limit(lower=np.inf, upper=np.inf, at_hz=np.nan)

    def _look_at(self, omega: Floats) -> None:
        """Samples at ``omega`` join those at which errors are taken."""
        self.samples = np.unique(np.concatenate([self.samples, omega]))
        self.full = self.full_model.response(self.samples)
        self.scale = self._scale_of(self.full)

    def _scale_of(self, full: NDArray[Any]) -> Floats:
        """(nf, 1 or 2) what errors at the samples are relative to, by the measure."""
        if self.measure == "pointwise":
            return self._norms(full)
        if self.measure == "peak":
            return np.broadcast_to(self._norms(full).max(axis=0), (len(full), len(self.counted)))
        each = np.stack([(self.F[:, :m] ** 2).sum(axis=1) for m in self.counted], axis=1)
        return np.asarray(1 / np.maximum(np.abs(self.full_model.dynamic(self.samples)), np.finfo(float).tiny) @ each)

    def smallest(self, family: str, fewer: int) -> Floats | None:
        """Certified basis of the lowest order, if that is below ``fewer``; ``reached`` tells the order without it."""
        candidates: dict[str, Callable[[float, float], Floats]] = {
            "gramian": self._gramian,
            "krylov": self._krylov,
            "modal": self._modal,
        }
        smallest: Floats | None = None
        self.reached[family] = None
        for exponent in TOL.response_weights if family != "modal" else TOL.response_weights[:1]:
            columns = candidates[family](self.tolerance, exponent)
            order, C = self._certify_columns(
                columns, min(fewer, TOL.no_order if smallest is None else smallest.shape[1])
            )
            if order is not None:
                least = self.reached[family]
                self.reached[family] = order if least is None else min(least, order)
            smallest = C if C is not None else smallest
        return smallest

    def _certify_columns(self, columns: Floats, fewer: int) -> tuple[int | None, Floats | None]:
        """The first of ``columns``, as few as hold the tolerance: their number, at the samples at least, and the
        certified basis where it has ``fewer``."""
        for _ in range(TOL.exchanges):
            C, error = self._cut(columns)
            if error > self.tolerance:
                return None, None
            if C.shape[1] >= fewer:
                return C.shape[1], None
            if self._holds(C):
                return C.shape[1], C
        for order in range(C.shape[1] + 1, min(columns.shape[1] + 1, fewer)):
            if self._holds(columns[:, :order]):
                return order, columns[:, :order]
        return None, None

    def _holds(self, C: Floats) -> bool:
        """True if the tolerance holds on all of the band; if not, the worst frequency joins the samples."""
        low, high = angular_band(self.certified.band_hz)
        verdict = decide(self.standard, self._response(C), low, high, self.measure, self.tolerance)
        if not verdict.holds:
            self._look_at(verdict.at)
            return False
        return True

    def cannot_reach_tolerance(self) -> bool:
        """True if not even all modes of the reference hold the tolerance: what is not known of it counts at zeros."""
        if self.measure != "pointwise" or self._holds(np.eye(len(self.reference.values))):
            return False
        size = self.standard.layout.norms(self.standard.H.at(self.samples))[:, 0]
        e = self.standard.modes.moduli(self.samples)[0] @ self.standard.residue_norms[:, 0]
        self.worst = Limit(lower=0.0, upper=np.inf, at_hz=in_hz(float(self.samples[(size / e).argmin()])))
        return True

    def limit(self, C: Floats, theta: Floats) -> Limit:
        """The certified limit of the body on span(C) whose eigenvalues came out as ``theta`` (n,)."""
        low, high = angular_band(self.certified.band_hz)
        body = self._response(C, theta if len(theta) == C.shape[1] else None)
        asked = self.measure, self.tolerance
        self.worst = compare(self.standard, body, low, high, asked=asked)[0][self.measure]
        return self.worst

    def _response(self, C: Floats, real: Floats | None = None) -> Response:
        """The transfer matrix of the model on span(C)."""
        reduced, layout = self._project_model(C, real)[0], self.standard.layout
        b, theta = reduced.B[:, : self.reference.inputs], reduced.theta
        D = np.diag(reduced.damping.of_modes(theta)) if reduced.D is None else reduced.D
        return response_of(
            np.eye(len(theta)),
            D,
            np.diag(theta),
            b,
            b.T,
            layout,
            structural=reduced.damping.structural,
            highest=2 * np.pi * self.certified.band_hz[1],
        )

    def zero(self, hz: float) -> bool:
        """True if the response is as good as zero at ``hz``."""
        w = 2 * np.pi * np.array([hz])
        e = self.standard.modes.moduli(w)[0] @ self.standard.residue_norms[:, 0]
        return bool(np.linalg.norm(self.standard.H.at(w)) < TOL.zero_response * e[0])

    def _cut(self, columns: Floats) -> tuple[Floats, float]:
        """The first of ``columns``, as few as hold the tolerance at the samples, and their error."""
        lower, upper = self.fixed.shape[1], columns.shape[1]
        error = self.error(columns)
        if error > self.tolerance:
            return columns, error
        while lower < upper:
            middle = (lower + upper) // 2
            tried = self.error(columns[:, :middle])
            if tried <= self.tolerance:
                upper, error = middle, tried
            else:
                lower = middle + 1
        return columns[:, :upper], error

    def error(self, C: Floats) -> float:
        """Largest error at the samples."""
        return float(self.errors(C).max())

    def errors(self, C: Floats) -> Floats:
        """Errors (nf,) at the samples by the measure."""
        if not C.shape[1]:
            return np.ones(len(self.samples))
        difference = self._project_model(C)[0].response(self.samples) - self.full
        errors = np.asarray((self._norms(difference) / self.scale).max(axis=1))
        if errors.max() < self.worst.upper:
            j = int(errors.argmax())
            self.worst = Limit(lower=errors[j], upper=errors[j], at_hz=in_hz(self.samples[j]))
        return errors

    def _norms(self, H: NDArray[np.complex128]) -> Floats:
        """Norms (nf, 2) of the part between interface motions and of the whole of ``H`` (nf, p, p)."""
        return np.stack([np.linalg.norm(H[:, :m, :m], axis=(1, 2)) for m in self.counted], axis=1)

    def _project_model(self, C: Floats, real: Floats | None = None) -> tuple[ModalModel, Floats]:
        """The model on span(C), and its modes (k, n) in those of the reference; ``real`` (n,) replaces its
        eigenvalues."""
        reference = self.reference

        def stiffness(Y: Floats) -> Floats:
            return np.asarray((C @ Y).T @ (reference.values[:, None] * (C @ Y)))

        theta, Y = accurate_eigh(stiffness(np.eye(C.shape[1])), projected=stiffness)
        V = C @ Y
        D = None if reference.D is None else V.T @ reference.D @ V
        return ModalModel(theta=theta if real is None else real, B=V.T @ self.F, D=D, damping=reference.damping), V

    def _orthonormal(self, X: Floats) -> Floats:
        """Orthonormal basis of the columns of ``X``, the dependent ones dropped."""
        size = np.linalg.norm(X, axis=0)
        U, s, _ = sl.svd(X[:, size > 0] / size[size > 0], full_matrices=False)
        return np.asarray(U[:, s > TOL.direction_noise * s[0]])

    def _leading(self, snapshots: Floats) -> Floats:
        """``fixed``, then the principal vectors of the remainder of the snapshots (k, j), in the energy norm."""
        weight = np.sqrt(self.reference.values + self.omega.mean() ** 2)[:, None]
        start = np.linalg.qr(weight * self.fixed)[0]
        X = weight * snapshots
        X = X - start @ (start.T @ X)
        # Of wide snapshots the triangle has the left singular vectors too.
        X = np.asarray(np.linalg.qr(X.T, mode="r")).T if X.shape[1] > 2 * len(X) else X
        U, s, _ = sl.svd(X, full_matrices=False)
        columns = np.hstack([start, U[:, s > TOL.direction_noise * s[0]]]) / weight
        # Nested spans: the first n columns of Q span the first n of these.
        return np.asarray(np.linalg.qr(columns)[0])

    def _weights(self, exponent: float) -> Floats:
        """Quadrature weights (nf,) of the band, times |H| to the ``exponent``."""
        return np.asarray(np.sqrt(trapezoid(self.omega)) * self.size**exponent)

    def _gramian(self, _: float, exponent: float) -> Floats:
        return self._leading(_parts(self.full_model.states(self.omega), self._weights(exponent)))

    def _krylov(self, tolerance: float, exponent: float) -> Floats:
        """Greedy responses, compressed to their principal vectors."""
        if self.greedy is None:
            self.greedy = self._responses(tolerance)
        return self._leading(self.greedy @ self._used_responses(self.greedy, exponent))

    def _responses(self, tolerance: float) -> Floats:
        """Responses of the undamped model (k, n), at 0 Hz first, then where the error is largest."""
        values, shifts = self.reference.values, [0.0]
        for _ in range(TOL.greedy_steps):
            blocks = [self.F / distances_to_shift(values, shift)[:, None] for shift in shifts]
            C = self._orthonormal(np.hstack(blocks))
            errors = self.errors(C)
            # Beside a shift that is there already a new one would add next to nothing.
            near = np.min(np.abs(self.samples[:, None] - np.array(shifts)) / self.samples[-1], axis=1) < 5e-3
            if errors.max() <= tolerance or near.all():
                break
            shifts.append(float(self.samples[np.argmax(np.where(near, 0.0, errors))]))
        self.chosen = shifts
        return C

    def _used_responses(self, C: Floats, exponent: float) -> Floats:
        """Responses over the band in the coordinates of the basis ``C``: what of it is used, and how much."""
        reduced, V = self._project_model(C)
        return np.asarray(C.T @ V @ _parts(reduced.states(self.omega), self._weights(exponent)))

    def _modal(self, _: float, __: float) -> Floats:
        """Static responses first, then modes in the order of their frequencies."""
        static = self._orthonormal(self.F / self.reference.values[:, None])
        return np.asarray(np.linalg.qr(np.hstack([static, np.eye(len(self.F))]))[0][:, : len(self.F)])


def distances_to_shift(values: Floats, shift: float) -> Floats:
    """``values`` - shift^2 (k,), for a shift half a percent higher where it hits a resonance."""
    if (np.abs(np.sqrt(values) - shift) < TOL.on_resonance * shift).any():
        shift *= TOL.shift_move
    return np.asarray(values - shift**2)


def _parts(states: NDArray[Any], weights: Floats) -> Floats:
    """(k, j) of ``states`` (nf, k, p) times ``weights`` (nf,): real and, where there are any, imaginary parts."""
    flat = (states * weights[:, None, None]).transpose(1, 0, 2).reshape(states.shape[1], -1)
    return np.hstack([flat.real, flat.imag]) if np.iscomplexobj(flat) else flat
