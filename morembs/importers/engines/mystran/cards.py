"""Elements of a deck as cards for MYSTRAN, in blocks that are split into runs.

What MYSTRAN 18 has otherwise than the deck means is written so that it comes out right, or refused: masses of laminates
go into their NSM, as MYSTRAN leaves out a ply, and those of shear panels are added to its matrix.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.fem import ElementBlock, Mesh, Nodes
from morembs.fem.handedness import right_handed
from morembs.importers.decks.problems import Problem, Problems
from morembs.importers.decks.tables import DeckTables, Elements, Section
from morembs.importers.decks.writers.nastran_cards import ElementText
from morembs.importers.nastran.text_of_cards import Field, card

# Kinds and shapes of the elements that it has.
KNOWN = {
    *(("solid", shape) for shape in ("tet4", "tet10", "wedge6", "wedge15", "hex8", "hex20")),
    *(("shell", "quad4"), ("shell", "tri3"), ("shear", "quad4"), ("beam", "line2"), ("truss", "line2")),
}
# Profiles whose area and moments it has right (18.0: wrong for BOX1, CHAN1, CHAN2, HAT, HEXA).
_PROFILES = ("BAR", "BOX", "CHAN", "CROSS", "H", "I", "I1", "ROD", "T", "T1", "T2", "TUBE", "TUBE2")


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """Elements (k,) of one card: labels of the deck, numbers of their properties, rows of their nodes (k, n) in the
    order of the card; ``tails`` (k) what follows the nodes, ``systems`` (k) the cards of coordinate systems that they
    name ("": none)."""

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


@dataclass(frozen=True)
class _Solids:
    """For what solids a property is: their card, behind it "2" for those with middle nodes, whether they are integrated
    in full, and at how many points along each edge."""

    card: str
    is_full: bool
    points: int


@dataclass(eq=False)
class MystranText(ElementText):
    """Elements in ``blocks`` and the cards of each property, with all that these name, in ``properties``.

    What is wrong with a section is one of the ``problems``; those of the sets ``without`` a material have no cards.
    """

    problems: Problems = field(default_factory=lambda: Problems(""))
    without: Collection[str] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        self.properties: list[tuple[str, ...]] = []
        self.blocks: list[Block] = []
        self.shear_masses = np.zeros(len(self.deck.ids))
        for part in self.parts:
            self._add(part)

    def _add(self, part: Elements) -> None:
        if part.kind == "beam" and np.isfinite(part.values.get("normal", np.nan)).any():
            raise InputError(
                f"{self.deck.name}: {part.code} have *NORMAL, which bars of MYSTRAN do not; leave it out",
                kind="unsupported",
            )
        nodes = self._orient(part)
        owner = self.owners(part.kind, part.ids)
        name, order, full = self.element_card(replace(part, nodes=nodes))
        points = part.numbers.get("points", np.zeros(len(part.ids), dtype=np.int64))
        properties = np.zeros(len(part.ids), dtype=np.int64)
        for number, asked in np.unique(np.column_stack([owner, points]), axis=0).tolist():
            variant = _Solids(name + "2" * (nodes.shape[1] > 8 or part.shape == "tet10"), full, asked)
            own = (owner == number) & (points == asked)
            properties[own] = self.property(part, number, variant if part.kind == "solid" else None)
        tails: list[Sequence[Field]] = [()] * len(part.ids)
        if part.kind in ("shell", "beam"):
            tails = [self.tail(part, int(number), i) for i, number in enumerate(owner.tolist())]
        named = [tail[0] if part.kind == "shell" and isinstance(tail[0], int) else 0 for tail in tails if tail]
        systems = [self.systems[number - 1] if number else "" for number in named] or [""] * len(part.ids)
        rows = self.labels.rows(order, "elements name")
        block = Block(card=name, ids=part.ids, properties=properties, nodes=rows, tails=tails, systems=systems)
        self.blocks.append(block)
        if part.kind == "shear":
            self._add_shear_masses(block, owner)

    def _orient(self, part: Elements) -> Ints:
        """Labels of nodes, of solids in the order of right-handed ones."""
        if part.kind != "solid":
            return part.nodes
        rows = self.labels.rows(part.nodes, "elements name")
        block = ElementBlock(type=part.shape, nodes=rows, ids=part.ids)
        mesh = right_handed(Mesh(nodes=Nodes(ids=self.deck.ids, xyz=self.deck.xyz), blocks=(block,)))
        return np.asarray(self.deck.ids[mesh.blocks[0].nodes])

    def _add_shear_masses(self, block: Block, owner: Ints) -> None:
        """Masses of shear panels, a quarter at each node; MYSTRAN gives them none."""
        x = self.deck.xyz[block.nodes]
        area = np.linalg.norm(np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1]), axis=1) / 2
        by_area = np.array([_mass_by_area(self.deck, section) for section in self.deck.sections])
        np.add.at(self.shear_masses, block.nodes, (area * by_area[owner])[:, None] / 4)

    def _add_property(self, section: Section, pid: int, variant: object) -> None:
        """The cards of a property, with materials of its own."""
        start, own = len(self.cards), ""
        self._materials.clear()
        if section.set not in self.without:
            with self.problems.collected():
                own = self._property_card(section, pid, variant)
        self.properties.append((own, *self.cards[start:]))
        del self.cards[start:]

    def _solid(self, section: Section, pid: int, variant: object) -> str:
        mid, system = self._solid_material(section)
        self.cards += self.systems[system - 1 : system] if system else []
        if not isinstance(variant, _Solids) or variant.card.startswith("CTETRA"):
            return card("PSOLID", [pid, mid, system])
        # With two points along each edge quadratic elements have modes without energy in MYSTRAN.
        points = 3 if variant.card.endswith("2") else variant.points or 2
        return card("PSOLID", [pid, mid, system, str(points), "", "1" if variant.is_full else ""])

    def _laminate(self, section: Section, pid: int) -> str:
        mass = section.nonstructural
        for ply in section.plies:
            mass += ply.thickness * (self._elastic(section, ply.material).density or 0.0)
        fields = self._laminate_head(section, pid, mass)
        for ply in section.plies:
            fields += [self._plane(section, ply.material, 0.0), ply.thickness, ply.angle, "NO"]
        return card("PCOMP", fields)

    def _beam(self, section: Section, pid: int, mid: int) -> str:
        name = section.profile.removeprefix("PBARL ")
        if section.profile.startswith("PBARL ") and name not in _PROFILES:
            raise InputError(
                f"{self._what(section)} has the section {name!r}; MYSTRAN has {', '.join(_PROFILES)} right; give its "
                "area and moments by PBAR",
                kind="unsupported",
            )
        if section.profile == "GENERAL" and section.dimensions[2] and any(section.shear_factors or ()):
            self.warnings.append(
                f"{self._what(section)} has I12 and shear factors K1, K2, which MYSTRAN leaves out beside I12: its "
                "bars are stiff in shear [formulation-differs]"
            )
        return super()._beam(section, pid, mid)


def _mass_by_area(deck: DeckTables, section: Section) -> float:
    material = deck.materials.get(section.material)
    density = material.density if material is not None else None
    return section.thickness * (density or 0.0) + section.nonstructural


def lacked_elements(deck: DeckTables) -> Iterator[Problem]:
    """A problem for elements of each kind and shape that MYSTRAN does not have, and for those of no program."""
    has_others = any((part.kind, part.shape) in KNOWN for part in deck.elements)
    for part in deck.elements:
        if part.kind in ("point", "none"):
            if part.problem is not None:
                yield part.problem
        elif (part.kind, part.shape) not in KNOWN:
            what = (
                f"{deck.name} has elements {part.code} ({part.kind} of {part.nodes.shape[1]} nodes), which MYSTRAN "
                "does not have"
            )
            what += "; --engine calculix may assemble them" if deck.program in ("Abaqus", "CalculiX") else ""
            flags = (f"--skip {part.code}",) if has_others else ()
            what += f"; {flags[0]} leaves them out if the model is right without them" if flags else ""
            yield Problem(what=what, file=deck.name, keyword=part.code, flags=flags)


def unscale(deck: DeckTables) -> DeckTables:
    """The deck with masses before PARAM WTMASS, as its cards have them."""
    scale = deck.mass_scale
    if scale == 1.0:
        return deck

    def before(value: float | None) -> float | None:
        return None if value is None else value / scale

    materials = {name: replace(own, density=before(own.density)) for name, own in deck.materials.items()}
    sections = (
        replace(own, density=before(own.density), nonstructural=own.nonstructural / scale) for own in deck.sections
    )
    return replace(deck, materials=materials, sections=tuple(sections))
