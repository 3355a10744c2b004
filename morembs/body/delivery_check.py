"""Checks a reduced body before it is handed over: symmetry, rigid-body motion in three ways, ground, mass, damping.

The checks are the usual ones of Craig-Bampton models in spacecraft dynamics, for every kind of basis. Those of
rigid-body motion are in ``rigid_check``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from morembs.base.errors import InputError, SolverError
from morembs.base.types import Floats
from morembs.base.units import eigenvalue_in_hz, in_hz
from morembs.body.curve_check import curve_findings
from morembs.body.delivered import Delivered, collect_delivered
from morembs.body.diagnostics.findings import Diagnosis, Finding, sentences
from morembs.body.effective_mass import effective_masses
from morembs.body.frame_check import frame_findings
from morembs.body.rigid_check import eigh, rigid_findings, scale
from morembs.body.stored import StoredBodies
from morembs.body.tolerances import TOL
from morembs.linalg.dense import symmetric
from morembs.linalg.massless import CURE, MassSplit, split_massless

if TYPE_CHECKING:
    from morembs.body import Body, Part
    from morembs.reducers.base import ReducedModel


def check_delivery(body: ReducedModel | Body, part: Part | StoredBodies | None = None) -> Diagnosis:
    """Findings about a reduced model (with its ``part``), a body, or one read from a file (with the whole of the file).

    Facts: "mass", "center_of_mass", "inertia" (of the reduced M), "rigid_energy_J" (way -> (6,), half the stiffness of
    a unit translation or rotation about the centre of mass), "rigid_hz" (way -> the highest frequency that this energy
    means), "ground_force" (way -> (n, 6) K q), "effective_mass" (modes with fixed interfaces, 6) with
    "effective_mass_share" (6,) of the whole and "fixed_hz", "free_hz", "damping_ratios" of the elastic modes.

    Raises:
        InputError: a stored body without its file, or a reduced model without its part.
    """
    given = collect_delivered(body, part)
    findings: list[Finding] = []
    facts: dict[str, Any] = {}
    if not _finite(given, findings):
        return Diagnosis(findings=tuple(findings))
    _symmetry(given, findings)
    split = _split(given, findings)
    _definite(given, findings, facts, split)
    if given.without_mass:
        sentence, _, cure = given.without_mass.partition("; give ")
        findings.append(Finding(code="without-mass", severity="warning", sentence=sentence, cure=f"give {cure}"))
    if any(
        finding.code == "loose" or (finding.code == "indefinite" and "M " in finding.sentence) for finding in findings
    ):
        return Diagnosis(findings=tuple(findings), facts=facts)
    try:
        # What is far out of range is told by the findings.
        with np.errstate(all="ignore"):
            _check_modes(given, findings, facts, split)
    except np.linalg.LinAlgError as error:
        sentence = f"K and M of the reduced body have no eigenvalues that can be computed ({error})"
        findings.append(Finding(code="unsolvable", severity="error", sentence=sentence, cure="write it again"))
    return Diagnosis(findings=tuple(findings), facts=facts)


def _check_modes(given: Delivered, findings: list[Finding], facts: dict[str, Any], split: MassSplit | None) -> None:
    """What the modes of the body tell; motions without mass have some for that, far above all others."""
    findings += frame_findings(given)
    values, Y, heavy = *_modes(given, split), given
    if split is not None:
        far = split.above(given.K, given.M)
        # Y stays: motions without mass are no part of what is told of modes.
        hz = np.where(np.isinf(given.hz), in_hz(far), given.hz)
        heavy = replace(given, M=split.with_mass(given.K, given.M, far), hz=hz)
        values = np.where(np.isinf(values), far**2, values)
    _frequencies(heavy, values, Y, findings, facts)
    ways = rigid_findings(heavy, values, Y, findings, facts)
    if given.symmetric and ways and len(given.C):
        _effective(given, next(iter(ways.values())), findings, facts)
    last = len(values) - (0 if split is None else split.Z.shape[1])
    _damping(given, values[:last], Y[:, :last], findings, facts)
    findings += _response(given, values, Y)
    facts["free_hz"][last:] = np.inf


def _name_matrices(given: Delivered) -> dict[str, Floats]:
    return {"M": given.M, "K": given.K, "D": given.D}


def _finite(given: Delivered, findings: list[Finding]) -> bool:
    bad = [
        name for name, A in {**_name_matrices(given), "B": given.B, "C": given.C}.items() if not np.isfinite(A).all()
    ]
    if bad:
        sentence = f"{', '.join(bad)} of the reduced body hold entries that are not finite numbers"
        findings.append(Finding(code="not-finite", severity="error", sentence=sentence, cure="reduce it again"))
    return not bad


def _symmetry(given: Delivered, findings: list[Finding]) -> None:
    if not given.symmetric:
        sentence = "the reduced matrices are not symmetric (two bases), so energy is not conserved exactly"
        code, cure = "two-sided", "check that the target takes such bodies"
        if _congruent(given):
            code, sentence = "gyroscopic", "the reduced matrices have gyroscopic or circulatory terms: skew parts"
        findings.append(Finding(code=code, severity="note", sentence=sentence, cure=cure))
    r = given.rigid_count
    if not _congruent(given) and max(np.abs(given.K[:r]).max(initial=0.0), np.abs(given.K[:, :r]).max(initial=0.0)) > (
        TOL.asymmetry * np.abs(given.K).max(initial=0.0)
    ):
        sentence = f"K has entries on the {r} rigid motions, which are the first coordinates of a body of two bases"
        findings.append(Finding(code="grounded", severity="error", sentence=sentence, cure="write it again"))
    for name, A in _name_matrices(given).items():
        if not given.symmetric and (name != "M" or not _congruent(given)):
            continue
        size = np.maximum(np.outer(scale(A), scale(A)), np.finfo(float).tiny)
        off = np.abs(A - A.T) / size
        if off.max(initial=0.0) > TOL.asymmetry:
            i, j = np.unravel_index(int(off.argmax()), off.shape)
            sentence = f"{name} is not symmetric: entries ({i + 1}, {j + 1}) are {A[i, j]:.6g} and {A[j, i]:.6g}"
            findings.append(Finding(code="not-symmetric", severity="error", sentence=sentence, cure="write it again"))


def _definite(given: Delivered, findings: list[Finding], facts: dict[str, Any], split: MassSplit | None) -> None:
    """M, K and D positive semidefinite."""
    for name, A in _name_matrices(given).items():
        if name == "M" and split is not None:
            continue
        if not given.symmetric and name != "M":
            continue
        s = scale(A)
        s[s == 0] = 1.0
        values = np.linalg.eigvalsh(symmetric(A) / np.outer(s, s))
        lowest = float(values.min(initial=1.0))
        facts[f"lowest_of_scaled_{name}"] = lowest
        if name != "M" and lowest < -TOL.negative_eigenvalue and _round_off(A, given):
            continue
        if lowest < -TOL.negative_eigenvalue:
            cure = "it feeds energy into a simulation; check the damping" if name == "D" else "check the full matrix"
            sentence = (
                f"{name} of the reduced body is not positive semidefinite (lowest scaled eigenvalue {lowest:.2e})"
            )
            findings.append(Finding(code="indefinite", severity="error", sentence=sentence, cure=cure))


def _split(given: Delivered, findings: list[Finding]) -> MassSplit | None:
    """The motions without mass, and a finding on them."""
    try:
        split = split_massless(symmetric(given.K), symmetric(given.M))
    except InputError as error:
        sentence, _, cure = str(error).partition("; ")
        findings.append(Finding(code="loose", severity="error", sentence=sentence, cure=cure))
        return None
    if split is None:
        return None
    n, m = split.Z.shape
    sentence = f"{m} of {n} coordinates of the reduced body have no mass (M is singular)"
    if not given.symmetric:
        cure = "give their dofs mass, or leave these out of the interface (components = [...])"
        findings.append(Finding(code="loose", severity="error", sentence=sentence, cure=cure))
        return None
    findings.append(
        Finding(code="massless", severity="warning", sentence=sentence, cure=f"where a simulation needs mass {CURE}")
    )
    return split


def _congruent(given: Delivered) -> bool:
    """True if motions are expanded with the basis that the equations were tested with."""
    return given.symmetric or bool(np.array_equal(given.B.T, given.C))


def _round_off(A: Floats, given: Delivered) -> bool:
    """True if what is negative in A lies in coordinates that it hardly resists, as rigid-body motion.

    A body of rigid-body motion alone has nothing but round-off in K and D.
    """
    if given.rigid_count == len(A):
        return True
    m = scale(given.M)
    m[m == 0] = 1.0
    values, squares = (np.linalg.eigvalsh(symmetric(X) / np.outer(m, m)) for X in (A, given.K))
    # Dashpots between nodes that move as one leave a D of round-off alone: critical damping is what it is measured by.
    size = np.sqrt(np.abs(squares).max(initial=0.0)) if A is given.D else 0.0
    return bool(values.min(initial=0.0) > -TOL.roundoff_eigenvalue * max(np.abs(values).max(initial=0.0), size))


def _modes(given: Delivered, split: MassSplit | None) -> tuple[Floats, Floats]:
    """Eigenvalues (n,) and vectors of unit modal mass, ascending, motions without mass last; real parts of bodies with
    two bases, and those of the symmetric part of K where there are circulatory terms."""
    if split is not None:
        P, Z = split.P, split.Z
        finite, X = eigh(symmetric(P.T @ given.K @ P), symmetric(P.T @ given.M @ P))
        return np.concatenate([finite, np.full(Z.shape[1], np.inf)]), np.hstack([P @ X, Z])
    if _congruent(given):
        return eigh(0.5 * (given.K + given.K.T), 0.5 * (given.M + given.M.T))
    import scipy.linalg as sl

    roots, vectors = sl.eig(given.K, given.M)
    order = np.argsort(roots.real, kind="stable")
    Y = vectors[:, order].real
    modal = np.einsum("in,ij,jn->n", Y, given.M, Y)
    return roots.real[order], Y / np.sqrt(np.maximum(np.abs(modal), np.finfo(float).tiny))


def _response(given: Delivered, values: Floats, Y: Floats) -> list[Finding]:
    E = None
    if _congruent(given):
        # Flow may make elastic modes softer than rigid motion.
        E = np.delete(Y, np.argsort(np.abs(values), kind="stable")[: given.rigid_count], axis=1)
    return curve_findings(given.curve, given.M, given.D, given.K, given.B, given.C, E, given.rigid_count)


def _frequencies(given: Delivered, values: Floats, Y: Floats, findings: list[Finding], facts: dict[str, Any]) -> None:
    hz = eigenvalue_in_hz(values)
    hz[: given.rigid_count] = 0.0
    facts["free_hz"] = hz
    if not given.inertia.any():
        sentence = f"the model has coordinates without places, {given.rigid_count} motions of which are free"
        cure = "a floating frame needs nodes; give coordinates and a dof map at the import"
        findings.append(Finding(code="no-places", severity="note", sentence=sentence, cure=cure))
    elif given.rigid_count < 6:
        sentence = f"the body is held to the ground: {given.rigid_count} of 6 rigid-body motions are free"
        cure = "multibody programs expect a free body; reduce a model without supports"
        findings.append(Finding(code="held", severity="warning", sentence=sentence, cure=cure))
    elastic = slice(given.rigid_count, None)
    squares = (2 * np.pi * given.hz) ** 2
    largest = np.abs(values).max(initial=0.0)
    slack = 2 * TOL.frequency_error * np.maximum(values, 0.0) + TOL.roundoff_eigenvalue * largest
    # Round-off of M in modes of unit modal mass, which light ones are made of.
    roundoff = len(values) * np.finfo(float).eps * np.einsum("ij,ij->j", np.abs(Y), np.abs(given.M) @ np.abs(Y))
    slack += 2 * roundoff * np.abs(values)
    if given.hz.shape != hz.shape or not (np.abs(squares - values) <= slack)[elastic].all():
        sentence = "the frequencies that come with the body are not those of its matrices"
        findings.append(Finding(code="frequencies", severity="error", sentence=sentence, cure="write it again"))
    if given.full_hz is None or not given.symmetric:
        return
    count = min(len(given.full_hz), len(hz))
    known = slice(given.rigid_count, count)
    full, reduced = given.full_hz[known], given.hz[known] if given.hz.shape == hz.shape else hz[known]
    # What round-off may take off a mode, eps abs(y)' abs(K) abs(y), in the body and in the model.
    size = np.abs(Y[:, known])
    lost = 2 * np.finfo(float).eps * np.einsum("ij,ij->j", size, np.abs(given.K) @ size) / (2 * np.pi) ** 2
    low = np.flatnonzero(reduced**2 + lost < (full * (1 - TOL.frequency_error)) ** 2)
    if len(low):
        k = int(low[0])
        sentence = (
            f"elastic mode {k + 1} of the body ({reduced[k]:.6g} Hz) is below that of the full model "
            f"({full[k]:.6g} Hz), which no projection does"
        )
        cure = "check that body and model belong together"
        findings.append(Finding(code="below-full-model", severity="error", sentence=sentence, cure=cure))


def _effective(given: Delivered, rigid: Floats, findings: list[Finding], facts: dict[str, Any]) -> None:
    """Effective masses of the modes with all interface degrees of freedom fixed (Clough and Penzien 1975)."""
    found = effective_masses(given.M, given.K, given.C, rigid)
    hz, share = found.frequencies_hz, found.share
    facts |= {"fixed_hz": hz, "effective_mass": found.masses, "effective_mass_share": share}
    if len(hz) and share[:3].min() < TOL.effective_mass:
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
    if len(ratios) and ratios.min() < -TOL.negative_damping:
        k = int(ratios.argmin())
        sentence = f"elastic mode {k + 1} at {in_hz(omega[k]):.4g} Hz has a negative damping ratio of {ratios[k]:.3g}"
        cure = "a simulation would gain energy; check the damping matrix"
        findings.append(Finding(code="negative-damping", severity="error", sentence=sentence, cure=cure))
    elif len(ratios):
        k = int(ratios.argmin())
        words = "no damping" if ratios.max() <= 0 else f"damping ratios from {ratios.min():.3g} to {ratios.max():.3g}"
        sentence = f"elastic modes have {words}, the lowest at {in_hz(omega[k]):.4g} Hz"
        findings.append(Finding(code="damping", severity="note", sentence=sentence))
    rigid = Y[:, : given.rigid_count]
    per_second = np.einsum("in,ij,jn->n", rigid, given.D, rigid)
    if len(per_second) and len(omega) and np.abs(per_second).max() > TOL.rigid_damping * omega[0]:
        sentence = f"damping slows rigid-body motion (up to {np.abs(per_second).max():.3g} 1/s)"
        cure = "leave out damping that is proportional to mass, unless the ground is meant"
        findings.append(Finding(code="grounded-damping", severity="warning", sentence=sentence, cure=cure))


def delivered_warnings(bodies: Sequence[Body]) -> tuple[str, ...]:
    """Warnings about reduced bodies, those of each named after it.

    Raises:
        SolverError: a body that is wrong.
    """
    warnings: list[str] = []
    for body in bodies:
        diagnosis = check_delivery(body)
        if diagnosis.errors:
            raise SolverError(f"the body {body.name!r} is not sound: {'; '.join(sentences(diagnosis.errors))}")
        warnings += [f"{body.name}: {sentence}" for sentence in sentences(diagnosis.warnings)]
    return tuple(warnings)


def stored_findings(file: StoredBodies) -> dict[str, Diagnosis]:
    """Faults of each body of a file: statements in the file that do not follow from its matrices."""
    return {name: check_delivery(body, file) for name, body in file.bodies.items()}


def refuse_unsound(path: str | Path, diagnoses: Mapping[str, Diagnosis]) -> None:
    """Stop at bodies that contradict themselves.

    Raises:
        InputError: there are some; all errors are in the message.
    """
    errors = {name: diagnosis.errors for name, diagnosis in diagnoses.items() if diagnosis.errors}
    wrong = [f"body {name!r}: {'; '.join(sentences(findings))}" for name, findings in errors.items()]
    if wrong:
        raise InputError(
            f"{path} is not sound, as it was damaged or changed after it was written: {'. '.join(wrong)}",
            kind="file",
            keyword=Path(path).name,
        )
