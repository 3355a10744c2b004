"""How a reduced model compares with the full one: its frequency response."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from morembs.body import ElasticBody
from morembs.body.stored import StoredBodies
from morembs.certificate.response import full_response, reduced_response
from morembs.problem import Problem
from morembs.progress import SILENT, Progress
from morembs.reducers.base import ReducedModel
from morembs.responses.measures import MEASURES
from morembs.summary import summarised

Floats = NDArray[np.float64]
POINTWISE = MEASURES.index("pointwise")
# A frequency of the full model may be unknown by this part of it, or of what it differs by from those of the bodies.
SHARP, SHARE = 1e-6, 0.1


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class FrequencyResponse:
    """Size of the elastic transfer function from interface forces to interface degrees of freedom.

    ``full`` (nf,) Frobenius norm of H in m/N at ``frequencies_hz`` (nf,); for each body ``reduced`` (nf,)
    its own norm and ``error`` (nf,) the norm of the difference over that of the full model, ``bound`` (2, n) steps of
    frequencies in Hz and of the upper limit of that error between them, where there is one, ``tolerance`` the limit of
    it that was asked for. Rotations and moments are scaled with the radius of gyration ``length`` in m, so that
    all entries have one unit.
    """

    frequencies_hz: Floats
    full: Floats
    reduced: Mapping[str, Floats]
    error: Mapping[str, Floats]
    bound: Mapping[str, Floats] = field(default_factory=dict)
    tolerance: Mapping[str, float] = field(default_factory=dict)
    length: float


def know_frequencies(problem: Problem, bodies: Sequence[ReducedModel], count: int, *, insist: bool) -> tuple[str, ...]:
    """Have ``problem`` know its lowest ``count`` free-free frequencies, for a comparison with those of ``bodies``.

    They are taken from the fixed-interface modes where these tell them sharply enough. Others are solved for unless the
    factor lies on disk, where that takes longer than all else; ``insist`` has it done there too. Returns notes on what
    is left out.
    """
    count = min(count, problem.K.shape[0] - problem.rigid.shape[1])
    if not count or problem.knows_modes(count):
        return ()
    hz = _sharp(problem.frequency_limits(count), bodies)
    if len(hz) < count and (insist or not problem.statics.factor.stats.out_of_core):
        problem.elastic_modes(count=count)
        return ()
    if len(hz):
        problem.take_frequencies(hz)
    if len(hz) == count:
        return ()
    return (
        f"{len(hz) or 'none'} of {count} free-free frequencies of the full model are known to compare the bodies with: "
        "the others would take an eigensolution with a factor on disk, which often takes longer than all else; "
        f"[check] full_modes = {count} asks for it",
    )


def _sharp(limits: Floats | None, bodies: Sequence[ReducedModel]) -> Floats:
    """The first frequencies (k,) in Hz that ``limits`` (2, n) tell well enough to compare ``bodies`` with."""
    if limits is None:
        return np.zeros(0)
    hz, off = limits[1], limits[1] - limits[0]
    least = np.full(len(hz), np.inf)
    for body in bodies:
        own = np.sqrt(np.maximum(body.modes()[0][body.rigid_count :], 0.0))[: len(hz)] / (2 * np.pi)
        least[: len(own)] = np.minimum(least[: len(own)], np.abs(own - hz[: len(own)]))
    sharp = off <= np.maximum(SHARP * hz, SHARE * np.where(np.isfinite(least), least, 0.0))
    return np.asarray(hz[: int(np.argmin(np.append(np.isfinite(hz) & sharp, False)))])


def recommended(limits: Mapping[str, float | None]) -> str:
    """Of the limits of the errors of some bodies the name of the smallest, the first where none is known."""
    known = {name: limit for name, limit in limits.items() if limit is not None}
    return min(known, key=lambda name: known[name]) if known else next(iter(limits))


def frequency_response(
    problem: Problem, bodies: Sequence[ElasticBody], frequencies_hz: Floats, progress: Progress = SILENT
) -> FrequencyResponse:
    """Full against reduced response at ``frequencies_hz`` (nf,)."""
    omega = 2 * np.pi * frequencies_hz
    size = np.outer(problem.motion_scale, problem.motion_scale)
    full = full_response(problem, omega, progress=progress) * size
    norm = np.linalg.norm(full, axis=(1, 2))
    reduced, error = {}, {}
    for body in bodies:
        H = reduced_response(body.reduced, omega) * size
        reduced[body.name] = np.linalg.norm(H, axis=(1, 2))
        error[body.name] = np.linalg.norm(H - full, axis=(1, 2)) / norm
    return FrequencyResponse(
        frequencies_hz=frequencies_hz, full=norm, reduced=reduced, error=error, length=problem.length
    )


def certified_response(problem: Problem, bodies: Sequence[ElasticBody]) -> FrequencyResponse | None:
    """The response that certificates were made with; None if no body has one."""
    known = {body.name: body.certificate for body in bodies if body.certificate is not None}
    if not known:
        return None
    first = next(iter(known.values()))
    return FrequencyResponse(
        frequencies_hz=first.frequencies_hz, full=first.full, length=problem.length,
        reduced={name: certificate.reduced for name, certificate in known.items()},
        error={name: certificate.error for name, certificate in known.items()},
        bound={
            name: _steps(certificate.cells_hz, certificate.cell_limit)
            for name, certificate in known.items() if len(certificate.cells_hz)
        },
        # Of a tolerance in another measure a line would tell nothing.
        tolerance={
            body.name: float(str(body.recipe["tolerance"])) for body in bodies
            if body.name in known and body.recipe.get("measure") == "pointwise" and "tolerance" in body.recipe
        },
    )  # fmt: skip


def _steps(cells_hz: Floats, limit: Floats) -> Floats:
    """(2, 2 nc) ends of the cells and their pointwise limits, as the error that is drawn beside them."""
    return np.stack([cells_hz.ravel(), np.repeat(limit[:, MEASURES.index("pointwise")], 2)])


def stored_response(stored: StoredBodies) -> FrequencyResponse | None:
    """The response that the certificates of a body file were made with, None without one."""
    known = {name: body.certificate for name, body in stored.bodies.items() if body.certificate is not None}
    if not known:
        return None
    first = next(iter(known.values()))
    return FrequencyResponse(
        frequencies_hz=first["frequencies_hz"], full=first["full"], length=float("nan"),
        reduced={name: values["reduced"] for name, values in known.items()},
        error={name: values["error"] for name, values in known.items()},
        bound={
            name: _steps(values["cells_hz"], values["cell_limit"])
            for name, values in known.items() if "cell_limit" in values
        },
    )  # fmt: skip
