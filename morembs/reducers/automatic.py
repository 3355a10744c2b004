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

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
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
from morembs.responses.band import band_frequencies, checked_band
from morembs.responses.certified import TOLERANCE, CertifiedReference, certified_reference, checked_floor, floor_of
from morembs.responses.measures import Limit, checked_measure, compare, decide
from morembs.responses.pencils import terms_of
from morembs.responses.rational import Terms
from morembs.responses.reference import Reference, product, reference_model

Floats = NDArray[np.float64]
# The reference is better than the tolerance by this factor, at least as good as FINE, and no better than FINEST.
BETTER, FINE, FINEST = 1e-3, 1e-10, 1e-14
KINDS = {"gramian": "gramian", "krylov": "krylov", "modal": "elastic"}
# Directions whose share of the leading one is below this are round-off.
NOISE = 1e-13
GREEDY_STEPS = 40
# Times that a worst frequency joins the samples before columns are added one by one.
EXCHANGES = 5
# More columns than any basis has.
MANY = 1_000_000
# A tolerance is not kept below this times the round-off of the model.
LOST_PARTS = 3.0
# No larger one is advised.
RAISED = 0.5
# A response below this part of its envelope is a zero; a shift that is a resonance up to this part of it hits it.
ZERO, HITS = 1e-3, 1e-6
# Responses weighted with |H| to these powers: relative errors ask for -1, resonances lose by it.
WEIGHTS = (-0.5, 0.0, -1.0)


@dataclass(frozen=True, kw_only=True)
class AutoReducer(OfResponses):
    """The smallest body whose transfer matrix is within ``tolerance`` over ``band_hz``.

    ``tolerance`` bounds the error by ``measure`` ("envelope", "peak" or "pointwise") at every frequency of the band,
    certified as in ``certify``; ``damping_floor`` as there. ``static_exact`` keeps the static responses to interface
    loads, ``inertia_loads`` those to the inertia of a moving frame (of a model that is held somewhere they are followed
    in any case).
    """

    method: ClassVar[str] = "auto"
    of_reference: ClassVar[float] = 4.0
    band_hz: list[float]
    tolerance: float
    static_exact: bool = False
    inertia_loads: bool = False
    measure: str = "envelope"
    damping_floor: float | None = None

    def __post_init__(self) -> None:
        checked_band(self.band_hz)
        if not 0 < self.tolerance < 1:
            raise InputError(f"tolerance = {self.tolerance} was given; expected a relative error between 0 and 1")
        checked_measure(self.measure)
        if self.damping_floor is not None:
            checked_floor(self.damping_floor)

    @property
    def computes_modes(self) -> bool:
        return True

    @property
    def certified_band(self) -> Sequence[float]:
        return self.band_hz

    def _basis(self, problem: Problem, progress: Progress) -> Basis:
        floor = floor_of(problem, self.damping_floor)
        omega = 2 * np.pi * band_frequencies(problem, self.band_hz, floor=floor)
        # A body that is held has no rigid motion to balance the inertia of its frame.
        inertia = self.inertia_loads or problem.rigid.shape[1] < 6
        fine = max(min(BETTER * self.tolerance, FINE), FINEST)
        try:
            certified = certified_reference(
                problem, self.band_hz, tolerance=min(BETTER * self.tolerance, TOLERANCE), damping_floor=floor,
                inertia_loads=inertia, progress=progress,
            )  # fmt: skip
            self._refuse_lost(certified)
            reference = reference_model(problem, omega, tolerance=fine, inertia_loads=inertia, progress=progress)
        except SolverError as fault:
            raise SolverError(f"tolerance = {self.tolerance:g} cannot be certified: {fault}") from fault
        search = _FamilySearch(certified, reference, omega, self.measure, self.tolerance, self.static_exact)
        found: dict[str, Floats] = {}
        orders: dict[str, object] = {}
        for family in KINDS:
            progress.update(f"order of the {family} basis")
            fewer = min((C.shape[1] for C in found.values()), default=MANY)
            C = search.smallest(family, fewer)
            orders[family] = "not reached" if search.reached[family] is None else search.reached[family]
            if C is not None:
                found = {family: C}
        if not found:
            raise self._unreachable(search)
        ((best, C),) = found.items()
        notes = {"family": best, "orders": orders, "reference_order": len(reference.values),
                 "measure": self.measure, "damping_floor": floor,
                 "choice": _words(best, orders, self.band_hz, self.tolerance)}  # fmt: skip
        if best == "krylov":
            notes["frequencies_hz"] = [float(w / (2 * np.pi)) for w in search.chosen]
        basis = elastic_basis(problem, reference.vectors(C), KINDS[best], notes)
        limit = search.limit(C, np.diag(basis.K)[problem.rigid.shape[1] :])
        if limit.upper > self.tolerance:
            raise self._unreachable(search)
        return replace(basis, notes={**notes, "certified": limit.upper})

    def _refuse_lost(self, certified: CertifiedReference) -> None:
        """Refuse what round-off, or resonances without damping, make impossible.

        Raises:
            InputError: an undamped resonance.
            SolverError: a tolerance below round-off.
        """
        if not np.isfinite(certified.off).all():
            raise InputError(
                "a transfer error of an undamped model has no bound at its resonances; give damping, or a "
                "damping_floor such as 0.01"
            )
        lost, at_hz = certified.lost()
        least = LOST_PARTS * lost
        if self.tolerance < least:
            # Above it by what two digits may take off.
            raising = f"raise the tolerance to {1.05 * least:.1e} or more, or " if least < RAISED else ""
            raise SolverError(
                f"round-off in the stiffness of this model alone may be {lost:.1e} of its response at {at_hz:,.6g} Hz, "
                f"and {LOST_PARTS:g} times that has to be allowed; {raising}{SOFTER}"
            )

    def _unreachable(self, search: _FamilySearch) -> InputError:
        at_hz = search.worst.at_hz
        if self.measure == "pointwise" and search.zero(at_hz):
            return InputError(
                f"tolerance = {self.tolerance:g} cannot be reached pointwise: H has a zero at {at_hz:,.6g} Hz; take "
                'measure = "envelope"'
            )
        least = search.worst.upper
        found = (
            f"the smallest error found is {least:.1e}, where the round-off of the full model begins"
            if least > self.tolerance
            else f"bodies come to {least:.1e} at single frequencies, but round-off keeps their certificate above it"
        )
        return InputError(
            f"tolerance = {self.tolerance:g} cannot be reached from {self.band_hz[0]:g} to {self.band_hz[1]:g} Hz; "
            f"{found}; raise the tolerance"
        )


def _words(best: str, orders: dict[str, object], band_hz: list[float], tolerance: float) -> str:
    others = ", ".join(f"{name} {order}" for name, order in orders.items() if name != best)
    return (
        f"{best} basis of {orders[best]} elastic coordinates, the smallest found that keeps {tolerance:g} from "
        f"{band_hz[0]:g} to {band_hz[1]:g} Hz ({others})"
    )


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
    """Families of bases (k, n) in the coordinates of a reference model, and their errors.

    Samples guide and the certificate decides (exchange method): a basis that is cut at the samples is certified over
    the band, and where it fails the worst frequency joins the samples.
    """

    def __init__(
        self, certified: CertifiedReference, reference: Reference, omega: Floats, measure: str, tolerance: float,
        static: bool,
    ) -> None:  # fmt: skip
        problem, damping = reference.problem, certified.damping
        self.certified, self.standard = certified, certified.standard()
        self.reference = reference = replace(reference, damping=damping)
        self.omega, self.measure, self.tolerance = omega, measure, tolerance
        scale = np.ones(reference.F.shape[1])
        scale[: reference.inputs] = problem.motion_scale
        # Inertia loads count as much as the interface loads, whatever their units.
        energy = np.sqrt(np.einsum("ij,ij->j", reference.F * scale, reference.F * scale / reference.values[:, None]))
        scale[reference.inputs :] *= energy[: reference.inputs].max() / energy[reference.inputs :]
        self.F = reference.F * scale
        # Inertia loads must not make the errors between interface motions look small, nor the other way round.
        self.counted = (reference.inputs, *([self.F.shape[1]] if self.F.shape[1] > reference.inputs else []))
        self.looked: Floats = np.zeros(0)
        self._look_at(omega)
        self.size = self._norms(self.full)[:, -1]
        self.fixed = self._orthonormal(self.F / reference.values[:, None]) if static else self.F[:, :0]
        self.chosen: list[float] = []
        self.greedy: Floats | None = None
        self.reached: dict[str, int | None] = {}
        self.worst = Limit(lower=np.inf, upper=np.inf, at_hz=np.nan)

    def _look_at(self, omega: Floats) -> None:
        """Samples at ``omega`` join those at which errors are taken."""
        self.looked = np.unique(np.concatenate([self.looked, omega]))
        self.full = np.array([self.F.T @ self._states(w) for w in self.looked])
        self.sizes = self._sizes(self.full)
        self.worst_first = np.arange(len(self.looked))[::-1]

    def _sizes(self, full: NDArray[Any]) -> Floats:
        """(nf, 1 or 2) what errors at the samples are relative to, by the measure."""
        if self.measure == "pointwise":
            return self._norms(full)
        if self.measure == "peak":
            return np.broadcast_to(self._norms(full).max(axis=0), (len(full), len(self.counted)))
        reference, w = self.reference, self.looked[:, None]
        a = reference.values * (1 + 1j * reference.damping.structural) - w**2 + 1j * w * reference.damping_of_modes()
        each = np.stack([(self.F[:, :m] ** 2).sum(axis=1) for m in self.counted], axis=1)
        return np.asarray(1 / np.maximum(np.abs(a), np.finfo(float).tiny) @ each)

    def smallest(self, family: str, fewer: int) -> Floats | None:
        """Certified basis of the lowest order, if that is below ``fewer``; ``reached`` tells the order without it."""
        made: dict[str, Callable[[float, float], Floats]] = {
            "gramian": self._gramian, "krylov": self._krylov, "modal": self._modal,
        }  # fmt: skip
        found: Floats | None = None
        self.reached[family] = None
        for exponent in WEIGHTS if family != "modal" else WEIGHTS[:1]:
            columns = made[family](self.tolerance, exponent)
            order, C = self._certified(columns, min(fewer, MANY if found is None else found.shape[1]))
            if order is not None:
                known = self.reached[family]
                self.reached[family] = order if known is None else min(known, order)
            found = C if C is not None else found
        return found

    def _certified(self, columns: Floats, fewer: int) -> tuple[int | None, Floats | None]:
        """The first of ``columns``, as few as hold the tolerance: their number, at the samples at least, and the
        certified basis where it has ``fewer``."""
        for _ in range(EXCHANGES):
            C, error = self._cut(columns)
            if error > self.tolerance:
                return None, None
            if C.shape[1] >= fewer:
                return C.shape[1], None
            if self._decided(C):
                return C.shape[1], C
        for order in range(C.shape[1] + 1, min(columns.shape[1] + 1, fewer)):
            if self._decided(columns[:, :order]):
                return order, columns[:, :order]
        return None, None

    def _decided(self, C: Floats) -> bool:
        """Whether the tolerance holds on all of the band; if not, the worst frequency joins the samples."""
        low, high = (2 * np.pi * f for f in self.certified.band_hz)
        verdict = decide(self.standard, self._terms(C), low, high, self.measure, self.tolerance)
        if not verdict.decided:
            self._look_at(verdict.at)
            return False
        return True

    def limit(self, C: Floats, theta: Floats) -> Limit:
        """The certified limit of the body on span(C) whose eigenvalues came out as ``theta`` (n,)."""
        low, high = (2 * np.pi * f for f in self.certified.band_hz)
        body = self._terms(C, theta if len(theta) == C.shape[1] else None)
        self.worst = compare(self.standard, body, low, high)[0][self.measure]
        return self.worst

    def _terms(self, C: Floats, real: Floats | None = None) -> Terms:
        """The transfer matrix of the model on span(C)."""
        reduced, layout = self._reduced(C, real), self.standard.layout
        b, theta = reduced.B[:, : self.reference.inputs], reduced.theta
        D = np.diag(reduced.damping.of_modes(theta)) if reduced.D is None else reduced.D
        return terms_of(
            np.eye(len(theta)), D, np.diag(theta), b, b.T, layout, structural=reduced.damping.structural,
            highest=2 * np.pi * self.certified.band_hz[1],
        )  # fmt: skip

    def zero(self, hz: float) -> bool:
        """Whether the response is as good as zero at ``hz``."""
        w = 2 * np.pi * np.array([hz])
        e = (1 / self.standard.modes.distances(w).prod(axis=2)) @ self.standard.sizes[:, 0]
        return bool(np.linalg.norm(self.standard.H.at(w)) < ZERO * e[0])

    def _cut(self, columns: Floats) -> tuple[Floats, float]:
        """The first of ``columns``, as few as hold the tolerance at the samples, and their error."""
        few, many = self.fixed.shape[1], columns.shape[1]
        error = self.error(columns)
        if error > self.tolerance:
            return columns, error
        while few < many:
            middle = (few + many) // 2
            tried = self._exceeds(columns[:, :middle])
            if tried <= self.tolerance:
                many, error = middle, tried
            else:
                few = middle + 1
        return columns[:, :many], error

    def error(self, C: Floats) -> float:
        """Largest error at the samples."""
        return float(self.errors(C).max())

    def errors(self, C: Floats) -> Floats:
        """Errors (nf,) at the samples by the measure."""
        if not C.shape[1]:
            return np.ones(len(self.looked))
        reduced = self._reduced(C)
        found = np.array([self._error_at(j, reduced) for j in range(len(self.looked))])
        self.worst_first = np.argsort(-found, kind="stable")
        if found.max() < self.worst.upper:
            j = int(found.argmax())
            self.worst = Limit(lower=found[j], upper=found[j], at_hz=self.looked[j] / (2 * np.pi))
        return found

    def _exceeds(self, C: Floats) -> float:
        """Largest error at the samples, or the first found above the tolerance."""
        if not C.shape[1]:
            return 1.0
        reduced, worst = self._reduced(C), 0.0
        # Where the last basis was worst this one is most likely too far off.
        for j in self.worst_first.tolist():
            worst = max(worst, self._error_at(j, reduced))
            if worst > self.tolerance:
                break
        return worst

    def _error_at(self, j: int, reduced: _Small) -> float:
        """Error at the sample ``j``."""
        u = product(reduced.V, reduced.state(float(self.looked[j])))
        off = self.full[j] - self.F.T @ u
        return float(max(np.linalg.norm(off[:m, :m]) / self.sizes[j, i] for i, m in enumerate(self.counted)))

    def _norms(self, H: NDArray[np.complex128]) -> Floats:
        """Norms (nf, 2) of the part between interface motions and of the whole of ``H`` (nf, p, p)."""
        return np.stack([np.linalg.norm(H[:, :m, :m], axis=(1, 2)) for m in self.counted], axis=1)

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
            blocks = [self.F / _apart(values, shift)[:, None] for shift in shifts]
            C = self._orthonormal(np.hstack(blocks))
            errors = self.errors(C)
            # Beside a shift that is there already a new one would add next to nothing.
            near = np.min(np.abs(self.looked[:, None] - np.array(shifts)) / self.looked[-1], axis=1) < 5e-3
            if errors.max() <= tolerance or near.all():
                break
            shifts.append(float(self.looked[np.argmax(np.where(near, 0.0, errors))]))
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


def _apart(values: Floats, shift: float) -> Floats:
    """``values`` - shift^2 (k,), for a shift half a percent higher where it hits a resonance."""
    if (np.abs(np.sqrt(values) - shift) < HITS * shift).any():
        shift *= 1.005
    return np.asarray(values - shift**2)


def _parts(states: Sequence[NDArray[Any]]) -> Floats:
    """Real and, where there are any, imaginary parts of ``states`` (k, p) each, side by side."""
    flat = np.concatenate(states, axis=1)
    return np.hstack([flat.real, flat.imag]) if np.iscomplexobj(flat) else flat
