"""What an input deck says, scope by scope: parts, instances and the assembly, before instances are placed."""

from __future__ import annotations

from dataclasses import dataclass, field

from morembs.base.types import Floats, Ints
from morembs.importers.abaqus.data import number
from morembs.importers.abaqus.keywords import Card
from morembs.importers.abaqus.left_out import warning_of
from morembs.importers.decks.formulations import meaning_of
from morembs.importers.decks.options import DeckOptions
from morembs.importers.decks.problems import Problem, Problems

Rows = list[list[str]]
NODES = {"tet4": 4, "tet10": 10, "hex8": 8, "hex20": 20, "hex27": 27, "wedge6": 6, "wedge15": 15}
KINDS = {
    "C3D4": "tet4",
    "C3D10": "tet10",
    "C3D8": "hex8",
    "C3D20": "hex20",
    "C3D27": "hex27",
    "C3D6": "wedge6",
    "C3D15": "wedge15",
}
# Variants of one shape: hybrid, modified, reduced integration, incompatible modes, improved stress, thermal.
_VARIANTS = {
    "C3D4": ("H", "T", "HT"),
    "C3D10": ("H", "I", "M", "MH", "HS", "T", "HT", "MT", "MHT", "R"),
    "C3D8": ("H", "I", "IH", "R", "RH", "S", "HS", "T", "RT", "HT", "RHT", "IT"),
    "C3D6": ("H", "T", "HT"),
    "C3D20": ("H", "R", "RH", "T", "RT", "HT", "RHT", "RI"),
    "C3D27": ("H", "R", "RH"),
    "C3D15": ("H",),
}
SOLIDS = KINDS | {code + end: KINDS[code] for code, ends in _VARIANTS.items() for end in ends}
# Elements on single nodes, with how many they have.
DISCRETE = {
    "MASS": 1,
    "ROTARYI": 1,
    "DCOUP3D": 1,
    "SPRING1": 1,
    "SPRING2": 2,
    "SPRINGA": 2,
    "DASHPOT1": 1,
    "DASHPOT2": 2,
    "DASHPOTA": 2,
}
# Kind and shape of shells, membranes, beams and trusses, which own assembly has not.
STRUCTURES = {
    "S3": ("shell", "tri3"),
    **dict.fromkeys(("S4", "S4R"), ("shell", "quad4")),
    "S6": ("shell", "tri6"),
    **dict.fromkeys(("S8", "S8R"), ("shell", "quad8")),
    "M3D3": ("membrane", "tri3"),
    **dict.fromkeys(("M3D4", "M3D4R"), ("membrane", "quad4")),
    "M3D6": ("membrane", "tri6"),
    **dict.fromkeys(("M3D8", "M3D8R"), ("membrane", "quad8")),
    **dict.fromkeys(("B31", "B31R"), ("beam", "line2")),
    **dict.fromkeys(("B32", "B32R"), ("beam", "line3")),
    "T3D2": ("truss", "line2"),
    "T3D3": ("truss", "line3"),
    "GAPUNI": ("gap", "line2"),
}
# Types of Abaqus that CalculiX has under another name, in a plain form.
PLAIN = {
    "S3R": "S3",
    "S3RS": "S3",
    "STRI3": "S3",
    "STRI65": "S6",
    "S4RS": "S4R",
    "S4R5": "S4R",
    "S8R5": "S8R",
    "B31H": "B31",
    "B31OS": "B31",
    "B32H": "B32",
    "B32OS": "B32",
    "B33": "B31",
    "PIPE31": "B31",
    "PIPE32": "B32",
    "T3D2H": "T3D2",
    "T3D3H": "T3D3",
}
# Nodes of lines in VTK order.
VTK_ORDER = {"line3": [0, 2, 1]}
_WIDTHS = {"tri3": 3, "quad4": 4, "tri6": 6, "quad8": 8, "line2": 2, "line3": 3}


def width_of(code: str) -> int:
    """Nodes of a shell, membrane, beam or truss, 0 of another type."""
    return _WIDTHS[STRUCTURES[code][1]] if code in STRUCTURES else 0


@dataclass
class Members:
    """What data lines put into a set: labels, ranges (first, last, step), names of sets, all of ``instance``; nodes of
    the elements of sets where they are ``of_elements``. ``unsorted`` ones are paired with others as they are listed,
    and hold either labels or names."""

    labels: Ints
    ranges: list[tuple[int, int, int]]
    names: list[str]
    instance: str
    of_elements: bool = False
    unsorted: bool = False


@dataclass
class NamedSet:
    """A set under the name that it was first written with."""

    name: str
    parts: list[Members] = field(default_factory=list)


@dataclass
class Scope:
    """What a part, an instance, or the assembly (with all that stands outside of parts) defines.

    ``others`` are elements that are not assembled here: type, label and nodes (k, 1 + width), without nodes where
    nobody takes them; ``sections`` are theirs.
    """

    name: str
    node_ids: list[Ints] = field(default_factory=list)
    xyz: list[Floats] = field(default_factory=list)
    elements: dict[str, list[Ints]] = field(default_factory=dict)
    discrete: list[tuple[int, list[str], str]] = field(default_factory=list)
    others: list[tuple[str, Ints]] = field(default_factory=list)
    node_sets: dict[str, NamedSet] = field(default_factory=dict)
    element_sets: dict[str, NamedSet] = field(default_factory=dict)
    surfaces: list[tuple[Card, Rows]] = field(default_factory=list)
    properties: list[tuple[Card, Rows]] = field(default_factory=list)
    sections: list[tuple[Card, Rows]] = field(default_factory=list)
    orientations: dict[str, tuple[Card, Rows]] = field(default_factory=dict)
    transforms: list[tuple[Card, Rows]] = field(default_factory=list)
    constraints: list[tuple[Card, Rows, Card | None, Rows]] = field(default_factory=list)


@dataclass
class Instance:
    """A part in its place: the scope of its own data, and the data lines that move it."""

    scope: Scope
    part: str
    card: Card
    moves: Rows


@dataclass
class Contents:
    """All of a deck; ``counts`` of element types as they are written, ``unsupported`` is the problem with
    the types that are ``unknown`` to own assembly, ``noted`` keywords without effect and the
    ``warnings`` of some of them, ``skipped`` what was left out as asked; ``dialect`` is the program whose types are
    meant, and ``guessed`` says that the deck does not tell.

    ``cards`` are keywords outside of steps beside mesh, sets, surfaces and materials, with their data as it stands;
    ``steps`` those of each step, with the data of its loads and supports.
    """

    name: str
    options: DeckOptions = field(default_factory=DeckOptions)
    problems: Problems = field(default_factory=lambda: Problems(""))
    top: Scope = field(default_factory=lambda: Scope(""))
    parts: dict[str, Scope] = field(default_factory=dict)
    instances: dict[str, Instance] = field(default_factory=dict)
    materials: dict[str, list[tuple[Card, Rows]]] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    noted: dict[str, int] = field(default_factory=dict)
    skipped: dict[str, int] = field(default_factory=dict)
    in_steps: dict[str, int] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    unsupported: Problem | None = None
    unknown: frozenset[str] = frozenset()
    dialects: set[str] = field(default_factory=set)
    dialect: str = "calculix"
    guessed: bool = False
    cards: list[tuple[Scope, Card, bytes]] = field(default_factory=list)
    steps: list[list[tuple[Card, bytes]]] = field(default_factory=list)

    def leave_out(self, card: Card) -> None:
        """Count a keyword that nothing of the model depends on, with the warning that it may need."""
        self.noted[card.keyword] = self.noted.get(card.keyword, 0) + 1
        warning = warning_of(card)
        if warning and warning not in self.warnings:
            self.warnings.append(warning)

    def skip(self, card: Card) -> None:
        """Count a keyword that is left out as asked."""
        self.skipped[f"*{card.keyword}"] = self.skipped.get(f"*{card.keyword}", 0) + 1

    def kind(self, code: str) -> tuple[str, str, str]:
        """Type, formulation and mass of the solids that the deck calls ``code``."""
        meaning = meaning_of(code, self.dialect)
        return SOLIDS[code], meaning.formulation, meaning.mass


def join(sets: dict[str, NamedSet], name: str, part: Members) -> None:
    if name:
        sets.setdefault(name.upper(), NamedSet(name)).parts.append(part)


def values(row: list[str], card: Card) -> list[float]:
    """The fields of a line as numbers."""
    return [number(text, card) for text in row]
