"""Decks of other programs for CalculiX: as flat decks, with what those cannot say beside the matrices."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from morembs.base.types import Floats, Ints
from morembs.fem import Nodes
from morembs.fem.material import Material
from morembs.importers.decks.flat import FlatDeck, refuse_no_elements
from morembs.importers.decks.formulations import deck_warnings, meaning_of
from morembs.importers.decks.labels import Labels, in_ranges, ranges_of
from morembs.importers.decks.materials import complete, problems_of_solids
from morembs.importers.decks.model import Deck
from morembs.importers.decks.problems import DeckError, Problem, Problems
from morembs.importers.decks.tables import NOT_WRITTEN, Elements
from morembs.importers.decks.writers import refuse_values, without_section
from morembs.importers.decks.writers.calculix import CalculixText
from morembs.importers.imported import Imported, nodes_of, on_rows

_ALL = range(6)


def complete_deck(deck: Deck, materials: Sequence[Material]) -> Deck:
    """A deck all of whose solids have a material.

    Raises:
        DeckError: all that keeps it from being written for CalculiX.
    """
    problems = Problems(deck.name, deck.options.flags)
    problems.entries = [*deck.problems, *(part.problem for part in deck.elements if part.problem)]
    if all(part.kind in ("point", "none") for part in deck.elements):
        refuse_no_elements(problems)
    with problems.ending():
        deck = complete(deck, materials)
    problems.entries += problems_of_solids(deck, materials)
    problems.refuse()
    return deck


def flat_deck(deck: Deck) -> tuple[Deck, FlatDeck]:
    """The flat deck of tables without masses, springs and average elements, and the deck with the solids of that and
    sets of the nodes of rigid bodies.

    Raises:
        InputError: what CalculiX cannot say.
    """
    refuse_values(deck, "calculix")
    text = _FlatText(_with_reduced(replace(deck, average=(), masses=(), discrete=())), counted=True)
    nodes, cards = text.split()
    in_solids, in_elements = (np.zeros(len(deck.ids), dtype=bool) for _ in range(2))
    for part in text.parts:
        rows = text.nodes.rows(part.nodes, "elements name")
        in_elements[rows] = True
        in_solids[rows[: len(rows) * (part.kind == "solid")]] = True
    sentences = (sentence for sentence in (*without_section(deck), *text.warnings) if NOT_WRITTEN not in sentence)
    flat = FlatDeck(
        name=deck.name,
        ids=deck.ids,
        xyz=deck.xyz,
        elements=text.elements.ids,
        nodes=nodes,
        cards=cards,
        in_solids=in_solids,
        in_elements=in_elements,
        expands=any(part.kind != "solid" for part in text.parts),
        held=text.held,
        bodies=tuple(text.bodies),
        followers=frozenset(text.followers),
        surfaces={name: text.nodes.rows(own.nodes, f"the surface {name} names") for name, own in deck.surfaces.items()},
        notes=("The matrices are those of CalculiX.",),
        warnings=(*deck.warnings, *sentences, *text.replaced),
    )
    codes, counts = iter(text.solid_codes), Counter[str]()
    parts = list[Elements]()
    for part in deck.elements:
        if part.kind == "solid":
            code = next(codes)
            counts[code] += len(part.ids)
            part = replace(part, meaning=meaning_of(code, "calculix"))
        parts.append(part)
    warnings = deck_warnings(dict(counts), "calculix", guessed=False)
    rigid = {own.name: ranges_of(np.unique(own.slaves)) for own in deck.rigid if len(own.components) == len(_ALL)}
    sets = {**rigid, **deck.node_sets}
    return replace(deck, elements=tuple(parts), node_sets=sets, mesh_warnings=tuple(warnings)), flat


def _with_reduced(deck: Deck) -> Deck:
    """The deck with beams of three nodes and thin-walled profiles as B32R, which alone have these in CalculiX
    (CrunchiX User's Manual, *BEAM SECTION)."""
    parts = list[Elements]()
    for part in deck.elements:
        thin = np.zeros(len(part.ids), dtype=bool)
        for section in deck.sections if (part.kind, part.shape) == ("beam", "line3") else ():
            own = in_ranges(part.ids, deck.ranges(section.set))
            thin[own] = section.profile in ("PIPE", "BOX")
        for rows, code in ((~thin, part.code), (thin, "B32R")):
            if rows.any():
                values = {name: value[rows] for name, value in part.values.items()}
                parts.append(replace(part, code=code, ids=part.ids[rows], nodes=part.nodes[rows], values=values))
    return replace(deck, elements=tuple(parts))


class _FlatText(CalculixText):
    """Cards of a deck, and their data on its nodes, as of ``FlatDeck``; types of its solids as they are written."""

    def split(self) -> tuple[str, str]:
        """Nodes, and all other cards."""
        self.held = np.zeros((len(self.deck.ids), 3), dtype=bool)
        self.bodies, self.followers, self.replaced = list[int](), set[int](), list[str]()
        self.solid_codes = list[str]()
        mesh = [*self.mesh_lines()]
        first = 1 + len(self.deck.ids)
        sections, supports = [*self.section_lines(), *self.normal_lines()], [*self.support_lines()]
        boundary = [supports.pop()] if supports and supports[-1].startswith("*BOUNDARY") else []
        body = [*self.equation_lines(), *supports, *self.tie_lines(), *self.coupling_lines(), *boundary]
        cards = "\n".join([*mesh[first:], *self.sets, *self.surfaces, *sections, *body])
        return "\n".join(mesh[:first]), cards

    def code(self, part: Elements) -> str:
        """The type of elements, which is kept of solids."""
        if part.code == "B32R":
            self.replaced.append(f"{len(part.ids)} elements B32 are assembled as B32R [hybrid-as-plain]")
            return part.code
        code = super().code(part)
        self.solid_codes += [code] * (part.kind == "solid")
        return code

    def equation(self, labels: Ints, dofs: Ints, factors: Floats) -> list[str]:
        """Lines of a sum, whose first node follows the others."""
        self.followers.add(int(self.node(labels[:1])[0]) - 1)
        return super().equation(labels, dofs, factors)

    def support_lines(self) -> Iterator[str]:
        """Held directions, kept where they are those of displacements along the axes."""
        supports = self.deck.supports
        plain = (supports.directions != 0).sum(axis=1) == 1
        row, axis = np.nonzero(supports.directions[plain][:, :3])
        self.held[self.nodes.rows(supports.nodes[plain], "supports name")[row], axis] = True
        yield from super().support_lines()

    def coupling_lines(self) -> Iterator[str]:
        """Rigid elements on nodes other than their references; CalculiX makes rotations of displacements alone."""
        whole = [rigid for rigid in self.deck.rigid if len(rigid.components) == len(_ALL)]
        for rigid in whole:
            nodes = np.setdiff1d(rigid.slaves, rigid.master)
            reference = self._body(rigid.master, nodes)
            yield f"*RIGID BODY, NSET={self.node_set(nodes)}, REF NODE={reference}"
        for rigid in self.deck.rigid:
            if rigid in whole:
                continue
            nodes = np.setdiff1d(rigid.slaves, rigid.master)
            reference = self._body(rigid.master, np.append(nodes, rigid.master))
            surface, name = self.name("SURFACE"), self.name("CONSTRAINT")
            self.surfaces.append(f"*SURFACE, NAME={surface}, TYPE=NODE\n{self.node_set(nodes)}")
            dofs = (f"{c + 1}, {c + 1}" for c in rigid.components if c < 3)
            head = f"*COUPLING, REF NODE={reference}, SURFACE={surface}, CONSTRAINT NAME={name}"
            yield "\n".join([head, "*KINEMATIC", *dofs])

    def _body(self, master: int, nodes: Ints) -> int:
        """The label of a reference node in the text."""
        self.followers.update((self.node(nodes) - 1).tolist())
        self.bodies.append(int(self.node(np.array([master]))[0]))
        return self.bodies[-1]


def with_others(imported: Imported, deck: Deck) -> Imported:
    """What CalculiX made of the flat deck, with masses, springs and average elements of the deck on its nodes.

    Raises:
        DeckError: they name nodes that are not there.
    """
    nodes = imported.nodes
    if nodes is None:
        raise DeckError(deck.name, [Problem(what=f"{deck.name} has no nodes after CalculiX; please report it")])
    wanted = nodes_of([*deck.average, *deck.masses, *deck.discrete])
    loose = np.setdiff1d(wanted, nodes.ids)
    at = Labels(deck.ids, deck.name, deck.node).rows(loose, "couplings name")
    nodes = Nodes(ids=np.append(nodes.ids, loose), xyz=np.vstack([nodes.xyz, deck.xyz[at]]), sets=nodes.sets)
    labels = Labels(nodes.ids, deck.name, deck.node)

    def rows(given: np.ndarray) -> np.ndarray:
        return labels.rows(given, "couplings name")

    return replace(
        imported,
        nodes=nodes,
        average=(*imported.average, *on_rows(deck.average, rows)),
        masses=(*imported.masses, *on_rows(deck.masses, rows)),
        discrete=(*imported.discrete, *on_rows(deck.discrete, rows)),
        notes=(*imported.notes, *deck.remarks),
    )
