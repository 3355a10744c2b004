"""Sections and materials of a deck for CalculiX, with those of the user where the deck has none."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem.material import Material
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.cards.ties import Flat
from morembs.importers.abaqus.deck import Contents, Rows
from morembs.importers.abaqus.keywords import Card
from morembs.importers.abaqus.names import Placed
from morembs.importers.decks.labels import in_ranges, ranges_of
from morembs.importers.decks.materials import complete, problems_of_solids
from morembs.importers.decks.tables import DeckTables, Section
from morembs.importers.decks.writers.calculix_mesh import numeral
from morembs.importers.decks.writers.calculix_sections import elastic_lines

SECTIONS = ("SOLID SECTION", "SHELL SECTION", "BEAM SECTION", "BEAM GENERAL SECTION", "MEMBRANE SECTION")
_REDUCED_PROFILES = ("PIPE", "BOX")
# Stands for a stiffness that is there, whatever it is.
_THERE = np.eye(6)


@dataclass(eq=False)
class Sections:
    """Writes sections of elements that are there, and the materials that they name.

    ``tables`` are mesh and sets of the deck, which are completed as those of any deck are.
    ``materials`` are those given for element sets, "all" for all elements that have none; ``expands`` says whether
    thermal expansion is kept.
    """

    deck: Contents
    tables: DeckTables
    assembly: Assembly
    flat: Flat
    materials: Sequence[Material]
    expands: bool

    def read(self, cards: Iterable[tuple[Placed, Card, Rows]]) -> None:
        """Find what the sections lack, and complete it."""
        self._names: dict[tuple[int, int, str], int] = {}
        sections, sets, labels = list[Section](), {**self.tables.element_sets}, self.flat.deck.labels
        for placed, card, rows in cards:
            if card.keyword not in SECTIONS:
                continue
            # What is wrong with a section is told where it is written.
            with suppress(InputError):
                elset = card.need("ELSET")
                numbers = self.flat.deck.write(self.assembly.elements_of(placed, elset))
                scope, rest = self.assembly.split(placed, elset)
                is_set = rest.upper() in scope.sets("element")
                name = self.assembly.final_name("element", placed, elset) if is_set else elset
                sets.setdefault(name, ranges_of(labels[numbers]))
                for text in _materials_of(card, rows) if len(numbers) else ():
                    self._names[id(placed), id(card), text.upper()] = len(sections)
                    sections.append(self._section(name, text))
        self._before = self._after = replace(self.tables, element_sets=sets, sections=tuple(sections))
        with self.deck.problems.collected():
            self._after = complete(self._before, self.materials)
        self.flat.warnings += self._after.warnings
        self.deck.problems.entries += dict.fromkeys(problems_of_solids(self._after, self.materials))

    def _section(self, name: str, text: str) -> Section:
        """What a section has of the material ``text``; its lack in a sentence."""
        section, key = Section(set=name, material=text), text.upper()
        if key not in self.deck.materials:
            what = f"names the material {text!r}, which is not defined" if text else "names no material"
            return replace(section, lacks=f"the section of the set {name} {what}")
        words = [card.keyword for card, _ in self.deck.materials[key]]
        if "ELASTIC" not in words:
            listed = ", ".join(f"*{word}" for word in words) or "empty"
            what = f"material {text} of the set {name} is {listed} only, which is not linear elastic; expected *ELASTIC"
            return replace(section, lacks=what)
        density = 1.0 if "DENSITY" in words else None
        lacks = "" if density else f"the material {text} of the set {name} has no *DENSITY"
        return replace(section, stiffness=_THERE, density=density, lacks=lacks)

    def write(self, placed: Placed, card: Card, rows: Rows) -> tuple[Card, Rows] | None:
        """The card of a section with its materials as they are called here, None where its elements are left out."""
        numbers = self.flat.deck.write(self.assembly.elements_of(placed, card.need("ELSET")))
        if not len(numbers):
            return None
        if card.options.get("SECTION", "").upper() in _REDUCED_PROFILES:
            self._reduce(numbers)
        options = dict(card.options)
        for text in _materials_of(card, rows):
            key = self._key(placed, card, text)
            if "COMPOSITE" in options:
                rows = [[*row[:2], key, *row[3:]] if row[2:3] == [text] else row for row in rows]
            else:
                options["MATERIAL"] = key
            if key.startswith(",") and card.keyword == "SOLID SECTION":
                # Materials that are given are along the global axes.
                options.pop("ORIENTATION", None)
        return Card(card.keyword, options, card.file, card.line), rows

    def _key(self, placed: Placed, card: Card, text: str) -> str:
        """The key of a material of the deck, of one with a density that was given, or of a given one; the name is no
        other's, as those of a deck have no commas."""
        number = self._names[id(placed), id(card), text.upper()]
        after = self._after.sections[number]
        if after is self._before.sections[number]:
            return text
        own = text if after.stiffness is _THERE else ""
        # The first section with the same material.
        same = (
            j
            for j, other in enumerate(self._after.sections)
            if other.stiffness is after.stiffness and other.density == after.density
        )
        return f"{own},{next(same)}"

    def _reduce(self, numbers: Ints) -> None:
        """Take beams B32 for B32R, which alone have the profile in CalculiX (CrunchiX User's Manual, *BEAM SECTION)."""
        start = self.assembly.solids + len(self.assembly.discrete)
        for code, ids, _ in self.assembly.others:
            own = numbers[(numbers >= start) & (numbers < start + len(ids))]
            start += len(ids)
            if code == "B32" and len(own):
                self.flat.deck.reduced[own] = True
                self.flat.replaced[code, "B32R"] = self.flat.replaced.get((code, "B32R"), 0) + len(own)

    def complete(self) -> None:
        """Sections of solids in none, and materials that sections name, with their stiffness and density only."""
        out, top = self.flat.deck, self.assembly.top
        for number in range(len(self._before.sections), len(self._after.sections)):
            own = in_ranges(out.labels[: self.assembly.solids], self._after.ranges(self._after.sections[number].set))
            name, elset = out.name("m", top, f",{number}"), out.new_set("e", np.flatnonzero(own))
            out.body.append((0, f"*SOLID SECTION, ELSET={elset}, MATERIAL={name}"))
        for (kind, _, key), name in list(out.names.items()):
            if kind != "m":
                continue
            text, comma, which = key.partition(",")
            section = self._after.sections[int(which)] if comma else None
            density = None if section is None else section.density
            if section is not None and section.stiffness is not None and section.stiffness is not _THERE:
                lines = self._given_values(name, section.stiffness)
            else:
                lines = self._own(name, self.deck.materials.get(text, []))
            out.body.append((-2, "\n".join([*lines, *([f"*DENSITY\n{numeral(density)}"] if density else [])])))

    def _given_values(self, name: str, stiffness: Floats) -> list[str]:
        return [f"*MATERIAL, NAME={name}", *elastic_lines(stiffness)]

    def _own(self, name: str, cards: list[tuple[Card, Rows]]) -> list[str]:
        """A material of the deck."""
        given = {card.keyword: (card, rows) for card, rows in cards}
        lines = [f"*MATERIAL, NAME={name}"]
        for word in ["ELASTIC", "DENSITY"] + (["EXPANSION"] if self.expands else []):
            if word in given:
                card, rows = given[word]
                lines.append(self.flat.deck.lines(self.assembly.top, card, [row for row in rows if row], "."))
        return lines


def _materials_of(card: Card, rows: Rows) -> list[str]:
    """Names of the materials of a section, of layers each once."""
    if "COMPOSITE" in card.options:
        return list(dict.fromkeys(row[2] for row in rows if len(row) > 2))
    return [card.options.get("MATERIAL", "")]
