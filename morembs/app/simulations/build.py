"""From the tables of a system file to the system of ``morembs.dynamics.multibody`` that they say."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from morembs.app.jobs.stages.unreduced import RotationTable
from morembs.app.simulations.system_file import SystemFile
from morembs.app.simulations.tables import (
    BodyTable,
    JointTable,
    LoadTable,
    MemberTable,
    RigidBodyTable,
    SpringTable,
    SystemTables,
)
from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats
from morembs.body.body import Body
from morembs.body.file import StoredBodies, read_body
from morembs.body.floating.frame import FloatingFrame
from morembs.body.stored import choose_body
from morembs.dynamics.gmp import ParameterisedBody, PlaneJoint, ReducedMember
from morembs.dynamics.gmp.data import Parameterised
from morembs.dynamics.gmp.stored import read_members
from morembs.dynamics.multibody import (
    Component,
    Constraint,
    DrivenAngle,
    DrivenPosition,
    FixedJoint,
    FlexibleBody,
    Force,
    Marker,
    PointLoad,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    SphericalJoint,
    SpringDamper,
    System,
    TorsionSpring,
    ground,
    rotation,
)

GROUND = "ground"
KINDS = {
    "fixed": FixedJoint,
    "revolute": RevoluteJoint,
    "prismatic": PrismaticJoint,
    "angle": DrivenAngle,
    "position": DrivenPosition,
}


@dataclass(kw_only=True, eq=False)
class Built:
    """A system with the names that its file gives to its parts.

    ``bodies`` and their ``kinds`` by name, ``markers`` by body and name, ``joints`` and ``forces`` by name; ``files``
    are the body file, its content and the body of it, of elastic bodies by name.
    """

    file: SystemFile
    system: System
    bodies: dict[str, Component] = field(default_factory=dict)
    kinds: dict[str, str] = field(default_factory=dict)
    markers: dict[str, dict[str, Marker]] = field(default_factory=dict)
    joints: dict[str, Constraint] = field(default_factory=dict)
    forces: dict[str, Force] = field(default_factory=dict)
    files: dict[str, tuple[Path, StoredBodies, Body]] = field(default_factory=dict)

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
            raise InputError(f"{label!r} names the body {body!r}; {nearest(body, [GROUND, *self.bodies])}")
        known = self.markers[body]
        if name not in known:
            raise InputError(f"{self._lacks(body, name)}; it has {', '.join(known) or 'none'}")
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

    def pair(self, between: list[str]) -> tuple[Marker, Marker]:
        """Two markers, of which one may be where the other is.

        Raises:
            InputError: as ``marker``; the ground twice.
        """
        first, second = between
        if first == second == GROUND:
            raise InputError("between names the ground twice; expected two bodies, or one and the ground")
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
        raise InputError(f"[[{table}]] {name!r}: {error}") from error


def build(file: SystemFile) -> Built:
    """The system of a file; the body files are read.

    Raises:
        InputError: files that cannot be used, names that there are not, or what the simulator refuses of a part.
    """
    built = Built(file=file, system=System(gravity=file.tables.gravity.acceleration))
    built.markers[GROUND] = {}
    _add_bodies(built)
    for marker in file.tables.marker:
        with told_of("marker", marker.name):
            _add_marker(built, marker.name, marker.body, marker.point, axes_of(marker.rotation))
    for number, joint in enumerate(file.tables.joint, start=1):
        name = joint.name or f"joint_{number}"
        with told_of("joint", name):
            built.joints[name] = built.system.add(_joint(built, joint, name))
    for number, load in enumerate(file.tables.load, start=1):
        name = load.name or f"load_{number}"
        with told_of("load", name):
            built.forces[name] = built.system.add(_load(built, load, name))
    for number, spring in enumerate(file.tables.spring, start=1):
        name = spring.name or f"spring_{number}"
        with told_of("spring", name):
            built.forces[name] = built.system.add(_spring(built, spring, name))
    return built


def axes_of(table: RotationTable | None) -> Floats | None:
    """The rotation matrix (3, 3) of a table."""
    return None if table is None else rotation(np.array(table.axis), np.radians(table.degrees))


def _add_bodies(built: Built) -> None:
    read: dict[str, StoredBodies] = {}
    members: dict[str, Mapping[str, Parameterised]] = {}
    for table in built.tables.body:
        with told_of("body", table.name):
            place = built.file.resolve(table.file)
            if table.file not in read:
                read[table.file] = read_body(place)
            bodies = read[table.file]
            if table.at:
                bodies = choose_body(bodies, table.reduction, place).parametric.at(**table.at).bodies
            body = choose_body(bodies, table.reduction, place)
            built.files[table.name] = place, bodies, body
            made = _elastic(table, body, place)
            for name, label in table.nodes.items():
                _add_node(made, bodies, body, name, label)
            _add_body(built, "elastic", made)
    for rigid in built.tables.rigid_body:
        with told_of("rigid_body", rigid.name):
            _add_body(built, "rigid", _rigid(rigid))
    for member in built.tables.member:
        with told_of("member", member.name):
            if member.file not in members:
                members[member.file] = read_members(built.file.resolve(member.file))
            _add_body(built, "member", _member(member, members[member.file]))


def _add_body(built: Built, kind: str, body: FlexibleBody | RigidBody | ParameterisedBody) -> None:
    built.bodies[body.name], built.kinds[body.name] = built.system.add(body), kind
    built.markers[body.name] = dict(body.markers)


def _elastic(table: BodyTable, body: Body, place: Path) -> FlexibleBody:
    frame = _frame(table, body, place)
    R = axes_of(table.rotation)
    axes = np.eye(3) if R is None else R
    spin = np.array(table.angular_velocity)
    return FlexibleBody(
        frame,
        position=np.array(table.position) + axes @ frame.origin,
        rotation=axes,
        velocity=np.array(table.velocity) + axes @ np.cross(spin, frame.origin),
        angular_velocity=spin,
        elastic=table.elastic or None,
        elastic_rate=table.elastic_rate or None,
        stiffening=table.stiffening,
        name=table.name,
    )


def _add_node(made: FlexibleBody, bodies: StoredBodies, body: Body, name: str, label: int) -> None:
    """A marker at a node of the file, whose axes do not turn as the body deforms."""
    rows = np.flatnonzero(bodies.node_ids == label)
    if not len(rows):
        raise InputError(
            f"nodes: {name} = {label} was given, and the file keeps no node {label} among its {len(bodies.node_ids)}; "
            'write it with nodes = "all", or take another'
        )
    row, frame = int(rows[0]), made.frame
    motion = body.basis()[3 * row : 3 * row + 3] @ frame.elastic
    made.marker_at(bodies.coordinates[row] - frame.origin, motion, name=name)


def _frame(table: BodyTable, body: Body, place: Path) -> FloatingFrame:
    """The floating frame of a body, or the other one that is asked for.

    Raises:
        InputError: a body without one, or that cannot be seen from the other.
    """
    if body.floating is None:
        raise InputError(
            f"body {body.name!r} of {place} has no floating frame: it is held to the ground, or not symmetric; reduce "
            "the free part, whose interfaces are held by [[joint]]s here"
        )
    if table.frame is None:
        return body.floating
    if table.stiffening:
        raise InputError("stiffening belongs to the frame of the file; leave frame out")
    kind, _, names = table.frame.partition(":")
    return body.floating.in_frame(kind, [name.strip() for name in names.split(",") if name.strip()])


def _rigid(table: RigidBodyTable) -> RigidBody:
    return RigidBody(
        table.mass,
        np.array(table.inertia),
        center_of_mass=table.center_of_mass,
        position=table.position,
        rotation=axes_of(table.rotation),
        velocity=table.velocity,
        angular_velocity=table.angular_velocity,
        markers=table.markers,
        name=table.name,
    )


def _member(table: MemberTable, known: Mapping[str, Parameterised]) -> ParameterisedBody:
    name = table.member
    if name is None and len(known) > 1:
        raise InputError(f"{table.file} holds {len(known)} members ({', '.join(known)}); name one by member = ...")
    if name is not None and name not in known:
        raise InputError(f"{table.file} has no member {name!r}; {nearest(name, known)}")
    return ParameterisedBody(
        ReducedMember.of(known[name or next(iter(known))]),
        position=table.position,
        rotation=axes_of(table.rotation),
        velocity=table.velocity,
        spin=table.spin,
        ends=table.ends,
        name=table.name,
    )


def _add_marker(built: Built, name: str, body: str, point: list[float], axes: Floats | None) -> None:
    if body == GROUND:
        made: Marker = ground.marker_at(point, axes=axes, name=name)
    elif body not in built.bodies:
        raise InputError(f"body = {body!r} was given; {nearest(body, [GROUND, *built.bodies])}")
    else:
        holder = built.bodies[body]
        if not isinstance(holder, RigidBody):
            raise InputError(
                f"body = {body!r} is not rigid; take its interfaces, or nodes = {{ {name} = LABEL }} of it"
            )
        made = holder.marker_at(point, axes=axes, name=name)
    if name in built.markers[body]:
        raise InputError(f"{body} has a marker {name!r} already; give it another name")
    built.markers[body][name] = made


def _joint(built: Built, table: JointTable, name: str) -> Constraint:
    first, second = built.pair(table.between)
    if table.kind == "spherical":
        return SphericalJoint(first, second, name=name)
    if table.kind in ("plane", "plane-fixed"):
        return PlaneJoint(first, second, normal=table.axis, fixed=table.kind == "plane-fixed", name=name)
    more = {}
    if table.motion is not None:
        times = built.tables.simulation
        more["motion"] = table.motion.motion(built.file.resolve, times.begin, times.end)
    made: Constraint = KINDS[table.kind](first, second, axis=table.axis, name=name, **more)
    return made


def _load(built: Built, table: LoadTable, name: str) -> PointLoad:
    force, moment = np.array(table.force), np.array(table.moment)
    given: dict[str, Any] = {"force": force, "moment": moment}
    if table.law is not None and table.law.kind != "table":
        factor = table.law.factor()
        given = {"force": lambda t: factor(t) * force, "moment": lambda t: factor(t) * moment}
    elif table.law is not None:
        times, values = table.law.columns(
            built.file.resolve, built.tables.simulation.begin, built.tables.simulation.end
        )
        if force.any() or moment.any():
            if values.shape[1] > 1:
                raise InputError(f"force or moment was given beside {table.law.file}, which has them; leave them out")
            values = values * np.concatenate((force, moment))
        elif values.shape[1] == 1:
            raise InputError(f"{table.law.file} has a factor; give the force or the moment that it multiplies")

        def at(t: float) -> Floats:
            return np.array([np.interp(t, times, column) for column in values.T])

        given = {"force": lambda t: at(t)[:3], "moment": lambda t: at(t)[3:]}
    return PointLoad(built.marker(table.marker), follows=table.follows, name=name, **given)


def _spring(built: Built, table: SpringTable, name: str) -> Force:
    first, second = built.pair(table.between)
    if table.kind == "line":
        return SpringDamper(
            first, second, stiffness=table.stiffness, damping=table.damping, length=table.length, name=name
        )
    return TorsionSpring(
        first,
        second,
        axis=table.axis or (),
        stiffness=table.stiffness,
        damping=table.damping,
        angle=table.angle,
        name=name,
    )
