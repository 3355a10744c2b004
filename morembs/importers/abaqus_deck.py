"""What an input deck says, scope by scope: parts, instances and the assembly, before instances are placed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.importers.abaqus_keywords import (
    Card,
    cards,
    element_numbers,
    fields,
    label,
    members,
    node_rows,
    number,
)  # fmt: skip
from morembs.importers.formulations import dialect_of, dialects_of_comments, meaning_of
from morembs.importers.includes import open_text

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Rows = list[list[str]]
NODES = {"tet4": 4, "tet10": 10, "hex8": 8, "hex20": 20, "hex27": 27, "wedge6": 6, "wedge15": 15}
_KINDS = {
    "C3D4": "tet4", "C3D10": "tet10", "C3D8": "hex8", "C3D20": "hex20", "C3D27": "hex27", "C3D6": "wedge6",
    "C3D15": "wedge15",
}  # fmt: skip
# Variants of one shape: hybrid, modified, reduced integration, incompatible modes, improved stress, thermal.
_VARIANTS = {
    "C3D4": ("H",), "C3D10": ("H", "I", "M", "MH", "HS", "T"), "C3D8": ("H", "I", "IH", "R", "RH", "S", "HS"),
    "C3D20": ("H", "R", "RH"), "C3D27": ("H", "R", "RH"), "C3D6": ("H",), "C3D15": ("H",),
}  # fmt: skip
SOLIDS = _KINDS | {code + end: _KINDS[code] for code, ends in _VARIANTS.items() for end in ends}
POINTS = ("MASS", "ROTARYI")
# Bytes at the begin of a deck whose comments may name the program that wrote it.
_HEAD = 1 << 16
CONSTRAINTS = ("COUPLING", "KINEMATIC COUPLING", "RIGID BODY", "MPC")
PROPERTIES = ("SOLID SECTION", "MASS", "ROTARY INERTIA")
# Properties of a material; which of them a model can carry is seen when materials are built.
MATERIAL = {
    "ELASTIC", "DENSITY", "EXPANSION", "CONDUCTIVITY", "SPECIFIC HEAT", "LATENT HEAT", "PLASTIC", "DAMPING", "CREEP",
    "CYCLIC HARDENING", "RATE DEPENDENT", "POTENTIAL", "DEPVAR", "HYPERELASTIC", "HYPERFOAM", "VISCOELASTIC",
    "USER MATERIAL", "ELECTRICAL CONDUCTIVITY", "FAIL STRESS", "FAIL STRAIN", "DEFORMATION PLASTICITY", "NO TENSION",
    "NO COMPRESSION", "FLUID CONSTANTS", "MAGNETIC PERMEABILITY", "USER DEFINED FIELD", "PERMEABILITY",
}  # fmt: skip
SILENT = {"HEADING", "PREPRINT"}
# Neither stiffness nor mass of the model depends on these; they are left out with a note.
NOTED = {
    "BOUNDARY", "INITIAL CONDITIONS", "AMPLITUDE", "TIME POINTS", "PHYSICAL CONSTANTS", "TRANSFORM", "FILTER",
    "SECTION CONTROLS", "SURFACE INTERACTION", "SURFACE BEHAVIOR", "FRICTION", "RESTART", "FILE FORMAT", "NODE PRINT",
    "NODE FILE", "NODE OUTPUT", "EL PRINT", "EL FILE", "ELEMENT OUTPUT", "CONTACT PRINT", "CONTACT FILE", "OUTPUT",
    "ENERGY PRINT", "ENERGY FILE", "MONITOR", "HOURGLASS STIFFNESS", "CLOAD", "DLOAD", "DSLOAD", "TEMPERATURE", "CFLUX",
    "DFLUX", "FILM", "RADIATE", "GAP CONDUCTANCE", "FLUID SURFACE", "IMPERFECTION", "BASE MOTION",
}  # fmt: skip
WHY_REFUSED = {
    "EQUATION": "linear equations between motions cannot be carried",
    "TIE": "meshes glued at a surface cannot be carried",
    "CONTACT PAIR": "contact is not linear",
    "SHELL SECTION": "shells are not supported",
    "BEAM SECTION": "beams are not supported",
    "BEAM GENERAL SECTION": "beams are not supported",
    "SPRING": "springs are not supported",
    "DASHPOT": "dashpots are not supported",
    "EMBEDDED ELEMENT": "embedded elements are not supported",
    "SYSTEM": "moved coordinates are not supported",
    "DISTRIBUTING COUPLING": "elements DCOUP3D are not supported; use *COUPLING with *DISTRIBUTING",
}


@dataclass
class Members:
    """What data lines put into a set: labels, ranges (first, last, step), names of sets, all of ``instance``."""

    labels: Ints
    ranges: list[tuple[int, int, int]]
    names: list[str]
    instance: str


@dataclass
class NamedSet:
    """A set under the name that it was first written with."""

    name: str
    parts: list[Members] = field(default_factory=list)


@dataclass
class Scope:
    """What a part, an instance, or the assembly (with all that stands outside of parts) defines.

    ``others`` are elements that a program may assemble though they cannot be here: type, label and nodes (k, 1 + width).
    """

    name: str
    node_ids: list[Ints] = field(default_factory=list)
    xyz: list[Floats] = field(default_factory=list)
    elements: dict[str, list[Ints]] = field(default_factory=dict)
    points: list[tuple[int, str, str]] = field(default_factory=list)
    others: list[tuple[str, Ints]] = field(default_factory=list)
    node_sets: dict[str, NamedSet] = field(default_factory=dict)
    element_sets: dict[str, NamedSet] = field(default_factory=dict)
    surfaces: list[tuple[Card, Rows]] = field(default_factory=list)
    properties: list[tuple[Card, Rows]] = field(default_factory=list)
    orientations: dict[str, tuple[Card, Rows]] = field(default_factory=dict)
    constraints: list[tuple[Card, Rows, Card | None, Rows]] = field(default_factory=list)


@dataclass
class Instance:
    """A part in its place: the scope of its own data, and the data lines that move it."""

    scope: Scope
    part: str
    card: Card
    moves: Rows


@dataclass
class Deck:
    """All of a deck; ``counts`` of element types as they are written, ``noted`` keywords without effect; ``dialect`` is
    the program whose types are meant, and ``guessed`` says that the deck does not tell."""

    name: str
    top: Scope = field(default_factory=lambda: Scope(""))
    parts: dict[str, Scope] = field(default_factory=dict)
    instances: dict[str, Instance] = field(default_factory=dict)
    materials: dict[str, list[tuple[Card, Rows]]] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    noted: dict[str, int] = field(default_factory=dict)
    in_steps: dict[str, int] = field(default_factory=dict)
    dialects: set[str] = field(default_factory=set)
    dialect: str = "calculix"
    guessed: bool = False

    def kind(self, code: str) -> tuple[str, str, str]:
        """Type, formulation and mass of the solids that the deck calls ``code``."""
        meaning = meaning_of(code, self.dialect)
        return SOLIDS[code], meaning.formulation, meaning.mass


def read_deck(path: Path, *, outside: bool = False, dialect: str = "auto") -> Deck:
    """The deck of a file; ``outside`` allows to include files from beyond its folder.

    ``dialect`` "auto" looks at keywords and at comments of the head; where they do not tell one program, a deck without
    parts is taken for one of CalculiX.

    Raises:
        InputError: the text is not an input deck, or holds what a model cannot carry.
    """
    deck = Deck(path.name)
    reader = DeckReader(deck)
    for card, pieces in cards(path, outside=outside):
        reader.take(card, pieces)
    if reader.open:
        raise InputError(
            f"{path.name} ends inside *{reader.open[-1]}: the part, assembly, instance or step is not ended "
            f"(*END {reader.open[-1]} is missing); the file may be cut off"
        )
    unknown = {code: n for code, n in deck.counts.items() if code not in SOLIDS and code not in POINTS}
    if unknown:
        listed = ", ".join(f"{n} of the type {code!r}" for code, n in unknown.items())
        raise InputError(
            f"{path.name} has elements that are not supported: {listed}; expected solids ({', '.join(_KINDS)} and "
            "their variants) and MASS or ROTARYI; take the others out of the deck"
        )
    with open_text(path) as file:
        deck.dialects |= dialects_of_comments(file.read(_HEAD))
    told = deck.dialects if dialect == "auto" else {dialect}
    deck.guessed = len(told) != 1
    deck.dialect = ("abaqus" if deck.parts else "calculix") if deck.guessed else next(iter(told))
    return deck


class DeckReader:
    """Puts each card where it belongs."""

    def __init__(self, deck: Deck) -> None:
        self.deck = deck
        self.open: list[str] = []
        self.scope = deck.top
        self.material: list[tuple[Card, Rows]] | None = None

    def take(self, card: Card, pieces: Iterator[bytes]) -> None:
        word, deck = card.keyword, self.deck
        told = dialect_of(word, card.options)
        deck.dialects |= {told} if told else set()
        if word == "STEP":
            self._begin(word, card)
        if self.open and self.open[-1] == "STEP":
            if word == "END STEP":
                self.open.pop()
            deck.in_steps[word] = deck.in_steps.get(word, 0) + 1
        elif word in MATERIAL and self.material is not None:
            self.material.append((card, fields(b"".join(pieces))))
        elif word in ("PART", "ASSEMBLY", "INSTANCE") or word.startswith("END "):
            self._structure(card, pieces)
        elif word in ("NODE", "ELEMENT", "NSET", "ELSET"):
            {"NODE": self._nodes, "ELEMENT": self._elements}.get(word, self._set)(card, pieces)
        elif word == "MATERIAL":
            self._material(card)
            _refuse_data(card, pieces)
        elif word in NOTED:
            deck.noted[word] = deck.noted.get(word, 0) + 1
        elif word not in SILENT:
            self._small(card, fields(b"".join(pieces)))

    def _begin(self, word: str, card: Card) -> None:
        allowed = {"PART": [], "ASSEMBLY": [], "INSTANCE": ["ASSEMBLY"], "STEP": []}[word]
        if self.open != allowed:
            where = f"inside *{self.open[-1]}" if self.open else "outside of an *ASSEMBLY"
            raise InputError(f"{card} stands {where}; check that each part, instance and step is ended")
        self.open.append(word)

    def _structure(self, card: Card, pieces: Iterator[bytes]) -> None:
        word, deck = card.keyword, self.deck
        if word != "INSTANCE":
            _refuse_data(card, pieces)
        if word.startswith("END "):
            if not self.open or self.open[-1] != word[4:]:
                raise InputError(f"{card} ends what was not begun; check the order of the keywords")
            self.open.pop()
            self.scope = deck.top
            return
        self._begin(word, card)
        if word == "ASSEMBLY":
            return
        name = card.need("NAME")
        known = deck.parts if word == "PART" else deck.instances
        if name.upper() in known:
            raise InputError(f"{card}: the name {name!r} is given twice; expected each name once")
        self.scope = Scope(name)
        if word == "PART":
            deck.parts[name.upper()] = self.scope
        else:
            part = card.options.get("PART", "")
            if part and part.upper() not in deck.parts:
                raise InputError(f"{card}: the instance {name!r} is of the part {part!r}, which is not defined")
            deck.instances[name.upper()] = Instance(self.scope, part.upper(), card, fields(b"".join(pieces)))

    def _nodes(self, card: Card, pieces: Iterator[bytes]) -> None:
        system = card.options.get("SYSTEM", "R").upper()
        if system not in ("R", "C"):
            raise InputError(f"{card} uses SYSTEM={system}; expected R (rectangular) or C (cylindrical)")
        for piece in pieces:
            ids, xyz = node_rows(piece, card) if piece else (np.empty(0, dtype=np.int64), np.empty((0, 3)))
            if system == "C":
                r, angle = xyz[:, 0], np.radians(xyz[:, 1])
                xyz = np.column_stack([r * np.cos(angle), r * np.sin(angle), xyz[:, 2]])
            self.scope.node_ids.append(ids)
            self.scope.xyz.append(xyz)
            join(self.scope.node_sets, card.options.get("NSET", ""), Members(ids, [], [], ""))

    def _elements(self, card: Card, pieces: Iterator[bytes]) -> None:
        code = card.options.get("TYPE", "").upper()
        counts, name = self.deck.counts, card.options.get("ELSET", "")
        counts.setdefault(code or "(none)", 0)
        if code in SOLIDS:
            for rows in _records(card, pieces, code):
                counts[code] += len(rows)
                self.scope.elements.setdefault(code, []).append(rows)
                join(self.scope.element_sets, name, Members(rows[:, 0].copy(), [], [], ""))
            return
        for row in fields(b"".join(pieces)):
            counts[code or "(none)"] += 1
            if code in POINTS:
                number_ = label(row[0]) if len(row) == 2 else None
                if number_ is None:
                    raise InputError(f"{card}: {', '.join(row)[:60]!r} was given; expected a label and a node")
                self.scope.points.append((number_, row[1], code))
                join(self.scope.element_sets, name, Members(np.array([number_]), [], [], ""))

    def _set(self, card: Card, pieces: Iterator[bytes]) -> None:
        sets = self.scope.node_sets if card.keyword == "NSET" else self.scope.element_sets
        name, instance = card.need(card.keyword), card.options.get("INSTANCE", "")
        if "ELSET" in card.options and card.keyword == "NSET":
            raise InputError(f"{card} makes {name!r} of the nodes of an element set; list the nodes")
        join(sets, name, Members(np.empty(0, dtype=np.int64), [], [], instance))
        for piece in pieces:
            if "GENERATE" in card.options:
                ranges = [_range(row, card) for row in fields(piece) if row]
                join(sets, name, Members(np.empty(0, dtype=np.int64), ranges, [], instance))
            elif piece:
                join(sets, name, Members(*_split(piece, card), instance))

    def _material(self, card: Card) -> None:
        name = card.need("NAME")
        if name.upper() in self.deck.materials:
            raise InputError(f"{card}: the name {name!r} is given twice; expected each material once")
        self.material = self.deck.materials.setdefault(name.upper(), [])

    def _small(self, card: Card, rows: Rows) -> None:
        word, scope = card.keyword, self.scope
        if word == "SURFACE":
            scope.surfaces.append((card, rows))
        elif word in PROPERTIES:
            if word == "SOLID SECTION" and len([row for row in rows if row]) > 1:
                raise InputError(f"{card} has several data lines; expected one, its thickness, or none")
            scope.properties.append((card, rows))
        elif word == "ORIENTATION":
            name = card.need("NAME").upper()
            if name in scope.orientations:
                raise InputError(f"{card}: the name {name!r} is given twice; expected each orientation once")
            scope.orientations[name] = (card, rows)
        elif word in CONSTRAINTS:
            scope.constraints.append((card, rows, None, []))
        elif word in ("KINEMATIC", "DISTRIBUTING"):
            if not scope.constraints or scope.constraints[-1][0].keyword != "COUPLING" or scope.constraints[-1][2]:
                raise InputError(f"{card} has no *COUPLING before it; expected one for each")
            scope.constraints[-1] = (*scope.constraints[-1][:2], card, rows)
        else:
            named = next((card.options[k] for k in ("NAME", "ELSET", "NSET") if card.options.get(k)), "")
            why = WHY_REFUSED.get(word, "it is not known here, so stiffness or mass may depend on it")
            raise InputError(
                f"{card}{f' ({named})' if named else ''} cannot be read: {why}; take it out of the deck if the model "
                "is right without it"
            )


def _refuse_data(card: Card, pieces: Iterator[bytes]) -> None:
    if any(piece.strip() for piece in pieces):
        raise InputError(f"{card} is followed by data lines, and takes none; a keyword above them is missing")


def join(sets: dict[str, NamedSet], name: str, part: Members) -> None:
    if name:
        sets.setdefault(name.upper(), NamedSet(name)).parts.append(part)


def _split(piece: bytes, card: Card) -> tuple[Ints, list[tuple[int, int, int]], list[str]]:
    labels, names = members(piece, card)
    return labels, [], names


def _range(row: list[str], card: Card) -> tuple[int, int, int]:
    parts = [label(text) for text in row]
    if len(parts) in (2, 3) and None not in parts:
        first, last, step = (int(p or 0) for p in [*parts, 1][:3])
        if step > 0 and last >= first:
            return first, last, step
    raise InputError(f"{card}: {', '.join(row)[:60]!r} was given; expected first label, last label and step")


def _records(card: Card, pieces: Iterator[bytes], code: str) -> Iterator[Ints]:
    """Label and nodes (k, width) of elements; each must begin on a line of its own."""
    width = 1 + NODES[SOLIDS[code]]
    rest, rest_first = np.empty(0, dtype=np.int64), np.empty(0, dtype=bool)
    for piece in pieces:
        if not piece:
            continue
        values, first = element_numbers(piece, card)
        values, first = np.concatenate([rest, values]), np.concatenate([rest_first, first])
        whole = len(values) // width * width
        rows = values[:whole].reshape(-1, width)
        shifted = np.flatnonzero(~first[:whole].reshape(-1, width)[:, 0])
        if len(shifted):
            near = rows[max(int(shifted[0]) - 1, 0), 0]
            raise InputError(
                f"{card}, TYPE={code}: the element {near} does not have {width - 1} nodes; expected a label and "
                f"{width - 1} nodes (a multiple of {width} numbers), each element on a line of its own"
            )
        rest, rest_first = values[whole:], first[whole:]
        yield rows
    if len(rest):
        raise InputError(
            f"{card}, TYPE={code}: the block does not hold a multiple of {width} numbers (label and {width - 1} nodes "
            f"for each element): {len(rest)} are left over; the file may be cut off"
        )


def values(row: list[str], card: Card) -> list[float]:
    """The fields of a line as numbers."""
    return [number(text, card) for text in row]
