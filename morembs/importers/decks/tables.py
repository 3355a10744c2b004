"""A deck as tables by labels: what readers of all programs fill, and what assemblies, engines and writers read.

Parts are in their places, includes are followed, and every name and label is one of the whole deck. Lengths, masses and
forces are in the units of the deck, vectors along its global axes, unless a field says otherwise. Couplings, masses and
springs are the types of a model with labels of nodes where those have rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morembs.base.summary import summarised
from morembs.base.types import Floats, Ints
from morembs.fem.constraints import AverageElement, Equations, RigidElement
from morembs.importers.decks.flat import Cards
from morembs.importers.decks.formulations import Meaning
from morembs.importers.decks.options import DeckOptions
from morembs.importers.decks.problems import Problem
from morembs.importers.imported import DiscreteElement, PointMass
from morembs.importers.tolerances import TOL

# Ends sentences on what a written deck lacks and K and M of its model do not.
NOT_WRITTEN = "[not-written]"


@dataclass(frozen=True, kw_only=True, eq=False)
class Elements:
    """Elements (k,) of one type: labels ``ids`` (k,) and labels of their ``nodes`` (k, n) in VTK order.

    A middle node that is not there has the label 0. Labels are unique among all elements of the deck.
    """

    # The name of the type in its program, such as "C3D8R", "CHEXA", "SOLID185", "S4", "CBAR".
    code: str
    # "solid"; "shell", "membrane", "shear" (panel), "beam", "truss"; "point" (masses, springs, rigid links, whose
    # properties are among the couplings, masses and springs of the deck); "none": neither stiffness nor mass.
    kind: str
    # "tet4", "tet10", "wedge6", "wedge15", "hex8", "hex20", "hex27"; "tri3", "tri6", "quad4", "quad8"; "line2",
    # "line3"; "" for a kind without a shape.
    shape: str
    ids: Ints
    nodes: Ints
    # Formulation and mass that an own assembly gives to solids.
    meaning: Meaning = field(default_factory=Meaning)
    # Numbers (k,) of the deck by what they count, such as "material", "real", "type", "property", "system"; "points"
    # along each edge at which solids are integrated, 0 for those of the element.
    numbers: Mapping[str, Ints] = field(default_factory=dict)
    # Properties that differ from element to element (NaN: that of the section):
    # "thickness" (k, n) at the nodes; "normal" (k, n, 3) there, of beams the second section axis;
    # "offset" (k,) of a shell along its normal, (k, 2, 3) of the ends of a beam;
    # "direction" (k, 3), with which the axis of a beam spans the plane of its first section axis, or whose projection
    # is the first material axis of a shell; "angle" (k,) in degrees about the normal, from the first edge of a shell
    # to its first material axis; "released" (k, 2, 6), 1 where an end of a beam carries no force in a component.
    values: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    # Why an own assembly cannot have them.
    problem: Problem | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class ElasticMaterial:
    """A material: ``stiffness`` (6, 6) along its own axes in Voigt order xx, yy, zz, yz, zx, xy, None where it has no
    linear one in space; ``density``, None where it has none.

    ``constants`` are the numbers of the deck by the names of its program, such as "EX". Those of MAT1 ("E", "G", "NU"),
    and of MAT8 ("E1", "E2", "NU12", "G12", "G1Z", "G2Z") and MAT2 ("G11" to "G33"), which have no stiffness in space
    and are for shells alone, hold as they stand: of three of MAT1 bars take "G", solids "E" and "NU".
    """

    name: str
    stiffness: Floats | None = None
    density: float | None = None
    constants: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class Ply:
    """A layer: the name of its ``material``, thickness, and angle in degrees from the first axis of the section."""

    material: str
    thickness: float
    angle: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Plate:
    """How a shell resists that is no plate of its section's material and thickness t: names of the materials of
    ``membrane``, ``bending`` and transverse ``shear`` ("": it has no such stiffness; of shear: it does not shear),
    12 I / t^3, and the share of t that carries shear."""

    membrane: str = ""
    bending: str = ""
    shear: str = ""
    inertia_ratio: float = 1.0
    shear_ratio: float = TOL.shear_thickness

    def of_material(self, name: str) -> Plate:
        """The same of one material, wherever it has one."""
        own = {part: name for part in ("membrane", "bending", "shear") if getattr(self, part)}
        return replace(self, **own)  # type: ignore[arg-type]


@dataclass(frozen=True, kw_only=True, eq=False)
class Section:
    """What elements of the set ``set`` of a deck, or "all", are made of; the last section of an element holds.

    Solids have ``stiffness`` (6, 6) along the global axes and ``density``; ``lacks`` says in a sentence what either
    lacks (stiffness without density: the density alone). Other kinds have their ``material`` along ``axes``, or
    ``lacks`` says why there is none.
    """

    set: str
    # As of Elements: "solid", "shell", "membrane", "shear", "beam", "truss".
    kind: str = "solid"
    # The name of the card, such as "*SHELL SECTION", "PSHELL 3", "SECTYPE 2".
    code: str = ""
    # Name in the materials of the deck, "" where plies have their own or there is none.
    material: str = ""
    stiffness: Floats | None = None
    density: float | None = None
    lacks: str = ""
    # Material axes (3, 3) as rows along the global axes; None: global for solids, of the element for others.
    axes: Floats | None = None
    # Of shells: thickness, layers from the bottom to the top (then their sum is the thickness), and the distance from
    # the nodes to the middle surface along the normal.
    thickness: float = 0.0
    plies: tuple[Ply, ...] = ()
    offset: float = 0.0
    plate: Plate | None = None
    # Of beams: the shape of the profile with its dimensions as *BEAM SECTION of Abaqus has them (RECT, CIRC, PIPE, BOX,
    # I, L, HEX, TRAPEZOID), "ELLIPSE" with its axes, "GENERAL" with area, I11, I12, I22, J; the name and dimensions of
    # PBARL behind "PBARL ".
    # Of trusses: the area, and behind it the torsion constant where there is one.
    profile: str = ""
    dimensions: tuple[float, ...] = ()
    # Shares of the area that carry shear along the two axes of a profile; (0, 0): no shear strain.
    shear_factors: tuple[float, float] | None = None
    # Direction (3,), with which the axis of a beam spans the plane of its first section axis.
    direction: Floats | None = None
    # Mass per area of shells, per length of beams and trusses, beside that of the material.
    nonstructural: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """Labels of ``nodes`` (n,), ascending, with ``weights`` (n,), their shares of the area; ``faces``: shape, such as
    "quad4", and labels of corners and middles (f, k) in VTK order."""

    nodes: Ints
    weights: Floats
    faces: tuple[tuple[str, Ints], ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Tie:
    """The surface ``slave`` glued to ``master``: what the ``equations`` of the deck with the same name say for a mesh.

    ``tolerance`` is the distance within which nodes are tied, 0 for that of the program; ``moves``: tied nodes were
    moved to the master; ``is_contact``: the deck has contact there, which is glued as asked.
    """

    name: str
    slave: str
    master: str
    tolerance: float = 0.0
    moves: bool = True
    is_contact: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class System:
    """A coordinate system: rectangular "R", cylindrical "C" or spherical "S"; ``origin`` (3,), ``axes`` (3, 3) as rows
    along the global axes, of which the third is that of rotation."""

    kind: str
    origin: Floats
    axes: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Supports:
    """Labels ``nodes`` (h,) that are held along ``directions`` (h, 6): x, y, z and rotations about them."""

    nodes: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    directions: Floats = field(default_factory=lambda: np.empty((0, 6)))


@dataclass(frozen=True)
class LeftOut:
    """How often something of a deck was left out, and why."""

    count: int
    why: str


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class DeckTables:
    """All of a deck that a linear model may need, by labels. Sets are ranges (k, 2) of labels, first and last.

    ``Deck`` is the same with what can be made of it.
    """

    # The name of its file, and of the program that it is written for: "Abaqus", "CalculiX", "Nastran", "ANSYS", "UNV".
    name: str
    program: str
    # Labels (n,), each once, and coordinates (n, 3) of all nodes, in any order.
    ids: Ints
    xyz: Floats
    elements: tuple[Elements, ...] = ()
    node_sets: Mapping[str, Ints] = field(default_factory=dict)
    element_sets: Mapping[str, Ints] = field(default_factory=dict)
    surfaces: Mapping[str, Surface] = field(default_factory=dict)
    materials: Mapping[str, ElasticMaterial] = field(default_factory=dict)
    sections: tuple[Section, ...] = ()
    # With labels of nodes where the type says rows.
    rigid: tuple[RigidElement, ...] = ()
    average: tuple[AverageElement, ...] = ()
    equations: tuple[Equations, ...] = ()
    masses: tuple[PointMass, ...] = ()
    discrete: tuple[DiscreteElement, ...] = ()
    ties: tuple[Tie, ...] = ()
    systems: Mapping[str, System] = field(default_factory=dict)
    # Labels of nodes with axes of their own; what acts along these is turned to the global ones already.
    turned: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    supports: Supports = field(default_factory=Supports)
    # What was left out, by its name in the deck.
    left_out: Mapping[str, LeftOut] = field(default_factory=dict)
    # Sentences on what was read; ``remarks`` are those on sections, couplings and masses. ``warnings`` are of the
    # model, ``mesh_warnings`` of its elements.
    notes: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    mesh_warnings: tuple[str, ...] = ()
    # What keeps the deck from becoming a model, whoever assembles it.
    problems: tuple[Problem, ...] = ()
    # With which it was read; densities that a user gives are multiplied by ``mass_scale`` (PARAM WTMASS).
    options: DeckOptions = field(default_factory=DeckOptions)
    mass_scale: float = 1.0
    # Whether its program takes meshes in which faces of elements that meet differ.
    seams: bool = False
    # What the program calls a node.
    node: str = "node"
    # What Abaqus and CalculiX read as it stands: cards that these tables have no fields for (steps, nonlinear springs,
    # temperatures, gaps, bolts, ...), in words of one flat deck; None where tables have all that was read. A deck
    # with cards has sections, couplings, masses and supports there, and not in tables.
    cards: Cards | None = None
    # Names of the files that it was read from, includes too, which no writer replaces.
    files: tuple[str, ...] = ()

    def ranges(self, name: str) -> Ints:
        """Ranges (k, 2) of the labels of a set of elements, "all" of these where it is none of the deck."""
        whole = np.array([[0, np.iinfo(np.int64).max]])
        return np.asarray(self.element_sets.get(name, whole if name == "all" else whole[:0]))

    def _facts(self) -> dict[str, object]:
        counts: dict[str, int] = {}
        for part in self.elements:
            counts[part.code] = counts.get(part.code, 0) + len(part.ids)
        return {
            "file": self.name,
            "program": self.program,
            "nodes": len(self.ids),
            "elements": " + ".join(f"{count} {code}" for code, count in counts.items()) or "none",
            "sections": len(self.sections),
            "problems": len(self.problems) or "none",
        }
