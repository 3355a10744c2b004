"""Body files against the truth: each sentence that is not true of them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.base.types import Floats
from tests.fuzz.truth import Truth, eliminated, refined

Long = np.longdouble
MEASURES = ("envelope", "peak", "pointwise")
# Proven limits may be exceeded by what the last digits of limits as they are stored may be.
LAST = 1e-6
# How many times the rounding of K to double an assembly in another order is off, and of what no one can be right in.
ASSEMBLED, LEAST = 30.0, 1e-12
# Relative error of frequencies that are promised without a certificate, beside the rounding of K.
FINE = 1e-7
# Modes this near to the end of a band may count as in it or as beyond it.
EDGE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Reduced:
    """The matrices of a body as they are stored, ``C`` (m, n)."""

    name: str
    K: Floats
    M: Floats
    D: Floats
    B: Floats
    C: Floats
    free: int
    frequencies_hz: Floats
    full_hz: Floats
    recipe: dict[str, object]
    kind: str = ""
    certificate: dict[str, Floats] | None = None

    @property
    def symmetric(self) -> bool:
        """Whether motions are those that loads do work on."""
        return bool(np.array_equal(self.C, self.B.T))

    def H(self, omega: Floats, loss: float, scale: Floats) -> NDArray[np.clongdouble]:
        """Elastic part (nf, m, m), scaled, in extended precision."""
        if not self.symmetric and self.free:
            raise NotImplementedError("two-sided bodies with rigid motions")
        K, M, D, B, C = (A.astype(Long) for A in (self.K, self.M, self.D, self.B, self.C))
        if len(K) == self.free:
            return np.zeros((len(omega), len(C), len(C)), dtype=np.clongdouble)
        if self.symmetric and self.free:
            _, V = sl.eigh((self.K + self.K.T) / 2, self.M)
            Z = V[:, : self.free].astype(Long)
            X = refined(K, M, _unit(Z, M))[1]
            K, M, D, B, C = X.T @ K @ X, X.T @ M @ X, X.T @ D @ X, X.T @ B, C @ X
        w = omega.astype(Long)[:, None, None]
        A = K * (1 + 1j * Long(loss)) + 1j * w * D - w * w * M
        H = np.einsum("in,fnj->fij", C * scale[:, None], eliminated(A, B * scale))
        return H


def _unit(Z, M):  # type: ignore[no-untyped-def]
    for k in range(Z.shape[1]):
        for _ in range(2):
            Z[:, k] -= Z[:, :k] @ (Z[:, :k].T @ M @ Z[:, k])
        Z[:, k] /= np.sqrt(Z[:, k] @ M @ Z[:, k])
    return Z


def bodies(path: Path) -> tuple[list[Reduced], dict[str, Floats]]:
    """Those of a file, and its mass properties, read by h5py alone."""
    found = []
    with h5py.File(path) as file:
        for name in (text.decode() for text in file["body_names"]):
            group = file["bodies"][name]
            take = {key: group[key][()] for key in group if isinstance(group[key], h5py.Dataset)}
            certificate = None
            if "certificate" in group:
                own = group["certificate"]
                certificate = {key: own[key][()] for key in own if isinstance(own[key], h5py.Dataset)}
                certificate |= {f"limits/{key}": own["limits"][key][()] for key in own.get("limits", {})}
            found.append(
                Reduced(
                    name=name,
                    K=take["stiffness_matrix"],
                    M=take["mass_matrix"],
                    D=take["damping_matrix"],
                    B=take["input_matrix"],
                    C=take.get("output_matrix", take["input_matrix"].T),
                    free=int(take["rigid_count"]),
                    frequencies_hz=take["frequencies_hz"],
                    full_hz=take.get("full_frequencies_hz", np.zeros(0)),
                    recipe=json.loads(take["recipe"]),
                    certificate=certificate,
                )
            )
        mass = {key: file["mass_properties"][key][()] for key in file["mass_properties"]}
    return found, mass


@dataclass
class Verdict:
    """Sentences that are wrong, and counts of certificates by kind; ``excess``: estimates that were exceeded."""

    wrong: list[str]
    proven: int = 0
    estimates: int = 0
    excess: int = 0
    points: int = 0
    unjudged: int = 0


def judge(
    path: Path,
    truth: Truth,
    rng: np.random.Generator,
    *,
    exact: set[str],
    tolerances: dict[str, tuple],  # type: ignore[type-arg]
    promised: dict[str, str],
) -> Verdict:
    """All bodies of a file. ``exact``: those with all modes; ``tolerances``: name -> (measure, tolerance, band, floor);
    ``promised``: name -> method."""
    verdict = Verdict([])
    found, mass = bodies(path)
    if truth.model.nodes and truth.model.support in ("free", "springs"):
        verdict.wrong += _mass(truth, mass)
    elif truth.model.nodes:
        # Dofs that are not there have no mass: the inertia of what is left depends on where it is taken about.
        truth.measure(float(np.trace(mass["inertia"]) / (2 * mass["mass"])) if mass["mass"] > 0 else -1.0)
    for body in found:
        try:
            for sentence in _body(truth, body, rng, verdict, exact, tolerances, promised):
                verdict.wrong.append(f"{body.name}: {sentence}")
        except NotImplementedError:
            verdict.unjudged += 1
    return verdict


def _mass(truth: Truth, found: dict[str, Floats]) -> Iterator[str]:
    mass, center, inertia = truth.mass
    size = float(np.ptp(truth.model.xyz, axis=0).max())
    if truth.model.family in ("framework", "beams") and not np.allclose(
        np.diag(truth.R.T @ truth.M @ truth.R)[:3].astype(float), mass, rtol=1e-9
    ):
        return
    if abs(found["mass"] / mass - 1) > 1e-9:
        yield f"mass {found['mass']:.9g} kg, {mass:.9g} is right"
    if np.abs(found["center_of_mass"] - center).max() > 1e-8 * size:
        yield f"centre of mass {found['center_of_mass']}, {center} is right"
    if np.abs(found["inertia"] - inertia).max() > 1e-8 * mass * size**2:
        yield f"inertia {found['inertia'].tolist()}, {inertia.tolist()} is right"


def _body(truth, body, rng, verdict, exact, tolerances, promised) -> Iterator[str]:  # type: ignore[no-untyped-def]
    method = promised.get(body.name, "")
    held = "fixed" in method
    if body.free != (0 if held else truth.model.free):
        yield f"{body.free} rigid-body motions, {truth.model.free} are right"
        return
    allowed = FINE + ASSEMBLED * truth.rounding / np.maximum(truth.modes[0].astype(float), 1e-300)
    known = body.full_hz[truth.model.free :][: len(truth.hz)]
    off = np.abs(known / truth.hz[: len(known)] - 1)
    if (off > allowed[: len(known)]).any():
        k = int(np.argmax(off - allowed[: len(known)]))
        yield f"full frequency {k + 1} is {known[k]:.9g} Hz, {truth.hz[k]:.9g} is right"
    own = np.sqrt(np.maximum(sl.eigvalsh((body.K + body.K.T) / 2, body.M), 0)) / (2 * np.pi) if body.symmetric else None
    if own is not None and len(own) > body.free and not held:
        own = own[body.free :]
        if len(own) > len(truth.hz):
            yield f"{len(own)} elastic coordinates of a model with {len(truth.hz)}"
        else:
            low = own / truth.hz[: len(own)] - 1
            # Rayleigh and Ritz: frequencies of a Galerkin body are upper bounds of those of the model.
            if (low < -allowed[: len(own)]).any():
                yield f"frequency {int(np.argmin(low)) + 1} lies below that of the model by {-low.min():.1e}"
            if method == "modal":
                yield from (
                    f"mode {k + 1} of {method} is off by {x:.1e}" for k, x in enumerate(low[:1]) if x > 10 * allowed[k]
                )
    if body.name in exact and body.symmetric:
        if len(body.frequencies_hz) - body.free != len(truth.hz):
            yield f"{len(body.frequencies_hz) - body.free} of {len(truth.hz)} elastic modes, though all were asked for"
        else:
            yield from _whole(truth, body, rng)
    if body.name in tolerances:
        measure, tolerance, band, floor = tolerances[body.name]
        yield from _promise(truth, body, rng, measure, tolerance, band, floor)
    if body.certificate is not None:
        yield from _certificate(truth, body, rng, verdict)


def _points(truth: Truth, band: Floats, rng: np.random.Generator, more: Floats) -> Floats:
    """Frequencies in rad/s where errors are likely to be largest."""
    low, high = band
    near = truth.hz[(truth.hz >= 0.8 * low) & (truth.hz <= 1.2 * high)][:12]
    width = np.maximum(truth.damping.ratio(near), 0.01)
    hz = np.concatenate(
        [
            [low, high],
            rng.uniform(low, high, 10),
            near,
            near * (1 - width),
            near * (1 + width),
            more,
            near * (1 + 1e-3 * rng.standard_normal(len(near))),
        ]
    )
    return 2 * np.pi * np.unique(np.clip(hz[np.isfinite(hz)], low, high))


def _ratios(truth: Truth, body: Reduced, omega: Floats, loss: float):  # type: ignore[no-untyped-def]
    """|E| (nf,), envelope, |H| and what of E is round-off of assembly, relative to the envelope."""
    # At 0 Hz an undamped free body has its statics.
    H, Hr = truth.H(omega, loss), body.H(omega, truth.damping.structural + loss, truth.scale)
    E, size = (np.sqrt((np.abs(A) ** 2).sum(axis=(1, 2))).astype(float) for A in (H - Hr, H))
    e = truth.envelope(omega, loss)
    a = np.abs(truth.moduli(omega, loss)).astype(float)
    b = np.linalg.norm(truth.b.astype(float), axis=1)
    lost = ((b * np.sqrt(truth.rounding) / a).sum(axis=1)) ** 2
    factor = ASSEMBLED if truth.model.family == "mesh" or any(p.coupling == "rigid" for p in truth.ports) else 0.0
    return E, e, size, factor * lost / e + LEAST


def _peak(truth: Truth, band: Floats, loss: float) -> float:
    """The largest |H| of a band: over a grid and about resonances, and closer where it is largest."""
    low, high = band
    near = truth.hz[(truth.hz >= 0.8 * low) & (truth.hz <= 1.2 * high)][:12]
    count = 40 if truth.D is not None else 300
    hz = np.unique(np.clip(np.concatenate([np.linspace(low, high, count), near]), low, high))
    size = _sizes(truth, hz, loss)
    best, width = float(size.max()), (high - low) / count
    # Peaks of nearly the same height are told apart only by a closer look at each.
    around = np.maximum(np.append(size[1:], 0), np.append(0, size[:-1]))
    for at in hz[(size >= around) & (size > 0.9 * best)]:
        step = width
        for _ in range(4):
            closer = np.clip(np.linspace(at - step, at + step, 21), low, high)
            size = _sizes(truth, closer, loss)
            best, at, step = max(best, float(size.max())), closer[int(size.argmax())], step / 8
    return best


def _sizes(truth: Truth, hz: Floats, loss: float) -> Floats:
    """|H| (nf,)."""
    return np.sqrt((np.abs(truth.H(2 * np.pi * hz, loss)) ** 2).sum(axis=(1, 2))).astype(float)


def _whole(truth: Truth, body: Reduced, rng: np.random.Generator) -> Iterator[str]:
    """A body with all modes is the model."""
    band = np.array([0.0, truth.hz[min(8, len(truth.hz) - 1)] * 1.1])
    omega = _points(truth, band, rng, np.zeros(0))
    E, e, _, lost = _ratios(truth, body, omega, 0.02)
    if truth.damping.steps and len(truth.damping.steps) > 1:
        return
    worst = int(np.argmax(E / e - lost))
    if E[worst] / e[worst] > 1e-6 + 10 * lost[worst]:
        hz = omega[worst] / 2 / np.pi
        yield f"the body with all modes is off by {E[worst] / e[worst]:.1e} of the envelope at {hz:.6g} Hz"


def _promise(truth, body, rng, measure, tolerance, band, floor) -> Iterator[str]:  # type: ignore[no-untyped-def]
    """The tolerance of auto."""
    if truth.D is not None and measure == "envelope":
        return
    omega = _points(truth, np.array(band), rng, body.frequencies_hz)
    E, e, H, lost = _ratios(truth, body, omega, 2 * floor)
    by = {"envelope": e, "peak": np.full(len(e), _peak(truth, np.array(band), 2 * floor)), "pointwise": H}[measure]
    ratio = E / by
    worst = int(np.argmax(ratio))
    slack = 1.05 if measure == "peak" else 1.001
    if ratio[worst] > slack * tolerance + lost[worst] * e[worst] / by[worst]:
        hz = omega[worst] / 2 / np.pi
        yield f"auto promises {tolerance:.1e} by {measure}, {ratio[worst]:.3e} is reached at {hz:.9g} Hz"


def _certificate(truth: Truth, body: Reduced, rng: np.random.Generator, verdict: Verdict) -> Iterator[str]:
    given = body.certificate
    assert given is not None
    band, floor, kind = given["band_hz"], float(given["damping_floor"]), given["bound_kind"].decode()
    verdict.proven += kind == "bound"
    verdict.estimates += kind == "estimate"
    yield from _modes_in_band(truth, given, band)
    if "cell_limit" not in given:
        return
    limits = {name: given[f"limits/{name}"] for name in MEASURES}
    at = np.array([limit[2] for limit in limits.values()])
    omega = _points(truth, band, rng, np.concatenate([at, body.frequencies_hz[body.free :][:20]]))
    E, e, H, lost = _ratios(truth, body, omega, 2 * floor)
    verdict.points += len(omega)
    cells, edges = given["cell_limit"], given["cells_hz"]
    at = np.clip(np.searchsorted(edges[:, 0], omega / 2 / np.pi, side="right") - 1, 0, len(edges) - 1)
    for m, measure in enumerate(MEASURES):
        if truth.D is not None and measure == "envelope":
            continue
        by = {"envelope": e, "peak": np.full(len(e), _peak(truth, band, 2 * floor) * 1.001), "pointwise": H}[measure]
        ratio = E / by
        own = np.maximum(cells[at, m], np.where(at > 0, cells[at - 1, m], 0))
        limit = np.minimum(own, limits[measure][1]) * (1 + LAST) + lost * e / by
        # An infinite limit holds for what is not a number.
        bad = np.flatnonzero(~(ratio <= limit) & np.isfinite(limit))
        if not len(bad):
            continue
        k = int(bad[np.argmax(ratio[bad] / limit[bad])])
        own_H = body.H(omega[k : k + 1], truth.damping.structural + 2 * floor, truth.scale)[0]
        proved = np.linalg.norm(truth.exact(float(omega[k]), 2 * floor) - own_H) / by[k]
        if proved <= limit[k]:
            continue
        if kind != "bound":
            verdict.excess += 1
            continue
        yield (
            f"the proven limit by {measure} is {own[k]:.6e}, {float(proved):.6e} is reached at "
            f"{omega[k] / 2 / np.pi:.12g} Hz"
        )


def _modes_in_band(truth: Truth, given: dict[str, Floats], band: Floats) -> Iterator[str]:
    low, high = band
    hz, found = truth.hz, given["mode_frequencies_hz"]
    sure = hz[(hz >= low * (1 + EDGE)) & (hz <= high * (1 - EDGE))]
    near = hz[(hz >= low * (1 - EDGE)) & (hz <= high * (1 + EDGE))]
    if not len(sure) <= len(found) <= len(near):
        yield f"{len(found)} modes are said to lie in the band from {low:g} to {high:g} Hz, {len(sure)} do"
        return
    enclosure = given.get("mode_enclosure_hz", np.zeros((0, 2)))
    for k, (a, b) in enumerate(enclosure):
        slack = 1e-9 * b + b * 15 * (truth.rounding / np.maximum(truth.modes[0].astype(float), 1e-300)).max()
        if not ((hz >= a - slack) & (hz <= b + slack)).any():
            yield f"no mode lies between {a:.12g} and {b:.12g} Hz, where mode {k + 1} is enclosed"
