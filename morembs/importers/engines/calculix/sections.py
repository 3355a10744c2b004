"""Sections and materials of a deck for CalculiX, with those that a user gives where they lack."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.types import Ints
from morembs.fem.material import Material
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.keywords import Card
from morembs.importers.abaqus.names import Placed
from morembs.importers.decks.options import MATERIAL, material_flags, unused_material
from morembs.importers.decks.problems import Problem, typed
from morembs.importers.decks.writers.calculix_mesh import numeral
from morembs.importers.decks.writers.calculix_sections import elastic_lines
from morembs.importers.engines.calculix.read import EngineDeck
from morembs.importers.engines.calculix.ties import Flat

SECTIONS = ("SOLID SECTION", "SHELL SECTION", "BEAM SECTION", "BEAM GENERAL SECTION", "MEMBRANE SECTION")
_REDUCED_PROFILES = ("PIPE", "BOX")


class Sections:
    """Writes sections of elements that are there, and the materials that they name.

    Args:
        materials: given ones of element sets, "all" for all elements that have none.
        expands: whether thermal expansion is kept.
    """

    def __init__(
        self, deck: EngineDeck, assembly: Assembly, flat: Flat, materials: Sequence[Material], *, expands: bool
    ) -> None:
        self.deck, self.assembly, self.flat, self.expands = deck, assembly, flat, expands
        self._given = {material.set.upper(): material for material in materials}
        self._set_of: dict[str, str] = {}
        self._has_section = np.zeros(len(flat.deck.labels), dtype=bool)

    def take(self, placed: Placed, card: Card) -> Card | None:
        """The card of a section with the material that was given for its set, None where its elements are left out."""
        elset, out = card.need("ELSET"), self.flat.deck
        numbers = out.written(self.assembly.elements_of(placed, elset))
        if not len(numbers):
            return None
        self._has_section[numbers] = True
        if card.options.get("SECTION", "").upper() in _REDUCED_PROFILES:
            self._reduce(numbers)
        scope, rest = self.assembly.split(placed, elset)
        is_set = rest.upper() in scope.sets("element")
        name = self.assembly.final_name("element", placed, elset) if is_set else elset
        own = card.options.get("MATERIAL", "")
        given = next((key for key in (name.upper(), elset.upper()) if key in self._given), "")
        lack = self._lack(own.upper(), of_all=False) if given and own else ""
        if given and (lack or not own):
            if lack:
                self._replaced(lack)
            card = Card(card.keyword, {**card.options, "MATERIAL": _key(given)}, card.file, card.line)
        self._set_of.setdefault(own.upper(), name)
        return card

    def _reduce(self, numbers: Ints) -> None:
        """Take beams B32 for B32R, which alone have the profile in CalculiX (CrunchiX User's Manual, *BEAM SECTION)."""
        start = self.assembly.solids + len(self.assembly.discrete)
        for code, ids, _ in self.assembly.others:
            own = numbers[(numbers >= start) & (numbers < start + len(ids))]
            start += len(ids)
            if code == "B32" and len(own):
                self.flat.deck.reduced[own] = True
                self.deck.replaced[code, "B32R"] = self.deck.replaced.get((code, "B32R"), 0) + len(own)

    def complete(self) -> None:
        """Sections of solids that the deck gives none, of the materials that were given for their sets or for all."""
        solids, named = self.assembly.solids, self.assembly.named("element")
        sets = {name.upper(): place for name, place in named.items()}
        for key in sorted(self._given, key=lambda key: key == "ALL"):
            if key != "ALL" and key not in sets:
                name = self._given[key].set
                raise InputError(f"--material was given for the set {name!r}; {nearest(name, named)}")
            numbers = np.arange(solids) if key == "ALL" else self.assembly.members("element", *sets[key])
            own = numbers[numbers < solids]
            own = own[~self._has_section[own]]
            if len(own):
                self._has_section[own] = True
                out = self.flat.deck
                name = out.name("m", self.assembly.top, _key(key))
                out.body.append((0, f"*SOLID SECTION, ELSET={out.new_set('e', own)}, MATERIAL={name}"))
        bare = np.flatnonzero(~self._has_section[:solids])
        if len(bare):
            first = self.flat.deck.labels[bare[0]]
            what = f"{len(bare)} solid elements have no section and so no material (first: {first})"
            members = {name: self.assembly.members("element", *place) for name, place in named.items()}
            of_solids = {name: own[own < solids] for name, own in members.items()} if self._given else {}
            flags = material_flags(bare, of_solids)
            self._problem(f"{what}; {' '.join(flags)}", *flags)

    def materials(self) -> None:
        """Materials that sections name, with their stiffness and density only."""
        out, unused = self.flat.deck, dict(self._given)
        for (kind, _, key), name in list(out.names.items()):
            if kind != "m":
                continue
            is_given = key.startswith(_key(""))
            lack = "" if is_given else self._lack(key)
            of_set = key.removeprefix(_key("")) if is_given else "ALL"
            given = self._given.get(of_set)
            if given is not None and (is_given or lack):
                unused.pop(of_set, None)
                elastic = elastic_lines(given.stiffness)
                out.body.append(
                    (-2, "\n".join([f"*MATERIAL, NAME={name}", *elastic, "*DENSITY", numeral(given.density)]))
                )
                if not is_given:
                    self._replaced(lack)
            elif lack:
                flag = "--density X" if self._is_elastic(key) else f"{MATERIAL}{self._set_of.get(key, 'all')}"
                self._problem(f"{lack}; {typed(flag)}", flag)
            else:
                self._material(key, name)
        for material in unused.values():
            self._problem(unused_material(material.set))

    def _lack(self, key: str, *, of_all: bool = True) -> str:
        """In which way a material of the deck is none, a sentence; empty where it has a stiffness and a density, which
        may be that ``of_all``."""
        if key not in self.deck.materials:
            return f"a section names the material {key!r}, which is not defined"
        words = [card.keyword for card, _ in self.deck.materials[key]]
        if "ELASTIC" not in words:
            listed = ", ".join(f"*{word}" for word in words) or "empty"
            return f"material {key} is {listed} only, which is not linear elastic; expected *ELASTIC"
        return (
            ""
            if "DENSITY" in words or self._density(key, of_all=of_all) is not None
            else f"the material {key} has no *DENSITY"
        )

    def _replaced(self, lack: str) -> None:
        self.flat.warnings.append(f"{lack}; the material that was given took its place")

    def _is_elastic(self, key: str) -> bool:
        return any(card.keyword == "ELASTIC" for card, _ in self.deck.materials.get(key, ()))

    def _material(self, key: str, name: str) -> None:
        """A material of the deck, with the density that was given where it has none."""
        out, given = self.flat.deck, {card.keyword: (card, rows) for card, rows in self.deck.materials[key]}
        lines = [f"*MATERIAL, NAME={name}"]
        for word in ["ELASTIC", "DENSITY"] + (["EXPANSION"] if self.expands else []):
            if word in given:
                card, rows = given[word]
                lines.append(out.lines(self.assembly.top, card, [row for row in rows if row], "."))
        density = self._density(key)
        if "DENSITY" not in given and density is not None:
            lines.append(f"*DENSITY\n{numeral(density)}")
            self.flat.warnings.append(
                f"the material {key} has no *DENSITY; {density:g} was given and taken [density-given]"
            )
        out.body.append((-2, "\n".join(lines)))

    def _density(self, material: str, *, of_all: bool = True) -> float | None:
        """The density that was given for a material: of one of the sets that it is for, or of all."""
        given = {name.upper(): value for name, value in self.deck.options.density.items()}
        for _, card, _ in self.deck.cards:
            if card.options.get("MATERIAL", "").upper() == material:
                own = given.get(card.options.get("ELSET", "").upper())
                if own is not None:
                    return own
        return given.get(material, given.get("ALL") if of_all else None)

    def _problem(self, what: str, *flags: str) -> None:
        self.deck.problems.add(Problem(what=what, file=self.deck.name, keyword="MATERIAL", flags=flags))


def _key(name: str) -> str:
    """The key of the material that was given for a set, which is no name of a deck: these have no commas."""
    return f"GIVEN,{name}"
