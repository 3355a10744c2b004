"""Checks a reduced body before it is handed over: symmetry, rigid-body motion in three ways, ground, mass, damping.

The checks are those that are usual for Craig-Bampton models in spacecraft dynamics, for every kind of basis. Rigid
motion of the body in reduced coordinates q, per unit motion about the origin, from

* geometry: the analytic rigid-body modes that the basis holds;
* stiffness: six interface degrees of freedom are given, the others follow without energy (K condensed to these);
* eigenvectors: the six lowest, scaled to the same interface degrees of freedom.

In a sound body all three agree, need no energy and give the mass of the model.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from morembs.body.stored import StoredBodies, StoredBody
from morembs.diagnostics.delivered import Delivered, delivered
from morembs.diagnostics.findings import MOTIONS, Diagnosis, Finding, listed, sentences
from morembs.diagnostics.frame_check import frame_findings
from morembs.errors import InputError
from morembs.model import skew
from morembs.model.mass import mass_properties

if TYPE_CHECKING:
    from morembs.body import ElasticBody, Part
    from morembs.reducers.base import ReducedModel

Floats = NDArray[np.float64]
# Against the largest eigenvalue, in units of the mass.
ROUND_OFF = 1e-12
Ints = NDArray[np.int64]
# Difference of two entries against the diagonal; negative part of an eigenvalue of the scaled matrix.
SYMMETRIC, NEGATIVE = 1e-9, 1e-8
# Energy of rigid motion as a frequency, against the first elastic one: warning and error.
SOFT, GROUNDED = 1e-2, 0.1
# Mass, centre (per radius of gyration) and inertia of the body against those of the model; frequencies.
MASS, FREQUENCY = 1e-6, 1e-6
# Sum of effective masses below which a note says so.
EFFECTIVE = 0.8


def check_delivery(body: ReducedModel | ElasticBody | StoredBody, part: Part | StoredBodies | None = None) -> Diagnosis:
    """Findings about a reduced model (with its ``part``), a body, or one read from a file (with the whole of the file).

    Facts: "mass", "center_of_mass", "inertia" (of the reduced M), "rigid_energy_J" (way -> (6,), half the stiffness of
    a unit translation or rotation about the centre of mass), "rigid_hz" (way -> the highest frequency that this energy
    means), "ground_force" (way -> (n, 6) K q), "effective_mass" (modes with fixed interfaces, 6) with
    "effective_mass_share" (6,) of the whole and "fixed_hz", "free_hz", "damping_ratios" of the elastic modes.

    Raises:
        InputError: a stored body without its file, or a reduced model without its part.
    """
    given = delivered(body, part)
    findings: list[Finding] = []
    facts: dict[str, Any] = {}
    if not _finite(given, findings):
        return Diagnosis(findings=tuple(findings))
    _symmetry(given, findings)
    _definite(given, findings, facts)
    if any(finding.code == "indefinite" and "M " in finding.sentence for finding in findings):
        return Diagnosis(findings=tuple(findings), facts=facts)
    try:
        values, Y = _modes(given)
    except np.linalg.LinAlgError as error:
        sentence = f"K and M of the reduced body have no eigenvalues that can be computed ({error})"
        findings.append(Finding(code="unsolvable", severity="error", sentence=sentence, cure="write it again"))
        return Diagnosis(findings=tuple(findings), facts=facts)
    _frequencies(given, values, findings, facts)
    ways = _rigid(given, values, Y, findings, facts)
    if given.symmetric and ways and len(given.C):
        _effective(given, next(iter(ways.values())), findings, facts)
    _damping(given, values, Y, findings, facts)
    findings += frame_findings(given)
    return Diagnosis(findings=tuple(findings), facts=facts)


def _named(given: Delivered) -> dict[str, Floats]:
    return {"M": given.M, "K": given.K, "D": given.D}


def _finite(given: Delivered, findings: list[Finding]) -> bool:
    bad = [name for name, A in {**_named(given), "B": given.B}.items() if not np.isfinite(A).all()]
    if bad:
        sentence = f"{', '.join(bad)} of the reduced body hold entries that are not finite numbers"
        findings.append(Finding(code="not-finite", severity="error", sentence=sentence, cure="reduce it again"))
    return not bad


def _scale(A: Floats) -> Floats:
    d = np.abs(np.diag(A))
    return np.asarray(np.sqrt(np.where(d > 0, d, np.abs(A).max(axis=1, initial=0.0))))


def _symmetry(given: Delivered, findings: list[Finding]) -> None:
    if not given.symmetric:
        sentence = "the reduced matrices are not symmetric (two bases), so energy is not conserved exactly"
        cure = "check that the target takes such bodies"
        findings.append(Finding(code="two-sided", severity="note", sentence=sentence, cure=cure))
        return
    for name, A in _named(given).items():
        size = np.maximum(np.outer(_scale(A), _scale(A)), np.finfo(float).tiny)
        off = np.abs(A - A.T) / size
        if off.max(initial=0.0) > SYMMETRIC:
            i, j = np.unravel_index(int(off.argmax()), off.shape)
            sentence = f"{name} is not symmetric: entries ({i + 1}, {j + 1}) are {A[i, j]:.6g} and {A[j, i]:.6g}"
            findings.append(Finding(code="not-symmetric", severity="error", sentence=sentence, cure="write it again"))


def _definite(given: Delivered, findings: list[Finding], facts: dict[str, Any]) -> None:
    """M positive definite, K and D positive semidefinite."""
    for name, A in _named(given).items():
        if not given.symmetric and name != "M":
            continue
        s = _scale(A)
        s[s == 0] = 1.0
        lowest = float(np.linalg.eigvalsh(0.5 * (A + A.T) / np.outer(s, s)).min(initial=1.0))
        facts[f"lowest_of_scaled_{name}"] = lowest
        if name != "M" and lowest < -NEGATIVE and _round_off(A, given):
            continue
        if lowest < -NEGATIVE or (name == "M" and lowest <= 0):
            what = "positive definite" if name == "M" else "positive semidefinite"
            cure = "it feeds energy into a simulation; check the damping" if name == "D" else "check the full matrix"
            sentence = f"{name} of the reduced body is not {what} (lowest scaled eigenvalue {lowest:.2e})"
            findings.append(Finding(code="indefinite", severity="error", sentence=sentence, cure=cure))


def _round_off(A: Floats, given: Delivered) -> bool:
    """Whether what is negative in A lies in coordinates that it hardly resists, as rigid-body motion.

    A body of rigid-body motion alone has nothing but round-off in K and D.
    """
    if given.rigid_count == len(A):
        return True
    m = _scale(given.M)
    m[m == 0] = 1.0
    values = np.linalg.eigvalsh(0.5 * (A + A.T) / np.outer(m, m))
    return bool(values.min(initial=0.0) > -ROUND_OFF * np.abs(values).max(initial=0.0))


def _modes(given: Delivered) -> tuple[Floats, Floats]:
    """Eigenvalues (n,) and vectors of unit modal mass, ascending; real parts where matrices are not symmetric."""
    if given.symmetric:
        return _eigh(0.5 * (given.K + given.K.T), 0.5 * (given.M + given.M.T))
    import scipy.linalg as sl

    roots, vectors = sl.eig(given.K, given.M)
    order = np.argsort(roots.real, kind="stable")
    Y = vectors[:, order].real
    modal = np.einsum("in,ij,jn->n", Y, given.M, Y)
    return roots.real[order], Y / np.sqrt(np.maximum(np.abs(modal), np.finfo(float).tiny))


def _eigh(K: Floats, M: Floats) -> tuple[Floats, Floats]:
    """Eigenvalues (n,) and M-orthonormal vectors (n, n) of symmetric K and M; SciPy's would cost most of ``info``."""
    L = np.linalg.cholesky(M)
    A = np.linalg.solve(L, np.linalg.solve(L, K).T)
    values, Z = np.linalg.eigh(0.5 * (A + A.T))
    return values, np.linalg.solve(L.T, Z)


def _frequencies(given: Delivered, values: Floats, findings: list[Finding], facts: dict[str, Any]) -> None:
    hz = np.sqrt(np.maximum(values, 0.0)) / (2 * np.pi)
    hz[: given.rigid_count] = 0.0
    facts["free_hz"] = hz
    if given.rigid_count < 6:
        sentence = f"the body is held to the ground: {given.rigid_count} of 6 rigid-body motions are free"
        cure = "multibody programs expect a free body; reduce a model without supports"
        findings.append(Finding(code="held", severity="warning", sentence=sentence, cure=cure))
    elastic = slice(given.rigid_count, None)
    squares = (2 * np.pi * given.hz) ** 2
    slack = 2 * FREQUENCY * np.maximum(values, 0.0) + ROUND_OFF * np.abs(values).max(initial=0.0)
    if given.hz.shape != hz.shape or not (np.abs(squares - values) <= slack)[elastic].all():
        sentence = "the frequencies that come with the body are not those of its matrices"
        findings.append(Finding(code="frequencies", severity="error", sentence=sentence, cure="write it again"))
    if given.full_hz is None or not given.symmetric:
        return
    count = min(len(given.full_hz), len(hz))
    full, mine = given.full_hz[given.rigid_count : count], hz[given.rigid_count : count]
    low = np.flatnonzero(mine < full * (1 - FREQUENCY))
    if len(low):
        k = int(low[0])
        sentence = (
            f"elastic mode {k + 1} of the body ({mine[k]:.6g} Hz) is below that of the full model ({full[k]:.6g} Hz), "
            "which no projection does"
        )
        cure = "check that body and model belong together"
        findings.append(Finding(code="below-full-model", severity="error", sentence=sentence, cure=cure))


def rigid_coordinates(given: Delivered, Y: Floats) -> dict[str, Floats]:
    """Way -> (n, 6) reduced coordinates of unit rigid motions about the origin of the model; those that can be told."""
    ways = {} if given.rigid is None else {"geometry": given.rigid}
    reference = _reference(given)
    if reference is None:
        return ways
    C, R = given.C[reference], given.frame[reference] if given.frame is not None else np.eye(6)
    if given.symmetric:
        # Least energy under the six motions; both blocks scaled to one. The stiffness of a body of rigid-body motion
        # alone is round-off, which must not decide: the six motions give it all.
        K = given.K if given.rigid_count < len(given.K) else given.M
        # Coordinates without stiffness are measured by their mass: whether they turn or move, in large or small units.
        softest = ROUND_OFF * float((np.abs(np.diag(K)) / np.diag(given.M)).max())
        s = 1 / _scale(K + softest * np.diag(np.diag(given.M)))
        A, G = s[:, None] * K * s, C * s
        g = np.abs(G).max(axis=1, keepdims=True)
        border = np.block([[A, (G / g).T], [G / g, np.zeros((6, 6))]])
        rhs = np.vstack([np.zeros((len(A), 6)), R / g])
        ways["stiffness"] = s[:, None] * np.linalg.lstsq(border, rhs, rcond=1e-15)[0][: len(A)]
    moved = C @ Y[:, :6]
    if np.linalg.cond(moved / np.maximum(np.abs(moved).max(axis=1, keepdims=True), np.finfo(float).tiny)) < 1e12:
        ways["eigenvectors"] = Y[:, :6] @ np.linalg.solve(moved, R)
    return ways


def _reference(given: Delivered) -> Ints | None:
    """Six interface degrees of freedom that hold the body as a statically determinate support; None without such."""
    if given.frame is None or len(given.frame) < 6:
        return None
    # Rotations per length, about the middle of the interfaces, so that the choice does not depend on units.
    length = float(np.sqrt(np.trace(given.inertia) / (2 * given.mass)))
    scaled = given.frame.copy()
    scaled[:, 3:] -= np.cross(given.center, given.frame[:, :3])
    turning = np.linalg.norm(given.frame[:, :3], axis=1) < 0.5
    scaled[turning, 3:] *= length
    scaled[:, 3:] /= length
    # Gram-Schmidt with pivots: each motion is the one that the others say least about.
    sizes, chosen = np.zeros(6), np.zeros(6, dtype=np.int64)
    for k in range(6):
        left = np.linalg.norm(scaled, axis=1)
        chosen[k] = np.argmax(left)
        sizes[k] = left[chosen[k]]
        if sizes[k] < 1e-8 * sizes[0] or not sizes[k] > 0:
            return None
        direction = scaled[chosen[k]] / sizes[k]
        scaled -= np.outer(scaled @ direction, direction)
    return np.sort(chosen)


def _rigid(
    given: Delivered, values: Floats, Y: Floats, findings: list[Finding], facts: dict[str, Any]
) -> dict[str, Floats]:
    """Energy, ground force and mass of rigid motion found in three ways."""
    if given.rigid_count < 6 or len(values) < 6:
        return {}
    ways = rigid_coordinates(given, Y)
    if not ways:
        sentence = "rigid-body motion could not be checked: fewer than six interface degrees of freedom and no frame"
        findings.append(Finding(code="rigid-unchecked", severity="note", sentence=sentence))
        return ways
    first = np.sqrt(max(values[6], 0.0)) / (2 * np.pi) if len(values) > 6 else 0.0
    shift = np.eye(6)
    shift[:3, 3:] = skew(given.center)
    facts["rigid_energy_J"], facts["rigid_hz"], facts["ground_force"], facts["rigid_mass"] = {}, {}, {}, {}
    for way, q in ways.items():
        centred = q @ shift
        energy, modal = centred.T @ given.K @ centred, centred.T @ given.M @ centred
        energy, modal = 0.5 * (energy + energy.T), 0.5 * (modal + modal.T)
        facts["rigid_energy_J"][way] = 0.5 * np.diag(energy)
        facts["ground_force"][way] = given.K @ q
        facts["rigid_mass"][way] = q.T @ given.M @ q
        d = np.sqrt(np.maximum(np.diag(modal), np.finfo(float).tiny))
        hz = float(np.sqrt(max(_eigh(energy / np.outer(d, d), modal / np.outer(d, d))[0][-1], 0.0)) / (2 * np.pi))
        facts["rigid_hz"][way] = hz
        if first and hz > SOFT * first:
            _ground(given, way, centred, hz, first, findings)
        _mass(given, way, q, findings, facts)
    if given.frame is not None and "geometry" in ways:
        _interfaces_follow(given, ways["geometry"], findings)
    return ways


def _ground(given: Delivered, way: str, q: Floats, hz: float, first: float, findings: list[Finding]) -> None:
    energy = 0.5 * np.diag(q.T @ given.K @ q)
    motions = np.flatnonzero(energy > 1e-3 * energy.max())
    sentence = (
        f"rigid motion (by {way}) strains the body: it would vibrate at {hz:.4g} Hz, the first elastic mode is at "
        f"{first:.4g} Hz; most energy {energy.max():.4g} J per unit motion, in "
        + ", ".join(MOTIONS[k] for k in motions)
    )
    findings.append(
        Finding(
            code="grounded", severity="error" if hz > GROUNDED * first else "warning", sentence=sentence,
            cure="look for springs to the ground in the model, or for interface points that are not where K has them",
            where=tuple(MOTIONS[k] for k in motions),
        )
    )  # fmt: skip


def _mass(given: Delivered, way: str, q: Floats, findings: list[Finding], facts: dict[str, Any]) -> None:
    """Mass, centre and inertia of q' M q against those of the model."""
    root = np.linalg.cholesky(0.5 * (given.M + given.M.T)).T
    mass, center, inertia = mass_properties(np.eye(len(q)), root @ q, np.zeros(3))
    if way == "geometry" or "mass" not in facts:
        facts |= {"mass": mass, "center_of_mass": center, "inertia": inertia}
    radius = float(np.sqrt(np.trace(given.inertia) / (2 * given.mass)))
    off = {
        "mass": abs(mass / given.mass - 1),
        "centre of mass": float(np.linalg.norm(center - given.center)) / radius,
        "inertia": float(np.abs(inertia - given.inertia).max() / np.abs(given.inertia).max()),
    }
    wrong = {name: value for name, value in off.items() if value > MASS}
    if wrong:
        words = ", ".join(f"{name} by {value:.1e}" for name, value in wrong.items())
        both = f"mass {mass:.6g} and {given.mass:.6g} kg"
        sentence = f"rigid motion (by {way}) has another mass than the model: {words} ({both})"
        cure = "check units, the mass matrix, and that body and model belong together"
        severity = "error" if max(wrong.values()) > 1e-3 else "warning"
        findings.append(Finding(code="mass", severity=severity, sentence=sentence, cure=cure, where=tuple(wrong)))


def _interfaces_follow(given: Delivered, q: Floats, findings: list[Finding]) -> None:
    """Interfaces must move with the body as their points say."""
    if given.frame is None:
        return
    moved = given.C @ q
    length = float(np.sqrt(np.trace(given.inertia) / (2 * given.mass)) + np.linalg.norm(given.center))
    # Displacements are 1 or an arm, rotations 0 or 1.
    size = np.array([1.0] * 3 + [length] * 3)
    turning = np.linalg.norm(given.frame[:, :3], axis=1) < 0.5
    size = np.where(turning[:, None], size / length, size)
    bad = np.flatnonzero((np.abs(moved - given.frame) > 1e-6 * size).any(axis=1))
    if len(bad):
        labels = tuple(given.motions[row] for row in bad.tolist())
        sentence = f"{len(bad)} interface degrees of freedom do not follow rigid motion of the body: {listed(labels)}"
        cure = "check the points of these interfaces and the input matrix"
        findings.append(Finding(code="interfaces", severity="error", sentence=sentence, cure=cure, where=labels))


def _effective(given: Delivered, rigid: Floats, findings: list[Finding], facts: dict[str, Any]) -> None:
    """Effective masses of the modes with all interface degrees of freedom fixed (Clough and Penzien 1975)."""
    s = np.maximum(np.abs(given.C).max(axis=1, keepdims=True), np.finfo(float).tiny)
    _, sizes, rows = np.linalg.svd(given.C / s)
    N = rows[np.count_nonzero(sizes > 1e-12 * sizes.max()) :].T
    if not N.shape[1]:
        facts |= {"fixed_hz": np.zeros(0), "effective_mass": np.zeros((0, 6)), "effective_mass_share": np.zeros(6)}
        return
    values, phi = _eigh(N.T @ given.K @ N, N.T @ given.M @ N)
    taken = (N @ phi).T @ given.M @ rigid
    whole = np.diag(rigid.T @ given.M @ rigid)
    share = (taken**2).sum(axis=0) / whole
    facts["fixed_hz"] = np.sqrt(np.maximum(values, 0.0)) / (2 * np.pi)
    facts["effective_mass"], facts["effective_mass_share"] = taken**2, share
    if share[:3].min() < EFFECTIVE:
        words = ", ".join(f"{value:.0%}" for value in share[:3])
        sentence = f"modes with fixed interfaces carry {words} of the mass along x, y, z"
        cure = "if loads come from moving interfaces, keep more modes; mass at the interfaces is not in this sum"
        findings.append(Finding(code="effective-mass", severity="note", sentence=sentence, cure=cure))


def _damping(given: Delivered, values: Floats, Y: Floats, findings: list[Finding], facts: dict[str, Any]) -> None:
    """Damping ratios of the elastic modes, and damping of rigid motion."""
    elastic = slice(given.rigid_count, None)
    omega = np.sqrt(np.maximum(values[elastic], np.finfo(float).tiny))
    ratios = np.einsum("in,ij,jn->n", Y[:, elastic], given.D, Y[:, elastic]) / (2 * omega)
    facts["damping_ratios"] = ratios
    if len(ratios) and ratios.min() < -1e-12:
        k = int(ratios.argmin())
        sentence = (
            f"elastic mode {k + 1} at {omega[k] / (2 * np.pi):.4g} Hz has a negative damping ratio of {ratios[k]:.3g}"
        )
        cure = "a simulation would gain energy; check the damping matrix"
        findings.append(Finding(code="negative-damping", severity="error", sentence=sentence, cure=cure))
    elif len(ratios):
        k = int(ratios.argmin())
        words = "no damping" if ratios.max() <= 0 else f"damping ratios from {ratios.min():.3g} to {ratios.max():.3g}"
        sentence = f"elastic modes have {words}, the lowest at {omega[k] / (2 * np.pi):.4g} Hz"
        findings.append(Finding(code="damping", severity="note", sentence=sentence))
    rigid = Y[:, : given.rigid_count]
    per_second = np.einsum("in,ij,jn->n", rigid, given.D, rigid)
    if len(per_second) and len(omega) and np.abs(per_second).max() > 1e-9 * omega[0]:
        sentence = f"damping slows rigid-body motion (up to {np.abs(per_second).max():.3g} 1/s)"
        cure = "leave out damping that is proportional to mass, unless the ground is meant"
        findings.append(Finding(code="grounded-damping", severity="warning", sentence=sentence, cure=cure))


def stored_findings(file: StoredBodies) -> dict[str, Diagnosis]:
    """What is wrong with each body of a file: whether what it says of itself is what follows from its matrices."""
    return {name: check_delivery(body, file) for name, body in file.bodies.items()}


def refuse_unsound(path: str, diagnoses: Mapping[str, Diagnosis]) -> None:
    """Stop at bodies that contradict themselves.

    Raises:
        InputError: there are some; all errors are in the message.
    """
    errors = {name: diagnosis.errors for name, diagnosis in diagnoses.items() if diagnosis.errors}
    wrong = [f"body {name!r}: {'; '.join(sentences(findings))}" for name, findings in errors.items()]
    if wrong:
        raise InputError(f"{path} is not sound, as it was damaged or changed after it was written: {'. '.join(wrong)}")
