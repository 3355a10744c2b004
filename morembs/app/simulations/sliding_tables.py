"""Tables of loads, supports and points that slide along a body with switched static modes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from morembs.app.jobs.tables import Three
from morembs.app.simulations.keys import ORIGIN, MarkerName, OptionalName, PartName, refuse_foreign
from morembs.app.simulations.laws import CsvPath, LawTable
from morembs.base.errors import InputError
from morembs.base.key_tables import Table, declare_key
from morembs.base.limits import Finite, NotNegative, PositiveCount, number
from morembs.dynamics.multibody.tolerances import TOL


@dataclass(frozen=True, kw_only=True)
class SwitchingTable(Table):
    """How static modes of a body are switched under ``[[sliding]]`` loads."""

    variant: Literal["quasi-static", "dynamic"] = "quasi-static"
    look_ahead: PositiveCount = 1
    damping_ratio: Annotated[float, number("a number from 0, such as 0.1", ge=0, lt=10)] = TOL.default_damping_ratio
    interpolation: Literal["catmull-rom", "linear"] = "catmull-rom"


@dataclass(frozen=True, kw_only=True)
class SlidingTable(Table):
    """``[[sliding]]``: a load that moves along the path of a body, or a marker that rides on it."""

    kind: Literal["load", "support", "point"] = "load"
    body: PartName
    at: Finite | None = declare_key("m along the path at the start; 0, of a rider the node nearest to its marker", None)
    speed: Finite = declare_key("m/s along the path, of the kind load", 0.0)
    positions: CsvPath | None = declare_key("in place of at and speed: a .csv file with the columns t and s", None)
    force: Three = declare_key("[x, y, z] in N along the inertial axes, of the kind load", ORIGIN)
    law: LawTable | None = declare_key("a table { kind = ..., ... }: a factor of time of the force", None)
    marker: MarkerName | None = declare_key("what rides on the path, of the kinds support and point", None)
    up: Three = declare_key("a direction across the path, of the kinds support and point", [0.0, 0.0, 1.0])
    compliance: NotNegative = declare_key("m/N besides that of the static modes, of the kind support", 0.0)
    name: OptionalName = declare_key("a name; sliding_1, sliding_2, ... unless given", "")

    def refuse_conflicts(self) -> None:
        riding = {"marker", "up"}
        keys = {"load": {"speed", "positions", "force", "law"}, "support": riding | {"compliance"}, "point": riding}
        refuse_foreign(self, self.kind, keys)
        if self.kind != "load" and self.marker is None:
            raise InputError(
                f'kind = "{self.kind}" was given without marker; expected "BODY:NAME"', kind="conflict", keyword="kind"
            )
        if self.positions is not None and self.given & {"at", "speed"}:
            raise InputError(
                "positions was given beside at or speed; leave them out", kind="conflict", keyword="positions"
            )
        if self.kind == "load" and not any(self.force):
            raise InputError("force is missing; expected [x, y, z] in N", kind="missing", keyword="force")
        if self.law is not None and self.law.kind == "table" and not any(self.force):
            raise InputError("law was given without force, which it multiplies", kind="conflict", keyword="law")
