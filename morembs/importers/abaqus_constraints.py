"""Surfaces, couplings, rigid bodies and point masses of an input deck, as rows of all its nodes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError, nearest
from morembs.importers.abaqus_assembly import Assembly, Placed
from morembs.importers.abaqus_deck import Rows, values
from morembs.importers.abaqus_keywords import Card, number
from morembs.importers.imported import PointMass
from morembs.model import Mesh, Nodes
from morembs.model.constraints import AverageElement, RigidElement
from morembs.model.elements import TYPES
from morembs.model.surface import outer_faces

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# Corners of the faces S1, S2, ...
_FACES = {
    "t": ((0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3)),
    "h": ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 4, 5), (1, 2, 5, 6), (2, 3, 6, 7), (0, 3, 4, 7)),
    "w": ((0, 1, 2), (3, 4, 5), (0, 1, 3, 4), (1, 2, 4, 5), (0, 2, 3, 5)),
}
_NO_CARD = Card("", {}, "")
_ALL = (0, 1, 2, 3, 4, 5)


@dataclass
class Found:
    """What the lines of a deck tie to the mesh; rows are those of all nodes."""

    surfaces: dict[str, Ints] = field(default_factory=dict)
    rigid: list[RigidElement] = field(default_factory=list)
    average: list[AverageElement] = field(default_factory=list)
    masses: list[PointMass] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


class Constraints:
    """Reads what stands in the scopes of an assembly.

    Raises:
        InputError: a line names what is not there, or ties nodes in a way that cannot be carried.
    """

    def __init__(self, assembly: Assembly) -> None:
        self.assembly = assembly
        self.deck = assembly.deck
        self.found = Found()
        self._weights: dict[tuple[int, str], tuple[Ints, Floats]] = {}
        self._outer: dict[str, Ints] | None = None

    def surfaces(self) -> None:
        """All surfaces as rows of nodes."""
        several = len(self.assembly.placed) > 1
        for placed in (self.assembly.top, *self.assembly.placed.values()):
            for scope in placed.contents:
                for card, rows in scope.surfaces:
                    name = card.need("NAME")
                    kind = card.options.get("TYPE", "ELEMENT").upper()
                    if kind not in ("ELEMENT", "NODE") or "COMBINE" in card.options:
                        self.found.notes.append(f"The surface {name} is not one of nodes or faces and was left out.")
                        continue
                    of = self._of_nodes if kind == "NODE" else self._of_faces
                    nodes, weights = of(placed, [row for row in rows if row], card)
                    self._weights[id(placed), name.upper()] = nodes, weights
                    clash = placed.name and (several or name in self.found.surfaces)
                    self.found.surfaces[f"{placed.name}.{name}" if clash else name] = nodes

    def _of_nodes(self, placed: Placed, rows: Rows, card: Card) -> tuple[Ints, Floats]:
        weight = np.zeros(len(self.assembly.ids))
        inside = np.zeros(len(weight), dtype=bool)
        for row in rows:
            nodes = self.assembly.nodes_of(placed, row[0])
            inside[nodes] = True
            weight[nodes] = number(row[1], card) if len(row) > 1 else 1.0
        nodes = np.flatnonzero(inside)
        return nodes, weight[nodes]

    def _of_faces(self, placed: Placed, rows: Rows, card: Card) -> tuple[Ints, Floats]:
        weight = np.zeros(len(self.assembly.ids))
        inside = np.zeros(len(weight), dtype=bool)
        for row in rows:
            numbers = self.assembly.elements_of(placed, row[0])
            side = row[1].upper() if len(row) > 1 else ""
            for kind, faces in self._faces(numbers, side, card):
                corners = self.assembly.xyz[faces[:, : 3 if kind.startswith("tri") else 4]]
                legs = (corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
                if corners.shape[1] == 4:
                    legs = (corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
                area = 0.5 * np.linalg.norm(np.cross(*legs), axis=1)
                np.add.at(weight, faces, np.repeat(area[:, None] / faces.shape[1], faces.shape[1], axis=1))
                inside[faces] = True
        nodes = np.flatnonzero(inside)
        return nodes, weight[nodes]

    def _faces(self, numbers: Ints, side: str, card: Card) -> list[tuple[str, Ints]]:
        """Type and nodes (nf, k) of the faces ``side`` (S1, ...) of elements; of their free faces if it is empty."""
        blocks, start = [], 0
        for block in self.assembly.blocks:
            kind, nodes = block.type, block.nodes
            own = numbers[(numbers >= start) & (numbers < start + len(nodes))] - start
            start += len(nodes)
            if not len(own):
                continue
            if not side:
                for face, local in TYPES[kind].face_nodes:
                    blocks.append((face, self._free(face, nodes[own][:, local])))
                continue
            table = _FACES[kind[0]]
            at = int(side[1:]) - 1 if side[:1] == "S" and side[1:].isdigit() and len(side) < 4 else -1
            if not 0 <= at < len(table):
                raise InputError(f"{card}: the face {side!r} was given; a {kind} has the faces S1 to S{len(table)}")
            for face, local in TYPES[kind].face_nodes:
                if set(local[: len(table[at])].tolist()) == set(table[at]):
                    blocks.append((face, nodes[own][:, local]))
        return blocks

    def _free(self, kind: str, faces: Ints) -> Ints:
        """Those of ``faces`` that no other element has."""
        if self._outer is None:
            assembly = self.assembly
            nodes = Nodes(ids=assembly.ids, xyz=assembly.xyz)
            self._outer = outer_faces(Mesh(nodes=nodes, blocks=tuple(assembly.blocks)))
        free = self._outer[kind]
        both = np.sort(np.concatenate([free, faces]), axis=1)
        _, group = np.unique(both, axis=0, return_inverse=True)
        group = group.ravel()
        return faces[np.isin(group[len(free) :], group[: len(free)])]

    def surface(self, placed: Placed, name: str, card: Card) -> tuple[Ints, Floats]:
        """Rows of the nodes of a surface, and their weights."""
        first, _, rest = name.partition(".")
        scope = self.assembly.placed.get(first.upper()) if placed is self.assembly.top else None
        key = (id(scope), rest.upper()) if scope else (id(placed), name.upper())
        if key not in self._weights:
            raise InputError(f"{card} names the surface {name!r}; {nearest(name, self.found.surfaces)}")
        return self._weights[key]

    def constraints(self) -> None:
        """Couplings, rigid bodies and *MPC."""
        for placed in (*self.assembly.placed.values(), self.assembly.top):
            for scope in placed.contents:
                for card, rows, kind, kind_rows in scope.constraints:
                    rows = [row for row in rows if row]
                    if card.keyword == "COUPLING":
                        self.coupling(placed, card, kind, [row for row in kind_rows if row])
                    elif card.keyword == "KINEMATIC COUPLING":
                        self._kinematic_coupling(placed, card, rows)
                    elif card.keyword == "RIGID BODY":
                        self._rigid_body(placed, card)
                    else:
                        self._mpc(placed, card, rows)

    def coupling(self, placed: Placed, card: Card, kind: Card | None, rows: Rows) -> None:
        """*COUPLING with what it is: *KINEMATIC or *DISTRIBUTING."""
        name = card.options.get("CONSTRAINT NAME", "")
        if kind is None:
            raise InputError(f"{card} {name!r} has neither *KINEMATIC nor *DISTRIBUTING; expected one")
        reference = self.assembly.one_node(placed, card.need("REF NODE"))
        nodes, weights = self.surface(placed, card.need("SURFACE"), card)
        components = _components(rows, kind)
        if card.options.get("ORIENTATION") and components not in (_ALL, (0, 1, 2)):
            raise InputError(f"{card} {name!r} ties some directions of an *ORIENTATION; expected all, or global axes")
        if card.options.get("INFLUENCE RADIUS"):
            away = np.linalg.norm(self.assembly.xyz[nodes] - self.assembly.xyz[reference], axis=1)
            near = away <= number(card.options["INFLUENCE RADIUS"], card)
            nodes, weights = nodes[near], weights[near]
        nodes, weights = nodes[nodes != reference], weights[nodes != reference]
        title = self._title(placed, name or card.options["SURFACE"])
        if not len(nodes):
            raise InputError(f"{card} {name!r} ties no nodes; check its surface")
        if kind.keyword == "KINEMATIC":
            self.found.rigid.append(RigidElement(name=title, master=reference, slaves=nodes, components=components))
            return
        method = kind.options.get("WEIGHTING METHOD", "UNIFORM").upper()
        if method != "UNIFORM":
            raise InputError(f"{kind} of {name!r} weighs by {method}; expected UNIFORM")
        if not (weights >= 0).all() or not weights.sum() > 0:
            raise InputError(f"{card} {name!r} has weights that are not positive; check its surface")
        self.found.average.append(
            AverageElement(name=title, reference=reference, nodes=nodes, weights=weights, components=components)
        )
        self.found.notes.append(
            f"The distributing coupling {title} weighs nodes of faces by their share of the area, each node of a face "
            "alike, and nodes of a node surface by the numbers given there."
        )

    def _kinematic_coupling(self, placed: Placed, card: Card, rows: Rows) -> None:
        reference = self.assembly.one_node(placed, card.need("REF NODE"))
        if card.options.get("ORIENTATION"):
            raise InputError(f"{card} uses an *ORIENTATION; expected directions along the global axes")
        groups: dict[tuple[int, ...], list[Ints]] = {}
        for row in rows:
            nodes = self.assembly.nodes_of(placed, row[0])
            groups.setdefault(_components([row[1:]] if row[1:] else [], card), []).append(nodes)
        for components, parts in groups.items():
            self._rigid(self._title(placed, "kinematic coupling"), reference, np.concatenate(parts), components, card)

    def _rigid_body(self, placed: Placed, card: Card) -> None:
        options = card.options
        if options.get("POSITION", "INPUT").upper() != "INPUT" or "ANALYTICAL SURFACE" in options:
            raise InputError(f"{card} is given with POSITION or ANALYTICAL SURFACE; expected nodes and a REF NODE")
        reference = self.assembly.one_node(placed, card.need("REF NODE"))
        parts = [
            self.assembly.nodes_of(placed, options[key]) for key in ("NSET", "TIE NSET", "PIN NSET") if options.get(key)
        ]
        if options.get("ELSET"):
            numbers, start = self.assembly.elements_of(placed, options["ELSET"]), 0
            for block in self.assembly.blocks:
                own = numbers[(numbers >= start) & (numbers < start + len(block.nodes))] - start
                parts.append(np.unique(block.nodes[own]))
                start += len(block.nodes)
        if options.get("ROT NODE"):
            self.found.notes.append(
                f"A rigid body has its rotations at the node {options['ROT NODE']}; here they are those of its "
                "reference node."
            )
        if not parts:
            raise InputError(f"{card} names no nodes; expected NSET or ELSET")
        title = self._title(placed, options.get("NSET") or options.get("ELSET") or "rigid body")
        self._rigid(title, reference, np.concatenate(parts), _ALL, card)

    def _mpc(self, placed: Placed, card: Card, rows: Rows) -> None:
        for row in rows:
            if row[0].upper() != "BEAM" or len(row) != 3:
                raise InputError(
                    f"{card} of the type {row[0]!r} cannot be carried; expected BEAM with two nodes or sets"
                )
            slaves, masters = (self.assembly.nodes_of(placed, text) for text in row[1:])
            if len(masters) == 1:
                self._rigid(self._title(placed, "MPC BEAM"), int(masters[0]), slaves, _ALL, card)
            else:
                raise InputError(
                    f"{card} BEAM: {row[2]!r} has {len(masters)} nodes; expected one that the others follow"
                )

    def _rigid(self, title: str, master: int, slaves: Ints, components: tuple[int, ...], card: Card) -> None:
        slaves = np.unique(slaves[slaves != master])
        if not len(slaves):
            raise InputError(f"{card} ties no nodes to its reference node; check its sets")
        self.found.rigid.append(RigidElement(name=title, master=master, slaves=slaves, components=components))

    def _title(self, placed: Placed, name: str) -> str:
        """A name that is not taken yet."""
        title = f"{placed.name}.{name}" if placed.name and len(self.assembly.placed) > 1 else name
        taken = {element.name for element in self.found.rigid} | {element.name for element in self.found.average}
        count, first = 1, title
        while title in taken:
            count += 1
            title = f"{first} {count}"
        return title

    def point_masses(self) -> None:
        """*MASS and *ROTARY INERTIA on their elements."""
        given: dict[int, tuple[Card, Floats]] = {}
        for placed in (*self.assembly.placed.values(), self.assembly.top):
            for scope in placed.contents:
                for card, rows in scope.properties:
                    if card.keyword != "SOLID SECTION":
                        value = _point_value(placed, card, [row for row in rows if row])
                        for element in self.assembly.elements_of(placed, card.need("ELSET")).tolist():
                            if element < self.assembly.solids or element in given:
                                why = "has a property already" if element in given else "is a solid"
                                raise InputError(f"{card} of {card.need('ELSET')!r} names an element that {why}")
                            given[element] = card, value
        for j, (_, node, code, element) in enumerate(self.assembly.points):
            card, value = given.get(self.assembly.solids + j, (_NO_CARD, np.zeros((3, 3))))
            if card.keyword != {"MASS": "MASS", "ROTARYI": "ROTARY INERTIA"}[code]:
                raise InputError(f"{self.deck}: the element {element} of the type {code} has no property of its kind")
            name = f"{card.options['ELSET']}:{element}"
            if code == "MASS":
                self.found.masses.append(PointMass(name=name, node=node, mass=float(value[0, 0])))
            else:
                self.found.masses.append(PointMass(name=name, node=node, mass=0.0, inertia=value))


def _components(rows: Rows, card: Card) -> tuple[int, ...]:
    """Components 0 to 5 of lines "first, last"; all of them without a line."""
    components: set[int] = set()
    for row in rows:
        ends = [int(text) if text in ("1", "2", "3", "4", "5", "6") else 0 for text in row[:2]]
        if not ends or 0 in ends or ends[0] > ends[-1]:
            raise InputError(f"{card}: {', '.join(row)!r} was given; expected the first and the last direction, 1 to 6")
        components |= set(range(ends[0] - 1, ends[-1]))
    return tuple(sorted(components)) if components else _ALL


def _point_value(placed: Placed, card: Card, rows: Rows) -> Floats:
    """Mass times the identity, or the inertia (3, 3) about the node."""
    if card.options.get("TYPE", "ISOTROPIC").upper() != "ISOTROPIC" or card.options.get("ORIENTATION"):
        raise InputError(f"{card} is given with TYPE or ORIENTATION; expected a plain mass, or inertia in global axes")
    row = values(rows[0], card) if rows else []
    if card.keyword == "MASS":
        if len(row) != 1 or not row[0] >= 0:
            raise InputError(f"{card} of {card.need('ELSET')!r} gives {row or 'nothing'}; expected one mass")
        return np.asarray(row[0] * np.eye(3))
    a = np.array([*row, *[0.0] * 6])[:6]
    J = np.array([[a[0], a[3], a[4]], [a[3], a[1], a[5]], [a[4], a[5], a[2]]])
    if not row or len(row) > 6 or np.linalg.eigvalsh(J)[0] < -1e-12 * np.abs(J).max():
        raise InputError(
            f"{card} of {card.need('ELSET')!r} gives {row or 'nothing'}; expected I11, I22, I33, I12, I13, I23"
        )
    if not np.array_equal(placed.rotation, np.eye(3)):
        raise InputError(f"{card} is in an instance that is turned; give the rotary inertia in the assembly")
    return J
