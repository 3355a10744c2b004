"""What a run tells of the named parts of its system, as its file keeps it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from morembs.app.simulations.build import Built
from morembs.app.simulations.result_file import BodyHistory, EnergyHistory, JointHistory, MarkerHistory
from morembs.base.types import Floats, Ints
from morembs.dynamics.multibody import Component, Result
from morembs.dynamics.multibody.floating_body import FloatingBody


def kept_rows(result: Result, every: int) -> list[Ints]:
    """Of each segment the rows that are kept: every n-th step of the run, and the ends of segments."""
    rows, begin = [], 0
    for segment in result.segments:
        last = len(segment.time) - 1
        first = -begin % every
        rows.append(np.unique(np.r_[0, np.arange(first, last + 1, every), last]))
        begin += last
    return rows


def thinned(result: Result, rows: list[Ints]) -> Result:
    """The run at those rows alone."""
    names = ("time", "x", "v", "acceleration", "multipliers")
    return Result(
        segments=tuple(
            replace(segment, **{name: getattr(segment, name)[at] for name in names})
            for segment, at in zip(result.segments, rows, strict=True)
        )
    )


def histories(built: Built, result: Result, rows: list[Ints]) -> dict[str, Any]:
    """The fields of ``Recording`` that a run fills, at the ``rows`` of its segments."""
    kept = thinned(result, rows)
    energy = result.energy()
    ends = np.cumsum([0, *(len(segment.time) for segment in result.segments)])
    flat = np.concatenate([begin + at for (begin, _), at in zip(pairwise(ends), rows, strict=True)])
    wanted = built.tables.output.markers
    return {
        "time": kept.time,
        "bodies": {
            name: _body(built, name, body, kept, None if wanted is None else set(wanted))
            for name, body in built.bodies.items()
        },
        "joints": {
            name: JointHistory(
                kind=table.kind, between=tuple(table.between), reaction=kept.reaction(built.joints[name])
            )
            for name, table in zip(built.joints, built.tables.joint, strict=True)
        },
        "energy": EnergyHistory(**{key: values[flat] for key, values in vars(energy).items()}),
    }


def _body(built: Built, name: str, body: Component, result: Result, wanted: set[str] | None) -> BodyHistory:
    x = result.configuration(body)
    markers = {
        key: MarkerHistory(**result.motion(marker))
        for key, marker in built.markers[name].items()
        if wanted is None or f"{name}:{key}" in wanted
    }
    given: Mapping[str, Floats] = {"coordinates": x}
    if isinstance(body, FloatingBody):
        given = {"position": x[:, :3], "rotation": x[:, 3:12].reshape(-1, 3, 3), "coordinates": x[:, 12:]}
    return BodyHistory(kind=built.kinds[name], speeds=result.speeds(body), markers=markers, **given)
