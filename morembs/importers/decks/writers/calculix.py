"""Flat decks of CalculiX and Abaqus: one part with all that a ``Deck`` holds, with its names and labels."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.decks.algebra import unit
from morembs.importers.decks.tables import NOT_WRITTEN, DeckTables, Surface
from morembs.importers.decks.writers.calculix_mesh import Line, numeral, numerals
from morembs.importers.decks.writers.calculix_sections import SectionText
from morembs.importers.imported import DiscreteElement
from morembs.importers.tolerances import TOL

_ALL = range(6)


@dataclass(eq=False)
class CalculixText(SectionText):
    """The cards of a deck, in the order in which both programs take them.

    Raises:
        InputError: what the program cannot say.
    """

    def tie_lines(self) -> Iterator[str]:
        """Surfaces that are glued."""
        for tie in self.deck.ties:
            slave, master = (self.surface(self.deck.surfaces[name], name) for name in (tie.slave, tie.master))
            near = f", POSITION TOLERANCE={numeral(tie.tolerance)}" if tie.tolerance else ""
            moves = "" if tie.moves else ", ADJUST=NO"
            yield f"*TIE, NAME={self.name('CONSTRAINT', stem=tie.name)}{near}{moves}\n{slave}, {master}"

    def equation_lines(self) -> Iterator[str]:
        """Equations but those of ties."""
        tied = {tie.name for tie in self.deck.ties}
        for given in self.deck.equations:
            if given.name in tied:
                continue
            for i in range(len(given)):
                own = slice(given.offsets[i], given.offsets[i + 1])
                if own.start == own.stop:
                    raise InputError(
                        f"{self.deck.name}: {given.name} holds a dof, which an equation of {self.program} cannot",
                        kind="unsupported",
                    )
                labels = np.append(given.nodes[i], given.term_nodes[own])
                dofs = np.append(given.components[i], given.term_components[own])
                factors = np.append(-1.0, given.coefficients[own])
                yield from self.equation(labels, dofs, factors)

    def equation(self, labels: Ints, dofs: Ints, factors: Floats) -> list[str]:
        """Lines of the sum of factors times dofs (from 0) of nodes that vanishes."""
        texts = [
            f"{node}, {dof + 1}, {numeral(factor)}"
            for node, dof, factor in zip(self.node(labels).tolist(), dofs.tolist(), factors.tolist(), strict=True)
        ]
        rows = range(0, len(texts), Line.EQUATION_TERMS)
        return ["*EQUATION", str(len(texts)), *(", ".join(texts[i : i + Line.EQUATION_TERMS]) for i in rows)]

    def coupling_lines(self) -> Iterator[str]:
        """Rigid elements as rigid bodies or kinematic couplings, average elements as distributing ones."""
        turning = self._turning()
        for rigid in self.deck.rigid:
            hinged = np.intersect1d(rigid.slaves, turning)
            if max(rigid.components) > 2 and len(hinged):
                raise InputError(
                    f"{self.deck.name}: {rigid.name} turns {self.deck.node} {hinged[0]} of shells, beams or couplings, "
                    "which CalculiX would join by a hinge; leave the rotations out, or write the deck for Abaqus",
                    kind="unsupported",
                )
            if len(rigid.components) == len(_ALL):
                nodes_of = self.node_set(np.unique(rigid.slaves), rigid.name)
                word = "TIE NSET" if self.dialect == "abaqus" else "NSET"
                yield f"*RIGID BODY, {word}={nodes_of}, REF NODE={self.node(np.array([rigid.master]))[0]}"
                continue
            nodes = Surface(nodes=np.unique(rigid.slaves), weights=np.ones(len(np.unique(rigid.slaves))))
            dofs = (f"{c + 1}, {c + 1}" for c in rigid.components)
            yield "\n".join([*self._coupling(rigid.name, rigid.master, nodes), "*KINEMATIC", *dofs])
        for mean in self.deck.average:
            dofs = (f"{c + 1}, {c + 1}" for c in mean.components)
            nodes = Surface(nodes=mean.nodes, weights=mean.weights)
            yield "\n".join([*self._coupling(mean.name, mean.reference, nodes), "*DISTRIBUTING", *dofs])

    def _turning(self) -> Ints:
        """Labels of nodes whose rotations CalculiX does not couple; none where the deck is one of CalculiX."""
        if self.dialect != "calculix" or self.deck.program == "CalculiX":
            return np.empty(0, dtype=np.int64)
        thin = [part.nodes.ravel() for part in self.parts if part.kind in ("shell", "beam")]
        references = [own.master for own in self.deck.rigid] + [own.reference for own in self.deck.average]
        return np.unique(np.concatenate([np.array(references, dtype=np.int64), *thin]))

    def _coupling(self, text: str, reference: int, nodes: Surface) -> list[str]:
        surface, name = self.surface(nodes), self.name("CONSTRAINT", stem=text)
        node = self.node(np.array([reference]))[0]
        return [f"*COUPLING, REF NODE={node}, SURFACE={surface}, CONSTRAINT NAME={name}"]

    def mass_lines(self) -> Iterator[str]:
        """Point masses, each with a set of its own."""
        for mass in self.deck.masses:
            if mass.offset.any():
                raise InputError(
                    f"{self.deck.name}: {mass.name} is away from its node, which {self.program} cannot say",
                    kind="unsupported",
                )
            if mass.inertia.any() and self.dialect == "calculix":
                raise InputError(
                    f"{self.deck.name}: {mass.name} has rotary inertia, which CalculiX lacks; leave the inertia "
                    "out, or write for Abaqus",
                    kind="unsupported",
                )
            if mass.mass:
                yield f"*MASS, ELSET={self._point('MASS', [mass.node])}\n{numeral(mass.mass)}"
            if mass.inertia.any():
                J = mass.inertia
                row = numerals([J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2]])
                yield f"*ROTARY INERTIA, ELSET={self._point('ROTARYI', [mass.node])}\n{row}"

    def _point(self, code: str, nodes: Iterable[int]) -> str:
        """The set of a new element on single nodes."""
        self.next_element += 1
        name = self.name("ELSET", stem=f"P{self.next_element}")
        labels = ", ".join(map(str, self.node(np.array(list(nodes))).tolist()))
        self.more_elements.append(f"*ELEMENT, TYPE={code}, ELSET={name}\n{self.next_element}, {labels}")
        return name

    def spring_lines(self) -> Iterator[str]:
        """Springs and dashpots on one dof, between two, and along a line."""
        for element in self.deck.discrete:
            word = {"K": "SPRING", "D": "DASHPOT"}.get(element.matrix, "")
            found = self._spring(element) if word else None
            if found is None:
                raise InputError(
                    f"{self.deck.name}: {element.name} is no spring or dashpot on one dof, between two or along a "
                    f"line, which {self.program} has",
                    kind="unsupported",
                )
            code, nodes, dofs, value = found
            if self.dialect == "calculix" and max(dofs, default=0) > 3:
                raise InputError(
                    f"{self.deck.name}: {element.name} is a spring or dashpot on rotations, which CalculiX leaves out; "
                    "write the deck for Abaqus or Nastran",
                    kind="unsupported",
                )
            elset = self._point(f"{word}{code}", nodes)
            # Along a line there is no direction: Abaqus has a blank line in its place, CalculiX none.
            directions = [", ".join(map(str, dofs))] if dofs or self.dialect == "abaqus" else []
            yield "\n".join([f"*{word}, ELSET={elset}", *directions, numeral(value)])

    def _spring(self, element: DiscreteElement) -> tuple[str, list[int], list[int], float] | None:
        """Ending of its code, nodes, dofs (from 1) and constant; None where it is no spring of the program."""
        A, nodes, dofs = element.values, element.nodes.tolist(), (element.components + 1).tolist()
        # CalculiX has dashpots along lines only.
        is_free = element.matrix == "K" or self.dialect == "abaqus"
        if len(nodes) == 1:
            return ("1", nodes, dofs, float(A[0, 0])) if is_free else None
        value = float(A[0, 0])
        if (
            is_free
            and len(nodes) == 2
            and np.array_equal(A, value * np.array([[1.0, -1.0], [-1.0, 1.0]]))
            and nodes[0] != nodes[1]
        ):
            return "2", nodes, dofs, value
        ends = list(dict.fromkeys(nodes))
        if len(ends) != 2 or max(dofs) > 3:
            return None
        x = self.deck.xyz[self.nodes.rows(np.array(ends), "springs name")]
        line = unit((x[1] - x[0])[None])[0]
        a = np.array([line[c - 1] * (1.0 if node == ends[1] else -1.0) for node, c in zip(nodes, dofs, strict=True)])
        value = float(np.trace(A) / (a @ a)) if a.any() else 0.0
        if np.abs(A - value * np.outer(a, a)).max() > TOL.isotropic_error * abs(value):
            return None
        return "A", ends, [], value

    def support_lines(self) -> Iterator[str]:
        """Held directions: along the axes by *BOUNDARY, along others as equations."""
        lines, supports = ["*BOUNDARY"], self.deck.supports
        for label, direction in zip(supports.nodes.tolist(), supports.directions, strict=True):
            held = np.flatnonzero(direction)
            if len(held) == 1:
                lines.append(f"{self.node(np.array([label]))[0]}, {held[0] + 1}")
            else:
                order = held[np.argsort(-np.abs(direction[held]), kind="stable")]
                yield from self.equation(np.full(len(order), label), order, direction[order])
        if len(lines) > 1:
            yield "\n".join(lines)

    def surface_lines(self) -> None:
        """Surfaces of the deck under their names, but those without nodes or on elements that are not written."""
        for name, surface in self.deck.surfaces.items():
            try:
                if not len(surface.nodes):
                    raise InputError("it is empty", kind="unsupported")
                self.surface(surface, name)
            except InputError as error:
                self.warnings.append(f"the surface {name} of {self.deck.name} is not written: {error} {NOT_WRITTEN}")

    def text(self) -> Iterator[str]:
        """The whole deck."""
        self.set_lines()
        self.surface_lines()
        sections = [*self.section_lines(), *self.normal_lines()]
        body = [
            *self.mass_lines(),
            *self.spring_lines(),
            *self.equation_lines(),
            *self.tie_lines(),
            *self.coupling_lines(),
        ]
        supports = [*self.support_lines()]
        if self.renamed:
            self.warnings.append(
                f"names of {self.deck.name} are written otherwise: {', '.join(self.renamed)} {NOT_WRITTEN}"
            )
        # By which a reader knows whose element types are meant.
        yield f"** Written for {self.program}\n*HEADING\n{self.deck.name}"
        yield from self.mesh_lines()
        yield from (*self.more_elements, *self.sets, *self.surfaces, *sections, *body, *supports)


def calculix_lines(deck: DeckTables, dialect: str = "calculix") -> tuple[Iterator[str], list[str]]:
    """Lines of a flat deck, and warnings of what differs in it.

    Raises:
        InputError: what the program cannot say.
    """
    text = CalculixText(deck, dialect)
    return text.text(), text.warnings
