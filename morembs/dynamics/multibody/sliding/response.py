"""Displacement and stress along a path, static modes included, after a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.dynamics.multibody.result import Result
from morembs.dynamics.multibody.segment import Segment
from morembs.dynamics.multibody.sliding.body import SwitchingBody
from morembs.dynamics.multibody.sliding.loads import Slider
from morembs.dynamics.multibody.system import State


@dataclass(frozen=True, kw_only=True, eq=False)
class LocalResponse:
    """Along a run: ``position`` (s,) m, ``displacement`` (s, 3) m of the path there along the axes of the body (static
    modes included), ``stress`` (s, 6) Pa between the nodes where the data have it, ``loads`` largest amplitude (s,)."""

    position: Floats
    displacement: Floats
    stress: Floats | None
    loads: Floats


@checked
def local_response(
    result: Result, body: SwitchingBody, position: Callable[[float], float] | Slider, *, stress: bool = False
) -> LocalResponse:
    """Displacement, and stress, at ``position``: m along the path as a function of time (s), or that of a slider.

    Args:
        result: the run.
        body: the body below the loads.
        position: m along the path as a function of time in s, or a slider.
        stress: whether stress is evaluated as well.

    Raises:
        InputError: a place too far from the loads for the band of the tables, stress that was not stored.
    """
    tables, rows = body.switching, []
    for segment in result.segments:
        for k, t in enumerate(segment.time):
            state = state_of(segment, k)
            s = position.along(state) if isinstance(position, Slider) else position(float(t))
            s = float(np.clip(0.0 if s is None else s, 0.0, tables.length))
            rows.append((s, *_local(state, body, s, stress)))
    s_, u, tensor, loads = (np.array(column) for column in zip(*rows, strict=True))
    return LocalResponse(position=s_, displacement=u, stress=tensor if stress else None, loads=loads)


def amplitudes(state: State, body: SwitchingBody) -> tuple[Floats, Ints, Floats]:
    """Coordinates (n,) of the constant basis, and the amplitudes (k,) of candidates, N, at a state."""
    assembly = state.assembly
    number = assembly.index(body)
    if number is None:
        raise InputError(f"body {body.name!r} is not in this run")
    x = state.x[assembly.in_x[number]]
    q = body.map @ body.split(x)[0][body.in_x]
    active = body.active(x)
    if active.set is not None:
        return q, active.set.candidates, active.set.Y @ body.split(x)[1]
    together = np.unique(np.concatenate(active.read))
    a = np.zeros(len(together))
    for force in assembly.forces:
        if isinstance(force, Slider) and force.path.component is body:
            at = [assembly.place(m, state.x) for m in force.markers]
            twists = [assembly.twist(m, p, state.v) for m, p in zip(force.markers, at, strict=True)]
            wrench = force.wrenches(state.time, at, twists)[0]
            a[np.searchsorted(together, active.read[force.path.window])] += wrench[6:]
    return q, together, a


def _local(state: State, body: SwitchingBody, s: float, stress: bool) -> tuple[Floats, Floats, float]:
    tables = body.switching
    q, candidates, a = amplitudes(state, body)
    acts = a != 0
    candidates, a = candidates[acts], a[acts]
    curve = tables.curve(s, body.interpolation)
    nodes, i = curve.span.nodes, curve.span.interval
    here = tables.of_nodes(int(nodes[0]), len(nodes))
    u = curve.rows(here) @ (tables.modes[here] @ q + tables.R(here, candidates) @ a)
    tensor = np.zeros(6)
    if stress:
        share = (s - tables.s[i]) / curve.span.length
        ends = [tables.stress_at(i + k, q, candidates, a) for k in (0, 1)]
        tensor = (1 - share) * ends[0] + share * ends[1]
    return u, tensor, float(np.abs(a).max(initial=0.0))


def state_of(segment: Segment, k: int) -> State:
    """The state number k of a segment."""
    return State(
        assembly=segment.assembly,
        time=float(segment.time[k]),
        x=segment.x[k],
        v=segment.v[k],
        acceleration=segment.acceleration[k],
        multipliers=segment.multipliers[k],
    )
