"""Bulk data of Nastran of what a ``Deck`` holds, in fields of 16 columns: numbers have 11 digits at least."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.decks.formulations import nastran_meaning
from morembs.importers.decks.labels import Labels, in_ranges, ranges_of
from morembs.importers.decks.tables import NOT_WRITTEN, DeckTables, Elements, Section
from morembs.importers.nastran.geometry import SOLIDS, card_of
from morembs.importers.nastran.text_of_cards import Field, card
from morembs.importers.tolerances import TOL

_STRUCTURES = {
    ("shell", "quad4"): "CQUAD4",
    ("shell", "tri3"): "CTRIA3",
    ("beam", "line2"): "CBAR",
    ("truss", "line2"): "CROD",
}
# Profiles of *BEAM SECTION by the names of PBARL, with the dimensions of that: Abaqus gives the first width along the
# first axis of the section, Nastran the height along its y axis behind the width.
_PROFILES: dict[str, tuple[str, Callable[[Sequence[float]], Sequence[float]]]] = {
    "RECT": ("BAR", lambda d: (d[1], d[0])),
    "CIRC": ("ROD", lambda d: (d[0],)),
    "PIPE": ("TUBE", lambda d: (d[0], d[0] - d[1])),
}
# Nastran orders shear xy, yz, zx.
_ORDER = [0, 1, 2, 5, 3, 4]
_HEAD = "SOL 103\nCEND\nMPC = 1\nSPC = 1\nBEGIN BULK\n"
_SPRINGS = {"K": "CELAS2", "D": "CDAMP2", "M": "CMASS2"}


@dataclass(eq=False)
class NastranText:
    """The cards of a deck; ``warnings`` say in what the written deck differs.

    Raises:
        InputError: what bulk data cannot say.
    """

    deck: DeckTables
    warnings: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.parts = [part for part in self.deck.elements if part.kind not in ("point", "none")]
        self.nodes = Labels(self.deck.ids, self.deck.name, self.deck.node)
        largest = (part.ids.max(initial=0) for part in self.deck.elements)
        self._element = int(max((*largest, 0)))
        self._materials: dict[tuple[bytes, float | None], int] = {}
        self._properties: dict[tuple[int, str, bool], int] = {}
        self.cards: list[str] = []

    def text(self) -> Iterator[str]:
        """The whole file."""
        elements = [*self.element_cards()]
        ties = [
            *self.mass_cards(),
            *self.spring_cards(),
            *self.tie_cards(),
            *self.equation_cards(),
            *self.support_cards(),
        ]
        yield f"$ {self.deck.name}\n{_HEAD}"
        for label, x in zip(self.deck.ids.tolist(), self.deck.xyz.tolist(), strict=True):
            yield card("GRID", [label, "", *x])
        yield from (*elements, *self.cards, *ties, *self.set_cards(), "ENDDATA\n")
        properties = {section.set for section in self.deck.sections}
        loose = [name for name in self.deck.element_sets if name not in properties]
        for kind, names in (("sets of elements", loose), ("surfaces", [*self.deck.surfaces])):
            if names:
                self.warnings.append(f"Nastran has no {kind}: {', '.join(names)} are not written {NOT_WRITTEN}")

    # Elements, properties and materials

    def element_cards(self) -> Iterator[str]:
        """Elements with the properties of the last section that each is in."""
        for part in self.parts:
            owner = np.full(len(part.ids), -1)
            for number, section in enumerate(self.deck.sections):
                if section.kind == part.kind:
                    owner[in_ranges(part.ids, self.deck.ranges(section.set))] = number
            name, nodes, full = self._card(part)
            for i, (label, row) in enumerate(zip(part.ids.tolist(), nodes.tolist(), strict=True)):
                number = int(owner[i])
                pid = self._property(part, number, full)
                tail = self._tail(part, number, i)
                yield card(name, [label, pid, *(node or "" for node in row), *tail])

    def _card(self, part: Elements) -> tuple[str, Ints, bool]:
        """Name of the card, nodes in its order, and whether its property asks for full integration.

        Raises:
            InputError: there is no card for the elements.
        """
        if part.kind != "solid":
            name = _STRUCTURES.get((part.kind, part.shape), "")
            if not name:
                raise InputError(
                    f"{self.deck.name}: bulk data have here no card for {len(part.ids)} {part.code} ({part.kind} of "
                    f"{part.nodes.shape[1]} nodes); leave them out with --skip {part.code}"
                )
            return name, part.nodes, False
        if part.shape == "hex27":
            raise InputError(f"{self.deck.name}: Nastran has no solid of 27 nodes ({part.code})")
        name = card_of(part.shape)
        low, _, _, order = SOLIDS[name]
        nodes = part.nodes if part.shape == low else part.nodes[:, np.argsort(order)]
        meant = part.meaning.formulation, part.meaning.mass
        theirs = {full: nastran_meaning(name, nodes.shape[1], full=full) for full in (False, True)}
        for full, meaning in theirs.items():
            if (meaning.formulation, meaning.mass) == meant:
                return name, nodes, full
        full = meant[0] == "full" and part.shape == "hex8"
        own = theirs[full]
        self.warnings.append(
            f"{len(part.ids)} elements {part.code} of {self.deck.program} are written as {name} of Nastran, which "
            f"has the formulation {own.formulation!r} and the mass {own.mass!r} in place of {meant[0]!r} and "
            f"{meant[1]!r} [formulation-differs]"
        )
        return name, nodes, full

    def _property(self, part: Elements, number: int, full: bool) -> int:
        """The number of the property of elements in a section (-1: in none)."""
        key = number, part.kind, full
        if key not in self._properties:
            if number < 0 and part.kind != "solid":
                raise InputError(
                    f"{self.deck.name}: {part.code} elements ({part.kind}) are in no section; give them one"
                )
            pid = self._properties[key] = len(self._properties) + 1
            section = self.deck.sections[number] if number >= 0 else Section(set="", kind=part.kind)
            self.cards += [f"$ {section.set or 'no section'}\n", self._property_card(section, pid, full)]
        return self._properties[key]

    def _property_card(self, section: Section, pid: int, full: bool) -> str:
        if section.kind == "solid":
            integration: list[Field] = [0, "TWO", "", "FULL"] if full else []
            if section.stiffness is None:
                if section.set:
                    self.warnings.append(f"the set {section.set} has no material: {section.lacks}")
                return card("PSOLID", [pid, 0, *integration])
            return card("PSOLID", [pid, self._material(section.stiffness, section.density), *integration])
        given = self.deck.materials.get(section.material)
        if given is None or given.stiffness is None or section.plies:
            raise InputError(f"{self._what(section)} has no material of one linear stiffness; give it one")
        mid, rest = self._material(given.stiffness, given.density, plane=True), section.nonstructural
        if section.kind == "shell":
            if not section.thickness > 0:
                raise InputError(f"{self._what(section)} has no thickness; give it one")
            return card("PSHELL", [pid, mid, section.thickness, mid, "", mid, "", rest])
        if section.kind == "truss":
            return card("PROD", [pid, mid, section.dimensions[0], 0.0, "", rest])
        if section.profile == "GENERAL":
            A, I11, I12, I22, J = section.dimensions[:5]
            return card("PBAR", [pid, mid, A, I22, I11, J, rest, *[""] * 11, I12])
        if section.profile not in _PROFILES:
            raise InputError(
                f"{self._what(section)} has the profile {section.profile!r}; expected {', '.join(_PROFILES)}"
            )
        name, dimensions = _PROFILES[section.profile]
        return card("PBARL", [pid, mid, "", name, "", "", "", "", *map(float, dimensions(section.dimensions)), rest])

    def _what(self, section: Section) -> str:
        return f"{self.deck.name}: {section.code or 'the section'} of the set {section.set}"

    def _material(self, C: Floats, density: float | None, *, plane: bool = False) -> int:
        """The number of a material, whose card is written once.

        Raises:
            InputError: one of shells, beams or rods that is not isotropic.
        """
        key = np.asarray(C).tobytes(), density
        if key in self._materials:
            return self._materials[key]
        number = self._materials[key] = len(self._materials) + 1
        lam, mu = float(C[0, 1]), float(C[3, 3])
        plain = np.diag([2 * mu] * 3 + [mu] * 3)
        plain[:3, :3] += lam
        mass: Field = "" if density is None else float(density)
        if np.abs(C - plain).max() <= TOL.isotropic_error * np.abs(C).max():
            young, poisson = mu * (3 * lam + 2 * mu) / (lam + mu), lam / (2 * (lam + mu))
            self.cards.append(card("MAT1", [number, young, "", poisson, mass]))
        elif plane:
            raise InputError(f"{self.deck.name}: a material of shells, beams or rods is not isotropic, which MAT1 is")
        else:
            constants = C[np.ix_(_ORDER, _ORDER)][np.triu_indices(6)]
            self.cards.append(card("MAT9", [number, *map(float, constants), mass]))
        return number

    def _tail(self, part: Elements, number: int, i: int) -> list[Field]:
        """What stands behind the nodes of an element."""
        section = self.deck.sections[number] if number >= 0 else Section(set="", kind=part.kind)
        if part.kind == "shell":
            return ["", section.offset] if section.offset else []
        if part.kind != "beam":
            return []
        own = part.values.get("direction")
        direction = section.direction if own is None or not np.isfinite(own[i]).all() else own[i]
        if direction is None:
            raise InputError(f"{self._what(section)} gives no direction of its first axis; give it one")
        tail: list[Field] = [*map(float, direction)]
        offset = part.values.get("offset")
        if offset is not None and np.nan_to_num(offset[i]).any():
            tail += ["", "", "", *map(float, np.nan_to_num(offset[i]).ravel())]
        return tail

    # Masses, springs, couplings, supports, sets

    def _new(self) -> int:
        """The label of a new element."""
        self._element += 1
        return self._element

    def mass_cards(self) -> Iterator[str]:
        """Point masses with their inertia."""
        for mass in self.deck.masses:
            J = mass.inertia
            inertia = [J[0, 0], -J[1, 0], J[1, 1], -J[2, 0], -J[2, 1], J[2, 2]]
            yield card(
                "CONM2", [self._new(), mass.node, 0, mass.mass, *map(float, mass.offset), "", *map(float, inertia)]
            )

    def spring_cards(self) -> Iterator[str]:
        """Springs, dampers and masses on one dof or between two."""
        for element in self.deck.discrete:
            A, count = element.values, len(element.nodes)
            value = float(A[0, 0])
            pair = np.array([[1.0, -1.0], [-1.0, 1.0]])
            if count > 2 or (count == 2 and not np.array_equal(A, value * pair)):
                raise InputError(
                    f"{self.deck.name}: {element.name} is no spring, damper or mass on one dof or between two, which "
                    f"{', '.join(_SPRINGS.values())} are"
                )
            ends = [
                word
                for node, component in zip(element.nodes.tolist(), element.components.tolist(), strict=True)
                for word in (node, component + 1)
            ]
            yield card(_SPRINGS[element.matrix], [self._new(), value, *ends])

    def tie_cards(self) -> Iterator[str]:
        """Rigid and average elements."""
        for rigid in self.deck.rigid:
            yield f"$ {rigid.name}\n"
            slaves = np.unique(rigid.slaves).tolist()
            yield card("RBE2", [self._new(), rigid.master, _digits(rigid.components), *slaves])
        for mean in self.deck.average:
            yield f"$ {mean.name}\n"
            groups: list[Field] = []
            for weight in np.unique(mean.weights[mean.weights != 0]).tolist():
                groups += [float(weight), "123", *mean.nodes[mean.weights == weight].tolist()]
            yield card("RBE3", [self._new(), "", mean.reference, _digits(mean.components), *groups])

    def equation_cards(self) -> Iterator[str]:
        """Equations, each of which its first term depends on the others."""
        for given in self.deck.equations:
            for i in range(len(given)):
                own = slice(given.offsets[i], given.offsets[i + 1])
                terms = [(int(given.nodes[i]), int(given.components[i]), -1.0)]
                terms += zip(
                    given.term_nodes[own].tolist(),
                    given.term_components[own].tolist(),
                    given.coefficients[own].tolist(),
                    strict=True,
                )
                yield self._equation(terms)

    def _equation(self, terms: list[tuple[int, int, float]]) -> str:
        fields: list[Field] = [1]
        for at in range(0, len(terms), 2):
            pair = [word for node, component, factor in terms[at : at + 2] for word in (node, component + 1, factor)]
            fields += [*([""] if at else []), *pair, *[""] * (7 - len(pair))]
        return card("MPC", fields)

    def support_cards(self) -> Iterator[str]:
        """Held directions, those along no axis as equations."""
        supports = self.deck.supports
        for node, direction in zip(supports.nodes.tolist(), supports.directions, strict=True):
            held = np.flatnonzero(direction)
            if len(held) == 1:
                yield card("SPC1", [1, str(held[0] + 1), node])
            else:
                order = held[np.argsort(-np.abs(direction[held]), kind="stable")].tolist()
                yield self._equation([(node, component, float(direction[component])) for component in order])

    def set_cards(self) -> Iterator[str]:
        """Sets of nodes by numbers, their names in comments."""
        for number, (name, ranges) in enumerate(self.deck.node_sets.items(), start=1):
            labels = self.deck.ids[self.nodes.members(ranges, f"the set {name} names")]
            fields = [
                word
                for a, b in ranges_of(labels).tolist()
                for word in ([a, "THRU", b] if b > a + 1 else [a, b][: b - a + 1])
            ]
            yield f"$ SET1 {number} is {name}\n{card('SET1', [number, *fields])}" if fields else ""


def nastran_lines(deck: DeckTables) -> tuple[Iterator[str], list[str]]:
    """Lines of bulk data, and sentences on what differs in them.

    Raises:
        InputError: what bulk data cannot say.
    """
    text = NastranText(deck)
    return text.text(), text.warnings


def _digits(components: tuple[int, ...]) -> str:
    return "".join(str(component + 1) for component in components)
