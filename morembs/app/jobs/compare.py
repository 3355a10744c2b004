"""How a reduced model compares with the full one: its frequency response."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from morembs.base.summary import summarised
from morembs.base.types import Floats
from morembs.body import Body
from morembs.certificate.response import full_response, reduced_response
from morembs.problem import Problem
from morembs.responses.measures import MEASURES

POINTWISE = MEASURES.index("pointwise")


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


def know_frequencies(problem: Problem, count: int, *, insist: bool) -> tuple[str, ...]:
    """Have ``problem`` know its lowest ``count`` free-free frequencies, to compare bodies with; notes if it does not.

    They are solved for, but not with a factor on disk unless ``insist`` says so: there it often takes longer than
    the other stages together.
    """
    count = min(count, problem.K.shape[0] - problem.rigid.shape[1])
    if not count or problem.knows_modes(count):
        return ()
    if insist or not problem.statics.factor.stats.out_of_core:
        problem.elastic_modes(count=count)
        return ()
    return (
        "no free-free frequencies of the full model are known to compare the bodies with: they would take an "
        f"eigensolution with a factor on disk, which often takes longer than the other stages "
        f"together; [check] full_modes = {count} asks for it",
    )


def recommend_body(limits: Mapping[str, float | None]) -> str:
    """Of the limits of the errors of some bodies the name of the smallest, the first where none is known."""
    known = {name: limit for name, limit in limits.items() if limit is not None}
    return min(known, key=lambda name: known[name]) if known else next(iter(limits))


def frequency_response(problem: Problem, bodies: Sequence[Body], frequencies_hz: Floats) -> FrequencyResponse:
    """Full against reduced response at ``frequencies_hz`` (nf,)."""
    omega = 2 * np.pi * frequencies_hz
    size = np.outer(problem.motion_scale, problem.motion_scale)
    full = full_response(problem, omega) * size
    norm = np.linalg.norm(full, axis=(1, 2))
    reduced, error = {}, {}
    for body in bodies:
        H = reduced_response(body.reduced, omega) * size
        reduced[body.name] = np.linalg.norm(H, axis=(1, 2))
        error[body.name] = np.linalg.norm(H - full, axis=(1, 2)) / norm
    return FrequencyResponse(
        frequencies_hz=frequencies_hz, full=norm, reduced=reduced, error=error, length=problem.length
    )


def certified_response(bodies: Sequence[Body], length: float = np.nan) -> FrequencyResponse | None:
    """The response that certificates were made with, of rotations scaled by ``length``; None if no body has one."""
    known = {body.name: body.certificate for body in bodies if body.certificate is not None}
    if not known:
        return None
    first = next(iter(known.values()))
    return FrequencyResponse(
        frequencies_hz=first.frequencies_hz,
        full=first.full,
        length=length,
        reduced={name: certificate.reduced for name, certificate in known.items()},
        error={name: certificate.error for name, certificate in known.items()},
        bound={
            name: _steps(certificate.cells_hz, certificate.cell_limit)
            for name, certificate in known.items()
            if certificate.limits and len(certificate.cells_hz)
        },
        # Of a tolerance in another measure a line would tell nothing.
        tolerance={
            body.name: float(str(body.recipe["tolerance"]))
            for body in bodies
            if body.name in known and body.recipe.get("measure") == "pointwise" and "tolerance" in body.recipe
        },
    )


def _steps(cells_hz: Floats, limit: Floats) -> Floats:
    """(2, 2 nc) ends of the cells and their pointwise limits, as the error that is drawn beside them."""
    return np.stack([cells_hz.ravel(), np.repeat(limit[:, MEASURES.index("pointwise")], 2)])
