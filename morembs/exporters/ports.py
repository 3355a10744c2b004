"""What goes in and out of a body, by names of interface, quantity and component; and whether supports hold it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats, Ints
from morembs.body.body import Body
from morembs.body.part import input_columns
from morembs.body.stored import StoredBodies
from morembs.exporters.tolerances import TOL
from morembs.fem import Nodes
from morembs.fem.fe_model import Component, rigid_motion
from morembs.fem.interface import Interface

COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
# Quantity -> unit of a translation, of a rotation.
UNITS = {
    "displacement": ("m", "rad"),
    "velocity": ("m/s", "rad/s"),
    "acceleration": ("m/s2", "rad/s2"),
    "force": ("N", "N m"),
    "reaction": ("N", "N m"),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Port:
    """One column of an input matrix: ``component`` 0..5, 6 of a generalised force, at ``point`` (3,) in m."""

    interface: str
    component: int
    word: str
    node: int
    point: Floats

    def name(self, quantity: str) -> str:
        """``tip:force:z``, of a direct interface ``tip:force:z@12`` at its node 12."""
        return f"{self.interface}:{quantity}:{self.word}" + (f"@{self.node}" if self.node >= 0 else "")

    def unit(self, quantity: str) -> str:
        """SI unit; generalised forces are in N, their motions in m."""
        return UNITS[quantity][2 < self.component < Component.SCALAR]


def ports_of_file(source: StoredBodies) -> tuple[Port, ...]:
    """Ports of the bodies of a file."""
    names = list(source.interfaces)
    xyz = dict(zip(source.node_ids.tolist(), source.coordinates, strict=True))
    parts = [(name, source.interfaces[name].point, source.interfaces[name].forces) for name in names]
    columns = (source.input_interface, source.input_component, source.input_node_id)
    return _ports(parts, zip(*(values.tolist() for values in columns), strict=True), xyz)


def ports_of(
    interfaces: Sequence[Interface], columns: Mapping[str, slice], node_ids: Ints, nodes: Nodes
) -> tuple[Port, ...]:
    """Ports of a model with nodes of the labels ``node_ids`` that is coupled to ``interfaces``, the ``columns`` of each
    in B; ``nodes`` are those of the interfaces, or more."""
    xyz = dict(zip(nodes.ids.tolist(), nodes.xyz, strict=True))
    parts = [(each.name, each.point, each.forces) for each in interfaces]
    rows = input_columns(interfaces, columns, node_ids)
    return _ports(parts, zip(*(values.tolist() for values in rows), strict=True), xyz)


def ports_of_body(body: Body) -> tuple[Port, ...]:
    """Ports of a body in memory."""
    return ports_of(body.part.interfaces, body.part.columns, body.part.node_ids, body.part.nodes)


def _ports(
    parts: Sequence[tuple[str, Floats, Sequence[str]]], rows: Iterable[tuple[int, int, int]], xyz: dict[int, Floats]
) -> tuple[Port, ...]:
    ports: list[Port] = []
    for index, component, node in rows:
        name, point, forces = parts[index]
        scalars = sum(port.interface == name and port.component == Component.SCALAR for port in ports)
        words = forces[scalars : scalars + 1] or (str(scalars + 1),)
        word = COMPONENTS[component] if component != Component.SCALAR else words[0]
        ports.append(Port(interface=name, component=component, word=word, node=node, point=xyz.get(node, point)))
    return tuple(ports)


def parts_of(ports: Sequence[Port], text: str, known: Sequence[str], what: str) -> tuple[str, list[int]]:
    """Quantity, one of ``known``, and rows of ``INTERFACE:QUANTITY`` or ``INTERFACE:QUANTITY:COMPONENT+...``.

    Without quantities (``known`` is one empty text) of ``INTERFACE`` or ``INTERFACE:COMPONENT+...``.

    Raises:
        InputError: no such interface, quantity or component.
    """
    interfaces = list(dict.fromkeys(port.interface for port in ports))
    # The longest, as names may hold colons.
    name = max((name for name in interfaces if f"{text}:".startswith(f"{name}:")), key=len, default=None)
    if name is None:
        raise InputError(
            f"{what} {text!r}: the body has no such interface; {nearest(text.split(':')[0], interfaces)}",
            kind="unknown",
            keyword=what,
        )
    quantity, _, words = text[len(name) + 1 :].partition(":") if known != ("",) else ("", "", text[len(name) + 1 :])
    if quantity not in known:
        given = f"{quantity!r} was given" if quantity else "no quantity was given"
        raise InputError(f"{what} {text!r}: {given}; expected {name}: with one of {', '.join(known)}", keyword=what)
    own = [row for row, port in enumerate(ports) if port.interface == name]
    there = {ports[row].word for row in own}
    named = {words} if words in there else set(words.split("+")) if words else there
    for word in sorted(named - there):
        raise InputError(
            f"{what} {text!r}: {name!r} has no component {word!r}; {nearest(word, there)}", kind="unknown", keyword=what
        )
    return quantity, [row for row in own if ports[row].word in named]


def refuse_loose(ports: Sequence[Port], rows: Sequence[int], rigid: Floats) -> None:
    """Refuse supports in some ``rows`` that leave the part a rigid-body motion.

    Args:
        rigid: motion (m, r) of all degrees of freedom by the r rigid-body motions that the part has.

    Raises:
        InputError: in these cases.
    """
    at = rigid[list(rows)]
    size = np.linalg.norm(at, axis=1)
    _, values, Vt = np.linalg.svd(at / np.where(size > 0, size, 1.0)[:, None])
    left = Vt[int((values > TOL.held_motion * values[0]).sum()) :].T
    if not left.shape[1]:
        return
    names = ", ".join(repr(text) for text in dict.fromkeys(ports[row].interface for row in rows))
    count = left.shape[1]
    which = _words(ports, rigid @ left[:, 0]) if count == 1 else ""
    raise InputError(
        f"the part is not held by the supports {names}; {count} rigid motion{'s are' if count > 1 else ' is'} left"
        f"{which}; prescribe {'them' if count > 1 else 'it'} as well, or take force inputs",
        kind="model",
    )


def _words(ports: Sequence[Port], motion: Floats) -> str:
    """Words for a rigid-body motion that moves the degrees of freedom by ``motion`` (m,)."""
    points = np.array([port.point for port in ports])
    center = points.mean(axis=0)
    rigid = rigid_motion(points - center, np.array([port.component for port in ports]))
    twist, *_ = np.linalg.lstsq(rigid, motion, rcond=TOL.told_motion)
    reach = np.abs(points - center).max() or 1.0
    turns = np.abs(twist[3:]).max() * reach > TOL.no_turn * np.abs(twist[:3]).max()
    axis = twist[3:] if turns else twist[:3]
    if not axis.any():
        return ""
    axis = axis / np.linalg.norm(axis)
    main = int(np.abs(axis).argmax())
    named = abs(axis[main]) > 1 - TOL.along_axis
    shown = "xyz"[main] if named else "(" + ", ".join(f"{value:.2g}" for value in axis) + ")"
    return f" (rotation about {shown})" if turns else f" (translation along {shown})"
