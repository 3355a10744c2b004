"""Nastran bulk data with their labels: mesh, property sets, materials, rigid elements, concentrated masses.

Read here and not by meshio, which drops labels, coordinate systems, rigid elements, masses and materials.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.fem import ElementBlock, Mesh, Nodes
from morembs.fem.constraints import Equations
from morembs.importers.decks.formulations import Meaning, nastran_mass_warnings, nastran_meaning, warnings_of
from morembs.importers.decks.missing_middles import filled, middle_equations
from morembs.importers.decks.options import DeckOptions, deck_options, left_out
from morembs.importers.decks.problems import Problem
from morembs.importers.imported import Imported, first_nodes, nodes_of
from morembs.importers.nastran.bulk import Bulk
from morembs.importers.nastran.geometry import card_of
from morembs.importers.nastran.names import OF_TEMPERATURE, RESTRAINTS, RIGID, SCALARS
from morembs.importers.nastran.properties import Materials, labels_of, padded
from morembs.importers.nastran.rigid import Ties
from morembs.importers.nastran.springs import Springs

# Values of PARAM COUPMASS that leave the mass lumped.
OFF = ("-1", "NO", "")
_SET = re.compile(r"^[ \t]*SET[ \t]+(\d{1,9})[ \t]*=((?:[^\n]*,[ \t]*\n)*[^\n]*)", re.MULTILINE | re.IGNORECASE)


def read_nastran(path: Path, *, allow_includes_outside: bool = False) -> Mesh:
    """Mesh of bulk data in the units of the file; materials are not read.

    Raises:
        InputError: not bulk data, or cards that a mesh cannot carry.
    """
    bulk = Bulk(path, outside=allow_includes_outside)
    ties = [name for name in (*RIGID, "CONM1", "CONM2", "MPC", "CBUSH", *SCALARS) if bulk.rows[name]]
    if ties:
        what = f"{bulk.file} has {', '.join(ties)}, which a mesh cannot carry; import the whole file, or take them out"
        bulk.problems.add(Problem(what=what, file=bulk.file, keyword=ties[0]))
    bulk.problems.refuse()
    parts, middles = solid_parts(bulk)
    if middles:
        raise InputError(f"{bulk.file} has edges without middle nodes, which a mesh cannot carry; import it all")
    return bulk_mesh(bulk, parts, np.empty(0, dtype=np.int64), [])[0]


def import_nastran(
    path: str | Path,
    *,
    density: float | dict[str, float] | None = None,
    skip: list[str] | str = "",
    allow_includes_outside: bool = False,
) -> Imported:
    """All of a file of bulk data that a model can carry, in the units of the file, along the basic axes.

    Elements of the property 3 are the set "PSOLID_3"; SET1 5 and SET 5 of case control are "SET1_5" and "SET_5". The
    rows of ``nodes`` are those of ``mesh.nodes``, and behind them grids that belong to no element but are named by a
    rigid element, a spring, an MPC or a mass. Restraints and loads are not applied (``notes`` say so).

    Args:
        density: of materials without one (before WTMASS), or set -> density, "all" standing for all.
        skip: cards to leave out, although stiffness or mass may depend on them.
        allow_includes_outside: INCLUDE may name files beyond the folder of the file.

    Peak memory: the numbers of the mesh about twice, besides a piece of the file as tables (about 150 MB).

    Raises:
        DeckError: all that keeps the file from becoming a model: an ``InputError`` with ``problems``.
    """
    options = deck_options(density, "refuse", skip)
    bulk = Bulk(Path(path), outside=allow_includes_outside, options=options)
    notes: list[str] = []
    with bulk.problems.ending():
        scale = bulk.mass_scale()
        parts, middles = list[Part](), None
        with bulk.problems.collected():
            parts, middles = solid_parts(bulk)
        ties, springs = tied(bulk, grids_of(bulk, parts), scale)
        if not parts:
            bulk.problems.refuse()
        everything = Imported(
            source=bulk.file,
            rigid=tuple(ties.rigid),
            average=tuple(ties.average),
            masses=tuple(ties.masses),
            equations=(*ties.equations, *([middles] if middles else [])),
            discrete=tuple(springs.elements),
        )
        mesh, nodes, row = bulk_mesh(bulk, parts, nodes_of(everything.ties), notes)
        pids = [int(name.removeprefix("PSOLID_")) for name in mesh.element_sets if name.startswith("PSOLID_")]
        materials = Materials(bulk.file, scale)
        assigned = materials.of(pids, bulk.rows["PSOLID"], bulk.rows, bulk.systems, bulk.grids)
    given = DeckOptions(density={name: scale * value for name, value in options.density.items()})
    whole, lacking, said = given.all_materials(bulk.problems, assigned, materials.lacking)
    return replace(
        everything.on_rows(row),
        nodes=nodes,
        mesh=mesh,
        materials=whole,
        incomplete=lacking,
        seams=True,
        notes=(*notes_of(bulk, scale), *notes, *materials.notes, *ties.notes),
        warnings=(*skipped_warnings(bulk), *dict.fromkeys(materials.warnings), *said),
    )


def skipped_warnings(bulk: Bulk) -> list[str]:
    """Warnings of cards that were skipped, and of those that make materials depend on temperature."""
    skipped = [left_out(name, count) for name, count in bulk.skipped.items()]
    cold = [
        f"{name} makes materials depend on temperature; their own values were taken [temperature-first-row]"
        for name in OF_TEMPERATURE
        if name in bulk.noted
    ]
    return [*skipped, *cold]


def grids_of(bulk: Bulk, parts: Sequence[Part]) -> NDArray[np.bool_]:
    """Which grids solids have."""
    solid = np.zeros(len(bulk.grids.ids), dtype=bool)
    for part in parts:
        solid[part.nodes] = True
    return solid


def tied(bulk: Bulk, solid: NDArray[np.bool_], scale: float) -> tuple[Ties, Springs]:
    """Rigid elements, equations, masses and springs; their faults are problems. ``solid`` grids have no rotations."""
    ties = Ties(bulk.grids, bulk.systems, scale, solid)
    springs = Springs(bulk.grids, bulk.systems, bulk.rows, scale)
    readers: dict[str, Callable[[list[str]], None]] = {
        "RBE1": ties.rbe1,
        "RBE2": ties.rbe2,
        "RBE3": ties.rbe3,
        "RBAR": ties.rbar,
        "RROD": ties.rrod,
        "RTRPLT": ties.rtrplt,
        "CONM2": ties.conm2,
        "CONM1": springs.conm1,
        "CBUSH": springs.bush,
        **{name: partial(springs.scalar, name) for name in SCALARS},
    }
    for name, take in readers.items():
        for row, card in bulk.cards(name):
            with bulk.problems.collected(card, (f"--skip {name}",)):
                take(row)
    with bulk.problems.collected(next((card for _, card in bulk.cards("MPC")), None), ("--skip MPC",)):
        ties.mpc(bulk.rows["MPC"], bulk.rows["MPCADD"], bulk.text.head)
    return ties, springs


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """Solids (k,) of one type and meaning: labels, property ids and ``nodes`` (k, n), rows of grids."""

    type: str
    meaning: Meaning
    ids: Ints
    pids: Ints
    nodes: Ints


def solid_parts(bulk: Bulk) -> tuple[list[Part], Equations | None]:
    """All solids, and equations of the middle nodes that they lack; ``bulk.solids`` gives them up."""
    full = [int(words[0]) for row in bulk.rows["PSOLID"] if is_full(words := padded(row, 6))]
    parts, first = [], len(bulk.grids.ids)
    blocks = bulk.solids.blocks(bulk.grids)
    whole, pairs = filled([(kind, nodes) for kind, *_, nodes in blocks], first)
    if len(pairs):
        bulk.grids.add_middles(pairs)
    for (kind, ids, pids, _), nodes in zip(blocks, whole, strict=True):
        asked = np.isin(pids, full)
        of = {given: nastran_meaning(card_of(kind), nodes.shape[1], full=given) for given in (False, True)}
        for meaning in dict.fromkeys(of.values()):
            rows = np.flatnonzero(np.where(asked, of[True] == meaning, of[False] == meaning))
            if len(rows):
                parts.append(Part(type=kind, meaning=meaning, ids=ids[rows], pids=pids[rows], nodes=nodes[rows]))
    return parts, middle_equations(pairs, first) if len(pairs) else None


def is_full(words: list[str]) -> bool:
    """Whether a PSOLID asks for full integration."""
    return words[0].isdigit() and words[5].upper() in ("1", "FULL") and words[3].upper() in ("2", "TWO", "3", "THREE")


def _warnings(bulk: Bulk, parts: Sequence[Part]) -> tuple[str, ...]:
    """What the element types mean otherwise in Nastran, and what the text warns of."""
    names = ((f"{card_of(part.type)} with {part.nodes.shape[1]} nodes", len(part.ids), part.meaning) for part in parts)
    consistent = bulk.parameter("COUPMASS", "-1").lstrip("+") not in OFF
    mass = nastran_mass_warnings(sum(len(part.ids) for part in parts), consistent=consistent)
    return (*warnings_of("Nastran", names), *mass, *bulk.text.warnings)


def bulk_mesh(bulk: Bulk, parts: Sequence[Part], extra: Ints, notes: list[str]) -> tuple[Mesh, Nodes, Ints]:
    """Mesh, its nodes with ``extra`` rows behind them, and the row among these of all grids (or -1)."""
    grids = bulk.grids
    used = np.zeros(len(grids.ids), dtype=bool)
    for part in parts:
        used[part.nodes] = True
    kept, loose = np.flatnonzero(used), np.unique(extra[~used[extra]])
    row = np.full(len(grids.ids), -1, dtype=np.int64)
    row[kept] = np.arange(len(kept))
    row[loose] = len(kept) + np.arange(len(loose))
    blocks = tuple(
        ElementBlock(
            type=part.type,
            nodes=row[part.nodes],
            ids=part.ids,
            formulation=part.meaning.formulation,
            mass=part.meaning.mass,
        )
        for part in parts
    )
    properties = [part.pids for part in parts]
    element_sets = {
        f"PSOLID_{pid}": tuple(np.flatnonzero(own == pid) for own in properties)
        for pid in np.unique(np.concatenate([np.unique(own) for own in properties])).tolist()
    }
    left = len(grids.ids) - len(kept) - len(loose)
    if left:
        notes.append(f"{left} grids belong to no element and were left out (first: {grids.ids[row < 0][0]}).")
    node_sets = sets_of(bulk, row, blocks, element_sets, notes)
    both = np.concatenate([kept, loose])
    nodes = Nodes(ids=grids.ids[both], xyz=grids.xyz[both], sets=node_sets)
    mesh = Mesh(
        nodes=first_nodes(nodes, len(kept)),
        blocks=blocks,
        element_sets=element_sets,
        source=bulk.file,
        warnings=_warnings(bulk, parts),
    )
    return mesh, nodes, row


def sets_of(
    bulk: Bulk, row: Ints, blocks: tuple[ElementBlock, ...], element_sets: dict[str, tuple[Ints, ...]], notes: list[str]
) -> dict[str, Ints]:
    """Node sets of SET1 and of case control; a set of case control that fits elements only goes to ``element_sets``."""
    ids, sets = bulk.grids.ids, dict[str, Ints]()
    for card in bulk.rows["SET1"]:
        what = f"{bulk.file}: SET1 {padded(card, 1)[0]}"
        rows = row[bulk.grids.rows(np.array(labels_of(card[1:], what, ids), dtype=np.int64), what)]
        if (rows >= 0).any():
            sets[f"SET1_{card[0]}"] = np.unique(rows[rows >= 0])
        else:
            notes.append(f"SET1 {padded(card, 1)[0]} holds no node of the model and was left out.")
    for number, text in _SET.findall(bulk.text.head):
        words = text.upper().replace(",", " ").split()
        name, what = f"SET_{int(number)}", f"{bulk.file}: SET {number}"
        if not words or not all(word == "THRU" or word.isdigit() for word in words):
            notes.append(f"SET {number} of case control is not a plain list of labels and was left out.")
            continue
        labels = np.array(labels_of(words, what, ids), dtype=np.int64)
        if np.isin(labels, ids).all():
            rows = row[bulk.grids.rows(labels, what)]
            if (rows >= 0).any():
                sets[name] = np.unique(rows[rows >= 0])
                notes.append(f"SET {number} of case control was read as a set of grids.")
                continue
        known = np.sort(np.concatenate([block.ids for block in blocks] or [np.empty(0, dtype=np.int64)]))
        labels = np.array(labels_of(words, what, known), dtype=np.int64)
        if np.isin(labels, known).all() and len(labels):
            element_sets[name] = tuple(np.flatnonzero(np.isin(block.ids, labels)) for block in blocks)
            notes.append(f"SET {number} of case control was read as a set of elements.")
        else:
            notes.append(f"SET {number} of case control names neither grids nor elements only and was left out.")
    return sets


def notes_of(bulk: Bulk, scale: float) -> list[str]:
    """What was left out, a sentence each."""
    notes = []
    if bulk.text.head.strip():
        notes.append("Executive and case control are not carried over, sets of labels excepted.")
    for name, count in bulk.noted.items():
        reason = "not applied; the body is free" if name in RESTRAINTS else "not carried over"
        notes.append(f"{count} {name}: {reason}.")
    if bulk.grids.fixed:
        notes.append("Permanent restraints of grids (PS) are not applied; the body is free.")
    if bulk.grids.repeated:
        notes.append(f"{bulk.grids.repeated} grids are given twice in the same way.")
    if bulk.grids.superelements:
        notes.append(f"{bulk.grids.superelements} grids belong to superelements (SEID); all of the file is one model.")
    if bulk.grids.middles:
        notes.append(
            f"{bulk.grids.middles} edges of quadratic elements have no middle node; nodes with labels from "
            f"{bulk.grids.ids[-bulk.grids.middles]} were added, which move as the means of their corners."
        )
    turned = int((bulk.grids.cd != 0).sum())
    if turned:
        notes.append(f"{turned} grids have axes of their own (CD); here all motions are along the basic axes.")
    named = [row[0].upper() for row in bulk.rows["PARAM"] if row and row[0].upper() != "WTMASS"]
    if named:
        notes.append(f"Parameters are not carried over: {', '.join(dict.fromkeys(named))}.")
    if scale != 1.0:
        notes.append(f"PARAM WTMASS = {scale:g} was multiplied into densities and masses.")
    return notes
