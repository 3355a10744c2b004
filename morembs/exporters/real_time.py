"""Bodies for real time: modes that a time step does not resolve answer at once, by their static compliance.

Singular perturbation (Kokotovic, Khalil and O'Reilly 1986): with x = [slow; fast], fast states are where their rates
vanish, so that they are a feedthrough of the others and of the inputs, exact at 0 Hz. Where fast and slow states are
not coupled, the error E(s) is that of the fast part alone: its series in s converges within the slowest fast pole, and
the sum of its terms bounds |E| at every frequency of a band.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sl

from morembs.base.errors import InputError
from morembs.base.summary import upwards
from morembs.base.types import Floats, Ints
from morembs.base.units import in_hz
from morembs.body.body import Body
from morembs.body.stored import StoredBodies
from morembs.exporters.read_back import TINY, FirstOrder
from morembs.exporters.tolerances import TOL

# Units of outputs -> what they are.
KINDS = {
    **dict.fromkeys(("m", "rad", "1"), "displacements"),
    **dict.fromkeys(("m/s", "rad/s"), "velocities"),
    **dict.fromkeys(("m/s2", "rad/s2"), "accelerations"),
    **dict.fromkeys(("N", "N m", "N.m"), "reactions"),
    "Pa": "stresses",
}
# Powers of a length that turn rotations into displacements, and moments into forces; and their units then.
_LENGTHS = {"rad": 1, "rad/s": 1, "rad/s2": 1, "N m": -1, "N.m": -1}
_FORCES = {"rad": "m", "rad/s": "m/s", "rad/s2": "m/s2", "N m": "N", "N.m": "N"}


class StepTooLongError(InputError):
    """A time step that resolves no motion of a body."""


class StepTooShortError(InputError):
    """A time step that resolves how motions without mass follow loads."""


@dataclass(frozen=True, kw_only=True)
class RealTime:
    """What a time ``step`` in s left of a body: ``kept`` of ``count`` modes; the others are static compliance.

    ``errors`` has for each kind of output the largest error of a response up to each of ``bands_hz``, over the largest
    elastic response of its units: an upper limit where ``proven``, else the largest at some frequencies.
    """

    step: float
    kept: int
    count: int
    bands_hz: tuple[float, ...]
    errors: Mapping[str, tuple[float, ...]]
    proven: bool

    def errors_to(self, hz: float) -> dict[str, float]:
        """Errors by kind of output in the narrowest band that reaches ``hz``, none where nothing was left out."""
        at = int(np.searchsorted(np.array(self.bands_hz) * (1 + TOL.step_roundoff), hz))
        return {kind: errors[at] for kind, errors in self.errors.items() if at < len(errors)}

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user of the export."""
        if self.kept == self.count:
            return (f"time step {self.step:g} s: resolves all {self.count} modes, nothing was changed",)
        kind = "at most" if self.proven else f"sampled at {TOL.error_samples} frequencies"
        bands = ", ".join(f"{hz:.4g}" for hz in self.bands_hz)
        shown = "; ".join(f"{name} {', '.join(map(upwards, errors))}" for name, errors in self.errors.items())
        return (
            f"time step {self.step:g} s: {self.kept} of {self.count} modes, up to {resolved_hz(self.step):.4g} Hz; the "
            "others are static compliance",
            f"error against the body up to {bands} Hz, over the largest elastic response, {kind}: {shown}",
        )


def resolved_hz(step: float) -> float:
    """Highest frequency in Hz that a time ``step`` in s resolves."""
    return in_hz(TOL.resolved_angle / step)


def slow_modes(omega: Floats, damping: Floats, step: float) -> np.ndarray:
    """Which modes of ``omega`` (n,) in rad/s and ``damping`` (n,) in 1/s a ``step`` resolves: the slowest pole of an
    overdamped mode counts."""
    half = 0.5 * np.maximum(damping, 0.0)
    root = np.sqrt(np.maximum(half**2 - omega**2, 0.0))
    slowest = omega * np.where(half > omega, omega / np.maximum(half + root, np.maximum(omega, TINY)), 1.0)
    return np.asarray(slowest * step <= TOL.resolved_angle)


def static_response(A: Floats, B: Floats, fast: Ints) -> tuple[Floats, Floats]:
    """The ``fast`` states (f,) at rest: (f, n - f) by the other states, (f, m) by the inputs."""
    slow = np.setdiff1d(np.arange(len(A)), fast)
    both: Floats = -np.asarray(
        np.linalg.solve(A[np.ix_(fast, fast)], np.hstack([A[np.ix_(fast, slow)], B[fast]])), float
    )
    return both[:, : len(slow)], both[:, len(slow) :]


def without_fast(system: FirstOrder, fast: Ints) -> FirstOrder:
    """The system in continuous time whose ``fast`` states answer at once."""
    A, B, C, D = system.A, system.B, system.C, system.D
    slow = np.setdiff1d(np.arange(len(A)), fast)
    by_states, by_inputs = static_response(A, B, fast)
    return FirstOrder(
        A=A[np.ix_(slow, slow)] + A[np.ix_(slow, fast)] @ by_states,
        B=B[slow] + A[np.ix_(slow, fast)] @ by_inputs,
        C=C[:, slow] + C[:, fast] @ by_states,
        D=D + C[:, fast] @ by_inputs,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Truncation:
    """The ``fast`` states (f,) of a ``system`` in continuous time, which go for a time ``step`` in s.

    ``moving`` states belong to modes without stiffness and to supports: their motion is no elastic response.
    ``units`` are those of outputs and inputs, ``derivatives`` of each input the input that it is a derivative of, and
    the order. Rotations and moments count at the ``length`` in m. A ``stand_in`` in their place has their responses at
    0 Hz.
    """

    system: FirstOrder
    fast: Ints
    moving: Ints
    units: tuple[Sequence[str], Sequence[str]]
    derivatives: Sequence[tuple[int, int]]
    length: float
    step: float
    stand_in: FirstOrder | None = None

    @property
    def is_proven(self) -> bool:
        """True if fast and slow states act on each other by no more than round-off."""
        A, slow = self.system.A, np.setdiff1d(np.arange(len(self.system.A)), self.fast)
        across = np.abs(np.hstack([A[np.ix_(slow, self.fast)].ravel(), A[np.ix_(self.fast, slow)].ravel()]))
        return bool(across.max(initial=0.0) <= TOL.rigid_damping * np.abs(np.diag(A)).max(initial=0.0))

    def measure(self, count: int) -> RealTime:
        """How far the system without its fast states is from the whole one, of ``count`` modes."""
        bands = [share * TOL.resolved_angle / self.step for share in TOL.band_shares if len(self.fast)]
        kinds = [KINDS[unit] for unit in self.units[0]]
        shares = [self._shares(kinds, band) for band in bands]
        errors = {kind: tuple(each[kind] for each in shares) for kind in dict.fromkeys(kinds)}
        return RealTime(
            step=self.step,
            kept=count - len(self.fast) // 2,
            count=count,
            bands_hz=tuple(in_hz(band) for band in bands),
            errors=errors,
            proven=self.is_proven,
        )

    def _shares(self, kinds: Sequence[str], band: float) -> dict[str, float]:
        """The largest error up to ``band`` in rad/s of each kind of output, over the largest size with its units."""
        inputs = [_FORCES.get(unit, unit) for unit in self.units[1]]
        error, result = self.error(band), dict.fromkeys(kinds, 0.0)
        size = np.max([self.size(band, share * band) for share in (0.0, 0.5, 1.0)], axis=0)
        for kind in result:
            for own in dict.fromkeys(inputs):
                block = np.ix_([each == kind for each in kinds], [unit == own for unit in inputs])
                whole = float(size[block].max())
                result[kind] = max(result[kind], float(error[block].max()) / whole if whole else 0.0)
        return result

    def _merge(self, matrix: np.ndarray, band: float) -> np.ndarray:
        """The columns of each input and its derivatives in one, all under the same motion at ``band`` in rad/s, and
        rotations and moments as displacements and forces at ``length``."""
        outputs, inputs = ([_LENGTHS.get(unit, 0) for unit in units] for units in self.units)
        result = np.zeros_like(matrix)
        for at, (base, order) in enumerate(self.derivatives):
            result[:, base] += band**order * matrix[:, at] * self.length ** -float(inputs[at])
        return np.asarray(result * self.length ** np.array(outputs, dtype=float)[:, None])

    def size(self, band: float, s: float) -> Floats:
        """(p, m): elastic responses at ``s`` >= 0 of the real axis, where there is no resonance, to motions of supports
        at ``band`` in rad/s."""
        every, system = np.arange(len(self.system.A)), self.system
        elastic = np.setdiff1d(every, self.moving)
        A, B, C = (system.A[np.ix_(elastic, elastic)], system.B[elastic], system.C[:, elastic])
        return np.asarray(np.abs(self._merge(_transfer(replace(system, A=A, B=B, C=C), s), band)), dtype=float)

    def error(self, band: float) -> Floats:
        """(p, m): largest |E(i w)| for w up to ``band`` in rad/s, an upper limit where ``is_proven``."""
        if self.is_proven:
            return self._merge(_error_bound(self._fast_parts(), band), band)
        short, stand_in = without_fast(self.system, self.fast), self.stand_in
        samples = 1j * band * np.arange(1, TOL.error_samples + 1) / TOL.error_samples
        differences = []
        for s in samples:
            found = _transfer(short, s)
            if stand_in is not None:
                found = found + _transfer(stand_in, s) - _transfer(stand_in, 0.0)
            differences.append(np.abs(_transfer(self.system, s) - found))
        return self._merge(np.asarray(np.max(differences, axis=0)), band)

    def _fast_parts(self) -> FirstOrder:
        """The fast states, and less of what is in their place."""
        system, fast, other = self.system, self.fast, self.stand_in
        parts = replace(system, A=system.A[np.ix_(fast, fast)], B=system.B[fast], C=system.C[:, fast])
        if other is None:
            return parts
        A, B = sl.block_diag(parts.A, other.A), np.vstack([parts.B, other.B])
        return replace(parts, A=A, B=B, C=np.hstack([parts.C, -other.C]))


def _error_bound(system: FirstOrder, band: float) -> Floats:
    """(p, m): upper limits of |E(i w)| for all w up to ``band`` in rad/s; E is the sum of s^k C A^-(k+1) B from the
    first power on."""
    A, B, C = system.A, system.B, system.C
    values, V = np.linalg.eig(A)
    size, ratio = np.abs(values), band / np.abs(values)
    # What the terms beyond the last add to at most, mode by mode.
    tail = ratio**TOL.series_terms / (size * (1 - ratio))
    result = np.abs(C @ V) * tail @ np.abs(np.linalg.solve(V, B))
    moment, factors = B, sl.lu_factor(A)
    for k in range(TOL.series_terms):
        moment = np.asarray(sl.lu_solve(factors, moment) * (band if k else 1.0), dtype=float)
        if k:
            result = result + np.abs(C @ moment)
    return np.asarray(result)


def _transfer(system: FirstOrder, s: complex) -> np.ndarray:
    return np.asarray(system.C @ np.linalg.solve(s * np.eye(len(system.A)) - system.A, system.B) + system.D)


def refuse_nothing_left(name: str, step: float, left: int) -> None:
    """Refuse a step that resolves no motion.

    Raises:
        StepTooLongError: in these cases.
    """
    if not left:
        raise StepTooLongError(
            f"a time step of {step:g} s was given, which resolves motion up to {resolved_hz(step):.4g} Hz, and body "
            f"{name!r} has no slower mode; take a shorter step",
            keyword="time_step",
        )


def slide_note(found: RealTime, count: int) -> tuple[str, ...]:
    """A note for the user of a file with ``count`` coordinates."""
    return (f"modes from {found.kept + 1} on stand for the compliance of the others",) if count > found.kept else ()


def certificate_note(body: Body) -> tuple[str, ...]:
    """What the body itself is off from the full model, which adds to the error of the export."""
    if body.certificate is None:
        return ("the error of the body itself is not known: it has no certificate",)
    return (f"the error of the body itself adds to that: {body.certificate.words}",)


def gyration(source: StoredBodies) -> float:
    """Radius of gyration in m, at which rotations and moments count; 1 m for what has no mass or no extent."""
    square = float(np.trace(source.inertia)) / (2 * source.mass) if source.mass > 0 else 0.0
    return float(np.sqrt(square)) if square > 0 else 1.0


def price_note(seconds: float | None, step: float) -> tuple[str, ...]:
    """What a simulated second costs where a ``step`` in s takes some ``seconds`` of the processor."""
    return () if seconds is None else (f"1 s costs {seconds / step:.2g} s on this machine, step {step:g} s",)


def find_step(
    truncated: Callable[[float], RealTime | None], step_error: Callable[[float], float], band_hz: float
) -> tuple[RealTime, dict[str, float]] | None:
    """The longest step of a few, and its errors, with which motion up to ``band_hz`` stays within
    ``TOL.real_time_error`` as far as steps can help: velocities miss the share of static compliance at any. None for a
    target that knows no step."""
    shares = [*sorted(TOL.band_shares, reverse=True), *(TOL.band_shares[0] / 2**k for k in range(1, TOL.step_halvings))]
    best: tuple[RealTime, dict[str, float]] | None = None
    for share in shares:
        angle = share * TOL.resolved_angle
        step = angle / (2 * np.pi * band_hz)
        unit = 10.0 ** (np.floor(np.log10(step)) - 1)
        try:
            # Two digits, rounded down, as people type it.
            found = truncated(float(f"{np.floor(step / unit) * unit:.1e}"))
        except StepTooLongError:
            continue
        except StepTooShortError:
            if best is None:
                raise
            break
        if found is None:
            return None
        own = step_error(2 * np.pi * band_hz * found.step)
        errors = found.errors_to(band_hz) | ({"steps": own} if own else {})
        best = found, errors
        if all(error <= TOL.real_time_error for kind, error in errors.items() if kind != "velocities"):
            break
    return best
