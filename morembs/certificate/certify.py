"""How wrong a reduced body is: measured against the full model, and bounded without it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from morembs.certificate.residual import bound_of, modal_damping, residual_of, static_response
from morembs.certificate.response import reduced_response
from morembs.errors import SolverError
from morembs.linalg.columns import dot, multiply_into, project_out
from morembs.linalg.eigen import Modes
from morembs.problem import Problem
from morembs.progress import SILENT, Progress
from morembs.reducers.base import ReducedModel
from morembs.responses.band import beyond, round_off
from morembs.responses.reference import Reference, reference_model

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
# The full response is known to this part of its largest entry.
REFERENCE = 1e-10
# A bound that a measured error exceeds by this times the error of the full response itself is not proven.
UNSURE = 10.0
# Modes this close to each other are compared as one subspace.
CLUSTER = 1e-3
# A mode whose MAC is below this is missing.
MISSING = 0.5
# Part of the upper frequency below which rigid-body motion leaves too few digits to hold an interface afterwards.
HELD = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class Certificate:
    """Errors of the elastic transfer matrix H over a band, forces and moments scaled by the radius of gyration.

    ``frequencies_hz`` (nf,); ``full`` and ``reduced`` (nf,) Frobenius norms of H in m/N, ``error`` (nf,) the norm of
    the difference over that of the full model, ``bound`` (nf,) an upper bound of it, ``bound_kind`` "bound" where it is
    proven, "estimate" where it is not (or lies below a measured error), "none", of infinity.
    ``block_error`` (ni, ni) largest relative error of each block
    (motion of interface i, load on interface j), ``held_error`` (ni, nf) the relative error of what is left when
    interface i is held still, from the whole transfer matrix with its rigid-body part; not a number below ``HELD`` of
    the upper frequency. ``static_error`` that at 0 Hz. ``mode_frequencies_hz`` (k,) of the
    full model in the band, ``mode_deviation`` (k,) relative deviation of the reduced ones, ``mode_mac`` (k,)
    mass-weighted modal assurance criterion, of the whole cluster where modes are close. ``reference_error`` (nf,) is
    the estimated error of the full response itself, round-off in K included: below it ``error`` says nothing.
    """

    frequencies_hz: Floats
    full: Floats
    reduced: Floats
    error: Floats
    bound: Floats
    bound_kind: str
    block_error: Floats
    held_error: Floats
    static_error: float
    mode_frequencies_hz: Floats
    mode_deviation: Floats
    mode_mac: Floats
    verified_below_hz: float
    reference_error: Floats
    notes: tuple[str, ...] = field(default_factory=tuple)

    @property
    def absolute_error(self) -> float:
        """Largest error of H, relative to the largest norm of H in the band: means something at resonances too."""
        return float((self.error * self.full).max() / self.full.max())


def certify(
    problem: Problem, bodies: Sequence[ReducedModel], frequencies_hz: Floats, *, bound: bool = True,
    progress: Progress = SILENT,
) -> tuple[Certificate, ...]:  # fmt: skip
    """Certificate of each of ``bodies`` at ``frequencies_hz`` (nf,).

    The full response is that of ``reference_model``. The bound knows nothing of it: it takes the free-free modes up to
    ``band.BEYOND`` times the highest frequency, proven complete by a Sturm count, and one static solve for each
    coordinate. For Rayleigh and structural damping and none it is proven (in exact arithmetic); otherwise it is an
    estimate.

    Raises:
        InputError: no interfaces, or modal damping beside a damping matrix of the model.
        SolverError: the full response cannot be computed to ``REFERENCE``, or a response is not a number.
    """
    omega = 2 * np.pi * np.asarray(frequencies_hz, dtype=float)
    modes = problem.elastic_modes(below=beyond(float(frequencies_hz[-1])))
    reference = reference_model(problem, omega, tolerance=REFERENCE, progress=progress)
    H = reference.response(omega)
    made = []
    for reduced in bodies:
        progress.update(f"certificate of {reduced.name}")
        made.append(_certificate(problem, reduced, modes, omega, H, reference, bound))
    return tuple(made)


def _certificate(
    problem: Problem, reduced: ReducedModel, modes: Modes, omega: Floats, H: Complexes, reference: Reference,
    bound: bool,
) -> Certificate:  # fmt: skip
    S = np.outer(problem.motion_scale, problem.motion_scale)
    H_r = reduced_response(reduced, omega)
    norm = np.linalg.norm(H * S, axis=(1, 2))
    V = _elastic_part(problem, reduced)
    kind, limit = "none", np.full(len(omega), np.inf)
    notes = []
    if not reduced.is_projection:
        notes.append("no bound: positions and velocities have bases of their own")
    elif bound and V.shape[1]:
        kind = "estimate" if problem.damping.is_modal or problem.D is not None else "bound"
        if problem.D is not None:
            notes.append("the estimate neglects how the model's own damping couples modes in the band to those above")
        limit = _bounds(problem, reduced, V, modes, omega, reference) / norm
        if not np.isfinite(limit).all():
            kind, limit = "none", np.full(len(omega), np.inf)
            notes.append("no bound: round-off leaves none at some frequencies")
    error = np.linalg.norm((H_r - H) * S, axis=(1, 2)) / norm
    if not np.isfinite(error).all():
        raise SolverError(
            f"the response of {reduced.name} or of the full model is not a number at "
            f"{int((~np.isfinite(error)).sum())} of {len(omega)} frequencies, from "
            f"{omega[~np.isfinite(error)][0] / (2 * np.pi):.6g} Hz on; move them, or give the model damping"
        )
    reference_error = reference.error + round_off(problem, modes, omega, float(reference.values.max(initial=0.0)))
    below = ~(error <= limit + REFERENCE + UNSURE * reference_error)
    if kind == "bound" and below.any():
        # Whatever was proven in exact arithmetic, here round-off is larger.
        kind = "estimate"
        notes.append(
            f"the bound is not proven: it lies below the measured error at {int(below.sum())} of {len(omega)} "
            f"frequencies, by up to {np.nanmax(error - limit):.1e}; round-off is larger than it"
        )
    statics = problem.B.T @ static_response(problem)
    deviation, mac = _compared_modes(problem, reduced, V, modes, omega[-1])
    notes += _on_damping(problem, reduced, modes, deviation, reference)
    inside = modes.eigenvalues <= omega[-1] ** 2
    missing = modes.frequencies_hz[inside][mac < MISSING]
    if len(missing):
        listed = ", ".join(f"{f:,.6g}" for f in missing[:5]) + (", ..." if len(missing) > 5 else "")
        notes.append(f"{len(missing)} of {int(inside.sum())} modes in the band are not in this body: {listed} Hz")
    return Certificate(
        frequencies_hz=omega / (2 * np.pi), full=norm, reduced=np.linalg.norm(H_r * S, axis=(1, 2)),
        error=error, bound=limit, bound_kind=kind,
        block_error=_block_errors(problem, (H_r - H) * S, H * S),
        held_error=_held_errors(problem, H_r * S, H * S, omega),
        static_error=float(np.linalg.norm((reduced_response(replace(reduced, structural=0.0), np.zeros(1))[0]
                                           - statics) * S) / np.linalg.norm(statics * S)),
        mode_frequencies_hz=modes.frequencies_hz[inside], mode_deviation=deviation, mode_mac=mac,
        verified_below_hz=float(np.sqrt(modes.verified_below) / (2 * np.pi)),
        reference_error=reference_error,
        notes=tuple(notes),
    )  # fmt: skip


def _elastic_coordinates(reduced: ReducedModel) -> Floats:
    """(n, n - r): eigenvectors of a Galerkin projection, otherwise the coordinates behind the rigid-body modes."""
    whole = reduced.modes()[1] if reduced.symmetric else np.eye(reduced.order)
    return whole[:, reduced.rigid_count :]


def _elastic_part(problem: Problem, reduced: ReducedModel, basis: Floats | None = None) -> Floats:
    """Eigenvectors (Nc, n) of the reduced elastic part, free of rigid-body motion."""
    basis = reduced.V if basis is None else basis
    Y = _elastic_coordinates(reduced)
    V = multiply_into(basis, Y, problem.budget.empty((len(basis), Y.shape[1]), order="F"), problem.budget)
    project_out(problem.rigid, V, problem.M)
    return V


def _bounds(
    problem: Problem, reduced: ReducedModel, V: Floats, modes: Modes, omega: Floats, reference: Reference
) -> Floats:
    """Bounds (nf,) of the Frobenius norm of the scaled error of H."""
    Y = _elastic_coordinates(reduced)
    K, D, M = (Y.T @ A @ Y for A in (reduced.K, reduced.D, reduced.M))
    B, C, S = Y.T @ reduced.B, reduced.C @ Y, problem.motion_scale
    W = V if reduced.left is None else _elastic_part(problem, reduced, reduced.left)
    primal = residual_of(problem, V, W, modes, reference).scaled(S)
    dual = primal if reduced.left is None else residual_of(problem, W, V, modes, reference).scaled(S)
    C_true = np.asarray(problem.B.T @ V)
    D_known, off_known = _damping_of_known(problem, modes), problem.uncertainty(modes)
    found = []
    for w in omega:
        c, g = problem.damping.proportional(1j * w)
        A = (1 + 1j * reduced.structural) * K + 1j * w * D - w**2 * M
        y = np.linalg.solve(A, (B * S).astype(complex))
        z = y if reduced.left is None else np.linalg.solve(A.T, (C.T * S).astype(complex))
        # What the reduced matrices differ from the projections of the full ones: often round-off, and it counts.
        off = z.T @ primal.projected(y, w, c, g) + S[:, None] * ((C_true - C) @ y)
        limit = bound_of((primal, np.asarray(y)), (dual, np.asarray(z)), modes, w, c, g, D_known, off_known)
        found.append(limit + float(np.linalg.norm(off)))
    return np.array(found)


def _damping_of_known(problem: Problem, modes: Modes) -> Floats:
    """Damping other than Rayleigh's seen by the known modes, (k,) or (k, k)."""
    if problem.D is not None:
        return dot(modes.vectors, problem.D @ modes.vectors, problem.budget)
    return modal_damping(problem, modes.eigenvalues)


def _on_damping(
    problem: Problem, reduced: ReducedModel, modes: Modes, deviation: Floats, reference: Reference
) -> list[str]:
    """What damping makes of the comparison, in words."""
    found = []
    damping = problem.damping
    if len(damping.jumps) and reference.error > REFERENCE:
        found.append(
            f"the full response is known to {reference.error:.1e} only: the modal damping table jumps beside modes "
            "that are not resolved"
        )
    # Where the frequency of a body is off, the table may give its mode another ratio.
    omega = np.sqrt(modes.eigenvalues[: len(deviation)])
    moved = damping.ratio(omega) != damping.ratio(omega * (1 + np.nan_to_num(deviation)))
    if moved.any():
        listed = ", ".join(f"{f:,.6g}" for f in omega[moved][:5] / (2 * np.pi)) + (", ..." if moved.sum() > 5 else "")
        found.append(
            f"the modal damping table jumps between the frequencies that {int(moved.sum())} modes have in the full "
            f"model and in this body, which gives them different ratios: {listed} Hz"
        )
    if reduced.structural != damping.structural:
        found.append(
            f"the body has structural damping of {reduced.structural:g}, the full model {damping.structural:g}"
        )
    return found


def _block_errors(problem: Problem, error: Complexes, H: Complexes) -> Floats:
    """(ni, ni) largest error of each block over the band, relative to the block's own norm at that frequency."""
    columns = list(problem.coupling.columns.values())
    found = np.zeros((len(columns), len(columns)))
    for i, rows in enumerate(columns):
        for j, loads in enumerate(columns):
            wrong, size = (np.linalg.norm(A[:, rows, loads], axis=(1, 2)) for A in (error, H))
            found[i, j] = float((wrong / np.maximum(size, np.finfo(float).tiny)).max())
    return found


def _held_errors(problem: Problem, H_r: Complexes, H: Complexes, omega: Floats) -> Floats:
    """(ni, nf) relative error of H_bb - H_ba H_aa^-1 H_ab, the response of the other motions with those of a held."""
    columns = list(problem.coupling.columns.values())
    found = np.full((len(columns), len(omega)), np.nan)
    high = omega > max(HELD * omega[-1], 0.0)
    ZB = (problem.B.T @ problem.rigid) * problem.motion_scale[:, None]
    rigid = -(ZB @ ZB.T) / omega[high, None, None] ** 2
    for i, own in enumerate(columns):
        a = np.arange(H.shape[1])[own]
        b = np.setdiff1d(np.arange(H.shape[1]), a)
        if not len(b):
            continue
        full, reduced = (_with_held(A[high] + rigid, a, b) for A in (H, H_r))
        norm = np.linalg.norm(full, axis=(1, 2))
        found[i, high] = np.linalg.norm(reduced - full, axis=(1, 2)) / np.maximum(norm, np.finfo(float).tiny)
    return found


def _with_held(H: Complexes, a: NDArray[np.int64], b: NDArray[np.int64]) -> Complexes:
    inner = H[:, a[:, None], a]
    # A body without some motion of the interface cannot be held there.
    if (np.linalg.matrix_rank(inner) < len(a)).any():
        return np.full((len(H), len(b), len(b)), np.nan)
    return np.asarray(H[:, b[:, None], b] - H[:, b[:, None], a] @ np.linalg.solve(inner, H[:, a[:, None], b]))


def _compared_modes(
    problem: Problem, reduced: ReducedModel, V: Floats, modes: Modes, highest: float
) -> tuple[Floats, Floats]:
    """Relative deviations (k,) of the frequencies and the MAC (k,) of the full model's modes up to ``highest``."""
    inside = int((modes.eigenvalues <= highest**2).sum())
    if not inside or not V.shape[1]:
        return np.full(inside, np.nan), np.zeros(inside)
    cross = dot(modes.vectors[:, :inside], problem.M @ V, problem.budget)
    if not reduced.symmetric:
        cross = cross @ reduced.modes()[1][reduced.rigid_count :, reduced.rigid_count :]
        cross /= np.maximum(np.linalg.norm(cross, axis=0).max(initial=0.0), 1.0)
    theta = np.maximum(reduced.modes()[0][reduced.rigid_count :], 0.0)
    rows, found = linear_sum_assignment(-(cross**2))
    deviation, mac = np.full(inside, np.nan), np.zeros(inside)
    omega = np.sqrt(modes.eigenvalues[:inside])
    deviation[rows] = np.abs(np.sqrt(theta[found]) / omega[rows] - 1)
    partner = np.full(inside, -1)
    partner[rows] = found
    starts = np.flatnonzero(np.concatenate([[True], np.diff(omega) > CLUSTER * omega[1:]]))
    for first, last in zip(starts, [*starts[1:], inside], strict=True):
        held = partner[first:last]
        block = cross[first:last][:, held[held >= 0]]
        s = np.linalg.svd(block, compute_uv=False) if block.size else np.zeros(1)
        mac[first:last] = s.min() ** 2 if len(held) == block.shape[1] else 0.0
    return deviation, mac
