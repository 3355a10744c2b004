"""From the tables of a system file to the system of ``morembs.dynamics.multibody`` that they say."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar, cast

import numpy as np

from morembs.app.jobs.stages.unreduced import RotationTable
from morembs.app.simulations.build_contact import contact_of, element_of
from morembs.app.simulations.build_sliding import slider_of, switching_body
from morembs.app.simulations.built import GROUND, Built, told_of
from morembs.app.simulations.system_file import SystemFile
from morembs.app.simulations.tables import BodyTable, JointTable, LoadTable, MemberTable, RigidBodyTable, SpringTable
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
    SlidingSwitch,
    SphericalJoint,
    SpringDamper,
    SwitchingBody,
    System,
    TorsionSpring,
    ground,
    rotation,
)

KINDS = {
    "fixed": FixedJoint,
    "revolute": RevoluteJoint,
    "prismatic": PrismaticJoint,
    "angle": DrivenAngle,
    "position": DrivenPosition,
}


def build(file: SystemFile) -> Built:
    """The system of a file; the body files are read.

    Raises:
        InputError: files that cannot be used, names that there are not, or what the simulator refuses of a part.
    """
    built = Built(file=file, system=System(gravity=file.tables.gravity.acceleration))
    built.markers[GROUND] = {}
    tables, add, carried = file.tables, built.system.add, {each.body for each in file.tables.sliding}
    _add_bodies(built, carried)
    for marker in tables.marker:
        with told_of("marker", marker.name):
            _add_marker(built, marker.name, marker.body, marker.point, axes_of(marker.rotation))
    for body in tables.body:
        if body.name in carried:
            with told_of("body", body.name):
                _add_switching(built, body)
    _refuse_unknown(carried, built)
    built.joints = _make_parts("joint", tables.joint, lambda table, name: add(_joint(built, table, name)))
    built.forces |= _make_parts("load", tables.load, lambda table, name: add(_load(built, table, name)))
    built.forces |= _make_parts("spring", tables.spring, lambda table, name: add(_spring(built, table, name)))
    elements = tables.contact_element
    built.forces |= _make_parts("contact_element", elements, lambda table, name: add(element_of(built, table, name)))
    built.contacts = _make_parts("contact", tables.contact, lambda table, name: contact_of(built, table, name))
    built.sliders = _make_parts("sliding", tables.sliding, lambda table, name: add(slider_of(built, table, name)))
    if carried:
        built.switch = SlidingSwitch(*(cast(SwitchingBody, built.bodies[name]) for name in sorted(carried)))
    return built


class Named(Protocol):
    """A table with a name, or with the empty one."""

    @property
    def name(self) -> str:
        """The name."""


AnyNamed = TypeVar("AnyNamed", bound=Named)
Part = TypeVar("Part")


def _make_parts(kind: str, tables: Sequence[AnyNamed], make: Callable[[AnyNamed, str], Part]) -> dict[str, Part]:
    """Objects made of tables, by the names of these, or by default "KIND_NUMBER"."""
    made = {}
    for number, table in enumerate(tables, start=1):
        name = table.name or f"{kind}_{number}"
        with told_of(kind, name):
            made[name] = make(table, name)
    return made


def _refuse_unknown(carried: set[str], built: Built) -> None:
    known = [table.name for table in built.tables.body]
    for name in sorted(carried - set(known)):
        raise InputError(
            f"[[sliding]] body = {name!r} is not a [[body]]; {nearest(name, known)}", kind="unknown", keyword="body"
        )


def axes_of(table: RotationTable | None) -> Floats | None:
    """The rotation matrix (3, 3) of a table."""
    return None if table is None else rotation(np.array(table.axis), np.radians(table.degrees))


def _add_bodies(built: Built, carried: set[str]) -> None:
    """Add all bodies except the ones that loads are ``carried`` by, whose start depends on them; all files are read."""
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
            if table.name in carried:
                continue
            _add_body(built, "elastic", _elastic(table, body, place))
            for name, label in table.nodes.items():
                built.markers[table.name][name] = built.node(table.name, _row(bodies, name, label), name)
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


def _row(bodies: StoredBodies, name: str, label: int) -> int:
    """The row of a node of a file.

    Raises:
        InputError: the file does not keep it.
    """
    rows = np.flatnonzero(bodies.node_ids == label)
    if not len(rows):
        raise InputError(
            f"nodes: {name} = {label} was given, and the file keeps no node {label} among its {len(bodies.node_ids)}; "
            'write it with nodes = "all", or take another',
            kind="unknown",
            keyword="nodes",
        )
    return int(rows[0])


def _add_switching(built: Built, table: BodyTable) -> None:
    place, _, body = built.files[table.name]
    if table.nodes:
        raise InputError(
            "nodes was given for a body that carries [[sliding]], whose markers are its interfaces", keyword="nodes"
        )
    moving = None if table.held else _elastic(table, body, place)
    sliding = [each for each in built.tables.sliding if each.body == table.name]
    made = switching_body(built, table, body, moving, sliding)
    built.bodies[table.name] = built.system.add(made)
    built.kinds[table.name] = "held" if moving is None else "elastic"
    built.markers[table.name] = {name: made.marker(name) for name in ([] if moving is None else moving.markers)}


def _frame(table: BodyTable, body: Body, place: Path) -> FloatingFrame:
    """The floating frame of a body, or the other one that is asked for.

    Raises:
        InputError: a body without one, or that cannot be seen from the other.
    """
    if body.floating is None:
        raise InputError(
            f"body {body.name!r} of {place} has no floating frame: it is held to the ground, or not symmetric; reduce "
            "the free part, whose interfaces are held by [[joint]]s here",
            kind="unsupported",
            keyword="frame",
        )
    if table.frame is None:
        return body.floating
    if table.stiffening:
        raise InputError(
            "stiffening belongs to the frame of the file; leave frame out", kind="conflict", keyword="frame"
        )
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
        raise InputError(
            f"{table.file} holds {len(known)} members ({', '.join(known)}); name one by member = ...",
            kind="missing",
            keyword="member",
        )
    if name is not None and name not in known:
        raise InputError(f"{table.file} has no member {name!r}; {nearest(name, known)}", kind="unknown")
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
        raise InputError(
            f"body = {body!r} was given; {nearest(body, [GROUND, *built.bodies])}", kind="unknown", keyword="body"
        )
    else:
        holder = built.bodies[body]
        if not isinstance(holder, RigidBody):
            raise InputError(
                f"body = {body!r} is not rigid; take its interfaces, or nodes = {{ {name} = LABEL }} of it",
                keyword="body",
            )
        made = holder.marker_at(point, axes=axes, name=name)
    if name in built.markers[body]:
        raise InputError(f"{body} has a marker {name!r} already; give it another name", kind="conflict", keyword="name")
    built.markers[body][name] = made


def _joint(built: Built, table: JointTable, name: str) -> Constraint:
    first, second = built.pair(table.between)
    _refuse_space_joint(table, first, second)
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


def _refuse_space_joint(table: JointTable, first: Marker, second: Marker) -> None:
    """A plane that a member keeps itself is not kept once more."""
    held = (first.component, second.component)
    members = [each for each in held if isinstance(each, ParameterisedBody)]
    if not members or not all(isinstance(each, (ParameterisedBody, type(ground))) for each in held):
        return
    # Members of two planes meet in a joint of space.
    if not np.allclose(np.cross(members[0].axes[:, 2], members[-1].axes[:, 2]), 0.0):
        return
    plane = {"fixed": "plane-fixed", "revolute": "plane", "spherical": "plane"}.get(table.kind)
    if plane is not None:
        raise InputError(
            f'kind = "{table.kind}" was given; expected "{plane}" at member {members[0].name!r}, which keeps its plane',
            keyword="kind",
        )


def _load(built: Built, table: LoadTable, name: str) -> PointLoad:
    force, moment = np.array(table.force), np.array(table.moment)
    given: dict[str, Any] = {"force": force, "moment": moment}
    if table.law is not None and (force.any() or moment.any()):
        factor = built.factor(table.law)
        given = {"force": lambda t: factor(t) * force, "moment": lambda t: factor(t) * moment}
    elif table.law is not None:
        times, values = built.columns(table.law)
        if values.shape[1] == 1:
            raise InputError(
                f"{table.law.file} has a factor; give the force or the moment that it multiplies",
                kind="missing",
                keyword="force",
            )

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
