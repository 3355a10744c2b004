"""Bulk data of Nastran of a ``Deck``, in fields of 16 columns: numbers have 11 digits at least."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from morembs.base.errors import InputError
from morembs.importers.decks.labels import ranges_of
from morembs.importers.decks.tables import NOT_WRITTEN, DeckTables
from morembs.importers.decks.writers.nastran_cards import ElementText, digits
from morembs.importers.nastran.text_of_cards import Field, card

_HEAD = "SOL 103\nCEND\nMPC = 1\nSPC = 1\nBEGIN BULK\n"
_SPRINGS = {"K": "CELAS2", "D": "CDAMP2", "M": "CMASS2"}


@dataclass(eq=False)
class NastranText(ElementText):
    """The cards of a deck; ``warnings`` say in what the written deck differs.

    Raises:
        InputError: what bulk data cannot say.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        largest = (part.ids.max(initial=0) for part in self.deck.elements)
        self._element = int(max((*largest, 0)))

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
        yield from (*elements, *self.cards, *self.systems, *ties, *self.set_cards(), "ENDDATA\n")
        properties = {section.set for section in self.deck.sections}
        loose = [name for name in self.deck.element_sets if name not in properties]
        for kind, names in (("sets of elements", loose), ("surfaces", [*self.deck.surfaces])):
            if names:
                self.warnings.append(f"Nastran has no {kind}: {', '.join(names)} are not written {NOT_WRITTEN}")

    def element_cards(self) -> Iterator[str]:
        """Elements with the properties of the last section that each is in."""
        for part in self.parts:
            owner = self.owners(part.kind, part.ids)
            name, nodes, full = self.element_card(part)
            for i, (label, row) in enumerate(zip(part.ids.tolist(), nodes.tolist(), strict=True)):
                number = int(owner[i])
                pid = self.property(part, number, full)
                yield card(name, [label, pid, *(node or "" for node in row), *self.tail(part, number, i)])

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
                    f"{', '.join(_SPRINGS.values())} are",
                    kind="unsupported",
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
            yield card("RBE2", [self._new(), rigid.master, digits(rigid.components), *slaves])
        for mean in self.deck.average:
            yield f"$ {mean.name}\n"
            groups: list[Field] = []
            for weight in np.unique(mean.weights[mean.weights != 0]).tolist():
                groups += [float(weight), "123", *mean.nodes[mean.weights == weight].tolist()]
            yield card("RBE3", [self._new(), "", mean.reference, digits(mean.components), *groups])

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
            labels = self.deck.ids[self.labels.members(ranges, f"the set {name} names")]
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
