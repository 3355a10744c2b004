"""The tables of a system file, SI units. Docs, messages and the JSON schema come from the hints of their keys."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from morembs.app.jobs.stages.unreduced import RotationTable
from morembs.app.jobs.tables import Three
from morembs.app.simulations.contact_tables import ContactElementTable, ContactTable
from morembs.app.simulations.keys import (
    ORIGIN,
    Between,
    MarkerName,
    OptionalName,
    PartName,
    refuse_foreign,
    refuse_names,
)
from morembs.app.simulations.laws import LawTable, MotionTable
from morembs.app.simulations.sliding_tables import SlidingTable, SwitchingTable
from morembs.app.simulations.tolerances import TOL as LIMITS
from morembs.base.errors import InputError
from morembs.base.key_tables import Table, declare_key
from morembs.base.limits import Finite, NotNegative, Positive, PositiveCount, SpectralRadius, length, text
from morembs.dynamics.multibody.tolerances import TOL, NewtonTolerance


@dataclass(frozen=True, kw_only=True)
class SimulationTable(Table):
    """``[simulation]``: times, and the integrator: generalised-alpha."""

    end: Finite = declare_key("the time at which the run ends, s")
    step: Positive = declare_key("the time step, s")
    begin: Finite = declare_key("the time at which it begins, s", 0.0)
    rho: SpectralRadius = TOL.default_rho
    tolerance: NewtonTolerance = TOL.newton_error
    corrected_start: bool = declare_key("true for a start of second order, or false", True)
    max_deflection: Positive | Literal["none"] = declare_key(
        'the largest deflection of an elastic body per length of it, or "none"', 1.0
    )

    def refuse_conflicts(self) -> None:
        if not self.end > self.begin:
            raise InputError(
                f"end = {self.end:g} was given with begin = {self.begin:g}; expected an end after it",
                kind="conflict",
                keyword="end",
            )
        if self.step > self.end - self.begin:
            raise InputError(
                f"step = {self.step:g} was given for a run of {self.end - self.begin:g} s; expected a shorter step",
                keyword="step",
            )

        if not (self.end - self.begin) / self.step <= LIMITS.steps:
            raise InputError(
                f"step = {self.step:g} was given for a run of {self.end - self.begin:g} s; expected {LIMITS.steps:,} "
                "steps at most: take a longer step or an earlier end",
                keyword="step",
            )

    @property
    def steps(self) -> int:
        """Number of steps without events."""
        return max(1, round((self.end - self.begin) / self.step))

    @property
    def deflection(self) -> float | None:
        """The limit as the simulator takes it."""
        return None if isinstance(self.max_deflection, str) else self.max_deflection


@dataclass(frozen=True, kw_only=True)
class GravityTable(Table):
    """``[gravity]``."""

    acceleration: Three = declare_key("[x, y, z] in m/s2, such as [0, 0, -9.81]", ORIGIN)


@dataclass(frozen=True, kw_only=True)
class EquilibriumTable(Table):
    """``[equilibrium]``: the run starts from the static equilibrium nearest to where the bodies are put."""

    load_steps: PositiveCount = 1
    tolerance: NewtonTolerance = TOL.left_force


@dataclass(frozen=True, kw_only=True)
class BodyTable(Table):
    """``[[body]]``: an elastic body of a body file; its interfaces are its markers."""

    name: PartName
    file: Annotated[str, text('the path of a body file such as "rod.h5"')]
    reduction: str | None = declare_key("the body of the file, where it has several", None)
    at: dict[str, Finite] = declare_key("values of its parameters in SI units such as { E = 2.0e11 }", {})
    frame: str | None = declare_key('another floating frame, such as "mean-axes" or "tangent:LEFT"', None)
    stiffening: bool = False
    position: Three = declare_key("[x, y, z] of the origin of its model, m", ORIGIN)
    rotation: RotationTable | None = declare_key("a table { axis = [x, y, z], degrees = ... }", None)
    velocity: Three = declare_key("[x, y, z] of the origin of its model along the inertial axes, m/s", ORIGIN)
    angular_velocity: Three = declare_key("[x, y, z] along the axes of the body, rad/s", ORIGIN)
    elastic: list[Finite] = declare_key("its elastic coordinates at the start, zero unless given", [])
    elastic_rate: list[Finite] = declare_key("their rates at the start, zero unless given", [])
    held: bool = declare_key("true for a body at rest that only bends, below [[sliding]] loads", False)
    switching: SwitchingTable = field(default_factory=SwitchingTable)
    nodes: dict[str, int] = declare_key("further markers at nodes of the file, such as { middle = 1234 }", {})

    def refuse_conflicts(self) -> None:
        refuse_names("nodes", self.nodes)


@dataclass(frozen=True, kw_only=True)
class RigidBodyTable(Table):
    """``[[rigid_body]]``: a rigid body, by its mass and inertia."""

    name: PartName
    mass: Positive
    inertia: list[Finite] | list[Three] = declare_key(
        "three principal moments or a matrix (3, 3), kg m2, about the centre of mass"
    )
    center_of_mass: Three = declare_key("[x, y, z] from its origin, m", ORIGIN)
    position: Three = declare_key("[x, y, z] of its origin, m", ORIGIN)
    rotation: RotationTable | None = declare_key("a table { axis = [x, y, z], degrees = ... }", None)
    velocity: Three = declare_key("[x, y, z] of its origin along the inertial axes, m/s", ORIGIN)
    angular_velocity: Three = declare_key("[x, y, z] along the axes of the body, rad/s", ORIGIN)
    markers: dict[str, Three] = declare_key("points of the body such as { pin = [0.1, 0, 0] }, m", {})

    def refuse_conflicts(self) -> None:
        refuse_names("markers", self.markers)


@dataclass(frozen=True, kw_only=True)
class MemberTable(Table):
    """``[[member]]``: a member with large deflections in a plane, of a file of its parameterisation.

    Its markers are ``start`` and ``end``.
    """

    name: PartName
    file: Annotated[str, text('the path of a file of members such as "rod.h5"')]
    member: str | None = declare_key("the member of the file, where it has several", None)
    position: Three = declare_key("[x, y, z] of its start, m", ORIGIN)
    rotation: RotationTable | None = declare_key(
        "a table { axis = [x, y, z], degrees = ... }: turns chord, direction across and normal from x, y and z", None
    )
    velocity: Three = declare_key("[x, y, z] of its start along the inertial axes, within its plane, m/s", ORIGIN)
    spin: Finite = declare_key("its angular velocity about its normal, rad/s", 0.0)
    ends: Annotated[list[Finite], length("two angles of start and end to the chord, rad", 2)] = declare_key(
        "two angles of start and end to the chord, rad", [0.0, 0.0]
    )


@dataclass(frozen=True, kw_only=True)
class MarkerTable(Table):
    """``[[marker]]``: a frame on the ground or on a rigid body, beside the markers that bodies have."""

    name: PartName
    body: PartName = "ground"
    point: Three = declare_key("[x, y, z] from the origin of the body, m", ORIGIN)
    rotation: RotationTable | None = declare_key("a table { axis = [x, y, z], degrees = ... } of its axes", None)


@dataclass(frozen=True, kw_only=True)
class JointTable(Table):
    """``[[joint]]``: constraints between two markers; "ground" alone is where the other marker is at the start."""

    kind: Literal["fixed", "revolute", "spherical", "prismatic", "plane", "plane-fixed", "angle", "position"]
    between: Between
    axis: Three = declare_key(
        "[x, y, z] along the axes of the first marker; of plane joints the normal", [0.0, 0.0, 1.0]
    )
    motion: MotionTable | None = declare_key("a table { kind = ..., ... }, of the kinds angle and position", None)
    name: OptionalName = declare_key("a name; joint_1, joint_2, ... unless given", "")

    def refuse_conflicts(self) -> None:
        driven = self.kind in ("angle", "position")
        if driven and self.motion is None:
            raise InputError(
                f'kind = "{self.kind}" was given without motion; expected a table {{ kind = ..., ... }}',
                kind="conflict",
                keyword="kind",
            )
        if self.motion is not None and not driven:
            raise InputError(
                f'motion was given beside kind = "{self.kind}"; add a [[joint]] for it, of kind "angle" or "position"',
                kind="conflict",
                keyword="motion",
            )


@dataclass(frozen=True, kw_only=True)
class LoadTable(Table):
    """``[[load]]``: a force and a moment at a marker."""

    marker: MarkerName
    force: Three = declare_key("[x, y, z] in N", ORIGIN)
    moment: Three = declare_key("[x, y, z] in Nm", ORIGIN)
    follows: bool = declare_key("true along the axes of the marker, false along those of the ground", False)
    law: LawTable | None = declare_key("a table { kind = ..., ... }: a factor of time; constant without it", None)
    name: OptionalName = declare_key("a name; load_1, load_2, ... unless given", "")

    def refuse_conflicts(self) -> None:
        if not any([*self.force, *self.moment]) and (self.law is None or self.law.kind != "table"):
            raise InputError(
                "neither force nor moment was given; expected one, or a law of the kind table",
                kind="missing",
                keyword="force",
            )


@dataclass(frozen=True, kw_only=True)
class SpringTable(Table):
    """``[[spring]]``: a spring and damper along the line of two markers, or about an axis."""

    kind: Literal["line", "torsion"] = "line"
    between: Between
    stiffness: NotNegative = declare_key("N/m, of a torsion spring Nm/rad")
    damping: NotNegative = declare_key("Ns/m, of a torsion spring Nms/rad", 0.0)
    length: NotNegative | None = declare_key("m without force, of the kind line; the distance at the start", None)
    axis: Three | None = declare_key("[x, y, z] along the axes of the first marker, of the kind torsion", None)
    angle: Finite = declare_key("rad without moment from the start, of the kind torsion", 0.0)
    name: OptionalName = declare_key("a name; spring_1, spring_2, ... unless given", "")

    def refuse_conflicts(self) -> None:
        refuse_foreign(self, self.kind, {"line": {"length"}, "torsion": {"axis", "angle"}})
        if self.kind == "torsion" and self.axis is None:
            raise InputError(
                'kind = "torsion" was given without axis; expected [x, y, z]', kind="conflict", keyword="kind"
            )


@dataclass(frozen=True, kw_only=True)
class ObserveTable(Table):
    """``[[observe]]``: the moving mesh of an elastic body, with its stresses, for ParaView."""

    body: PartName
    path: Annotated[str, text("the path of a .vtkhdf file", r"\.(vtkhdf|hdf)$")]
    stress: bool | None = declare_key("true or false; where its file has a stress recovery", None)
    scale: Positive = declare_key("magnifies deformations", 1.0)
    every: PositiveCount = declare_key("n to take every n-th of the times of the result", 1)


@dataclass(frozen=True, kw_only=True)
class OutputTable(Table):
    """``[output]``: the file of the result."""

    path: Annotated[str, text('the path of the result such as "swing.h5"', r"\.(h5|hdf5)$")]
    every: PositiveCount = declare_key("n to keep every n-th step", 1)
    markers: list[MarkerName] | None = declare_key("those whose motion is written; all", None)


@dataclass(frozen=True, kw_only=True)
class SystemTables(Table):
    """All tables of a system file."""

    simulation: SimulationTable
    gravity: GravityTable = field(default_factory=GravityTable)
    equilibrium: EquilibriumTable | None = None
    body: list[BodyTable] = field(default_factory=list)
    rigid_body: list[RigidBodyTable] = field(default_factory=list)
    member: list[MemberTable] = field(default_factory=list)
    marker: list[MarkerTable] = field(default_factory=list)
    joint: list[JointTable] = field(default_factory=list)
    load: list[LoadTable] = field(default_factory=list)
    spring: list[SpringTable] = field(default_factory=list)
    contact_element: list[ContactElementTable] = field(default_factory=list)
    contact: list[ContactTable] = field(default_factory=list)
    sliding: list[SlidingTable] = field(default_factory=list)
    observe: list[ObserveTable] = field(default_factory=list)
    output: OutputTable

    def refuse_conflicts(self) -> None:
        bodies = [each.name for key in ("body", "rigid_body", "member") for each in getattr(self, key)]
        if not bodies:
            raise InputError(
                "no body was given; expected tables [[body]], [[rigid_body]] or [[member]]",
                kind="missing",
                keyword="body",
            )
        _refuse_twice("body", [*bodies, "ground"])
        for key in ("joint", "load", "spring", "contact_element", "contact", "sliding"):
            _refuse_twice(key, [each.name for each in getattr(self, key) if each.name])
        self._refuse_mixed()

    def _refuse_mixed(self) -> None:
        """Refuse what one run cannot have together: its integrators differ."""
        if self.contact and self.sliding:
            raise InputError(
                "[[contact]] and [[sliding]] were both given, and no run has both; take [[contact_element]], a force",
                kind="conflict",
                keyword="contact",
            )
        special = "contact" if self.contact else "sliding" if self.sliding else ""
        if special and self.equilibrium is not None:
            raise InputError(
                f"[equilibrium] was given beside [[{special}]], whose run starts where bodies are put",
                kind="conflict",
                keyword="equilibrium",
            )
        if self.sliding and "corrected_start" in self.simulation.given:
            raise InputError(
                "[simulation] corrected_start was given beside [[sliding]], which chooses it; leave it out",
                kind="conflict",
                keyword="simulation",
            )
        carried = {each.body for each in self.sliding}
        for body in self.body:
            for key in sorted({"held", "switching"} & body.given) if body.name not in carried else ():
                raise InputError(
                    f"[[body]] {body.name!r}: {key} was given, and no [[sliding]] is on it; leave it out",
                    keyword="body",
                )
            if body.held and body.given & {
                "position",
                "rotation",
                "velocity",
                "angular_velocity",
                "stiffening",
                "frame",
            }:
                raise InputError(
                    f"[[body]] {body.name!r}: held was given, and it stays where its model is", keyword="body"
                )


def _refuse_twice(what: str, names: list[str]) -> None:
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(
            f"the name {twice!r} was given twice for a {what}; give each a name of its own",
            kind="conflict",
            keyword="name",
        )
