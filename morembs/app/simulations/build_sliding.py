"""Bodies with switched static modes, and what slides along them, from a system file."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np

from morembs.app.simulations.built import Built
from morembs.app.simulations.laws import refuse_outside
from morembs.app.simulations.sliding_tables import SlidingTable
from morembs.app.simulations.tables import BodyTable
from morembs.base.types import Floats
from morembs.body.body import Body
from morembs.dynamics.multibody import FlexibleBody, LinearBody, MovingLoad, PathSupport, PointOnPath, SwitchingBody
from morembs.responses.static_mode_tables import StaticModeTables
from morembs.storage.csv_table import read_table


def switching_body(
    built: Built, table: BodyTable, body: Body, moving: FlexibleBody | None, sliding: list[SlidingTable]
) -> SwitchingBody:
    """The body of a table with its static modes; without ``moving`` it is held.

    Raises:
        InputError: a body without static modes, or a start off its path.
    """
    tables = body.switching()
    inner: FlexibleBody | LinearBody
    if moving is None:
        inner = LinearBody(
            body.mass_matrix,
            body.stiffness_matrix,
            body.damping_matrix,
            weight=tables.weight,
            start=table.elastic or None,
            rate=table.elastic_rate or None,
            name=table.name,
        )
    else:
        inner = moving
    own = table.switching
    return SwitchingBody(
        inner,
        tables,
        at=[_start(built, each, tables, inner) for each in sliding],
        variant=own.variant,
        look_ahead=own.look_ahead,
        damping_ratio=own.damping_ratio,
        interpolation=own.interpolation,
    )


def _start(built: Built, table: SlidingTable, tables: StaticModeTables, inner: FlexibleBody | LinearBody) -> float:
    """Position along the path at the start, m."""
    if table.at is not None:
        return table.at
    if table.marker is None:
        return position_of(built, table)(built.tables.simulation.begin)
    rider = built.marker(table.marker)
    place = rider.place(rider.component.start()[0]).position
    if isinstance(inner, FlexibleBody):
        x = inner.start()[0]
        place = x[3:12].reshape(3, 3).T @ (place - x[:3]) + inner.frame.origin
    return float(tables.s[int(np.argmin(np.linalg.norm(tables.xyz - place, axis=1)))])


def position_of(built: Built, table: SlidingTable) -> Callable[[float], float]:
    """Position of a load along its path, m, as a function of time.

    Raises:
        InputError: a table that cannot be read, or does not cover the run.
    """
    times = built.tables.simulation
    if table.positions is None:
        start, speed, begin = table.at or 0.0, table.speed, times.begin
        return lambda t: start + speed * (t - begin)
    path = built.file.resolve(table.positions)
    columns = read_table(path, ("t", "s"), what="the positions of a load")
    refuse_outside(path, columns["t"], times.begin, times.end)
    return lambda t: float(np.interp(t, columns["t"], columns["s"]))


def slider_of(built: Built, table: SlidingTable, name: str) -> MovingLoad | PathSupport | PointOnPath:
    """What slides on a body, on the window that is its own.

    Raises:
        InputError: what the simulator refuses.
    """
    on_it = [each for each in built.tables.sliding if each.body == table.body]
    window = next(number for number, each in enumerate(on_it) if each is table)
    path = cast(SwitchingBody, built.bodies[table.body]).path(window)
    if table.kind == "load":
        return MovingLoad(path, position=position_of(built, table), force=_force(built, table), name=name)
    rider = built.marker(table.marker or "")
    if table.kind == "support":
        return PathSupport(path, rider, up=table.up, compliance=table.compliance, name=name)
    return PointOnPath(path, rider, up=table.up, name=name)


def _force(built: Built, table: SlidingTable) -> Floats | Callable[[float], Floats]:
    force = np.array(table.force)
    if table.law is None:
        return force
    factor = built.factor(table.law)
    return lambda t: factor(t) * force
