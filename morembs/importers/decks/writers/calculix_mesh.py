"""Nodes, elements, sets and surfaces of a deck in the words of CalculiX and Abaqus."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.fem import ElementBlock, Mesh, Nodes
from morembs.fem.handedness import right_handed
from morembs.importers.decks.formulations import meaning_of
from morembs.importers.decks.labels import Labels, in_ranges
from morembs.importers.decks.tables import NOT_WRITTEN, DeckTables, Elements, Surface


class Line:
    """What CalculiX takes of a line (CalculiX CrunchiX User's Manual): characters of a number and of a name, entries of
    sets, elements and equations, constants of materials."""

    NUMBER_CHARACTERS = 20
    NAME_CHARACTERS = 80
    SET_ENTRIES = 16
    ELEMENT_ENTRIES = 10
    EQUATION_TERMS = 4
    CONSTANTS = 8


# Types of solids by shape, of which one is taken by its formulation.
_SOLIDS = {
    "tet4": ("C3D4",),
    "tet10": ("C3D10",),
    "wedge6": ("C3D6",),
    "wedge15": ("C3D15",),
    "hex8": ("C3D8", "C3D8R", "C3D8I"),
    "hex20": ("C3D20", "C3D20R"),
    "hex27": ("C3D27",),
}
_STRUCTURES = {
    ("shell", "tri3"): "S3",
    ("shell", "quad4"): "S4",
    ("shell", "tri6"): "S6",
    ("shell", "quad8"): "S8R",
    ("membrane", "tri3"): "M3D3",
    ("membrane", "quad4"): "M3D4",
    ("membrane", "tri6"): "M3D6",
    ("membrane", "quad8"): "M3D8",
    ("beam", "line2"): "B31",
    ("beam", "line3"): "B32",
    ("truss", "line2"): "T3D2",
    ("truss", "line3"): "T3D3",
}
# Nodes of lines stand along them.
_ORDER = {"line3": (0, 2, 1)}
# Corners of the faces S1, S2, ... of solids by the first letter of their type.
FACES = {
    "t": ((0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3)),
    "h": ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 4, 5), (1, 2, 5, 6), (2, 3, 6, 7), (0, 3, 4, 7)),
    "w": ((0, 1, 2), (3, 4, 5), (0, 1, 3, 4), (1, 2, 4, 5), (0, 2, 3, 5)),
}
# Names that the text needs beside those of the deck, by their kind.
_OWN_NAMES = {"NSET": "NS", "ELSET": "ES", "SURFACE": "S", "MATERIAL": "M", "ORIENTATION": "O", "CONSTRAINT": "C"}
_NAME = re.compile(r"[^A-Za-z0-9_.-]")


def numeral(value: float) -> str:
    """A number in the characters that CalculiX reads, with as many digits as fit."""
    text, digits = repr(float(value)), sys.float_info.dig + 1
    while len(text) > Line.NUMBER_CHARACTERS:
        text = re.sub(r"e([+-])0*", r"e\1", f"{value:.{digits}e}")
        digits -= 1
    return text


def numerals(values: Iterable[float]) -> str:
    """Numbers of a data line."""
    return ", ".join(map(numeral, values))


@dataclass(eq=False)
class MeshText:
    """Names and labels of a deck in the text, and the cards of its mesh.

    ``dialect`` "calculix" or "abaqus"; with ``counted`` nodes and elements have labels from 1 without gaps, as CalculiX
    allocates memory by the largest one. ``warnings`` say in what the written deck differs.

    Raises:
        InputError: what the program cannot say.
    """

    deck: DeckTables
    dialect: str = "calculix"
    counted: bool = False
    warnings: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        deck = self.deck
        self.program = {"calculix": "CalculiX", "abaqus": "Abaqus"}[self.dialect]
        self.nodes = Labels(deck.ids, deck.name, deck.node)
        self.parts = [part for part in deck.elements if part.kind not in ("point", "none")]
        ids = np.concatenate([np.empty(0, dtype=np.int64), *(part.ids for part in self.parts)])
        self.elements = Labels(ids, deck.name, "element")
        self.named = np.arange(1, len(deck.ids) + 1) if self.counted else deck.ids
        self.numbers = np.arange(1, len(ids) + 1) if self.counted else ids
        self.next_element = int(
            max(self.numbers.max(initial=0), *(part.ids.max(initial=0) for part in deck.elements), 0)
        )
        # Names in capitals by their kind, each of which has names of its own.
        self._names: dict[str, set[str]] = {}
        self._sets: dict[tuple[str, str, bytes], str] = {}
        self.renamed: list[str] = []
        self._surfaces: dict[tuple[str, bytes, bytes, bool], str] = {}
        self._materials: dict[tuple[bytes, float | None], str] = {}
        self.more_nodes: list[str] = []
        self.more_elements: list[str] = []
        self.sets: list[str] = []
        self.surfaces: list[str] = []
        self.solids = self._solids()

    # Names and labels

    def name(self, kind: str, text: str = "", stem: str = "") -> str:
        """A name that the programs take, and that nothing else of its kind has: ``text`` of the deck, which is said
        where it has to change, or one that begins like ``stem``."""
        plain = _NAME.sub("_", text or stem or _OWN_NAMES[kind])[: Line.NAME_CHARACTERS - 4]
        plain = plain if plain[:1].isalpha() else f"N{plain}"
        taken = self._names.setdefault(kind, set())
        name, count = plain, 1
        while name.upper() in taken:
            count += 1
            name = f"{plain}_{count}"
        taken.add(name.upper())
        if text and name != text:
            self.renamed.append(f"{kind} {text!r} as {name!r}")
        return name

    def node(self, labels: Ints) -> Ints:
        """What nodes are called in the text, by their labels (any shape) in the deck."""
        return np.asarray(self.named[self.nodes.rows(labels, "the deck names")])

    def node_set(self, labels: Ints, text: str = "") -> str:
        """The name of a set of nodes by their labels in the deck."""
        return self._set("NSET", np.unique(self.node(labels)), text)

    def element_set(self, rows: Ints, text: str = "") -> str:
        """The name of a set of elements by their rows among all that are written."""
        return self._set("ELSET", np.unique(self.numbers[rows]), text)

    def _set(self, word: str, members: Ints, text: str) -> str:
        """The set of the deck with these members and that name, for no name the first one with these members."""
        key = word, text, members.tobytes()
        if key not in self._sets:
            self._sets[key] = self.name(word, text)
            self._sets.setdefault((word, "", members.tobytes()), self._sets[key])
            self.sets.append("\n".join([f"*{word}, {word}={self._sets[key]}", *sixteen(members)]))
        return self._sets[key]

    def rows_of_set(self, name: str) -> Ints:
        """Rows of the elements of a set of the deck among the written elements."""
        return np.flatnonzero(in_ranges(self.elements.ids, self.deck.ranges(name)))

    # Mesh

    def _solids(self) -> tuple[ElementBlock, ...]:
        """Solids on rows of all nodes, right-handed ones."""
        blocks = []
        for part in self.parts:
            if part.kind == "solid":
                if not part.nodes.all():
                    raise InputError(
                        f"{self.deck.name}: {part.code} has edges without middle nodes, which {self.program} lacks; "
                        "add middle nodes",
                        kind="unsupported",
                    )
                nodes = self.nodes.rows(part.nodes, "elements name")
                blocks.append(ElementBlock(type=part.shape, nodes=nodes, ids=part.ids))
        mesh = right_handed(Mesh(nodes=Nodes(ids=self.deck.ids, xyz=self.deck.xyz), blocks=tuple(blocks)))
        self.warnings += mesh.warnings
        return mesh.blocks

    def mesh_lines(self) -> Iterator[str]:
        """Nodes and elements."""
        yield "*NODE"
        yield from (f"{i}, {numerals(x)}" for i, x in zip(self.named.tolist(), self.deck.xyz.tolist(), strict=True))
        solids, at = iter(self.solids), 0
        for part in self.parts:
            yield f"*ELEMENT, TYPE={self.code(part)}"
            rows = next(solids).nodes if part.kind == "solid" else self.nodes.rows(part.nodes, "elements name")
            rows = rows[:, list(_ORDER.get(part.shape, range(rows.shape[1])))]
            table = np.column_stack([self.numbers[at : at + len(rows)], self.named[rows]])
            at += len(rows)
            yield from entry_lines(table)

    def code(self, part: Elements) -> str:
        """The type of elements in the program.

        Raises:
            InputError: it has none.
        """
        if part.kind != "solid":
            code = part.code if self.deck.program in ("Abaqus", "CalculiX") else ""
            code = code or _STRUCTURES.get((part.kind, part.shape), "")
            if not code:
                raise InputError(
                    f"{self.deck.name}: {self.program} has no element for {len(part.ids)} {part.code} ({part.kind} of "
                    f"{part.nodes.shape[1]} nodes); leave them out with --skip {part.code}",
                    kind="unsupported",
                )
            if code != part.code:
                self.warnings.append(
                    f"{len(part.ids)} elements {part.code} of {self.deck.program} are written as {code} of "
                    f"{self.program}, whose formulation is another [formulation-differs]"
                )
            return code
        codes = () if (self.dialect, part.shape) == ("calculix", "hex27") else _SOLIDS[part.shape]
        if not codes:
            raise InputError(
                f"{self.deck.name}: CalculiX has no element of 27 nodes; write it for Abaqus", kind="unsupported"
            )
        meant = part.meaning.formulation, part.meaning.mass
        theirs = {code: meaning_of(code, self.dialect) for code in codes}
        for code, meaning in theirs.items():
            if (meaning.formulation, meaning.mass) == meant:
                return code
        code = solid_code(part.shape, meant[0], self.dialect) or codes[0]
        self.warnings.append(
            f"{len(part.ids)} elements {part.code} of {self.deck.program} are written as {code} of {self.program}, "
            f"which has the formulation {theirs[code].formulation!r} and the mass {theirs[code].mass!r} in place of "
            f"{meant[0]!r} and {meant[1]!r} [formulation-differs]"
        )
        return code

    def set_lines(self) -> None:
        """Sets of the deck under their names, as far as their members are written."""
        others = [part.ids for part in self.deck.elements if part.kind in ("point", "none")]
        unwritten, lost = np.concatenate([np.empty(0, dtype=np.int64), *others]), list[str]()
        for name, ranges in self.deck.node_sets.items():
            rows = self.nodes.members(ranges, f"the set {name} names")
            if len(rows):
                self.node_set(self.deck.ids[rows], name)
            else:
                lost.append(name)
        for name, ranges in self.deck.element_sets.items():
            rows = self.rows_of_set(name)
            if len(rows):
                self.element_set(rows, name)
            if not len(rows) or in_ranges(unwritten, ranges).any():
                lost.append(name)
        if lost:
            self.warnings.append(
                f"the sets {', '.join(lost)} of {self.deck.name} lack what is empty or stands for masses, springs and "
                f"dashpots, whose labels are new {NOT_WRITTEN}"
            )

    # Surfaces

    def surface(self, surface: Surface, text: str = "") -> str:
        """The name of a surface, of sides of elements where it has faces, else of nodes with weights; written once."""
        key = text, surface.nodes.tobytes(), surface.weights.tobytes(), bool(surface.faces)
        if key in self._surfaces:
            return self._surfaces[key]
        sides = self._sides(surface, text) if surface.faces else []
        name = self._surfaces[key] = self.name("SURFACE", text)
        self._surfaces.setdefault(("", *key[1:]), name)
        if surface.faces:
            lines = [f"*SURFACE, NAME={name}, TYPE=ELEMENT", *sides]
        else:
            pairs = zip(self.node(surface.nodes).tolist(), surface.weights.tolist(), strict=True)
            lines = [f"*SURFACE, NAME={name}, TYPE=NODE", *(f"{node}, {numeral(w)}" for node, w in pairs)]
        self.surfaces.append("\n".join(lines))
        return name

    def _sides(self, surface: Surface, text: str) -> list[str]:
        """Element and side of each face."""
        keys, numbers, sides = [], list[Ints](), list[str]()
        solids, start = iter(self.solids), 0
        for part in self.parts:
            rows = next(solids).nodes if part.kind == "solid" else self.nodes.rows(part.nodes, "elements name")
            own = self.numbers[start : start + len(rows)]
            start += len(rows)
            faces = FACES[part.shape[0]] if part.kind == "solid" else (tuple(range(_corners(part.shape))),)
            for side, corners in enumerate(faces, start=1):
                if len(corners) > 2:
                    keys.append(face_keys(rows[:, list(corners)]))
                    numbers.append(own)
                    sides += [f"S{side}" if part.kind == "solid" else "SPOS"] * len(own)
        wanted = [
            face_keys(self.nodes.rows(nodes[:, : 3 if shape.startswith("tri") else 4], f"the surface {text} names"))
            for shape, nodes in surface.faces
        ]
        whole = np.concatenate([np.empty((0, 4), dtype=np.int64), *keys])
        unique, first = np.unique(whole, axis=0, return_index=True)
        both, group = np.unique(np.concatenate([unique, *wanted]), axis=0, return_inverse=True)
        group = group.ravel()
        if len(both) > len(unique):
            raise InputError(
                f"{self.deck.name}: the surface {text} has faces of no element; check it", kind="unsupported"
            )
        place = np.empty(len(both), dtype=np.int64)
        place[group[: len(unique)]] = first
        number = np.concatenate(numbers) if numbers else np.empty(0, dtype=np.int64)
        return [f"{number[i]}, {sides[i]}" for i in np.sort(place[group[len(unique) :]]).tolist()]


def solid_code(shape: str, formulation: str, dialect: str = "calculix") -> str:
    """The type of solids of a shape and formulation in a program, "" where it has none."""
    return next((code for code in _SOLIDS[shape] if meaning_of(code, dialect).formulation == formulation), "")


def _corners(shape: str) -> int:
    return 3 if shape.startswith("tri") else 4 if shape.startswith("quad") else 2


def face_keys(corners: Ints) -> Ints:
    """Corners (n, 3 or 4) of faces as rows (n, 4) that are the same for the same face."""
    key = np.full((len(corners), 4), -1, dtype=np.int64)
    key[:, : corners.shape[1]] = np.sort(corners, axis=1)
    return key


def sixteen(labels: Ints) -> list[str]:
    """Data lines of a set."""
    entries = list(map(str, labels.tolist()))
    return [", ".join(entries[i : i + Line.SET_ENTRIES]) + "," for i in range(0, len(entries), Line.SET_ENTRIES)]


def entry_lines(table: Ints) -> Iterator[str]:
    """Data lines of elements: labels with their nodes."""
    max_entries = Line.ELEMENT_ENTRIES
    for row in table.tolist():
        entries = list(map(str, row))
        for i in range(0, len(entries), max_entries):
            yield ", ".join(entries[i : i + max_entries]) + ("," if i + max_entries < len(entries) else "")
