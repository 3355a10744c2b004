"""One tolerance in: the family, the frequencies and the order follow from it.

Everything happens in the modal coordinates of the reference model, where a reduced model of any family is a small
matrix C (k, n) and the residual bound of its transfer matrix takes small products only. Three families stand for
search, each cut to its smallest order that meets the tolerance over the band:

- "gramian": leading vectors of the responses over the band (Lehner 2007; Fehr and Eberhard 2010) in the energy inner
  product, with the best of some weights;
- "krylov": responses at frequencies chosen where the error is largest, one after the other, until the tolerance
  holds (greedy, after Fehr, Fischer, Haasdonk and Eberhard 2013), then compressed;
- "modal": modes of the band with the residual static responses (Rubin 1975).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.errors import InputError, SolverError
from morembs.linalg.eigen import graded_modes
from morembs.problem import SOFTER, Problem
from morembs.problem.damping import Damping
from morembs.progress import Progress
from morembs.reducers.base import Basis, elastic_basis
from morembs.reducers.families import OfResponses
from morembs.responses.band import band_frequencies, beyond, checked_band, round_off
from morembs.responses.reference import Reference, product, reference_model

Floats = NDArray[np.float64]
# The reference is better than the tolerance by this factor, at least as good as FINE, and no better than FINEST.
BETTER, FINE, FINEST = 1e-3, 1e-10, 1e-14
# With jumps in a modal table it is better by this factor at least.
BETTER_JUMPS = 0.1
KINDS = {"gramian": "gramian", "krylov": "krylov", "modal": "elastic"}
# Directions whose share of the leading one is below this are round-off.
NOISE = 1e-13
GREEDY_STEPS = 40
# Responses weighted with |H| to these powers: relative errors ask for -1, resonances lose by it.
WEIGHTS = (-0.5, 0.0, -1.0)


@dataclass(frozen=True, kw_only=True)
class AutoReducer(OfResponses):
    """The smallest body whose transfer matrix is within ``tolerance`` over ``band_hz``.

    ``tolerance`` bounds the Frobenius norm of the error relative to that of the full model, at every frequency
    of the band and beside its resonances; for undamped models, Rayleigh and structural damping by the residual bound,
    otherwise as measured. ``static_exact`` keeps the static responses to interface loads, ``inertia_loads`` those to
    the inertia of a moving frame (of a model that is held somewhere they are followed in any case).
    """

    method: ClassVar[str] = "auto"
    of_reference: ClassVar[float] = 4.0
    band_hz: list[float]
    tolerance: float
    static_exact: bool = False
    inertia_loads: bool = False

    def __post_init__(self) -> None:
        checked_band(self.band_hz)
        if not 0 < self.tolerance < 1:
            raise InputError(f"tolerance = {self.tolerance} was given; expected a relative error between 0 and 1")

    @property
    def computes_modes(self) -> bool:
        return True

    @property
    def certified_band(self) -> Sequence[float]:
        return self.band_hz

    def _basis(self, problem: Problem, progress: Progress) -> Basis:
        omega = 2 * np.pi * band_frequencies(problem, self.band_hz)
        # A body that is held has no rigid motion to balance the inertia of its frame.
        inertia = self.inertia_loads or problem.rigid.shape[1] < 6
        fine = max(min(BETTER * self.tolerance, FINE), FINEST)
        try:
            reference = reference_model(problem, omega, tolerance=fine, inertia_loads=inertia, progress=progress)
        except SolverError as fault:
            raise SolverError(f"tolerance = {self.tolerance:g} cannot be certified: {fault}") from fault
        if len(problem.damping.jumps) and reference.error > BETTER_JUMPS * self.tolerance:
            raise SolverError(
                f"tolerance = {self.tolerance:g} cannot be certified: the full response is known to "
                f"{reference.error:.1e} only, as the modal damping table jumps beside modes that are not resolved; "
                "raise the tolerance, or let the ratio jump elsewhere"
            )
        lost = self._round_off(problem, reference, omega)
        if lost > self.tolerance:
            raise SolverError(
                f"tolerance = {self.tolerance:g} cannot be certified: round-off in the stiffness matrix moves the full "
                f"response by {lost:.1e}; {SOFTER}, or raise the tolerance"
            )
        search = _FamilySearch(problem, reference, omega, self.static_exact)
        found, best, reached = None, "", np.inf
        orders: dict[str, object] = {}
        for family in KINDS:
            progress.update(f"order of the {family} basis")
            C, error = search.smallest(family, self.tolerance)
            orders[family] = "not reached" if error > self.tolerance else C.shape[1]
            reached = min(reached, error)
            if error <= self.tolerance and (found is None or C.shape[1] < found.shape[1]):
                found, best = C, family
        if found is None:
            raise self._unreachable(reached)
        notes = {"family": best, "orders": orders, "reference_order": len(reference.values),
                 "choice": _words(best, orders, self.band_hz, self.tolerance)}  # fmt: skip
        if best == "krylov":
            notes["frequencies_hz"] = [float(w / (2 * np.pi)) for w in search.chosen]
        basis = elastic_basis(problem, reference.vectors(found), KINDS[best], notes)
        real = search.measured(found, np.diag(basis.K)[problem.rigid.shape[1] :])
        if real > self.tolerance:
            raise self._unreachable(real)
        return basis

    def _round_off(self, problem: Problem, reference: Reference, omega: Floats) -> float:
        modes = problem.elastic_modes(below=beyond(self.band_hz[1]))
        return float(round_off(problem, modes, omega, float(reference.values[-1])).max())

    def _unreachable(self, error: float) -> InputError:
        return InputError(
            f"tolerance = {self.tolerance:g} cannot be reached from {self.band_hz[0]:g} to {self.band_hz[1]:g} Hz; the "
            f"smallest error found is {error:.1e}, where the round-off of the full model begins; raise the tolerance, "
            "or give an undamped model damping"
        )


def _words(best: str, orders: dict[str, object], band_hz: list[float], tolerance: float) -> str:
    others = ", ".join(f"{name} {order}" for name, order in orders.items() if name != best)
    return (
        f"{best} basis of {orders[best]} elastic coordinates, the smallest found that keeps {tolerance:g} from "
        f"{band_hz[0]:g} to {band_hz[1]:g} Hz ({others})"
    )


def _better(one: tuple[Floats, float], other: tuple[Floats, float], tolerance: float) -> bool:
    """Whether ``one`` holds the tolerance with fewer columns, or comes nearer to it where none does."""
    (C, error), (D, least) = one, other
    if error <= tolerance and least <= tolerance:
        return bool(C.shape[1] < D.shape[1])
    return error < least


@dataclass(frozen=True, kw_only=True, eq=False)
class _Small:
    """A reduced model in its modal coordinates: ``V`` (k, n) in those of the reference, ``B`` (n, p) loads."""

    V: Floats
    theta: Floats
    B: Floats
    D: Floats | None
    damping: Damping

    def state(self, w: float) -> NDArray[Any]:
        """(n, p) at ``w`` rad/s, real where there is no damping."""
        if self.D is not None:
            A = np.diag(self.theta - w**2) + 1j * w * self.D
            return np.asarray(np.linalg.solve(A, self.B.astype(complex)))
        a = self.theta * (1 + 1j * self.damping.structural) + 1j * w * self.damping.of_modes(self.theta) - w**2
        return np.asarray(self.B / (a if a.imag.any() else a.real)[:, None])


class _FamilySearch:
    """Families of bases (k, n) in the coordinates of a reference model, and their errors."""

    def __init__(self, problem: Problem, reference: Reference, omega: Floats, static: bool) -> None:
        self.reference, self.omega = reference, omega
        scale = np.ones(reference.F.shape[1])
        scale[: reference.inputs] = problem.motion_scale
        # Inertia loads count as much as the interface loads, whatever their units.
        energy = np.sqrt(np.einsum("ij,ij->j", reference.F * scale, reference.F * scale / reference.values[:, None]))
        scale[reference.inputs :] *= energy[: reference.inputs].max() / energy[reference.inputs :]
        self.F = reference.F * scale
        self.known = reference.values <= beyond(float(omega[-1]) / (2 * np.pi))
        self.cut = beyond(float(omega[-1]) / (2 * np.pi))
        full = self._full()
        # Inertia loads must not make the errors between interface motions look small, nor the other way round.
        self.counted = (reference.inputs, *([self.F.shape[1]] if self.F.shape[1] > reference.inputs else []))
        self.sizes = self._norms(full)
        self.size = self.sizes[:, -1]
        self.worst_first = np.arange(len(omega))[::-1]
        # Only undamped models, Rayleigh and structural damping have a bound; for others the errors are measured.
        self.full = full if reference.damping.is_modal or reference.D is not None else None
        self.fixed = self._orthonormal(self.F / reference.values[:, None]) if static else self.F[:, :0]
        self.chosen: list[float] = []
        self.greedy: Floats | None = None

    def smallest(self, family: str, tolerance: float) -> tuple[Floats, float]:
        """Basis of the lowest order with an error below ``tolerance`` and that error; the best found if none has."""
        made: dict[str, Callable[[float, float], Floats]] = {
            "gramian": self._gramian, "krylov": self._krylov, "modal": self._modal,
        }  # fmt: skip
        found: tuple[Floats, float] | None = None
        for exponent in WEIGHTS if family != "modal" else WEIGHTS[:1]:
            tried = self._cut(made[family](tolerance, exponent), tolerance)
            if found is None or _better(tried, found, tolerance):
                found = tried
        return found if found is not None else (self.fixed, np.inf)

    def _cut(self, columns: Floats, tolerance: float) -> tuple[Floats, float]:
        """The first of ``columns``, as few as hold the tolerance, and their error."""
        few, many = self.fixed.shape[1], columns.shape[1]
        error = self.error(columns)
        if error > tolerance:
            return columns, error
        while few < many:
            middle = (few + many) // 2
            tried = self._exceeds(columns[:, :middle], tolerance)
            if tried <= tolerance:
                many, error = middle, tried
            else:
                few = middle + 1
        return columns[:, :many], error

    def error(self, C: Floats) -> float:
        """Largest error over the band."""
        return float(self.errors(C).max())

    def errors(self, C: Floats) -> Floats:
        """Errors (nf,) relative to |H|: the residual bound, or as measured where the damping allows no bound."""
        if not C.shape[1]:
            return np.ones(len(self.omega))
        reduced = self._reduced(C)
        found = np.array([self._error_at(j, reduced) for j in range(len(self.omega))])
        self.worst_first = np.argsort(-found, kind="stable")
        return found

    def _exceeds(self, C: Floats, tolerance: float) -> float:
        """Largest error over the band, or the first found above ``tolerance``."""
        if not C.shape[1]:
            return 1.0
        reduced, worst = self._reduced(C), 0.0
        # Where the last basis was worst this one is most likely too far off.
        for j in self.worst_first.tolist():
            worst = max(worst, self._error_at(j, reduced))
            if worst > tolerance:
                break
        return worst

    def _error_at(self, j: int, reduced: _Small) -> float:
        """Error at the frequency ``j``."""
        reference, values, w = self.reference, self.reference.values, float(self.omega[j])
        u = product(reduced.V, reduced.state(w))
        if self.full is not None:
            off = self.full[j] - self.F.T @ u
            return float(max(np.linalg.norm(off[:m, :m]) / self.sizes[j, i] for i, m in enumerate(self.counted)))
        a = values * (1 + 1j * reference.damping.structural) - w**2 + 1j * w * reference.damping_of_modes()
        a = a if a.imag.any() else a.real
        r = self.F - a[:, None] * u
        seen = r[self.known].T @ (r[self.known] / a[self.known, None])
        tail = r[~self.known] / np.sqrt(values[~self.known])[:, None]
        gram = tail.conj().T @ tail
        gamma = self.cut / (self.cut - w**2)
        found = 0.0
        for i, m in enumerate(self.counted):
            # Frobenius and spectral norm of the tail from its Gram matrix.
            top = sl.eigvalsh(gram[:m, :m], subset_by_index=[m - 1, m - 1])[0]
            rest = np.sqrt(max(float(np.trace(gram[:m, :m]).real), 0.0) * max(float(top), 0.0))
            found = max(found, float(np.linalg.norm(seen[:m, :m]) + gamma * rest) / float(self.sizes[j, i]))
        return found

    def measured(self, C: Floats, theta: Floats) -> float:
        """Largest error over the band of the body on span(C) whose eigenvalues came out as ``theta`` (n,)."""
        full = self._full()
        reduced = self._reduced(C, theta if len(theta) == C.shape[1] else None)
        seen = self.F.T @ reduced.V
        H = np.array([product(seen, reduced.state(float(w))) for w in self.omega])
        return float((self._norms(full - H) / self.sizes).max())

    def _norms(self, H: NDArray[np.complex128]) -> Floats:
        """Norms (nf, 2) of the part between interface motions and of the whole of ``H`` (nf, p, p)."""
        return np.stack([np.linalg.norm(H[:, :m, :m], axis=(1, 2)) for m in self.counted], axis=1)

    def _full(self) -> NDArray[Any]:
        """H (nf, p, p) of the reference model."""
        return np.array([self.F.T @ self._states(w) for w in self.omega])

    def _states(self, w: float) -> NDArray[Any]:
        """(k, p) modal coordinates of the reference model at ``w`` rad/s, real ones where there is no damping."""
        X = self.reference.states(np.array([1j * w]), self.F)[0]
        return np.asarray(X if X.imag.any() else X.real)

    def _reduced(self, C: Floats, real: Floats | None = None) -> _Small:
        """The model on span(C); ``real`` (n,) replaces its eigenvalues."""
        reference = self.reference

        def stiffness(Y: Floats) -> Floats:
            return np.asarray((C @ Y).T @ (reference.values[:, None] * (C @ Y)))

        theta, Y = graded_modes(stiffness(np.eye(C.shape[1])), projected=stiffness)
        V = C @ Y
        D = None if reference.D is None else V.T @ reference.D @ V
        return _Small(V=V, theta=theta if real is None else real, B=V.T @ self.F, D=D, damping=reference.damping)

    def _orthonormal(self, X: Floats) -> Floats:
        """Orthonormal basis of the columns of ``X``, the dependent ones dropped."""
        size = np.linalg.norm(X, axis=0)
        U, s, _ = sl.svd(X[:, size > 0] / size[size > 0], full_matrices=False)
        return np.asarray(U[:, s > NOISE * s[0]])

    def _leading(self, snapshots: Floats) -> Floats:
        """``fixed`` and behind it the principal vectors of the rest of the snapshots (k, j), in the energy norm."""
        weight = np.sqrt(self.reference.values + self.omega.mean() ** 2)[:, None]
        start = np.linalg.qr(weight * self.fixed)[0]
        X = weight * snapshots
        X = X - start @ (start.T @ X)
        # Of wide snapshots the triangle has the left singular vectors too.
        X = np.asarray(np.linalg.qr(X.T, mode="r")).T if X.shape[1] > 2 * len(X) else X
        U, s, _ = sl.svd(X, full_matrices=False)
        columns = np.hstack([start, U[:, s > NOISE * s[0]]]) / weight
        # Nested spans: the first n columns of Q span the first n of these.
        return np.asarray(np.linalg.qr(columns)[0])

    def _weights(self, exponent: float) -> Floats:
        """Quadrature weights (nf,) of the band, times |H| to the ``exponent``."""
        return np.asarray(np.sqrt(np.gradient(self.omega)) * self.size**exponent)

    def _gramian(self, _: float, exponent: float) -> Floats:
        weights = self._weights(exponent)
        return self._leading(_parts([self._states(w) * weight for w, weight in zip(self.omega, weights, strict=True)]))

    def _krylov(self, tolerance: float, exponent: float) -> Floats:
        """Greedy responses, compressed to their principal vectors."""
        if self.greedy is None:
            self.greedy = self._responses(tolerance)
        return self._leading(self.greedy @ self._seen(self.greedy, exponent))

    def _responses(self, tolerance: float) -> Floats:
        """Responses of the undamped model (k, n), at 0 Hz first, then where the error is largest."""
        values, shifts = self.reference.values, [0.0]
        for _ in range(GREEDY_STEPS):
            blocks = [self.F / _apart(values - shift**2, NOISE * values)[:, None] for shift in shifts]
            C = self._orthonormal(np.hstack(blocks))
            errors = self.errors(C)
            # Beside a shift that is there already a new one would add next to nothing.
            near = np.min(np.abs(self.omega[:, None] - np.array(shifts)) / self.omega[-1], axis=1) < 5e-3
            if errors.max() <= tolerance or near.all():
                break
            shifts.append(float(self.omega[np.argmax(np.where(near, 0.0, errors))]))
        self.chosen = shifts
        return C

    def _seen(self, C: Floats, exponent: float) -> Floats:
        """Responses over the band in the coordinates of the basis ``C``: what of it is used, and how much."""
        reduced, weights = self._reduced(C), self._weights(exponent)
        states = [reduced.state(w) * weight for w, weight in zip(self.omega, weights, strict=True)]
        return np.asarray(C.T @ reduced.V @ _parts(states))

    def _modal(self, _: float, __: float) -> Floats:
        """Static responses first, then modes in the order of their frequencies."""
        static = self._orthonormal(self.F / self.reference.values[:, None])
        return np.asarray(np.linalg.qr(np.hstack([static, np.eye(len(self.F))]))[0][:, : len(self.F)])


def _apart(a: Floats, least: Floats) -> Floats:
    """``a`` (k,), kept ``least`` (k,) away from zero: beside a resonance that a shift hits."""
    return np.where(np.abs(a) < least, least, a)


def _parts(states: Sequence[NDArray[Any]]) -> Floats:
    """Real and, where there are any, imaginary parts of ``states`` (k, p) each, side by side."""
    flat = np.concatenate(states, axis=1)
    return np.hstack([flat.real, flat.imag]) if np.iscomplexobj(flat) else flat
