"""Elements of Nastran bulk data as cards for MYSTRAN: shells, bars and rods, and solids of the mesh."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem import Mesh
from morembs.importers.engines.mystran.cards import system_card
from morembs.importers.engines.mystran.sections import Sections
from morembs.importers.nastran.bulk import Bulk
from morembs.importers.nastran.cards import integer, real
from morembs.importers.nastran.geometry import SOLIDS, card_of
from morembs.importers.nastran.properties import padded
from morembs.importers.nastran.text_of_cards import Field, card
from morembs.importers.tolerances import TOL

# For each card: the kind of its properties and how many grids it has.
STRUCTURES = {
    "CQUAD4": ("shell", 4),
    "CTRIA3": ("shell", 3),
    "CSHEAR": ("shear", 4),
    "CBAR": ("bar", 2),
    "CBEAM": ("beam", 2),
    "CROD": ("rod", 2),
    "CTUBE": ("tube", 2),
    "CONROD": ("conrod", 2),
}
# As which of its own cards MYSTRAN gets them.
_AS = {"CBEAM": "CBAR", "CTUBE": "CROD", "CONROD": "CROD"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Elements:
    """Elements (k,) of one card of MYSTRAN: labels of the deck, numbers of their properties, rows of their grids
    (k, n) in the order of the card; ``tails`` (k) what follows the grids, ``systems`` (k) the cards of coordinate
    systems that they name ("": none)."""

    card: str
    ids: Ints
    properties: Ints
    nodes: Ints
    tails: Sequence[Sequence[Field]]
    systems: Sequence[str]

    def text(self, rows: Ints, first: int) -> Iterator[str]:
        """Cards of elements in ``rows``, numbered from ``first`` on."""
        for number, i in enumerate(rows.tolist(), start=first):
            yield card(self.card, [number, int(self.properties[i]), *(self.nodes[i] + 1).tolist(), *self.tails[i]])


class Structures:
    """Reads the elements that are no solids; what is wrong with one is a problem of the deck."""

    def __init__(self, bulk: Bulk, sections: Sections) -> None:
        self.bulk, self.sections, self.beams = bulk, sections, 0
        self.blocks: list[Elements] = []
        self._systems: dict[int, str] = {}
        for name in STRUCTURES:
            self._read(name)

    def _read(self, name: str) -> None:
        kind, count = STRUCTURES[name]
        readers: dict[str, Callable[[str, list[str], Ints], tuple[list[Field], str]]] = {
            "shell": self._shell,
            "bar": self._bar,
            "beam": self._bar,
        }
        default = self._default("BAROR" if kind == "bar" else "BEAMOR" if kind == "beam" else "")
        ids, properties, nodes, tails, systems = [], [], [], [], []
        for row, where in self.bulk.cards(name):
            with self.bulk.problems.collected(where, (f"--skip {name}",)):
                words = padded(row, 24)
                what = f"{self.bulk.file}: {name} {words[0]}"
                label, pid = integer(words[0], what), integer(words[1] or default[1] or words[0], what)
                at = 1 if kind == "conrod" else 2
                grids = self.bulk.grids.rows(np.array([integer(text, what) for text in words[at : at + count]]), what)
                if len(set(grids.tolist())) < count:
                    raise InputError(f"{what} names a grid twice; expected {count} grids")
                if kind == "conrod":
                    number = self.sections.number(kind, label, what, own=[words[0], *words[3:8]])
                else:
                    number = self.sections.number(kind, pid, what)
                if kind in ("bar", "beam"):
                    words = self._with_default(words, default)
                tail, system = readers.get(kind, _nothing)(what, words, grids)
                self.beams += kind == "beam"
                ids.append(label)
                properties.append(number)
                nodes.append(grids)
                tails.append(tail)
                systems.append(system)
        if ids:
            self.blocks.append(
                Elements(
                    card=_AS.get(name, name),
                    ids=np.array(ids),
                    properties=np.array(properties),
                    nodes=np.array(nodes),
                    tails=tails,
                    systems=systems,
                )
            )

    def _default(self, name: str) -> list[str]:
        rows = self.bulk.rows[name] if name else []
        if len(rows) > 1:
            raise InputError(f"{self.bulk.file} has {len(rows)} cards {name}; expected one")
        return padded(rows[0], 8) if rows else [""] * 8

    @staticmethod
    def _with_default(words: list[str], default: list[str]) -> list[str]:
        vector = words[4:7] if any(words[4:7]) else default[4:7]
        return [*words[:4], *vector, words[7] or default[7], *words[8:]]

    def _shell(self, what: str, words: list[str], grids: Ints) -> tuple[list[Field], str]:
        """THETA or MCID, offset, thicknesses at the corners."""
        at = 2 + len(grids)
        angle, offset = words[at : at + 2]
        direction: Field = ""
        system = ""
        if "." in angle:
            direction = real(angle, what)
        elif angle:
            number = integer(angle, what)
            direction = number
            if number and number not in self._systems:
                self._systems[number] = system_card(self.bulk, number)
            system = self._systems[number] if number else ""
        thick = words[10 : 10 + len(grids)]
        if words[9] not in ("", "0"):
            raise InputError(f"{what} gives its thicknesses as fractions (TFLAG); give them in units of length")
        if any(thick) and not all(thick):
            raise InputError(f"{what} gives thicknesses at some corners only; expected all or none")
        tail: list[Field] = [direction, real(offset, what) if offset else ""]
        if any(thick):
            tail += [*[""] * (8 - at - 2), "", "", *(real(text, what) for text in thick)]
        return tail, system

    def _bar(self, what: str, words: list[str], grids: Ints) -> tuple[list[Field], str]:
        """Orientation, pins and offsets along basic axes."""
        a, b = grids.tolist()
        options = (words[7] or "GGG").upper()
        if options in ("1", "2"):
            # COSMIC NASTRAN says there whether a vector (1) or a grid (2) stands before (User's Manual, CBAR, BAROR).
            if (options == "2") == any(words[5:7]):
                raise InputError(f"{what} has the flag F = {options} and an orientation of the other kind; mend it")
            options = "GGG"
        offsets = np.array([real(text, what) for text in words[10:16]]).reshape(2, 3)
        if "." in options or len(options) != 3 or options[0] not in "GB" or (offsets.any() and options[1:] != "GG"):
            raise InputError(f"{what} gives its orientation or offsets along {options!r}; expected GGG or BGG")
        if words[16] or words[17]:
            raise InputError(f"{what} has points that warp (SA, SB), which MYSTRAN has not")
        if not any(words[4:7]):
            raise InputError(f"{what} has no orientation; expected X1, X2, X3 or G0")
        if not any(words[5:7]) and "." not in words[4]:
            other = self.bulk.grids.rows(np.array([integer(words[4], what)]), what)[0]
            vector = self.bulk.grids.xyz[other] - self.bulk.grids.xyz[a]
        else:
            axes = np.eye(3) if options[0] == "B" else self._axes(a)
            vector = np.array([real(text, what) for text in words[4:7]]) @ axes
        along = self.bulk.grids.xyz[b] + offsets[1] @ self._axes(b) - self.bulk.grids.xyz[a]
        along = along - offsets[0] @ self._axes(a)
        least = TOL.parallel_orientation * np.linalg.norm(along) * np.linalg.norm(vector)
        if not np.linalg.norm(np.cross(along, vector)) > least:
            raise InputError(f"{what} has no length, or its orientation lies along it; mend it")
        pins = [integer(text, what) for text in words[8:10]]
        tail: list[Field] = [*map(float, vector), "", *(pin or "" for pin in pins)]
        if offsets.any():
            tail += [float(x) for row, grid in zip(offsets, (a, b), strict=True) for x in row @ self._axes(grid)]
        return tail, ""

    def _axes(self, grid: int) -> Floats:
        """The axes (3, 3) of a grid as rows."""
        grids = self.bulk.grids
        return self.bulk.systems.axes(int(grids.cd[grid]), grids.xyz[grid], grids)


def _nothing(what: str, words: list[str], grids: Ints) -> tuple[list[Field], str]:
    return [], ""


def solid_cards(bulk: Bulk, mesh: Mesh, sections: Sections) -> list[Elements]:
    """The solids of a mesh whose element sets PSOLID_3, ... are the properties."""
    rows = bulk.grids.rows(mesh.nodes.ids, "a solid")
    result = []
    for i, block in enumerate(mesh.blocks):
        name = card_of(block.type)
        low, _, _, order = SOLIDS[name]
        properties = np.zeros(len(block.ids), dtype=np.int64)
        for key, members in mesh.element_sets.items():
            if key.startswith("PSOLID_") and len(members[i]):
                pid = int(key.removeprefix("PSOLID_"))
                what = f"{bulk.file}: {name} {block.ids[members[i][0]]}"
                element = name if block.type == low else f"{name}2"
                properties[members[i]] = sections.number("solid", pid, what, element=element)
        nodes = rows[block.nodes] if block.type == low else rows[block.nodes][:, np.argsort(order)]
        none: list[Sequence[Field]] = [()] * len(block.ids)
        result.append(
            Elements(
                card=name, ids=block.ids, properties=properties, nodes=nodes, tails=none, systems=[""] * len(block.ids)
            )
        )
    return result
