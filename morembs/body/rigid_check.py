"""Rigid-body motion of a reduced body, found in three ways, which in a sound body need no energy and give its mass.

Rigid motion of the body in reduced coordinates q, per unit motion about the origin, from

* geometry: the analytic rigid-body modes that the basis holds;
* stiffness: six interface degrees of freedom are given, the others follow without energy (K condensed to these);
* eigenvectors: the six lowest, scaled to the same interface degrees of freedom.

In a sound body all three agree, need no energy and give the mass of the model.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from morembs.base.types import Floats, Ints
from morembs.base.units import eigenvalue_in_hz
from morembs.body.delivered import Delivered
from morembs.body.diagnostics.findings import MOTIONS, Finding, list_labels
from morembs.body.tolerances import TOL
from morembs.fem import skew
from morembs.fem.mass import mass_properties
from morembs.linalg.dense import symmetric


def scale(A: Floats) -> Floats:
    """Roots (n,) of the diagonal of ``A`` (n, n), of the largest entry of its row where that vanishes."""
    d = np.abs(np.diag(A))
    return np.asarray(np.sqrt(np.where(d > 0, d, np.abs(A).max(axis=1, initial=0.0))))


def eigh(K: Floats, M: Floats) -> tuple[Floats, Floats]:
    """Eigenvalues (n,) and M-orthonormal vectors (n, n) of symmetric K and M; SciPy's would cost most of ``info``."""
    L = np.linalg.cholesky(M)
    A = np.linalg.solve(L, np.linalg.solve(L, K).T)
    values, Z = np.linalg.eigh(symmetric(A))
    return values, np.linalg.solve(L.T, Z)


def rigid_coordinates(given: Delivered, Y: Floats) -> dict[str, Floats]:
    """Way -> (n, 6) reduced coordinates of unit rigid motions about the origin of the model; known ways alone."""
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
        softest = TOL.roundoff_eigenvalue * float((np.abs(np.diag(K)) / np.diag(given.M)).max())
        s = 1 / scale(K + softest * np.diag(np.diag(given.M)))
        A, G = s[:, None] * K * s, C * s
        g = np.abs(G).max(axis=1, keepdims=True)
        border = np.block([[A, (G / g).T], [G / g, np.zeros((6, 6))]])
        rhs = np.vstack([np.zeros((len(A), 6)), R / g])
        ways["stiffness"] = s[:, None] * np.linalg.lstsq(border, rhs, rcond=TOL.least_squares_cutoff)[0][: len(A)]
    moved = C @ Y[:, :6]
    size = np.maximum(np.abs(moved).max(axis=1, keepdims=True), np.finfo(float).tiny)
    if np.linalg.cond(moved / size) < TOL.unclear_condition:
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
        if sizes[k] < TOL.dependent_support * sizes[0] or not sizes[k] > 0:
            return None
        direction = scaled[chosen[k]] / sizes[k]
        scaled -= np.outer(scaled @ direction, direction)
    return np.sort(chosen)


def rigid_findings(
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
    first = eigenvalue_in_hz(values[6]) if len(values) > 6 else 0.0
    shift = np.eye(6)
    shift[:3, 3:] = skew(given.center)
    facts["rigid_energy_J"], facts["rigid_hz"], facts["ground_force"], facts["rigid_mass"] = {}, {}, {}, {}
    for way, q in ways.items():
        centred = q @ shift
        energy, modal = centred.T @ given.K @ centred, centred.T @ given.M @ centred
        energy, modal = symmetric(energy), symmetric(modal)
        facts["rigid_energy_J"][way] = 0.5 * np.diag(energy)
        facts["ground_force"][way] = given.K @ q
        facts["rigid_mass"][way] = q.T @ given.M @ q
        d = np.sqrt(np.maximum(np.diag(modal), np.finfo(float).tiny))
        hz = float(eigenvalue_in_hz(eigh(energy / np.outer(d, d), modal / np.outer(d, d))[0][-1]))
        facts["rigid_hz"][way] = hz
        if first and hz > TOL.soft_ground * first:
            _ground(given, way, centred, hz, first, findings)
        _mass(given, way, q, findings, facts)
    if given.frame is not None and "geometry" in ways:
        _interfaces_follow(given, ways["geometry"], findings)
    return ways


def _ground(given: Delivered, way: str, q: Floats, hz: float, first: float, findings: list[Finding]) -> None:
    energy = 0.5 * np.diag(q.T @ given.K @ q)
    motions = np.flatnonzero(energy > TOL.named_energy * energy.max())
    sentence = (
        f"rigid motion (by {way}) strains the body: it would vibrate at {hz:.4g} Hz, the first elastic mode is at "
        f"{first:.4g} Hz; most energy {energy.max():.4g} J per unit motion, in "
        + ", ".join(MOTIONS[k] for k in motions)
    )
    findings.append(
        Finding(
            code="grounded",
            severity="error" if hz > TOL.hard_ground * first else "warning",
            sentence=sentence,
            cure="look for springs to the ground in the model, or for interface points that are not where K has them",
            where=tuple(MOTIONS[k] for k in motions),
        )
    )


def _mass(given: Delivered, way: str, q: Floats, findings: list[Finding], facts: dict[str, Any]) -> None:
    """Mass, centre and inertia of q' M q against those of the model."""
    root = _root(symmetric(given.M))
    mass, center, inertia = mass_properties(np.eye(len(q)), root @ q, np.zeros(3))
    if way == "geometry" or "mass" not in facts:
        facts |= {"mass": mass, "center_of_mass": center, "inertia": inertia}
    radius = float(np.sqrt(np.trace(given.inertia) / (2 * given.mass)))
    off = {
        "mass": abs(mass / given.mass - 1),
        "centre of mass": float(np.linalg.norm(center - given.center)) / radius,
        "inertia": float(np.abs(inertia - given.inertia).max() / np.abs(given.inertia).max()),
    }
    wrong = {name: value for name, value in off.items() if value > TOL.mass_error}
    if wrong:
        words = ", ".join(f"{name} by {value:.1e}" for name, value in wrong.items())
        both = f"mass {mass:.6g} and {given.mass:.6g} kg"
        sentence = f"rigid motion (by {way}) has another mass than the model: {words} ({both})"
        cure = "check units, the mass matrix, and that body and model belong together"
        severity = "error" if max(wrong.values()) > TOL.wrong_mass else "warning"
        findings.append(Finding(code="mass", severity=severity, sentence=sentence, cure=cure, where=tuple(wrong)))


def _root(M: Floats) -> Floats:
    """X (n, n) with X'X = M, which may be next to singular."""
    try:
        return np.asarray(np.linalg.cholesky(M).T)
    except np.linalg.LinAlgError:
        values, U = np.linalg.eigh(M)
        return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * U.T)


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
    bad = np.flatnonzero((np.abs(moved - given.frame) > TOL.interface_motion * size).any(axis=1))
    if len(bad):
        labels = tuple(given.motions[row] for row in bad.tolist())
        sentence = (
            f"{len(bad)} interface degrees of freedom do not follow rigid motion of the body: {list_labels(labels)}"
        )
        cure = "check the points of these interfaces and the input matrix"
        findings.append(Finding(code="interfaces", severity="error", sentence=sentence, cure=cure, where=labels))
