"""Limits of the error of a body on every frequency of a band."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from morembs.base.errors import InputError
from morembs.base.summary import upwards
from morembs.base.types import Floats
from morembs.base.units import angular_band, in_hz
from morembs.certificate.record import ErrorLimits
from morembs.certificate.tolerances import TOL
from morembs.reducers.base import ReducedModel
from morembs.responses.cells import BandCells
from morembs.responses.certified_reference import CertifiedReference
from morembs.responses.layout import BlockIndex
from morembs.responses.measures import MEASURES, Limit, ReferenceResponse, compare
from morembs.responses.pencils import response_of
from morembs.responses.rational import PoleResidueForm
from morembs.responses.rounding import Response
from morembs.responses.tolerances import TOL as RESPONSES

UNKNOWN = ("the residual of the reference", "round-off of the full model", "round-off of the body")
CURES = (
    "give damping, or a damping_floor such as 0.01",
    "give more damping, or a larger damping_floor, or stiff parts a smaller stiffness",
    "give more damping, or another basis with fewer coordinates",
)


def body_response(reference: CertifiedReference, reduced: ReducedModel, layout: BlockIndex) -> Response:
    """The transfer matrix of ``reduced``, scaled, with the damping floor of ``reference``."""
    scale = reference.problem.motion_scale
    return response_of(
        reduced.M,
        reduced.D,
        reduced.K,
        reduced.B * scale,
        scale[:, None] * reduced.C,
        layout,
        structural=reduced.structural + 2 * reference.floor,
        highest=2 * np.pi * reference.band_hz[1],
        rigid=reduced.rigid_count,
        symmetric=reduced.symmetric,
    )


def error_limits(
    reference: CertifiedReference,
    reduced: ReducedModel,
    *,
    sharpness: float = RESPONSES.sharpness,
    most_cells: int = RESPONSES.max_cells,
) -> ErrorLimits:
    """Limits of the error of any body on every frequency of the band of ``reference``; it may be read from a file.

    An upper limit is at most ``sharpness`` times the lower one, unless round-off hinders or the band would have to be
    cut into more than ``most_cells`` cells; the limits hold all the same then, and a note says so.

    Args:
        reference: the full model over a band.
        reduced: the body to judge.
        sharpness: largest ratio of the upper limit to the lower one.
        most_cells: largest number of cells of the band.

    Raises:
        InputError: inputs that are not those of the problem.

    >>> limits = error_limits(certified_reference(problem, [0.0, 3000.0]), reduced)
    >>> sorted(limits.limits)
    ['envelope', 'peak', 'pointwise']
    """
    problem = reference.problem
    if reduced.B.shape[1] != problem.B.shape[1]:
        raise InputError(
            f"{reduced.name} has {reduced.B.shape[1]} inputs and the problem {problem.B.shape[1]}; "
            "give the problem the interfaces of the body",
            kind="conflict",
            keyword="interfaces",
        )
    low, high = angular_band(reference.band_hz)
    standard = reference.standard(reduced.symmetric)
    body = body_response(reference, reduced, standard.layout)
    sharp = {
        whose: at
        for whose, terms in (("the full model", standard.H), ("the body", body.terms))
        if (at := _undamped_pole(terms, low, high)) is not None
    }
    if sharp:
        at_hz, n = in_hz(min(sharp.values())), len(problem.coupling.columns)
        return ErrorLimits(
            limits={name: Limit(lower=0.0, upper=np.inf, at_hz=at_hz) for name in MEASURES},
            block_limit=np.full((n, n), np.inf),
            cells_hz=np.array([reference.band_hz]),
            cell_limit=np.full((1, 3), np.inf),
            notes=(
                f"no limit: there is an undamped resonance at {at_hz:,.6g} Hz, a pole of {' and of '.join(sharp)}, "
                "where a transfer error has none; "
                "give damping, or a damping_floor such as 0.01",
            ),
        )
    limits, blocks, cells = compare(standard, body, low, high, sharpness, most_cells=most_cells)
    hz, upper = merge_cells(in_hz(cells.edges), cells.upper)
    # The ends as they were given.
    hz[0, 0], hz[-1, 1] = reference.band_hz
    notes: tuple[str, ...] = ()
    if not cells.converged:
        notes = (f"limits could be sharper: the search ended at {len(cells.upper):,} cells",)
    loose = [
        name
        for name, limit in limits.items()
        if limit.upper == np.inf or (cells.converged and 2 * sharpness * limit.lower < limit.upper)
    ]
    notes += tuple(_causes(standard, body, cells, loose))
    return ErrorLimits(limits=limits, block_limit=blocks, cells_hz=hz, cell_limit=upper, notes=notes)


def _causes(standard: ReferenceResponse, body: Response, cells: BandCells, loose: Sequence[str]) -> list[str]:
    """Why the limits of the measures ``loose`` lie far above what is reached, or are infinite, in words.

    The largest part of what is not known of the two responses, over the envelope, on the cell with the largest limit.
    """
    because: dict[str, list[str]] = {}
    for name in loose:
        low, high = cells.edges[int(cells.upper[:, MEASURES.index(name)].argmax())]
        omega = np.linspace(low, high, TOL.cause_samples)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            inverse = standard.modes.moduli(omega)[0]
            e = inverse @ standard.residue_norms[:, 0]
            parts = np.nan_to_num(
                [
                    standard.uncertainty(omega, omega),
                    standard.lost_to_rounding(omega, inverse) / e + standard.floor,
                    body.rounding.at(body.terms.moduli(omega)[0]).size()[:, 0] / e,
                ],
                nan=np.inf,
                posinf=np.inf,
            )
            size = standard.layout.norms(standard.H.at(omega))[:, 0] / e
        worst = int(parts.max(axis=1).argmax())
        lost = float(parts[worst].max())
        at = omega[int(parts[worst].argmax())]
        amount = f"is {upwards(lost)} of the envelope" if np.isfinite(lost) else "exceeds the damping of a pole"
        what = f"{UNKNOWN[worst]} {amount} at {in_hz(at):,.6g} Hz; {CURES[worst]}"
        if name == "pointwise" and lost < TOL.zero_response and size.min() < TOL.zero_response:
            at = omega[int(size.argmin())]
            what = (
                f"H has a zero near {in_hz(at):,.6g} Hz, of {size.min():.1e} of its envelope, of which "
                f'{upwards(lost)} is not known; take measure = "envelope"'
            )
        elif name == "peak" and not cells.lower[3] > 0:
            what = f"no value of H is known to differ from zero: {what}"
        because.setdefault(what, []).append(name)
    return [f"{', '.join(names)}: limited as {what}" for what, names in because.items()]


def _undamped_pole(terms: PoleResidueForm, low: float, high: float) -> float | None:
    """The first pole in the band that lies on the axis of frequencies, up to round-off; None if there is none."""
    z = terms.z.ravel()
    on = z.real[(np.abs(z.imag) <= TOL.undamped_pole * np.abs(z)) & (z.real >= low) & (z.real <= high)]
    return float(on.min()) if len(on) else None


def merge_cells(cells: Floats, upper: Floats) -> tuple[Floats, Floats]:
    """Neighbouring cells (nc, 2) with limits (nc, 3) in the same ``cell_merge_ratio`` as one, the larger limits."""
    alike = TOL.cell_merge_ratio
    with np.errstate(divide="ignore"):
        size = np.log(upper)
    while True:
        steps = np.floor(size / np.log1p(alike))
        first = np.flatnonzero(np.append(True, (steps[1:] != steps[:-1]).any(axis=1)))
        if alike > TOL.max_merge_ratio:
            # Infinite limits beside finite ones are alike in no steps: neighbours are one whatever they are.
            first = np.arange(0, len(cells), -(-len(cells) // TOL.max_stored_cells))
        if len(first) <= TOL.max_stored_cells:
            ends = cells[np.append(first[1:], len(cells)) - 1, 1]
            return np.stack([cells[first, 0], ends], axis=1), np.maximum.reduceat(upper, first)
        alike *= 2


def infinite_limits(blocks: int) -> ErrorLimits:
    """No limits."""
    return ErrorLimits(
        limits={name: Limit(lower=0.0, upper=np.inf, at_hz=np.nan) for name in MEASURES},
        block_limit=np.full((blocks, blocks), np.inf),
        cells_hz=np.zeros((0, 2)),
        cell_limit=np.zeros((0, 3)),
    )
