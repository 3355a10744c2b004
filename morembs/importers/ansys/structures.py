"""Shells, beams and links of ANSYS archives as elements of a deck, which own assembly does not have."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from morembs.base.types import Ints
from morembs.importers.ansys.archive import Archive, Place
from morembs.importers.ansys.elements import Rows
from morembs.importers.ansys.names import element_name
from morembs.importers.ansys.properties import section
from morembs.importers.ansys.sections import BEAMS, LINKS, SHELLS, directions_of, sections_of, shapes_of
from morembs.importers.decks.labels import ranges_of
from morembs.importers.decks.problems import Problem, Problems
from morembs.importers.decks.tables import ElasticMaterial, Elements, Section

STRUCTURES = (*SHELLS, *BEAMS, *LINKS)


class Structures:
    """``sections`` of shells, beams and links, and the ``sets`` of their elements; what is wrong with one is a problem
    of the archive."""

    def __init__(self, archive: Archive, problems: Problems) -> None:
        self.archive, self.problems = archive, problems
        self.sections: list[Section] = []
        self.sets: dict[str, Ints] = {}

    def add(
        self, routine: int, keys: dict[int, int], rows: Rows, numbers: Mapping[str, Ints], problem: Problem
    ) -> Iterator[Elements]:
        """Elements of one type of the archive by shape."""
        archive, name = self.archive, element_name(routine)
        for made, own in sections_of(routine, keys, rows, archive.reals, archive.sections, archive.name):
            with self.problems.collected(Place(archive.name, 0, name)):
                self.sections.append(made())
            self.sets[made.set] = ranges_of(rows.ids[own])
        values = {}
        if routine in BEAMS:
            with self.problems.collected(Place(archive.name, 0, name)):
                ids, xyz = np.concatenate(archive.ids), np.concatenate(archive.xyz)
                values["direction"] = directions_of(routine, rows.nodes, ids, xyz, archive.name)
        for kind, shape, own, nodes in shapes_of(routine, rows):
            yield Elements(
                code=name,
                kind=kind,
                shape=shape,
                ids=rows.ids[own],
                nodes=nodes,
                numbers={what: given[own] for what, given in numbers.items()},
                values={what: given[own] for what, given in values.items()},
                problem=problem,
            )

    def materials(self, notes: list[str]) -> dict[str, ElasticMaterial]:
        """The materials that the sections name."""
        names = [name for own in self.sections for name in (own.material, *(ply.material for ply in own.plies)) if name]
        found = {}
        for name in dict.fromkeys(names):
            number = int(name.removeprefix("material "))
            tables = self.archive.tables.get(number, "")
            with self.problems.collected():
                found[name] = section(number, self.archive.properties.get(number, {}), tables, notes, False)[0]
        return found
