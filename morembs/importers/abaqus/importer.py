"""Abaqus and CalculiX input decks with their labels: mesh, sets, surfaces, materials, and all that ties or hangs on it.

Read here and not by meshio, which drops labels, sets named inside keywords, instances in their places and materials.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np

from morembs.base.arguments import check_value
from morembs.base.errors import InputError
from morembs.base.limits import one_of
from morembs.fem import Mesh
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.constraints import Constraints
from morembs.importers.abaqus.deck import SOLIDS, Deck
from morembs.importers.abaqus.left_out import LOCKED, PRETENSION, notes_of
from morembs.importers.abaqus.materials import materials_of
from morembs.importers.abaqus.mesh import mesh_of
from morembs.importers.abaqus.reader import read_deck
from morembs.importers.abaqus.words import of_kind
from morembs.importers.decks.formulations import DIALECTS, deck_warnings
from morembs.importers.decks.options import deck_options, left_out
from morembs.importers.decks.problems import Problem
from morembs.importers.imported import Imported, nodes_of, sets_on


def read_abaqus(path: Path, *, dialect: str = "auto", allow_includes_outside: bool = False) -> Mesh:
    """Mesh of an input deck in the deck's own units; its materials are not read.

    Raises:
        InputError: not a deck, an element type that is not supported, or couplings, springs and point masses, which a
            mesh cannot carry.
    """
    deck = read_deck(path, outside=allow_includes_outside, dialect=_known(dialect))
    scopes = [deck.top, *deck.parts.values(), *(instance.scope for instance in deck.instances.values())]
    ties = [card for scope in scopes for card, *_ in scope.constraints]
    if ties or any(scope.discrete for scope in scopes):
        what = f"*{ties[0].keyword}" if ties else "point masses or springs"
        deck.problems.add(
            Problem(
                what=f"{deck.name} has {what}, which a mesh cannot carry; import the whole deck, or take them out",
                file=deck.name,
                keyword=ties[0].keyword if ties else "ELEMENT",
            )
        )
    with deck.problems.ending():
        mesh = mesh_of(Assembly(deck), np.empty(0, dtype=np.int64))[0]
    deck.problems.refuse()
    return _with_warnings(mesh, deck)


def import_abaqus(
    path: str | Path,
    *,
    dialect: str = "auto",
    density: float | dict[str, float] | None = None,
    contact: str = "refuse",
    skip: list[str] | str = "",
    allow_includes_outside: bool = False,
) -> Imported:
    """All of an input deck that a model can carry, in the deck's own units.

    The rows of ``nodes`` are those of ``mesh.nodes``, and behind them nodes that belong to no element but are named
    by a coupling, an equation, a spring or a point mass. Boundary conditions and steps are not applied (``notes`` say
    so).

    Args:
        allow_includes_outside: includes may name files beyond the folder of the deck.
        dialect: the program whose element types are meant, "abaqus" or "calculix"; "auto" looks at keywords and
            comments.
        density: of materials with *ELASTIC and without *DENSITY, or set -> density, "all" standing for all.
        contact: "refuse" contact pairs, "skip" them, or "tie" them: glue their surfaces.
        skip: keywords and element types to leave out, although stiffness or mass may depend on them.

    Peak memory: the numbers of the mesh about twice, besides a piece of the file of a few MB.

    Raises:
        DeckError: all that keeps the deck from becoming a model: an ``InputError`` with ``problems``.
        InputError: options that are not known.
    """
    options = deck_options(density, contact, skip)
    deck = read_deck(Path(path), outside=allow_includes_outside, dialect=_known(dialect), options=options)
    with deck.problems.ending():
        assembly = Assembly(deck)
        if not assembly.blocks:
            raise InputError(f"{deck.name} has no solid elements; expected a mesh of solids (C3D4, C3D10, C3D8, ...)")
        constraints = Constraints(deck, assembly)
        ties = constraints.read()
        sections = materials_of(deck, assembly)
        tied = Imported(
            source=deck.name,
            rigid=tuple(ties.rigid),
            average=tuple(ties.average),
            equations=tuple(ties.equations),
            masses=tuple(ties.masses),
            discrete=tuple(ties.discrete),
        )
        mesh, nodes, row = mesh_of(assembly, nodes_of(tied.ties))
    materials, lacking, said = options.all_materials(deck.problems, sections.materials, sections.lacking)
    for instance in deck.instances.values():
        if instance.moves:
            assembly.notes.append(f"The instance {instance.scope.name} was moved to its place.")
    return replace(
        tied.on_rows(row),
        nodes=nodes,
        mesh=_with_warnings(mesh, deck),
        materials=materials,
        incomplete=lacking,
        surfaces=sets_on(constraints.surfaces.nodes, row),
        notes=(*_notes(deck), *assembly.notes, *sections.notes, *ties.notes),
        warnings=(*skipped_warnings(deck), *deck.warnings, *ties.warnings, *sections.warnings, *said),
    )


def _known(dialect: str) -> str:
    check_value("dialect", dialect, Annotated[str, one_of(*DIALECTS)])
    return dialect


def skipped_warnings(deck: Deck) -> list[str]:
    """What was left out as asked, a sentence each."""
    contact = ("*CONTACT PAIR", "*CONTACT")
    return [left_out(kind, count, contact=kind in contact) for kind, count in deck.skipped.items()]


def _with_warnings(mesh: Mesh, deck: Deck) -> Mesh:
    """The mesh with what its element types mean otherwise in their program."""
    solids = {code: count for code, count in deck.counts.items() if code in SOLIDS and count}
    return replace(mesh, warnings=(*mesh.warnings, *deck_warnings(solids, deck.dialect, guessed=deck.guessed)))


def _notes(deck: Deck) -> list[str]:
    """What was left out, a sentence for each class."""
    in_steps = [word for word in deck.in_steps if word in of_kind("support", "load")]
    notes = notes_of(dict.fromkeys([*deck.noted, *in_steps]))
    if f"*{PRETENSION}" in deck.skipped:
        notes.append(LOCKED.format(""))
    if deck.in_steps:
        listed = ", ".join(f"*{word}" for word in deck.in_steps if word != "END STEP")
        notes.append(f"Steps and all in them are not applied: {listed}.")
    return notes
