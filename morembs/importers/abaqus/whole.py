"""An input deck as a ``Deck``: parts in their places, labels of the whole, names resolved."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.constraints import Constraints, DeckTies
from morembs.importers.abaqus.deck import PLAIN, SOLIDS, STRUCTURES, VTK_ORDER, Contents
from morembs.importers.abaqus.equations import Axes
from morembs.importers.abaqus.left_out import LOCKED, PRETENSION, notes_of
from morembs.importers.abaqus.materials import SectionMaterials, materials_of
from morembs.importers.abaqus.structures import structures_of
from morembs.importers.abaqus.supports import supports_of
from morembs.importers.abaqus.words import EFFECTS, LEFT_OUT, SECTIONS, WORDS, of_kind
from morembs.importers.decks.expansion.sections import SOLIDS as EXPANDED
from morembs.importers.decks.formulations import Meaning, deck_warnings, program_of
from morembs.importers.decks.labels import ranges_of
from morembs.importers.decks.model import Deck
from morembs.importers.decks.options import describe_left_out
from morembs.importers.decks.tables import Elements, LeftOut, Supports, Surface
from morembs.importers.imported import on_rows

Values = Mapping[str, Mapping[int, Floats]]


def deck_of(contents: Contents) -> Deck:
    """What a deck holds, as tables by labels of the whole.

    Raises:
        DeckError: it makes no sense; what else was found is among the problems of the deck.
    """
    with contents.problems.ending():
        assembly, left_out = Assembly(contents), _list_left_out(contents)
        ties, sections, surfaces, supports = DeckTies(), SectionMaterials(), dict[str, Surface](), Supports()
        if assembly.blocks or any(nodes.shape[1] for *_, nodes in assembly.others):
            constraints = Constraints(contents, assembly)
            ties, surfaces = constraints.read(), constraints.surfaces.named
            sections = materials_of(contents, assembly)
            left_out, supports = _supports(contents, assembly, constraints.axes)
        structures = structures_of(contents, assembly)
        deck = mesh_deck(contents, assembly, structures.values)
    ids = assembly.ids
    moved = (own.scope.name for own in contents.instances.values() if own.moves)
    return replace(
        deck,
        surfaces={name: _label(surface, ids) for name, surface in surfaces.items()},
        materials=structures.materials,
        sections=(*sections.sections, *structures.sections),
        rigid=on_rows(ties.rigid, ids),
        average=on_rows(ties.average, ids),
        equations=on_rows(ties.equations, ids),
        masses=on_rows(ties.masses, ids),
        discrete=on_rows(ties.discrete, ids),
        ties=tuple(ties.ties),
        notes=(*_notes(contents, taken=any(part.code in EXPANDED for part in deck.elements)), *deck.notes),
        remarks=(*(f"The instance {name} was moved to its place." for name in moved), *sections.notes, *ties.notes),
        warnings=(
            *skipped_warnings(contents),
            *_plain_warnings(contents, deck),
            *contents.warnings,
            *ties.warnings,
            *sections.warnings,
        ),
        problems=tuple(contents.problems.entries),
        supports=supports,
        left_out=left_out,
    )


def mesh_deck(contents: Contents, assembly: Assembly, values: Values | None = None) -> Deck:
    """Nodes, elements and sets alone, with ``values`` of elements by their numbers; the assembly gives up its
    solids."""
    labels, ids = assembly.element_labels(), assembly.ids
    node_sets = {name: ranges_of(ids[rows]) for name, rows in assembly.resolve("node")}
    element_sets = {name: ranges_of(labels[numbers]) for name, numbers in assembly.resolve("element")}
    counted = {code: count for code, count in contents.counts.items() if code in SOLIDS and count}
    return Deck(
        name=contents.name,
        program=program_of(contents.dialect),
        ids=ids,
        xyz=assembly.xyz,
        elements=tuple(_elements(contents, assembly, values or {})),
        node_sets=node_sets,
        element_sets=element_sets,
        notes=tuple(assembly.notes),
        mesh_warnings=(*assembly.warnings, *deck_warnings(counted, contents.dialect, guessed=contents.guessed)),
        problems=tuple(contents.problems.entries),
        options=contents.options,
    )


def _elements(contents: Contents, assembly: Assembly, values: Values) -> Iterator[Elements]:
    """Solids by type, formulation and mass, then elements on single nodes, then others."""
    start = assembly.solids + len(assembly.discrete)
    codes = {contents.kind(code): code for code in reversed(contents.counts) if code in SOLIDS}
    while assembly.blocks:
        block = assembly.blocks.pop(0)
        code = codes[block.type, block.formulation, block.mass]
        meaning = Meaning(formulation=block.formulation, mass=block.mass)
        nodes = assembly.ids[block.nodes]
        yield Elements(code=code, kind="solid", shape=block.type, ids=block.ids, nodes=nodes, meaning=meaning)
    for code in dict.fromkeys(element.code for element in assembly.discrete):
        own = [element for element in assembly.discrete if element.code == code]
        labels, nodes = np.array([element.label for element in own]), np.array([element.nodes for element in own])
        yield Elements(code=code, kind="point", shape="", ids=labels, nodes=assembly.ids[nodes])
    for code, labels, nodes in assembly.others:
        kind, shape = STRUCTURES[code] if nodes.shape[1] else ("none", "")
        is_refused = bool(nodes.shape[1]) or code in contents.unknown
        yield Elements(
            code=code,
            kind=kind,
            shape=shape,
            ids=labels,
            nodes=assembly.ids[nodes[:, VTK_ORDER.get(shape, slice(None))]],
            values=dict(_values_of(start, len(labels), values)),
            problem=contents.unsupported if is_refused and code not in EXPANDED else None,
        )
        start += len(labels)


def _values_of(start: int, count: int, values: Values) -> Iterator[tuple[str, Floats]]:
    """Values (count, ...) of the elements with the numbers from ``start`` on, by their names, where there are any."""
    for name, given in values.items():
        own = [given.get(start + i) for i in range(count)]
        some = next((value for value in own if value is not None), None)
        if some is not None:
            none = np.full(some.shape, 0.0 if name == "offset" else np.nan)
            yield name, np.array([none if value is None else value for value in own])


def _label(surface: Surface, ids: Ints) -> Surface:
    """A surface on rows of all nodes, with the labels of these."""
    faces = tuple((shape, ids[nodes]) for shape, nodes in surface.faces)
    return Surface(nodes=ids[surface.nodes], weights=surface.weights, faces=faces)


def skipped_warnings(contents: Contents) -> list[str]:
    """What was left out as asked, a sentence each."""
    contact = ("*CONTACT PAIR", "*CONTACT")
    return [describe_left_out(kind, count, contact=kind in contact) for kind, count in contents.skipped.items()]


def _plain_warnings(contents: Contents, deck: Deck) -> list[str]:
    """A sentence for each element type of Abaqus that is assembled as its plain one."""
    codes = {part.code for part in deck.elements if part.kind != "none"}
    return [
        f"{count} elements {code} are assembled as {PLAIN[code]} [hybrid-as-plain]"
        for code, count in contents.counts.items()
        if count and PLAIN.get(code) in codes
    ]


def _supports(contents: Contents, assembly: Assembly, axes: Axes) -> tuple[dict[str, LeftOut], Supports]:
    """Cards that are left out, with reasons, and the supports that are read."""
    left_out = _list_left_out(contents)
    try:
        supports = supports_of(contents, assembly, axes)
    except InputError as error:
        # A free body does without; a program that is to hold it says so.
        return {**left_out, "*BOUNDARY": replace(left_out["*BOUNDARY"], why=str(error))}, Supports()
    later = sum(card.keyword == "BOUNDARY" for step in contents.steps[1:] for card, _ in step)
    left_out |= {"*BOUNDARY": LeftOut(later, "they are of later steps than the first")} if later else {}
    return {name: own for name, own in left_out.items() if later or name != "*BOUNDARY"}, supports


def _list_left_out(contents: Contents) -> dict[str, LeftOut]:
    """Supports and loads, in steps and outside of them."""
    counted = {word: contents.noted.get(word, 0) + contents.in_steps.get(word, 0) for word in LEFT_OUT}
    acting = set(of_kind("support", "load"))
    return {f"*{word}": LeftOut(n, EFFECTS[WORDS[word].kind]) for word, n in counted.items() if n and word in acting}


def _notes(contents: Contents, *, taken: bool) -> list[str]:
    """What was left out, a sentence for each class; sections of shells and beams may be ``taken``."""
    in_steps = [word for word in contents.in_steps if word in of_kind("support", "load")]
    noted = [word for word in contents.noted if not (taken and word in SECTIONS)]
    notes = notes_of(dict.fromkeys([*noted, *in_steps]))
    if f"*{PRETENSION}" in contents.skipped:
        notes.append(LOCKED.format(""))
    if contents.in_steps:
        listed = ", ".join(f"*{word}" for word in contents.in_steps if word != "END STEP")
        notes.append(f"Steps and all in them are not applied: {listed}.")
    return notes
