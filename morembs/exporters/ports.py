"""Names of what goes in and out of a body: interface, quantity, component."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from morembs.body.body import ElasticBody
from morembs.body.stored import StoredBodies
from morembs.errors import InputError, nearest
from morembs.model.fe_model import SCALAR

Floats = NDArray[np.float64]
COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
# Quantity -> unit of a translation, of a rotation.
UNITS = {
    "displacement": ("m", "rad"), "velocity": ("m/s", "rad/s"), "acceleration": ("m/s2", "rad/s2"),
    "force": ("N", "N m"), "reaction": ("N", "N m"),
}  # fmt: skip


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
        return UNITS[quantity][2 < self.component < SCALAR]


def ports_of_file(source: StoredBodies) -> tuple[Port, ...]:
    """Ports of the bodies of a file."""
    names = list(source.interfaces)
    xyz = dict(zip(source.node_ids.tolist(), source.coordinates, strict=True))
    parts = [(name, source.interfaces[name].point, source.interfaces[name].forces) for name in names]
    columns = (source.input_interface, source.input_component, source.input_node_id)
    return _ports(parts, zip(*(values.tolist() for values in columns), strict=True), xyz)


def ports_of_body(body: ElasticBody) -> tuple[Port, ...]:
    """Ports of a body in memory."""
    xyz = dict(zip(body.part.nodes.ids.tolist(), body.part.nodes.xyz, strict=True))
    parts = [(each.name, each.point, each.forces) for each in body.part.interfaces]
    return _ports(parts, zip(*(values.tolist() for values in body.part.inputs()), strict=True), xyz)


def _ports(
    parts: Sequence[tuple[str, Floats, Sequence[str]]], rows: Iterable[tuple[int, int, int]], xyz: dict[int, Floats]
) -> tuple[Port, ...]:
    ports: list[Port] = []
    for index, component, node in rows:
        name, point, forces = parts[index]
        scalars = sum(port.interface == name and port.component == SCALAR for port in ports)
        words = forces[scalars : scalars + 1] or (str(scalars + 1),)
        word = COMPONENTS[component] if component != SCALAR else words[0]
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
        raise InputError(f"{what} {text!r}: the body has no such interface; {nearest(text.split(':')[0], interfaces)}")
    quantity, _, words = text[len(name) + 1 :].partition(":") if known != ("",) else ("", "", text[len(name) + 1 :])
    if quantity not in known:
        given = f"{quantity!r} was given" if quantity else "no quantity was given"
        raise InputError(f"{what} {text!r}: {given}; expected {name}: with one of {', '.join(known)}")
    own = [row for row, port in enumerate(ports) if port.interface == name]
    there = {ports[row].word for row in own}
    named = {words} if words in there else set(words.split("+")) if words else there
    for word in sorted(named - there):
        raise InputError(f"{what} {text!r}: {name!r} has no component {word!r}; {nearest(word, there)}")
    return quantity, [row for row in own if ports[row].word in named]
