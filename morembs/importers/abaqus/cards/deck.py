"""One flat deck for CalculiX from the tables of a deck: parts in their places, labels from 1 without gaps.

CalculiX knows no parts, allocates memory by the largest label, and wants sets before their use. So nodes, elements,
sets and names are rewritten; of all other keywords the table ``CARDS`` says what stands in their data lines.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.fem import Mesh, Nodes
from morembs.fem.handedness import right_handed
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.cards.text import element_lines
from morembs.importers.abaqus.data import label
from morembs.importers.abaqus.deck import Contents, Rows
from morembs.importers.abaqus.equations import Axes, equations_of
from morembs.importers.abaqus.keywords import Card
from morembs.importers.abaqus.names import Placed
from morembs.importers.abaqus.supports import spans_of
from morembs.importers.abaqus.surfaces import Surfaces
from morembs.importers.decks.writers.calculix_mesh import FACES, Line, face_keys, numeral, sixteen

# What the fields of data lines are: n a node or a set of such, e an element or set, s a surface, o an orientation,
# m a material, . as it stands. The last letter holds for all fields behind it.
CARDS = {
    "SOLID SECTION": "..mo",
    "SHELL SECTION": "..mo",
    "BEAM SECTION": ".",
    "BEAM GENERAL SECTION": ".",
    "MEMBRANE SECTION": ".",
    "SPRING": ".",
    "GAP": ".",
    "TIE": "s",
    "RIGID BODY": ".",
    "MPC": ".n",
    "TRANSFORM": ".",
    "DISTRIBUTION": "e.",
    "DISTRIBUTING COUPLING": "n.",
    "PRE-TENSION SECTION": ".",
    "NODAL THICKNESS": "n.",
    "NORMAL": "en.",
    "INITIAL CONDITIONS": "n.",
    "BOUNDARY": "n.",
    "CLOAD": "n.",
    "DLOAD": "e.",
    "DSLOAD": "s.",
    "TEMPERATURE": "n.",
    "STATIC": ".",
    "ORIENTATION": ".",
}
_OPTIONS = {
    "NSET": "n",
    "TIE NSET": "n",
    "PIN NSET": "n",
    "REF NODE": "n",
    "ROT NODE": "n",
    "NODE": "n",
    "ELSET": "e",
    "ELEMENT": "e",
    "MATERIAL": "m",
    "ORIENTATION": "o",
    "SURFACE": "s",
}
_LAST = ("EQUATION", "TIE", "RIGID BODY", "MPC", "COUPLING", "INITIAL CONDITIONS", "BOUNDARY")
_NONE = np.empty(0, dtype=np.int64)


@dataclass(eq=False)
class FlatText:
    """Text for CalculiX: node ``row`` of the assembly has the label row + 1, element ``number`` that plus 1.

    ``masses`` are the numbers of point masses that are in it, ``reduced`` (elements,) says which are of their type with
    R, ``held`` (n, 3) the displacements that *BOUNDARY holds, ``followers`` rows of nodes that follow others,
    ``equated`` what equations name, as ``problems_of_references`` has it.
    """

    assembly: Assembly
    deck: Contents
    sets: dict[tuple[str, int, str], str] = field(default_factory=dict)
    names: dict[tuple[str, int, str], str] = field(default_factory=dict)
    defined: list[str] = field(default_factory=list)
    surfaces: list[str] = field(default_factory=list)
    body: list[tuple[int, str]] = field(default_factory=list)
    steps: list[str] = field(default_factory=list)
    masses: set[int] = field(default_factory=set)
    followers: set[int] = field(default_factory=set)
    equated: list[tuple[str, int, bool]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.labels = self.assembly.element_labels()
        nodes = Nodes(ids=self.assembly.ids, xyz=self.assembly.xyz)
        mesh = right_handed(Mesh(nodes=nodes, blocks=tuple(self.assembly.blocks)))
        self.blocks, self.reversed = mesh.blocks, mesh.warnings
        self.held = np.zeros((len(self.assembly.ids), 3), dtype=bool)
        self.reduced = np.zeros(len(self.labels), dtype=bool)
        left = [np.full(len(ids), not nodes.shape[1]) for _, ids, nodes in self.assembly.others]
        self.left = np.concatenate([np.zeros(len(self.labels) - sum(map(len, left)), dtype=bool), *left])

    def write(self, numbers: Ints) -> Ints:
        """Those of the elements that are not left out."""
        return np.asarray(numbers[~self.left[numbers]])

    def text(self) -> str:
        """All cards but nodes and steps."""
        body = [text for _, text in sorted(self.body, key=lambda item: item[0])]
        elements = element_lines(self.assembly, self.blocks, self.masses, self.reduced)
        return "\n".join([*elements, *self.defined, *self.surfaces, *body])

    def card(self, placed: Placed, card: Card, rows: Rows, *, fields: str | None = None) -> None:
        """A keyword with its data."""
        kinds = CARDS[card.keyword] if fields is None else fields
        rank = _LAST.index(card.keyword) + 1 if card.keyword in _LAST else 0
        self.body.append((rank, self.lines(placed, card, rows, kinds)))

    def lines(self, placed: Placed, card: Card, rows: Rows, kinds: str) -> str:
        """The text of a keyword with its data, names and labels in those of the flat deck."""
        if card.keyword in ("SOLID SECTION", "SHELL SECTION") and "COMPOSITE" not in card.options:
            kinds = "."
        head = "*" + ", ".join([card.keyword, *(self._option(placed, card, *item) for item in card.options.items())])
        data = []
        for row in rows:
            fields = [self.translate(kinds[min(i, len(kinds) - 1)], placed, text, card) for i, text in enumerate(row)]
            data += [", ".join(fields[i : i + Line.SET_ENTRIES]) for i in range(0, len(fields), Line.SET_ENTRIES)] or [
                ""
            ]
        return "\n".join([head, *data])

    def _option(self, placed: Placed, card: Card, key: str, text: str) -> str:
        if key == "NAME":
            kind = {"ORIENTATION": "o", "DISTRIBUTION": "d"}.get(card.keyword, "x")
            return f"NAME={self.name(kind, placed, text)}"
        if not text:
            return key
        return f"{key}={self.translate(_OPTIONS.get(key, '.'), placed, text, card)}"

    def name(self, kind: str, placed: Placed, text: str) -> str:
        """A new name for the object that a scope calls ``text``."""
        return self.names.setdefault((kind, id(placed), text.upper()), f"{kind.upper()}{len(self.names) + 1}")

    def find_name(self, kind: str, placed: Placed, text: str, card: Card) -> str:
        """The name of the object that a scope, or the assembly, has defined as ``text``."""
        for scope in (placed, self.assembly.top):
            if (kind, id(scope), text.upper()) in self.names:
                return self.names[kind, id(scope), text.upper()]
        raise InputError(f"{card} names {text!r}, which is not defined", kind="unknown")

    def translate(self, kind: str, placed: Placed, text: str, card: Card) -> str:
        """A field of a data line."""
        if not text or kind == ".":
            return text
        if kind in "ne":
            return self.group(kind, placed, text)
        if kind == "s":
            return self.surface(placed, text, card)
        if kind == "m":
            return self.name("m", self.assembly.top, text)
        return self.find_name(kind, placed, text, card)

    def group(self, kind: str, placed: Placed, text: str) -> str:
        """The label of a node or element in the flat deck, or a set of them."""
        find = self.assembly.nodes_of if kind == "n" else self.assembly.elements_of
        if label(text.partition(".")[2] if "." in text else text) is not None:
            return str(int(find(placed, text)[0]) + 1)
        key = kind, id(placed), text.upper()
        if key not in self.sets:
            rows = find(placed, text)
            self.sets[key] = self.new_set(kind, rows if kind == "n" else self.write(rows))
        return self.sets[key]

    def new_set(self, kind: str, rows: Ints) -> str:
        """A set of nodes or elements (counted from 0) under a name of its own."""
        name, word = f"{kind.upper()}S{len(self.defined) + 1}", "NSET" if kind == "n" else "ELSET"
        self.defined.append("\n".join([f"*{word}, {word}={name}", *sixteen(rows + 1)]))
        return name

    def surface(self, placed: Placed, text: str, card: Card) -> str:
        """The name of a surface, which is written when it is named first; also of a set of nodes as one."""
        where, own, rows = self._find_surface(placed, text, card)
        name = own.options["NAME"]
        if ("s", id(where), name.upper()) in self.names:
            return self.names["s", id(where), name.upper()]
        return self._surface(where, own, rows, name)

    def nodes_of_surface(self, placed: Placed, text: str, card: Card) -> Ints:
        """Rows of the nodes of a surface, of shells those"""
        where, own, rows = self._find_surface(placed, text, card)
        if own.options.get("TYPE", "ELEMENT").upper() == "NODE":
            return np.unique(np.concatenate([self.assembly.nodes_of(where, row[0]) for row in rows]))
        surfaces = Surfaces(self.assembly)
        pieces = [_NONE]
        for row in rows:
            numbers = self.assembly.elements_of(where, row[0])
            if (numbers < self.assembly.solids).all():
                pieces.append(surfaces.of_faces(where, [row], own).nodes)
            else:
                pieces.append(self.assembly.nodes_of_elements(numbers))
        return np.unique(np.concatenate(pieces))

    def _find_surface(self, placed: Placed, text: str, card: Card) -> tuple[Placed, Card, Rows]:
        scope, rest = self.assembly.split(placed, text)
        for where in (scope, self.assembly.top):
            for content in where.contents:
                for own, rows in content.surfaces:
                    if own.options.get("NAME", "").upper() == rest.upper():
                        return where, own, [row for row in rows if row]
        raise InputError(f"{card} names the surface {text!r}, which is not defined", kind="unknown")

    def _surface(self, placed: Placed, card: Card, rows: Rows, text: str) -> str:
        name = self.name("s", placed, text)
        kind = "n" if card.options.get("TYPE", "ELEMENT").upper() == "NODE" else "e"
        if "COMBINE" in card.options:
            raise InputError(f"{card} {text!r} combines others; list their faces in one surface", kind="unsupported")
        lines = []
        for row in rows:
            if kind == "e" and (len(row) < 2 or not row[1] or (self.reversed and row[1][:2].upper() != "SP")):
                lines += self._sides(placed, row, card)
            else:
                lines.append(", ".join([self.group(kind, placed, row[0]), *(row[1:] if kind == "e" else [])]))
        word = "NODE" if kind == "n" else "ELEMENT"
        self.surfaces.append("\n".join([f"*SURFACE, NAME={name}, TYPE={word}", *lines]))
        return name

    def _sides(self, placed: Placed, row: list[str], card: Card) -> list[str]:
        """Element and side of the faces of solids that a line names, of free ones where it names no side."""
        wanted = self.assembly.elements_of(placed, row[0])
        faces = [nodes for _, nodes in Surfaces(self.assembly).of_faces(placed, [row], card).faces if len(nodes)]
        named = [face_keys(nodes[:, : 3 if nodes.shape[1] in (3, 6) else 4]) for nodes in faces]
        keys, numbers, sides, start = [np.concatenate([np.empty((0, 4), dtype=np.int64), *named])], [], [], 0
        for part in self.blocks:
            for side, corners in enumerate(FACES[part.type[0]]):
                keys.append(face_keys(part.nodes[:, corners]))
                numbers.append(start + np.arange(len(part.nodes)))
                sides.append(np.full(len(part.nodes), side + 1))
            start += len(part.nodes)
        _, group = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
        group, number, side_of = group.ravel(), np.concatenate(numbers), np.concatenate(sides)
        given = np.isin(group[len(keys[0]) :], group[: len(keys[0])]) & np.isin(number, wanted)
        return [f"{number[i] + 1}, S{side_of[i]}" for i in np.flatnonzero(given).tolist()]

    def boundary(self, placed: Placed, card: Card, rows: Rows) -> str:
        """*BOUNDARY that holds its dofs at zero."""
        lines = []
        for row in rows:
            node, own = self.group("n", placed, row[0]), self.assembly.nodes_of(placed, row[0])
            for first, last in spans_of(row, card):
                lines.append(f"{node}, {first}, {last}")
                self.held[own, first - 1 : min(last, 3)] = True
        return "\n".join(["*BOUNDARY", *lines])

    def equation(self, placed: Placed, card: Card, rows: Rows) -> None:
        """*EQUATION, whose axes CalculiX turns itself; sets of nodes one by one."""
        for _, terms in equations_of(self.assembly, Axes(self.assembly), placed, card, rows):
            self.terms([(node + 1, component + 1, value) for node, component, value in terms])

    def terms(self, terms: list[tuple[int, int, float]], keyword: str = "EQUATION") -> None:
        """One equation of terms (label, dof from 1, coefficient)."""
        self.equated += [(keyword, label - 1, True) for label, *_ in terms]
        self.followers.add(terms[0][0] - 1)
        texts = [f"{label}, {dof}, {numeral(value)}" for label, dof, value in terms]
        lines = [", ".join(texts[i : i + 4]) for i in range(0, len(texts), 4)]
        self.body.append((1, "\n".join(["*EQUATION", str(len(texts)), *lines])))
