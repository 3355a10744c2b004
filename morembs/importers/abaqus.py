"""Abaqus and CalculiX input decks with their labels: mesh, sets, surfaces, materials, couplings, point masses.

Read here and not by meshio, which drops labels, sets named inside keywords, instances in their places and materials.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError, nearest
from morembs.importers.abaqus_assembly import Assembly
from morembs.importers.abaqus_constraints import Constraints
from morembs.importers.abaqus_deck import SOLIDS, Deck, read_deck
from morembs.importers.abaqus_materials import materials_of
from morembs.importers.abaqus_mesh import mesh_of
from morembs.importers.formulations import DIALECTS, deck_warnings
from morembs.importers.imported import Imported, nodes_of, on_rows
from morembs.model import Mesh

Ints = NDArray[np.int64]


def read_abaqus(path: Path, *, allow_includes_outside: bool = False) -> Mesh:
    """Mesh of an input deck in the deck's own units; its materials are not read.

    Raises:
        InputError: not a deck, an element type that is not supported, or couplings and point masses, which a mesh
            cannot carry.
    """
    deck = read_deck(path, outside=allow_includes_outside)
    scopes = [deck.top, *deck.parts.values(), *(instance.scope for instance in deck.instances.values())]
    ties = [card for scope in scopes for card, *_ in scope.constraints]
    if ties or any(scope.points for scope in scopes):
        what = f"*{ties[0].keyword}" if ties else "point masses"
        raise InputError(
            f"{deck.name} has {what}, which a mesh cannot carry; import the whole deck, or take them out of it"
        )
    return _with_warnings(mesh_of(Assembly(deck), np.empty(0, dtype=np.int64))[0], deck)


def import_abaqus(path: str | Path, *, dialect: str = "auto", allow_includes_outside: bool = False) -> Imported:
    """All of an input deck that a model can carry, in the deck's own units.

    The rows of ``nodes`` are those of ``mesh.nodes``, and behind them nodes that belong to no element but are named
    by a coupling or a point mass. Boundary conditions and steps are not applied (``notes`` say so).

    Args:
        allow_includes_outside: includes may name files beyond the folder of the deck.
        dialect: the program whose element types are meant, "abaqus" or "calculix"; "auto" looks at keywords and
            comments.

    Peak memory: the numbers of the mesh about twice, besides a piece of the file of a few MB.

    Raises:
        InputError: the file is not a deck, contradicts itself, or holds what a model cannot carry.
    """
    if dialect not in DIALECTS:
        raise InputError(f"dialect = {dialect!r} was given; {nearest(dialect, DIALECTS)}")
    deck = read_deck(Path(path), outside=allow_includes_outside, dialect=dialect)
    assembly = Assembly(deck)
    if not assembly.blocks:
        raise InputError(f"{deck.name} has no solid elements; expected a mesh of solids (C3D4, C3D10, C3D8, ...)")
    constraints = Constraints(assembly)
    constraints.surfaces()
    constraints.constraints()
    constraints.point_masses()
    materials, material_notes, lacking = materials_of(deck, assembly)
    got = constraints.found
    mesh, nodes, row = mesh_of(assembly, nodes_of([*got.rigid, *got.average, *got.masses]))
    surfaces = {name: np.sort(row[rows][row[rows] >= 0]) for name, rows in got.surfaces.items()}
    for instance in deck.instances.values():
        if instance.moves:
            assembly.notes.append(f"The instance {instance.scope.name} was moved to its place.")
    return Imported(
        source=deck.name,
        nodes=nodes,
        mesh=_with_warnings(mesh, deck),
        materials=materials,
        rigid=on_rows(got.rigid, row),
        average=on_rows(got.average, row),
        masses=on_rows(got.masses, row),
        surfaces={name: rows for name, rows in surfaces.items() if len(rows)},
        notes=(*_notes(deck), *assembly.notes, *material_notes, *got.notes),
        incomplete=lacking,
    )


def _with_warnings(mesh: Mesh, deck: Deck) -> Mesh:
    """The mesh with what its element types mean otherwise in their program."""
    solids = {code: count for code, count in deck.counts.items() if code in SOLIDS and count}
    return replace(mesh, warnings=(*mesh.warnings, *deck_warnings(solids, deck.dialect, guessed=deck.guessed)))


def _notes(deck: Deck) -> list[str]:
    """What was left out, a sentence each."""
    notes = []
    for word in deck.noted:
        reason = "is not applied; the body is free" if word == "BOUNDARY" else "is not carried over"
        notes.append(f"*{word} {reason}.")
    if deck.in_steps:
        listed = ", ".join(f"*{word}" for word in deck.in_steps if word != "END STEP")
        notes.append(f"Steps and all in them are not applied: {listed}.")
    return notes
