"""Surfaces of an input deck: their faces, their nodes and the weights of these, with rows of nodes for labels."""

from __future__ import annotations

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.types import Ints
from morembs.fem import Mesh, Nodes
from morembs.fem.elements import TYPES
from morembs.fem.surface import outer_faces
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.data import number
from morembs.importers.abaqus.deck import STRUCTURES, Rows
from morembs.importers.abaqus.keywords import Card
from morembs.importers.abaqus.names import Placed
from morembs.importers.decks.tables import Surface
from morembs.importers.decks.writers.calculix_mesh import FACES


def faces_of(kind: str) -> list[tuple[str, Ints]]:
    """Type and nodes of the faces of an element, each from the corner where CalculiX begins: it matters for ties."""
    faces = list(TYPES[kind].face_nodes)
    if kind.startswith("hex"):
        face, local = faces[0]
        faces[0] = face, np.concatenate([np.roll(local[:4], -1), np.roll(local[4:8], -1), local[8:]])
    return faces


class Surfaces:
    """The surfaces of an assembly by name, on rows of all nodes; ``notes`` on surfaces that were left out."""

    def __init__(self, assembly: Assembly) -> None:
        self.assembly = assembly
        self.named: dict[str, Surface] = {}
        self.notes: list[str] = []
        self._of_scope: dict[tuple[int, str], Surface] = {}
        self._outer: dict[str, Ints] | None = None

    def read(self) -> None:
        """All surfaces of the scopes."""
        several = len(self.assembly.placed) > 1
        for placed in (self.assembly.top, *self.assembly.placed.values()):
            for scope in placed.contents:
                for card, rows in scope.surfaces:
                    with self.assembly.problems.collected(card):
                        self._read_surface(placed, card, [row for row in rows if row], several=several)

    def _read_surface(self, placed: Placed, card: Card, rows: Rows, *, several: bool) -> None:
        name, kind = card.need("NAME"), card.options.get("TYPE", "ELEMENT").upper()
        if kind not in ("ELEMENT", "NODE") or "CROP" in card.options:
            self.notes.append(f"The surface {name} is not one of nodes or faces and was left out.")
            return
        if "COMBINE" in card.options:
            if card.options["COMBINE"].upper() != "UNION":
                self.notes.append(f"The surface {name} is not one of nodes or faces and was left out.")
                return
            surface = self._union([self.of(placed, text, card) for row in rows for text in row if text])
        else:
            surface = self._of_nodes(placed, rows, card) if kind == "NODE" else self.of_faces(placed, rows, card)
        self._of_scope[id(placed), name.upper()] = surface
        clash = placed.name and (several or name in self.named)
        self.named[f"{placed.name}.{name}" if clash else name] = surface

    def of(self, placed: Placed, name: str, card: Card) -> Surface:
        """The surface that a card of a scope names.

        Raises:
            InputError: there is none.
        """
        first, _, rest = name.partition(".")
        scope = self.assembly.placed.get(first.upper()) if placed is self.assembly.top else None
        key = (id(scope), rest.upper()) if scope else (id(placed), name.upper())
        if key not in self._of_scope:
            raise InputError(f"{card} names the surface {name!r}; {nearest(name, self.named)}", kind="unknown")
        return self._of_scope[key]

    def _union(self, parts: list[Surface]) -> Surface:
        weight = np.zeros(len(self.assembly.ids))
        for part in parts:
            weight[part.nodes] += part.weights
        nodes = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *(part.nodes for part in parts)]))
        return Surface(nodes=nodes, weights=weight[nodes], faces=tuple(face for part in parts for face in part.faces))

    def _of_nodes(self, placed: Placed, rows: Rows, card: Card) -> Surface:
        weight = np.zeros(len(self.assembly.ids))
        inside = np.zeros(len(weight), dtype=bool)
        for row in rows:
            nodes = self.assembly.nodes_of(placed, row[0])
            inside[nodes] = True
            weight[nodes] = number(row[1], card) if len(row) > 1 else 1.0
        nodes = np.flatnonzero(inside)
        return Surface(nodes=nodes, weights=weight[nodes])

    def of_faces(self, placed: Placed, rows: Rows, card: Card) -> Surface:
        """The surface of sides of solids that data lines name."""
        weight = np.zeros(len(self.assembly.ids))
        inside = np.zeros(len(weight), dtype=bool)
        blocks: list[tuple[str, Ints]] = []
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
                blocks.append((kind, faces))
        nodes = np.flatnonzero(inside)
        return Surface(nodes=nodes, weights=weight[nodes], faces=tuple(blocks))

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
                for face, local in faces_of(kind):
                    blocks.append((face, self._free(face, nodes[own][:, local])))
                continue
            table = FACES[kind[0]]
            at = int(side[1:]) - 1 if side[:1] == "S" and side[1:].isdigit() and len(side) < 4 else -1
            if not 0 <= at < len(table):
                raise InputError(f"{card}: the face {side!r} was given; a {kind} has the faces S1 to S{len(table)}")
            for face, local in faces_of(kind):
                if set(local[: len(table[at])].tolist()) == set(table[at]):
                    blocks.append((face, nodes[own][:, local]))
        start += len(self.assembly.discrete)
        for code, ids, nodes in self.assembly.others:
            own = numbers[(numbers >= start) & (numbers < start + len(ids))] - start
            start += len(ids)
            if len(own) and nodes.shape[1] and STRUCTURES[code][0] in ("shell", "membrane"):
                blocks.append((STRUCTURES[code][1], nodes[own]))
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
