"""How wrong a reduced body is: limits of the error on every frequency of a band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morembs.base import progress
from morembs.base.arguments import checked
from morembs.base.errors import InputError, quote_value
from morembs.base.limits import DampingFloor
from morembs.base.types import Complexes, Floats
from morembs.base.units import eigenvalue_in_hz, in_hz
from morembs.certificate.limits import body_response, error_limits, infinite_limits
from morembs.certificate.poles import Poles, poles_of
from morembs.certificate.proof import proof_of
from morembs.certificate.record import Certificate, ErrorLimits
from morembs.certificate.response import reduced_response
from morembs.certificate.tolerances import TOL
from morembs.linalg.massless import split_massless
from morembs.problem import Problem
from morembs.reducers.base import ReducedModel
from morembs.responses.band import band_frequencies, checked_band
from morembs.responses.certified import certified_reference
from morembs.responses.certified_reference import CertifiedReference
from morembs.responses.direct import direct_response, elastic_statics
from morembs.responses.layout import BlockIndex
from morembs.responses.loads import static_response
from morembs.responses.measures import Measure, Sharpness
from morembs.responses.tolerances import TOL as RESPONSES
from morembs.storage.lemma import kind_of


@checked
def certify(
    problem: Problem,
    bodies: Sequence[ReducedModel],
    band_hz: Sequence[float] | Floats,
    *,
    measure: Measure = "envelope",
    damping_floor: DampingFloor | None = None,
    sharpness: Sharpness = RESPONSES.sharpness,
    points: int | Sequence[float] | Floats = RESPONSES.band_points,
    bound: bool = True,
) -> tuple[Certificate, ...]:
    """Compute the certificate of each body: limits of its error at every frequency of a band, both ends included.

    The limits include the error of the reference (``certified_reference``) that replaces the full model, and
    round-off. They are estimates if a damping matrix of the model has a negative eigenvalue. For a model with a
    gyroscopic or circulatory matrix there are no limits: errors are computed at the frequencies ``points`` from the
    full equations, and ``kind`` is "sampled".

    Args:
        problem: the full model with its interfaces.
        bodies: reduced models of ``problem``.
        band_hz: (low, high) in Hz.
        measure: "envelope", "peak" or "pointwise".
        damping_floor: ratio of critical damping that is added to the model and the bodies.
        sharpness: largest ratio of the upper limit to the lower limit; round-off may prevent it.
        points: number of frequencies of the stored curves, in addition to the resonances, or the frequencies (nf,)
            in Hz.
        bound: compute limits; without them the certificate has the curves only.

    Raises:
        InputError: no interfaces, an option out of its range, ``points`` that do not ascend within the band, modal
            damping together with a damping matrix of the model, or a damping floor together with a gyroscopic or
            circulatory matrix.
        SolverError: the full response cannot be computed.

    >>> [certificate] = certify(problem, [reduced], [0.0, 3000.0])
    >>> certificate.kind, certificate.measure
    ('proven', 'envelope')
    """
    if isinstance(bodies, ReducedModel):
        raise InputError("one reduced model was given; expected a list of them, such as [reduced]")
    low, high = checked_band([float(f) for f in band_hz])
    count, chosen = (int(points), None) if isinstance(points, int | np.integer) else (0, _within((low, high), points))
    if not problem.symmetric:
        hz = band_frequencies(problem, (low, high), count) if chosen is None else chosen
        return _measure_errors(problem, bodies, hz, (low, high), measure, damping_floor)
    reference = certified_reference(problem, (low, high), damping_floor=damping_floor)
    hz = band_frequencies(problem, (low, high), count, reference.floor) if chosen is None else chosen
    H = reference.H(2 * np.pi * hz)
    light = [reduced for reduced in bodies if _lacks_mass(reduced)]
    sampled_ones = iter(_measure_errors(problem, light, hz, (low, high), measure, damping_floor) if light else ())
    certificates = []
    for reduced in bodies:
        progress.update(f"certificate of {reduced.name}")
        if reduced in light:
            certificates.append(next(sampled_ones))
            continue
        if bound:
            limits = error_limits(reference, reduced, sharpness=sharpness)
        else:
            limits = infinite_limits(len(problem.coupling.columns))
        certificates.append(_certificate(reference, reduced, hz, H, limits, measure, bound))
    return tuple(certificates)


def _within(band_hz: tuple[float, float], points: Sequence[float] | Floats) -> Floats:
    """Frequencies (nf,) in Hz that were chosen, none of them beyond the band."""
    hz, (low, high) = np.asarray(points, dtype=float), band_hz
    if hz.ndim != 1 or not len(hz) or not (low <= hz[0] and hz[-1] <= high and (np.diff(hz) > 0).all()):
        raise InputError(
            f"points = {quote_value(hz.tolist())} was given; expected how many, or ascending frequencies in Hz "
            f"from {low:g} to {high:g}",
            keyword="points",
        )
    return hz


def _certificate(
    reference: CertifiedReference,
    reduced: ReducedModel,
    hz: Floats,
    H: Complexes,
    limits: ErrorLimits,
    measure: str,
    bound: bool,
) -> Certificate:
    problem, omega = reference.problem, 2 * np.pi * hz
    layout = BlockIndex(problem.B.shape[1], list(problem.coupling.columns.values()), symmetric=False)
    with np.errstate(divide="ignore", invalid="ignore"):
        body = body_response(reference, reduced, layout)
        H_r = body.terms.at(omega).reshape(H.shape)
        norm = np.linalg.norm(H, axis=(1, 2))
        error = np.linalg.norm(H_r - H, axis=(1, 2)) / norm
        unsure = reference.uncertainty(omega) / norm
        own = body.rounding.at(body.terms.moduli(omega)[0]).size()[:, 0] / norm
    poles = poles_of(reference, reduced)
    proof = proof_of(reference, limits) if bound else ()
    return Certificate(
        limits=limits.limits,
        block_limit=limits.block_limit,
        cells_hz=limits.cells_hz,
        cell_limit=limits.cell_limit,
        band_hz=reference.band_hz,
        measure=measure,
        damping_floor=reference.floor,
        proof=proof,
        kind=kind_of(proof) if bound else "sampled",
        frequencies_hz=hz,
        full=norm,
        reduced=np.linalg.norm(H_r, axis=(1, 2)),
        error=error,
        bound=error + unsure + own if bound else np.full(len(hz), np.inf),
        reference_error=unsure,
        block_error=_block_errors(problem, H_r - H, H),
        held_error=_held_errors(problem, H_r, H, omega),
        **_static_errors(problem, reduced),
        mode_frequencies_hz=poles.frequencies_hz,
        mode_enclosure_hz=poles.enclosure_hz,
        mode_deviation=poles.deviation,
        mode_mac=poles.mac,
        residue_deviation=poles.residue,
        verified_below_hz=float(eigenvalue_in_hz(reference.cut)),
        notes=(*limits.notes, *_on_damping(reference, reduced, poles), *_missing(poles)),
    )


def _lacks_mass(body: ReducedModel) -> bool:
    """True if some motion of ``body`` has no mass."""
    return body.symmetric and split_massless(body.K, body.M) is not None


def _measure_errors(
    problem: Problem,
    bodies: Sequence[ReducedModel],
    hz: Floats,
    band_hz: tuple[float, float],
    measure: str,
    floor: float | None,
) -> tuple[Certificate, ...]:
    """Certificates of bodies of a model that is not symmetric, or with motions without mass: errors at ``hz`` (nf,),
    without a limit between them."""
    what = (
        "bodies with motions that have no mass"
        if problem.symmetric
        else "a model with a gyroscopic or circulatory matrix"
    )
    if floor:
        raise InputError(
            f"a damping floor was given for {what}; leave it out", kind="unsupported", keyword="damping_floor"
        )
    S, nothing = np.outer(problem.motion_scale, problem.motion_scale), np.empty(0)
    H = direct_response(problem, 2 * np.pi * hz) * S
    statics, norm = problem.B.T @ elastic_statics(problem, problem.B) * S, np.linalg.norm(H, axis=(1, 2))
    certificates = []
    for body in bodies:
        H_r = reduced_response(body, 2 * np.pi * hz) * S
        static = reduced_response(body, np.zeros(1))[0] * S
        limits, error = infinite_limits(len(problem.coupling.columns)), np.linalg.norm(H_r - H, axis=(1, 2)) / norm
        certificates.append(
            Certificate(
                limits=limits.limits,
                block_limit=limits.block_limit,
                cells_hz=limits.cells_hz,
                cell_limit=limits.cell_limit,
                band_hz=band_hz,
                measure=measure,
                damping_floor=0.0,
                kind="sampled",
                frequencies_hz=hz,
                full=norm,
                reduced=np.linalg.norm(H_r, axis=(1, 2)),
                error=error,
                bound=np.full(len(hz), np.inf),
                reference_error=np.zeros(len(hz)),
                block_error=_block_errors(problem, H_r - H, H),
                held_error=_held_errors(problem, H_r, H, 2 * np.pi * hz),
                static_error=float(np.linalg.norm(static - statics) / np.linalg.norm(statics)),
                static_block_error=_block_errors(problem, (static - statics)[None], statics[None]),
                mode_frequencies_hz=nothing,
                mode_enclosure_hz=np.empty((0, 2)),
                mode_deviation=nothing,
                mode_mac=nothing,
                residue_deviation=nothing,
                verified_below_hz=0.0,
                notes=(
                    f"no limit is proven of {what}: errors are those at the sampled frequencies; modes are not "
                    "compared",
                ),
            )
        )
    return tuple(certificates)


def _static_errors(problem: Problem, reduced: ReducedModel) -> dict[str, Any]:
    """Errors at 0 Hz, by the fields of a certificate."""
    S = np.outer(problem.motion_scale, problem.motion_scale)
    statics = problem.B.T @ static_response(problem)
    # Without the loss factor, which would hide real parts.
    response = reduced_response(replace(reduced, structural=0.0), np.zeros(1))[0]
    wrong, full = (response - statics) * S, statics * S
    return {
        "static_error": float(np.linalg.norm(wrong) / np.linalg.norm(full)),
        "static_block_error": _block_errors(problem, wrong[None], full[None]),
    }


def _missing(poles: Poles) -> list[str]:
    """Modes that loads excite and the body does not have, in words."""
    lost = poles.frequencies_hz[poles.excited & (poles.mac < TOL.least_mac)]
    if not len(lost):
        return []
    listed = ", ".join(f"{f:,.6g}" for f in lost[:5]) + (", ..." if len(lost) > 5 else "")
    return [f"{len(lost)} of {len(poles.mac)} modes in the band are not in this body: {listed} Hz"]


def _on_damping(reference: CertifiedReference, reduced: ReducedModel, poles: Poles) -> list[str]:
    """What damping makes of the comparison, in words."""
    sentences, damping = list(reference.doubts), reference.problem.damping
    # Where the frequency of a body is off, the table may give its mode another ratio.
    omega = 2 * np.pi * poles.frequencies_hz
    moved = damping.ratio(omega) != damping.ratio(omega * (1 + np.nan_to_num(poles.deviation)))
    if moved.any():
        listed = ", ".join(f"{f:,.6g}" for f in in_hz(omega[moved][:5])) + (", ..." if moved.sum() > 5 else "")
        sentences.append(
            f"the modal damping table jumps between the frequencies that {int(moved.sum())} modes have in the full "
            f"model and in this body, which gives them different ratios: {listed} Hz"
        )
    if reduced.structural != damping.structural:
        sentences.append(
            f"the body has structural damping of {reduced.structural:g}, the full model {damping.structural:g}"
        )
    return sentences


def _block_errors(problem: Problem, error: Complexes, H: Complexes) -> Floats:
    """(ni, ni) largest error of each block over the band, relative to the block's own norm at that frequency."""
    columns = list(problem.coupling.columns.values())
    errors = np.zeros((len(columns), len(columns)))
    for i, rows in enumerate(columns):
        for j, loads in enumerate(columns):
            wrong, size = (np.linalg.norm(A[:, rows, loads], axis=(1, 2)) for A in (error, H))
            errors[i, j] = float((wrong / np.maximum(size, np.finfo(float).tiny)).max())
    return errors


def _held_errors(problem: Problem, H_r: Complexes, H: Complexes, omega: Floats) -> Floats:
    """(ni, nf) relative error of H_bb - H_ba H_aa^-1 H_ab, the response of the other motions with those of a held."""
    columns = list(problem.coupling.columns.values())
    errors = np.full((len(columns), len(omega)), np.nan)
    high = omega > max(TOL.least_held * omega[-1], 0.0)
    ZB = (problem.B.T @ problem.rigid) * problem.motion_scale[:, None]
    rigid = -(ZB @ ZB.T) / omega[high, None, None] ** 2
    for i, own in enumerate(columns):
        a = np.arange(H.shape[1])[own]
        b = np.setdiff1d(np.arange(H.shape[1]), a)
        if not len(b):
            continue
        full, reduced = (_with_held(A[high] + rigid, a, b) for A in (H, H_r))
        norm = np.linalg.norm(full, axis=(1, 2))
        errors[i, high] = np.linalg.norm(reduced - full, axis=(1, 2)) / np.maximum(norm, np.finfo(float).tiny)
    return errors


def _with_held(H: Complexes, a: NDArray[np.int64], b: NDArray[np.int64]) -> Complexes:
    inner = H[:, a[:, None], a]
    # A body without some motion of the interface, or on an undamped resonance, cannot be held there.
    if not np.isfinite(inner).all() or (np.linalg.matrix_rank(inner) < len(a)).any():
        return np.full((len(H), len(b), len(b)), np.nan)
    return np.asarray(H[:, b[:, None], b] - H[:, b[:, None], a] @ np.linalg.solve(inner, H[:, a[:, None], b]))
