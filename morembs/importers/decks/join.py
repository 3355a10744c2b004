"""From a deck by labels to the mesh, couplings and materials of a model on rows: the one way for all programs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.fem import ElementBlock, Mesh, Nodes
from morembs.fem.material import Material
from morembs.importers.decks.expansion import expand
from morembs.importers.decks.expansion.sections import is_expanded
from morembs.importers.decks.labels import Labels, distinct, find
from morembs.importers.decks.materials import complete
from morembs.importers.decks.missing_middles import with_middles
from morembs.importers.decks.options import lacking_problems
from morembs.importers.decks.problems import Problem, Problems
from morembs.importers.decks.tables import DeckTables, Elements
from morembs.importers.imported import Imported, Lacking, first_nodes, nodes_of, sets_on

# Solids of each program that own assembly has.
_SOLIDS = {
    "Abaqus": "C3D4, C3D10, C3D8, ...",
    "CalculiX": "C3D4, C3D10, C3D8, ...",
    "Nastran": "CTETRA, CHEXA, CPENTA",
    "ANSYS": "SOLID185, SOLID186, SOLID187, ...",
    "UNV": "datasets 780 or 2412",
}
# Their decks have sets for loads and output, of which nothing is said where part of them is left out.
_SILENT = ("Abaqus", "CalculiX")


@dataclass(frozen=True, kw_only=True, eq=False)
class SolidMesh:
    """Solids of a deck on rows: ``mesh`` (None without any), its nodes first among ``nodes``; ``row`` (n,) of each
    node of the deck, whose ``labels`` are here, -1 for nodes that were left out; notes on these."""

    mesh: Mesh | None
    nodes: Nodes
    labels: Labels
    row: Ints
    notes: tuple[str, ...]

    def rows(self, labels: Ints) -> Ints:
        """Rows of ``nodes`` by labels (any shape)."""
        return np.asarray(self.row[self.labels.rows(labels, "couplings name")])


def import_deck(deck: DeckTables, materials: Sequence[Material] = ()) -> Imported:
    """All that own assembly has of a deck with ``materials`` of its sets, as ``complete`` has them.

    Raises:
        DeckError: all that keeps the deck from becoming a model.
    """
    problems = _problems(deck)
    with problems.ending():
        # Without solids that is what is told.
        is_there = any(part.kind == "solid" or is_expanded(part) for part in deck.elements)
        if is_there:
            try:
                deck = complete(deck, materials)
            except InputError as error:
                # Told beside what else is wrong, such as elements without a section.
                problems.add(Problem.of(error, deck.name))
        deck = with_middles(expand(deck, problems))
        tied = couplings_of(deck)
        solids = join(deck, nodes_of(tied.ties))
        mesh = _mesh(deck, solids)
    whole, rest = _materials(deck)
    if problems.entries:
        problems.entries += lacking_problems(deck.name, rest)
    problems.refuse()
    surfaces = {
        name: solids.labels.rows(surface.nodes, f"the surface {name} names") for name, surface in deck.surfaces.items()
    }
    return replace(
        tied.on_rows(solids.rows),
        nodes=solids.nodes,
        mesh=mesh,
        materials=tuple(whole),
        surfaces=sets_on(surfaces, solids.row),
        notes=(*deck.notes, *solids.notes, *deck.remarks),
        warnings=deck.warnings,
        incomplete=rest,
        seams=deck.seams,
    )


def mesh_of(deck: DeckTables) -> Mesh:
    """Mesh of the solids of a deck.

    Raises:
        DeckError: as ``import_deck``, or couplings, springs, point masses, shells, beams or edges without middle nodes.
    """
    problems = _problems(deck)
    shells = [part for part in deck.elements if is_expanded(part)]
    if shells:
        listed = ", ".join(f"{len(part.ids)} of the type {part.code!r}" for part in shells)
        what = f"{deck.name} has elements that are not supported in a mesh: {listed}; expected solids "
        what += f"({_SOLIDS.get(deck.program, 'tetrahedra')}); import the whole deck, or take them out"
        problems.add(Problem(what=what, file=deck.name, keyword="ELEMENT"))
        problems.refuse()
    with problems.ending():
        deck = with_middles(deck)
    names = list(dict.fromkeys(tie.name for tie in couplings_of(deck).ties))
    if names:
        what = f"{deck.name} has {', '.join(names[:10])}, which a mesh cannot carry; import the whole deck, or take "
        problems.add(Problem(what=f"{what}them out", file=deck.name))
    with problems.ending():
        mesh = _mesh(deck, join(deck, np.empty(0, dtype=np.int64)))
    problems.refuse()
    return mesh


def _problems(deck: DeckTables) -> Problems:
    """Those of the deck, and of elements that own assembly does not have."""
    problems = Problems(deck.name, deck.options.flags, hint="; ".join(deck.options.idle))
    of_elements = dict.fromkeys(part.problem for part in deck.elements if part.problem)
    # Faults of cards whose elements cannot be had at all are for those who have them.
    lost = {part.code for part in deck.elements if part.problem}
    of_deck = [own for own in deck.problems if own.keyword not in lost]
    problems.entries = [*(own for own in of_elements if own not in of_deck), *of_deck]
    return problems


def couplings_of(deck: DeckTables) -> Imported:
    """Couplings, masses and springs of a deck, on labels."""
    return Imported(
        source=deck.name,
        rigid=deck.rigid,
        average=deck.average,
        equations=deck.equations,
        masses=deck.masses,
        discrete=deck.discrete,
    )


def _mesh(deck: DeckTables, solids: SolidMesh) -> Mesh:
    if solids.mesh is None:
        raise InputError(
            f"{deck.name} has no solid elements; expected a mesh of solids ({_SOLIDS.get(deck.program, 'tetrahedra')})",
            kind="missing",
        )
    return solids.mesh


def _materials(deck: DeckTables) -> tuple[list[Material], dict[str, Lacking]]:
    """A material for each section of solids, and what those of others lack."""
    given, lacking = list[Material](), dict[str, Lacking]()
    for section in deck.sections:
        if section.kind != "solid":
            continue
        if section.lacks or section.stiffness is None or section.density is None:
            sentence = section.lacks or f"the section of the set {section.set} has no material"
            lacking[section.set] = Lacking(sentence=sentence, stiffness=section.stiffness)
        else:
            given.append(Material(set=section.set, stiffness=section.stiffness, density=section.density))
    return given, lacking


def join(deck: DeckTables, extra: Ints) -> SolidMesh:
    """Solids of a deck, whose middle nodes are there, on rows: their nodes by label, then those with the labels
    ``extra`` in the order of the deck.

    Raises:
        InputError: labels that are there twice, or that are named and not there.
    """
    labels = Labels(deck.ids, deck.name, deck.node)
    groups: dict[tuple[str, str, str], list[Elements]] = {}
    for part in deck.elements:
        if part.kind == "solid":
            groups.setdefault((part.shape, part.meaning.formulation, part.meaning.mass), []).append(part)
    used, tied = (np.zeros(len(deck.ids), dtype=bool) for _ in range(2))
    places = []
    for group in groups.values():
        places.append(labels.rows(np.concatenate([part.nodes for part in group]), "elements name"))
        used[places[-1]] = True
    tied[labels.rows(extra, "couplings name")] = True
    kept, loose = labels.order[used[labels.order]], np.flatnonzero(tied & ~used)
    both, row = np.concatenate([kept, loose]), np.full(len(deck.ids), -1, dtype=np.int64)
    row[both] = np.arange(len(both))
    notes = []
    if len(left := deck.ids[row < 0]):
        notes.append(f"{len(left)} {deck.node}s belong to no element and were left out (first: {left.min()}).")
    sets = dict(_node_sets(deck, labels, row, notes))
    nodes, mesh = Nodes(ids=deck.ids[both], xyz=deck.xyz[both], sets=sets), None
    if groups:
        blocks = tuple(
            ElementBlock(
                type=shape,
                nodes=row[own],
                ids=np.concatenate([part.ids for part in group]),
                formulation=formulation,
                mass=mass,
            )
            for ((shape, formulation, mass), group), own in zip(groups.items(), places, strict=True)
        )
        mesh = Mesh(
            nodes=first_nodes(nodes, len(kept)),
            blocks=blocks,
            element_sets=dict(_element_sets(deck, blocks, notes)),
            source=deck.name,
            warnings=deck.mesh_warnings,
        )
    return SolidMesh(mesh=mesh, nodes=nodes, labels=labels, row=row, notes=tuple(notes))


def _node_sets(deck: DeckTables, labels: Labels, row: Ints, notes: list[str]) -> Iterator[tuple[str, Ints]]:
    for name, ranges in deck.node_sets.items():
        members = row[labels.members(ranges, f"the set {name} names")]
        kept = np.sort(members[members >= 0])
        if not len(kept):
            notes.append(f"The {deck.node} set {name} holds no node of the model and was left out.")
            continue
        if len(kept) < len(members) and deck.program not in _SILENT:
            left = len(members) - len(kept)
            notes.append(f"{left} of {len(members)} {deck.node}s of the set {name} belong to no element.")
        yield name, kept


def _element_sets(
    deck: DeckTables, blocks: tuple[ElementBlock, ...], notes: list[str]
) -> Iterator[tuple[str, tuple[Ints, ...]]]:
    solids = Labels(np.concatenate([block.ids for block in blocks]), deck.name, "element")
    none = solids.ids[:0]
    others = distinct(np.concatenate([none, *(part.ids for part in deck.elements if part.kind != "solid")]))
    points = distinct(np.concatenate([none, *(part.ids for part in deck.elements if part.kind == "point")]))
    others = others[~solids.has(others)]
    known = Labels(np.concatenate([solids.ids, others]), deck.name, "element")
    is_left = np.concatenate([np.zeros(len(solids), dtype=bool), ~find(points, others)[1]])
    ends = np.cumsum([0, *(len(block.ids) for block in blocks)])
    for name, ranges in deck.element_sets.items():
        members = np.sort(known.members(ranges, f"the set {name} names"))
        parts = np.split(members, np.searchsorted(members, ends[1:]))
        picked = tuple(part - start for part, start in zip(parts, ends, strict=True))
        left = int(is_left[members].sum())
        if left and deck.program not in _SILENT:
            notes.append(f"{left} of {len(members)} elements of the set {name} are no solids and were left out.")
        if any(map(len, picked[:-1])):
            yield name, picked[:-1]
