"""H2-optimal choice of shifts for few inputs, after SOR-IRKA (Gugercin, Antoulas and Beattie 2008; Wyatt 2012).

V = [Re, Im] of A(sigma_i)^-1 B b_i, sigma_i the mirror images of poles and b_i the directions of their residues:
a second-order model of order n has 2 n poles, of which the first-order iteration on that small model keeps n. A
fixed point is no proven optimum of the second-order problem, so errors are measured and the best model is kept. With
little damping the two columns of a pair are nearly parallel, and n of them follow n / 2 resonances: the n strongest
modes (Varga 1995) are one more candidate.

Everything happens in the modal coordinates of a reference model: no shift costs a factorisation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.base import progress
from morembs.base.errors import InputError
from morembs.base.limits import PositiveCount, RelativeError
from morembs.base.types import Complexes, Floats
from morembs.base.units import angular_band
from morembs.linalg.columns import orthonormal
from morembs.linalg.quadrature import trapezoid
from morembs.linalg.tolerances import TOL as LINALG
from morembs.problem import Problem
from morembs.reducers.base import Basis, elastic_basis
from morembs.reducers.families import OfResponses
from morembs.reducers.problem_summary import ProblemSummary
from morembs.reducers.tolerances import TOL
from morembs.responses.band import Band
from morembs.responses.reference import ModalReference, reference_model

# Places about a resonance, in half power widths, where its peak is sampled.
PEAK = np.array([0.25, 0.5, 1.0, 2.0, 4.0, 8.0])


@dataclass(frozen=True, kw_only=True)
class Irka(OfResponses):
    """Elastic coordinates with a small H2 error of the responses in a band.

    Each pair of shifts takes two coordinates, so with little damping n of them follow n / 2 resonances closely. Where
    the band has more, the n strongest modes are mostly better, and are kept then (``kept`` = "modes"). For the largest
    error rather than the H2 error take ``BalancedTruncation``: half or less with the same order and little damping.

    The recipe says whether the shifts came to rest (``converged``), the relative H2 error in the band of the first and
    of the kept model, and the shifts of the kept one (real and imaginary parts in 1/s; of each conjugate pair the upper
    one; of modes the mirrored poles). Without damping poles have no mirror images off the imaginary axis: H(s + delta)
    is approximated instead, delta in the recipe.

    Args:
        order: number of elastic coordinates.
        band_hz: [low, high], the band in which the error is measured.
        max_steps: maximum number of iterations.
        tolerance: the iteration ends when every shift changes by less than this part of its value.

    >>> Irka(order=6, band_hz=[0.0, 5000.0]).reduce(problem).rigid_count
    6
    """

    method: ClassVar[str] = "irka"
    order: PositiveCount
    band_hz: Band
    max_steps: PositiveCount = 50
    tolerance: RelativeError = 1e-4

    def why_not(self, facts: ProblemSummary) -> str:
        if facts.damping.structural:
            return (
                f'method "{self.method}" follows poles of viscous damping, which structural damping has not; replace '
                'it by rayleigh or modal damping, or take method = "gramian" or "krylov"'
            )
        return super().why_not(facts)

    def _basis(self, problem: Problem) -> Basis:
        low, high = angular_band(self.band_hz)
        reference = reference_model(
            problem, np.linspace(low, high, TOL.reference_samples), tolerance=TOL.reference_error
        )
        if self.order > len(reference.values):
            raise InputError(
                f"order = {self.order} was given; {len(reference.values)} coordinates give the responses in this band "
                f"to {TOL.reference_error:.0e} already: lower the order, or widen band_hz",
                kind="conflict",
                keyword="order",
            )
        band = _Band(reference, low, high)
        runs = [self._run(band, shifts) for shifts in _starts(band, self.order, low, high)]
        met = min(runs, key=lambda run: run.error)
        modes = _of_modes(band, met, self.order)
        progress.update(f"{self.method}: the strongest modes, H2 error {modes.error:.2e}, no shifts")
        best = min(met, modes, key=lambda run: run.error)
        s = best.shifts.s + band.delta
        notes: dict[str, object] = {
            "kept": "shifts" if best is met else "modes",
            "converged": best.change <= self.tolerance,
            "steps": best.steps,
            "kept_step": best.kept,
            "first_h2_error": best.first,
            "h2_error": best.error,
            "shifts": [[float(x.real), float(x.imag)] for x in s],
        }
        if best.change > self.tolerance:
            notes["not_converged"] = f"the shifts still moved by {best.change:.1e}; the best model met was kept"
        if band.delta:
            notes["delta"] = band.delta
        if best.C.shape[1] < self.order:
            notes["deflated"] = f"{self.order - best.C.shape[1]} of {self.order} columns depend on the others"
        return elastic_basis(problem, reference.vectors(best.C), "krylov", notes)

    def _run(self, band: _Band, shifts: _Shifts) -> _Run:
        """The iteration from one start, and the best model on its way."""
        errors: list[float] = []
        best, kept, change = band.columns(shifts), shifts, np.inf
        for step in range(self.max_steps + 1):
            X = band.columns(shifts)
            errors.append(band.error(X))
            progress.update(f"{self.method}: step {step}, H2 error {errors[-1]:.2e}, shifts move by {change:.1e}")
            if errors[-1] == min(errors):
                best, kept = X, shifts
            if change <= self.tolerance or step == self.max_steps:
                break
            moved = band.next_shifts(X, shifts)
            change, shifts = _change(shifts, moved), moved
        return _Run(
            C=best,
            shifts=kept,
            first=errors[0],
            error=min(errors),
            kept=int(np.argmin(errors)),
            steps=len(errors) - 1,
            change=change,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Shifts:
    """``s`` (k,), imaginary parts not negative (those above zero stand for a pair), with directions ``b`` (k, m)."""

    s: Complexes
    b: Complexes


@dataclass(frozen=True, kw_only=True, eq=False)
class _Run:
    """Best model ``C`` (k, n) met in ``steps`` steps, at step ``kept``, with its ``shifts`` and errors."""

    C: Floats
    shifts: _Shifts
    first: float
    error: float
    kept: int
    steps: int
    change: float


class _Band:
    """The reference with s moved by ``delta`` (M = I, K + delta D + delta^2, D + 2 delta), and its response."""

    def __init__(self, reference: ModalReference, low: float, high: float) -> None:
        self.reference = reference
        values, d = reference.values, reference.damping_of_modes()
        inside = values <= (TOL.modes_beyond * high) ** 2
        inside[0] = True
        light = bool((d[inside] < 2 * TOL.light_damping * np.sqrt(values[inside])).any())
        self.delta = delta = TOL.light_offset * high if light else 0.0
        # What the damping of the peaks is when s has moved.
        self.decay = 0.5 * d + delta
        self.B = reference.B * reference.problem.motion_scale
        width = self.decay[inside, None] * PEAK
        middle = np.sqrt(values[inside, None])
        every = np.concatenate(
            [np.linspace(low, high, TOL.measured_samples), *(middle - width), *(middle + width), middle[:, 0]]
        )
        self.omega = np.unique(every[(every >= low) & (every <= high)])
        self.weight = trapezoid(self.omega)
        self.H = self.B.T @ self.states(1j * self.omega, self.B)
        self.size = self._norm(self.H)

    def states(self, s: Complexes, F: NDArray[Any]) -> Complexes:
        """A(s + delta)^-1 F (ns, k, p)."""
        return self.reference.states(s + self.delta, F)

    def project(self, X: Floats) -> tuple[Floats, Floats, Floats]:
        """K, D (n, n) and B (n, m) of the model on ``X`` (k, n), damped as the reducer damps it, s moved."""
        reference, eye = self.reference, np.eye(X.shape[1])
        K = X.T @ (reference.values[:, None] * X)
        none = np.zeros((len(K), 0))
        D = reference.problem.damping.matrix(eye, K, none) if reference.D is None else X.T @ reference.D @ X
        return K + self.delta * D + self.delta**2 * eye, D + 2 * self.delta * eye, X.T @ self.B

    def _norm(self, H: Complexes) -> float:
        return float(np.sqrt(self.weight @ np.linalg.norm(H, axis=(1, 2)) ** 2 / np.pi))

    def columns(self, shifts: _Shifts) -> Floats:
        """Orthonormal columns (k, n) of [Re, Im] of the states at the shifts."""
        parts = []
        for s, b in zip(shifts.s, shifts.b, strict=True):
            x = self.states(np.array([s]), (self.B @ b)[:, None])[0]
            parts += [x.real, x.imag] if s.imag else [x.real]
        return np.asarray(orthonormal(np.hstack(parts), None, passes=LINALG.krylov_passes))

    def error(self, X: Floats) -> float:
        """Relative H2 error in the band of the model on ``X``."""
        K, D, B = self.project(X)
        w = self.omega[:, None, None]
        A = K + 1j * w * D - w**2 * np.eye(len(K))
        h = B.T @ np.linalg.solve(A, np.broadcast_to(B.astype(complex), (len(w), *B.shape)))
        return self._norm(h - self.H) / self.size

    def next_shifts(self, X: Floats, shifts: _Shifts) -> _Shifts:
        """Mirrored poles of the first-order model of order n that is optimal for the second-order one on ``X``."""
        K, D, B = self.project(X)
        n = len(K)
        eye, zero = np.eye(n), np.zeros((n, n))
        # A symmetric form of first order, so that one space serves both sides: E x' = A x + F u, y = F'x. The
        # frequency c gives velocities the unit of motions.
        c = float(np.sqrt(np.trace(K) / n))
        E = np.block([[D, c * eye], [c * eye, zero]])
        A = np.block([[-K, zero], [zero, c**2 * eye]])
        F = np.vstack([B, np.zeros_like(B)])
        for _ in range(TOL.inner_steps):
            moved = _mirrored_poles(E, A, F, shifts)
            change, shifts = _change(shifts, moved), moved
            if change <= TOL.inner_tolerance:
                break
        return shifts


def _mirrored_poles(E: Floats, A: Floats, F: Floats, shifts: _Shifts) -> _Shifts:
    """One step of first-order IRKA for E x' = A x + F u, y = F'x with symmetric E and A."""
    parts = []
    for s, b in zip(shifts.s, shifts.b, strict=True):
        x = np.linalg.solve(s * E - A, (F @ b)[:, None])
        parts += [x.real, x.imag] if s.imag else [x.real]
    V = np.asarray(orthonormal(np.hstack(parts), None, passes=LINALG.krylov_passes))
    poles, X = sl.eig(V.T @ A @ V, V.T @ E @ V)
    good = np.isfinite(poles) & (poles.imag >= 0)
    poles, G = poles[good], (X[:, good].T @ (V.T @ F)).conj()
    G /= np.maximum(np.linalg.norm(G, axis=1, keepdims=True), np.finfo(float).tiny)
    # The upper of a mirrored pair belongs to the lower pole; poles on the wrong side are mirrored to the right too.
    s = np.abs(poles.real) + 1j * poles.imag
    order = np.lexsort((s.real, s.imag))
    real = s.imag == 0
    G[real] = G[real].real
    return _Shifts(s=s[order], b=G[order])


def _starts(band: _Band, order: int, low: float, high: float) -> list[_Shifts]:
    """Pairs spread over the band, and pairs at the modes that respond most; for an odd order one real shift too.

    The iteration finds the next fixed point only, which for a few sharp resonances depends on the start.
    """
    pairs, reference = order // 2, band.reference
    spread = low + (high - low) * (np.arange(pairs) + 0.5) / max(pairs, 1)
    omega = np.sqrt(reference.values)
    inside = np.flatnonzero((omega >= low) & (omega <= high))
    strongest = omega[inside[np.argsort(-_strength(band)[inside], kind="stable")[:pairs]]]
    # Where the band has fewer modes than pairs, the others are spread.
    chosen = [spread, np.append(strongest, spread[: pairs - len(strongest)])]
    return [_first_shifts(band, np.sort(w), 0.5 * (low + high) if order % 2 else None) for w in chosen]


def _strength(band: _Band) -> Floats:
    """H2 norm (k,) of the response of each mode alone, up to a factor."""
    return np.asarray(np.linalg.norm(band.B, axis=1) ** 2 / np.sqrt(band.reference.values * band.decay))


def _of_modes(band: _Band, met: _Run, order: int) -> _Run:
    """The model of the ``order`` strongest modes in place of the best one ``met``; its shifts are mirrored poles."""
    first = np.sort(np.argsort(-_strength(band), kind="stable")[:order])
    X, values, decay = np.eye(len(band.B))[:, first], band.reference.values[first], band.decay[first]
    imaginary = np.sqrt(values - np.minimum((decay - band.delta) ** 2, values))
    shifts = _Shifts(s=decay + 1j * imaginary, b=band.B[first].astype(complex))
    return replace(met, C=X, shifts=shifts, error=band.error(X))


def _first_shifts(band: _Band, omega: Floats, real: float | None) -> _Shifts:
    """Lightly damped shifts at ``omega`` and one at ``real``, in the directions of the largest response there."""
    s = TOL.first_shift_ratio * omega + 1j * omega
    if real is not None:
        s = np.append(real + 0j, s)
    H = band.B.T @ band.states(s, band.B)
    directions = [np.linalg.svd(h if x.imag else h.real)[2][0].conj() + 0j for x, h in zip(s, H, strict=True)]
    return _Shifts(s=s, b=np.array(directions))


def _change(old: _Shifts, new: _Shifts) -> float:
    """Largest move of a shift, relative to it."""
    if len(old.s) != len(new.s):
        return np.inf
    return float((np.abs(new.s - old.s) / np.abs(old.s)).max())
