"""What a run tells of the named parts of its system, as its file keeps it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from morembs.app.simulations.built import Built
from morembs.app.simulations.result_file import (
    BodyHistory,
    ContactHistory,
    EnergyHistory,
    ImpactList,
    JointHistory,
    MarkerHistory,
    SliderHistory,
    SwitchLog,
)
from morembs.base.types import Floats, Ints
from morembs.dynamics.multibody import (
    ContactResult,
    MovingLoad,
    PathSupport,
    PointOnPath,
    Result,
    SwitchingBody,
    local_response,
)
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


def select_rows(result: Result, rows: list[Ints]) -> Result:
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
    kept = select_rows(result, rows)
    energy = result.balance() if isinstance(result, ContactResult) else result.energy()
    ends = np.cumsum([0, *(len(segment.time) for segment in result.segments)])
    flat = np.concatenate([begin + at for (begin, _), at in zip(pairwise(ends), rows, strict=True)])
    return {
        "time": kept.time,
        "bodies": {name: _body(built, name, kept) for name in built.bodies},
        "joints": {
            name: JointHistory(
                kind=table.kind, between=tuple(table.between), reaction=kept.reaction(built.joints[name])
            )
            for name, table in zip(built.joints, built.tables.joint, strict=True)
        },
        "energy": EnergyHistory(**{key: values[flat] for key, values in vars(energy).items()}),
        **(_contacts(built, result, flat) if isinstance(result, ContactResult) else {"contacts": {}}),
        "sliders": {name: _slider(slider, kept) for name, slider in built.sliders.items()},
        "switches": _switches(built),
    }


def _body(built: Built, name: str, result: Result) -> BodyHistory:
    body, wanted = built.bodies[name], built.tables.output.markers
    x = result.configuration(body)
    markers = {
        key: MarkerHistory(**result.motion(marker), load=result.load(marker))
        for key, marker in built.markers[name].items()
        if wanted is None or f"{name}:{key}" in wanted
    }
    inner = body
    if isinstance(body, SwitchingBody):
        # The places of windows come last.
        inner, x = body.inner, x[:, : body.configuration_size - body.windows]
    given: Mapping[str, Floats] = {"coordinates": x}
    if isinstance(inner, FloatingBody):
        given = {"position": x[:, :3], "rotation": x[:, 3:12].reshape(-1, 3, 3), "coordinates": x[:, 12:]}
    return BodyHistory(kind=built.kinds[name], speeds=result.speeds(body), markers=markers, **given)


def _contacts(built: Built, result: ContactResult, flat: Ints) -> dict[str, Any]:
    values = ("gap", "force", "friction", "slip", "foot")
    impacts = result.impacts
    return {
        "contacts": {
            name: ContactHistory(**{key: getattr(result, key)(contact)[flat] for key in values})
            for name, contact in built.contacts.items()
        },
        "impacts": ImpactList(
            time=np.array([each.time for each in impacts]),
            loss=np.array([each.loss for each in impacts]),
            contact=tuple(", ".join(dict.fromkeys(name for name, _ in each.points)) for each in impacts),
        ),
    }


def _slider(slider: MovingLoad | PathSupport | PointOnPath, result: Result) -> SliderHistory:
    body = slider.path.component
    response = local_response(result, body, slider, stress=body.switching.stress is not None)
    return SliderHistory(
        position=response.position,
        displacement=response.displacement,
        largest_amplitude=response.loads,
        stress=response.stress,
    )


def _switches(built: Built) -> SwitchLog | None:
    if built.switch is None:
        return None
    log = built.switch.log
    return SwitchLog(
        time=np.array([each.time for each in log]),
        slider=tuple(each.slider for each in log),
        position=np.array([each.position for each in log]),
        rank=np.array([each.rank for each in log], dtype=int),
        dropped=np.array([each.dropped for each in log]),
    )
