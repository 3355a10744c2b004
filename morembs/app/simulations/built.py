"""A system with the names of its parts, on its way from a system file to the simulator."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import numpy as np

from morembs.app.simulations.laws import LawTable, Scalar
from morembs.app.simulations.system_file import SystemFile
from morembs.app.simulations.tables import SystemTables
from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats
from morembs.body.body import Body
from morembs.body.file import StoredBodies
from morembs.dynamics.multibody import (
    Component,
    Constraint,
    Contact,
    FlexibleBody,
    Force,
    Marker,
    MovingLoad,
    PathSupport,
    PointOnPath,
    SlidingSwitch,
    SwitchingBody,
    System,
    ground,
)

GROUND = "ground"


@dataclass(kw_only=True, eq=False)
class Built:
    """A system with the names that its file gives to its parts.

    ``bodies`` and their ``kinds`` by name, ``markers`` by body and name, ``joints``, ``forces``, ``contacts`` and
    ``sliders`` by name; ``files`` are the body file, its content and the body of it, of elastic bodies by name.
    """

    file: SystemFile
    system: System
    bodies: dict[str, Component] = field(default_factory=dict)
    kinds: dict[str, str] = field(default_factory=dict)
    markers: dict[str, dict[str, Marker]] = field(default_factory=dict)
    joints: dict[str, Constraint] = field(default_factory=dict)
    forces: dict[str, Force] = field(default_factory=dict)
    contacts: dict[str, Contact] = field(default_factory=dict)
    sliders: dict[str, MovingLoad | PathSupport | PointOnPath] = field(default_factory=dict)
    files: dict[str, tuple[Path, StoredBodies, Body]] = field(default_factory=dict)
    switch: SlidingSwitch | None = None

    @property
    def tables(self) -> SystemTables:
        """Those of the file."""
        return self.file.tables

    def marker(self, label: str, other: Marker | None = None) -> Marker:
        """The marker of a label, "BODY:NAME"; "ground" alone is where the ``other`` one starts.

        Raises:
            InputError: a body or a marker that there is not.
        """
        body, _, name = label.partition(":")
        if label == GROUND:
            start = None if other is None else other.place(other.component.start()[0]).position
            return ground.marker_at() if start is None else ground.marker_at(start)
        if body != GROUND and body not in self.bodies:
            raise InputError(
                f"{label!r} names the body {body!r}; {nearest(body, [GROUND, *self.bodies])}", kind="unknown"
            )
        known = self.markers[body]
        if name not in known:
            raise InputError(f"{self._lacks(body, name)}; it has {', '.join(known) or 'none'}", kind="unknown")
        return known[name]

    def _lacks(self, body: str, name: str) -> str:
        """Why a body has no such marker."""
        if body in self.files:
            interface = self.files[body][1].interfaces
            if name in interface:
                return (
                    f"interface {name!r} of body {body!r} has the coupling {interface[name].coupling!r} and no frame "
                    'for joints and loads (reduce it with coupling = "rigid" or "average")'
                )
            return f"body {body!r} has no interface {name!r}"
        return "the ground has no marker" if body == GROUND else f"body {body!r} has no marker {name!r}"

    def node(self, body: str, row: int, name: str) -> Marker:
        """A marker at a node of an elastic body, a row of its file; its axes do not turn as the body deforms."""
        _, stored, content = self.files[body]
        made = self.bodies[body]
        if isinstance(made, SwitchingBody):
            raise InputError(
                f"body {body!r} carries [[sliding]], and its nodes are no markers; take its interfaces",
                kind="unsupported",
            )
        flexible = cast(FlexibleBody, made)
        if name in flexible.markers:
            return flexible.markers[name]
        motion = content.basis()[3 * row : 3 * row + 3] @ flexible.frame.elastic
        return flexible.marker_at(stored.coordinates[row] - flexible.frame.origin, motion, name=name)

    def factor(self, law: LawTable) -> Scalar:
        """The factor of a law.

        Raises:
            InputError: a table that cannot be read, or has no factor.
        """
        if law.kind != "table":
            return law.factor()
        times, values = self.columns(law)
        if values.shape[1] > 1:
            raise InputError(
                f"{law.file} has a force and a moment; expected the columns t,factor", kind="conflict", keyword="law"
            )
        return lambda t: float(np.interp(t, times, values[:, 0]))

    def columns(self, law: LawTable) -> tuple[Floats, Floats]:
        """Times and values of the table of a law."""
        times = self.tables.simulation
        return law.columns(self.file.resolve, times.begin, times.end)

    def pair(self, between: list[str]) -> tuple[Marker, Marker]:
        """Two markers, of which one may be where the other is.

        Raises:
            InputError: as ``marker``; the ground twice.
        """
        first, second = between
        if first == second == GROUND:
            raise InputError(
                "between names the ground twice; expected two bodies, or one and the ground",
                kind="conflict",
                keyword="between",
            )
        if first == GROUND:
            other = self.marker(second)
            return self.marker(first, other), other
        one = self.marker(first)
        return one, self.marker(second, one)


@contextmanager
def told_of(table: str, name: str) -> Iterator[None]:
    """Errors inside say which table they are about.

    Raises:
        InputError: as inside.
    """
    try:
        yield
    except InputError as error:
        raise error.restate(f"[[{table}]] {name!r}: {error}") from error
