"""Shells, beams and trusses of Abaqus decks by labels, for MYSTRAN: what own assembly leaves out of a ``Deck``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from morembs.base.errors import InputError
from morembs.fem.material import isotropic
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.data import fields
from morembs.importers.abaqus.deck import PLAIN, Contents, Rows, values
from morembs.importers.abaqus.keywords import Card
from morembs.importers.abaqus.names import Placed
from morembs.importers.decks.labels import in_ranges, ranges_of
from morembs.importers.decks.model import Deck
from morembs.importers.decks.options import DeckOptions
from morembs.importers.decks.tables import ElasticMaterial, Elements, Section
from morembs.importers.engines.calculix.read import read_for_engine

# Kind and shape of the types that CalculiX has, too.
SHAPES = {
    "S3": ("shell", "tri3"),
    "S4": ("shell", "quad4"),
    "S4R": ("shell", "quad4"),
    "B31": ("beam", "line2"),
    "B31R": ("beam", "line2"),
    "T3D2": ("truss", "line2"),
}
_SECTIONS = {"SHELL SECTION": "shell", "BEAM SECTION": "beam", "BEAM GENERAL SECTION": "beam", "SOLID SECTION": "truss"}
# What a deck without solids may hold beside its elements.
_OTHER = {"ORIENTATION", "DISTRIBUTION", "BOUNDARY", "INITIAL CONDITIONS", "AMPLITUDE", "TIME POINTS", "NORMAL"}
# Offsets in thicknesses.
_SIDES = {"SPOS": 0.5, "SNEG": -0.5}


def with_structures(deck: Deck, path: Path, options: DeckOptions, *, outside: bool) -> Deck:
    """A deck with its shells, beams and trusses, their sections and materials; solids and all else are in it.

    Raises:
        DeckError: elements that are none of ``SHAPES``.
        InputError: sections that bulk data cannot say, or couplings of a deck without solids.
    """
    read = read_for_engine(path, options, outside=outside)
    problems = [problem for problem in deck.problems if problem.keyword != "ELEMENT"]
    read.problems.entries += problems
    read.problems.refuse()
    assembly = Assembly(read)
    if not assembly.others:
        return replace(deck, problems=())
    strange = [code for code, *_ in assembly.others if code not in SHAPES]
    if strange:
        raise InputError(
            f"{deck.name} has elements {', '.join(dict.fromkeys(strange))}, which MYSTRAN is not given here; expected "
            f"{', '.join(SHAPES)}: --engine calculix"
        )
    if not any(part.kind == "solid" for part in deck.elements):
        lost = {card.keyword for _, card, _ in read.cards} - set(_SECTIONS) - _OTHER - {"MATERIAL", "HEADING"}
        held = sorted(word for word in lost if word in _COUPLES)
        if held or read.top.constraints:
            raise InputError(
                f"{deck.name} has *{held[0] if held else 'COUPLING'} and no solids, which MYSTRAN is not given here: "
                "--engine calculix"
            )
    return _Structures(read, assembly, options).into(deck)


_COUPLES = {"EQUATION", "MPC", "TIE", "RIGID BODY", "KINEMATIC COUPLING", "DISTRIBUTING COUPLING", "MASS", "SPRING"}
_COUPLES |= {"ROTARY INERTIA", "DASHPOT", "PRE-TENSION SECTION", "TRANSFORM", "NODAL THICKNESS"}


class _Structures:
    def __init__(self, read: Contents, assembly: Assembly, options: DeckOptions) -> None:
        self.read, self.assembly, self.options = read, assembly, options
        self.labels = assembly.element_labels()
        self.sections: list[Section] = []
        self.sets: dict[str, np.ndarray] = {}
        self.materials: dict[str, ElasticMaterial] = {}

    def into(self, deck: Deck) -> Deck:
        """The deck with all of it."""
        solids = np.concatenate([self.labels[:0], *(part.ids for part in deck.elements if part.kind == "solid")])
        self.taken = {name for name, own in deck.element_sets.items() if in_ranges(solids, own).any()}
        places = [*self.assembly.placed.values(), self.assembly.top]
        first = self.assembly.solids + len(self.assembly.discrete)
        for scope, card, data in self.read.cards:
            for placed in places:
                if card.keyword in _SECTIONS and any(scope is own for own in placed.contents):
                    numbers = self.assembly.elements_of(placed, card.need("ELSET"))
                    own = numbers[numbers >= first]
                    if len(own):
                        self._section(placed, card, [row for row in fields(data) if row], own)
        parts = [
            Elements(code=code, kind=SHAPES[code][0], shape=SHAPES[code][1], ids=ids, nodes=self.assembly.ids[nodes])
            for code, ids, nodes in self.assembly.others
        ]
        return replace(
            deck,
            elements=(*(part for part in deck.elements if part.kind in ("solid", "point")), *parts),
            sections=(*(section for section in deck.sections if section.kind == "solid"), *self.sections),
            element_sets={**deck.element_sets, **self.sets},
            materials={**deck.materials, **self.materials},
            problems=(),
            warnings=(*deck.warnings, *self._replaced()),
        )

    def _replaced(self) -> list[str]:
        return [
            f"{count} elements {code} are assembled as {PLAIN[code]} [hybrid-as-plain]"
            for code, count in self.read.counts.items()
            if code in PLAIN
        ]

    def _section(self, placed: Placed, card: Card, rows: Rows, numbers: np.ndarray) -> None:
        elset = card.need("ELSET")
        if "COMPOSITE" in card.options or not rows:
            raise InputError(f"{card} of {elset!r} has layers or no data, which MYSTRAN is not given here")
        name = self.assembly.final_name("element", placed, elset)
        if name in self.taken or name in self.sets:
            name = f"section {len(self.sections) + 1} of {name}"
        self.sets[name] = ranges_of(self.labels[numbers])
        kind, data = _SECTIONS[card.keyword], values([text for text in rows[0] if text], card)
        made = Section(set=name, kind=kind, code=f"*{card.keyword}", material=self._material(card))
        if kind == "shell":
            side = card.options.get("OFFSET", "0").upper()
            offset = _SIDES.get(side) if side in _SIDES else values([side], card)[0]
            # Nodes are by so many thicknesses above the middle surface.
            made = replace(made, thickness=data[0], offset=-float(offset or 0.0) * data[0])
        elif kind == "beam":
            profile = card.options.get("SECTION", "GENERAL" if "GENERAL" in card.keyword else "RECT").upper()
            if profile == "GENERAL":
                raise InputError(f"{card} of {elset!r} is a general one, which MYSTRAN is not given here")
            direction = values((rows[1] if len(rows) > 1 else ["0", "0", "-1"])[:3], card)
            direction += [0.0] * (3 - len(direction))
            along = placed.rotation @ np.array(direction)
            made = replace(made, profile=profile, dimensions=tuple(data), direction=along)
        else:
            made = replace(made, dimensions=(data[0],))
        self.sections.append(made)

    def _material(self, card: Card) -> str:
        """The name of the material of a section, which is read."""
        name = card.need("MATERIAL")
        given = {
            own.keyword: (own, [row for row in rows if row]) for own, rows in self.read.materials.get(name.upper(), [])
        }
        if "ELASTIC" not in given or not given["ELASTIC"][0].options.get("TYPE", "ISO").upper().startswith("ISO"):
            raise InputError(f"{card}: the material {name!r} has no isotropic *ELASTIC, which MYSTRAN is given here")
        young, poisson = values(given["ELASTIC"][1][0][:2], given["ELASTIC"][0])
        density = values(given["DENSITY"][1][0][:1], given["DENSITY"][0])[0] if "DENSITY" in given else None
        C = isotropic(set=name, young=young, poisson=poisson, density=density or 1.0).stiffness
        self.materials[name] = ElasticMaterial(name=name, stiffness=C, density=density)
        return name
