"""Nastran bulk data with their labels: mesh, property sets, materials, rigid elements, concentrated masses.

Read here and not by meshio, which drops labels, coordinate systems, rigid elements, masses and materials.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Bools, Ints
from morembs.importers.decks.formulations import nastran_mass_warnings, nastran_meaning, warnings_of
from morembs.importers.decks.labels import distinct, find, ranges_by_number, ranges_of
from morembs.importers.decks.model import Deck
from morembs.importers.decks.options import deck_options, describe_left_out
from morembs.importers.decks.tables import Elements, LeftOut, Section, Supports
from morembs.importers.imported import Imported, nodes_of
from morembs.importers.nastran.bulk import Bulk
from morembs.importers.nastran.geometry import card_of
from morembs.importers.nastran.names import OF_STRUCTURES, OF_TEMPERATURE, RESTRAINTS, SCALARS
from morembs.importers.nastran.properties import Materials, labels_of, pad
from morembs.importers.nastran.restraints import supports_of
from morembs.importers.nastran.rigid import Ties
from morembs.importers.nastran.springs import Springs
from morembs.importers.nastran.structures import Structures

# Values of PARAM COUPMASS that leave the mass lumped.
OFF = ("-1", "NO", "")
_SET = re.compile(r"^[ \t]*SET[ \t]+(\d{1,9})[ \t]*=((?:[^\n]*,[ \t]*\n)*[^\n]*)", re.MULTILINE | re.IGNORECASE)
# Of bulk data behind an executive and case control.
HEAD_NOTE = "Executive and case control are not carried over, sets of labels excepted."


def read_nastran(
    path: str | Path,
    *,
    density: float | dict[str, float] | None = None,
    skip: list[str] | str = "",
    allow_includes_outside: bool = False,
) -> Deck:
    """All of a file of bulk data by labels, in the units of the file, along the basic axes.

    Elements of the property 3 are the set "PSOLID_3"; SET1 5 and SET 5 of case control are "SET1_5" and "SET_5".
    Restraints and loads are not applied (``notes`` say so).

    Args:
        density: of materials without one (before WTMASS), or set -> density, "all" standing for all.
        skip: cards to leave out, although stiffness or mass may depend on them.
        allow_includes_outside: INCLUDE may name files beyond the folder of the file.

    Peak memory: the numbers of the mesh about twice, besides a piece of the file as tables (about 150 MB).

    Raises:
        DeckError: what ends the reading, with all problems that were found before.
    """
    bulk = Bulk(Path(path), outside=allow_includes_outside, options=deck_options(density, "refuse", skip))
    return deck_of(bulk)


def deck_of(bulk: Bulk, *, is_held: bool = False) -> Deck:
    """The tables of bulk data; of a model that ``is_held`` supports have to be there.

    Raises:
        DeckError: what ends the reading, with all problems that were found before.
    """
    with bulk.problems.ending():
        scale = bulk.mass_scale()
        solids, materials = solid_elements(bulk), Materials(bulk.file, bulk.rows, scale)
        structures = Structures(bulk, materials)
        turning = grids_of(bulk, structures.parts)
        ties, springs = tie_grids(bulk, grids_of(bulk, solids) & ~turning, scale)
        return _deck(bulk, solids, structures, materials, ties, springs, is_held=is_held)


def _deck(
    bulk: Bulk,
    solids: Sequence[Elements],
    structures: Structures,
    materials: Materials,
    ties: Ties,
    springs: Springs,
    *,
    is_held: bool,
) -> Deck:
    grids, scale, remarks = bulk.grids, ties.scale, list[str]()
    parts = [*solids, *structures.parts]
    whole = Imported(
        source=bulk.file,
        rigid=tuple(ties.rigid),
        average=tuple(ties.average),
        masses=tuple(ties.masses),
        equations=tuple(ties.equations),
        discrete=tuple(springs.elements),
    )
    used = grids_of(bulk, parts)
    used[nodes_of(whole.ties)] = True
    properties = ranges_by_number((part.ids, part.numbers["property"]) for part in solids)
    node_sets, element_sets = _sets(bulk, used, parts, remarks)
    sections = [*materials.of_solids(list(properties), bulk.systems, grids), *structures.sections]
    for name, count in _count_unused(bulk, sections, materials).items():
        bulk.noted[name] = count
    supports, out = Supports(), {name: LeftOut(count, _why(name)) for name, count in bulk.noted.items()}
    try:
        supports = supports_of(bulk)
    except InputError as error:
        if is_held:
            raise
        # A free body does without.
        out["SPC"] = LeftOut(1, str(error))
    whole = whole.on_rows(grids.ids.__getitem__)
    return Deck(
        name=bulk.file,
        program="Nastran",
        node="grid",
        ids=grids.ids,
        xyz=grids.xyz,
        elements=tuple(parts),
        node_sets=node_sets,
        element_sets={f"PSOLID_{pid}": own for pid, own in properties.items()} | structures.sets | element_sets,
        materials=materials.known,
        sections=tuple(sections),
        rigid=whole.rigid,
        average=whole.average,
        masses=whole.masses,
        equations=whole.equations,
        discrete=whole.discrete,
        systems=bulk.systems.placed,
        turned=grids.ids[grids.cd != 0],
        supports=supports,
        left_out=out,
        notes=tuple(_notes(bulk, scale, is_held=is_held)),
        remarks=(*remarks, *materials.notes, *ties.notes),
        warnings=(*_skipped_warnings(bulk), *dict.fromkeys(materials.warnings)),
        mesh_warnings=_warnings(bulk, solids),
        problems=tuple(bulk.problems.entries),
        options=bulk.options,
        mass_scale=scale,
        seams=True,
    )


def _count_unused(bulk: Bulk, sections: Sequence[Section], materials: Materials) -> dict[str, int]:
    """How many cards there are of properties and materials of shells and bars of which no element uses any."""
    used = {word.split()[0] for word in (*materials.known, *(section.code for section in sections))}
    names = (name for name in (*OF_STRUCTURES, "MAT2", "MAT8") if name not in used)
    return {name: len(bulk.rows[name]) for name in names if bulk.rows[name]}


def _skipped_warnings(bulk: Bulk) -> list[str]:
    """Warnings of cards that were skipped, and of cards that make materials depend on temperature."""
    skipped = [describe_left_out(name, count) for name, count in bulk.skipped.items()]
    cold = [
        f"{name} makes materials depend on temperature; their own values were taken [temperature-first-row]"
        for name in OF_TEMPERATURE
        if name in bulk.noted
    ]
    return [*skipped, *cold]


def grids_of(bulk: Bulk, parts: Sequence[Elements]) -> Bools:
    """Which grids elements have."""
    solid = np.zeros(len(bulk.grids.ids), dtype=bool)
    for part in parts:
        nodes = part.nodes[bulk.grids.labels.has(part.nodes)]
        solid[bulk.grids.labels.rows(nodes, "elements name")] = True
    return solid


def tie_grids(bulk: Bulk, solid: Bools, scale: float) -> tuple[Ties, Springs]:
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
        if bulk.rows["MPC"]:
            ties.mpc(bulk.rows["MPC"], *bulk.choose("MPC"))
    return ties, springs


def solid_elements(bulk: Bulk) -> list[Elements]:
    """All solids by shape and meaning, with the numbers of their "property"; ``bulk.solids`` gives them up."""
    full = [int(words[0]) for row in bulk.rows["PSOLID"] if _is_full(words := pad(row, 6))]
    three = [int(words[0]) for row in bulk.rows["PSOLID"] if _has_three_points(words := pad(row, 6))]
    parts = []
    for shape, ids, pids, nodes in bulk.solids.blocks():
        code, asked = card_of(shape), np.isin(pids, full)
        of = {given: nastran_meaning(code, nodes.shape[1], full=given) for given in (False, True)}
        for meaning in dict.fromkeys(of.values()):
            rows = np.flatnonzero(np.where(asked, of[True] == meaning, of[False] == meaning))
            if len(rows):
                numbers = {"property": pids[rows], "points": np.where(np.isin(pids[rows], three), 3, 0)}
                parts.append(
                    Elements(
                        code=code,
                        kind="solid",
                        shape=shape,
                        ids=ids[rows],
                        nodes=nodes[rows],
                        meaning=meaning,
                        numbers=numbers,
                    )
                )
    return parts


def _is_full(words: list[str]) -> bool:
    """True if a PSOLID asks for full integration."""
    return words[0].isdigit() and words[5].upper() in ("1", "FULL") and words[3].upper() in ("2", "TWO", "3", "THREE")


def _has_three_points(words: list[str]) -> bool:
    """True if a PSOLID asks for three points along each edge."""
    return words[0].isdigit() and words[3].upper() in ("3", "THREE")


def _warnings(bulk: Bulk, parts: Sequence[Elements]) -> tuple[str, ...]:
    """What the element types mean otherwise in Nastran, and what the text warns of."""
    names = ((f"{part.code} with {part.nodes.shape[1]} nodes", len(part.ids), part.meaning) for part in parts)
    consistent = bulk.parameter("COUPMASS", "-1").lstrip("+") not in OFF
    mass = nastran_mass_warnings(sum(len(part.ids) for part in parts), consistent=consistent)
    return (*warnings_of("Nastran", names), *mass, *bulk.text.warnings)


def _sets(
    bulk: Bulk, used: Bools, parts: Sequence[Elements], notes: list[str]
) -> tuple[dict[str, Ints], dict[str, Ints]]:
    """Sets of SET1 and of case control, of grids and of elements; one of case control that fits grids which are
    ``used`` is of these."""
    ids, node_sets, element_sets = bulk.grids.ids, dict[str, Ints](), dict[str, Ints]()
    for card in bulk.rows["SET1"]:
        what = f"{bulk.file}: SET1 {pad(card, 1)[0]}"
        node_sets[f"SET1_{card[0]}"] = ranges_of(np.array(labels_of(card[1:], what, ids), dtype=np.int64))
    known = distinct(np.concatenate([ids[:0], *(part.ids for part in parts)]))
    for number, text in _SET.findall(bulk.text.head):
        words = text.upper().replace(",", " ").split()
        name, what = f"SET_{int(number)}", f"{bulk.file}: SET {number}"
        if not words or not all(word == "THRU" or word.isdigit() for word in words):
            notes.append(f"SET {number} of case control is not a plain list of labels and was left out.")
            continue
        labels = np.array(labels_of(words, what, ids), dtype=np.int64)
        if bulk.grids.labels.has(labels).all() and used[bulk.grids.labels.rows(labels, what)].any():
            node_sets[name] = ranges_of(labels)
            notes.append(f"SET {number} of case control was read as a set of grids.")
            continue
        labels = np.array(labels_of(words, what, known), dtype=np.int64)
        if find(known, labels)[1].all() and len(labels):
            element_sets[name] = ranges_of(labels)
            notes.append(f"SET {number} of case control was read as a set of elements.")
        else:
            notes.append(f"SET {number} of case control names neither grids nor elements only and was left out.")
    return node_sets, element_sets


def _why(name: str) -> str:
    return "not applied; the body is free" if name in RESTRAINTS else "not carried over"


def _notes(bulk: Bulk, scale: float, *, is_held: bool = False) -> list[str]:
    """What was left out, a sentence each; of a model that ``is_held`` nothing on restraints."""
    notes = []
    if bulk.text.head.strip():
        notes.append(HEAD_NOTE)
    for name, count in bulk.noted.items():
        if not (is_held and name in RESTRAINTS[:3]):
            notes.append(f"{count} {name}: {_why(name)}.")
    if bulk.grids.fixed and not is_held:
        notes.append("Permanent restraints of grids (PS) are not applied; the body is free.")
    if bulk.grids.repeated:
        notes.append(f"{bulk.grids.repeated} grids are given twice in the same way.")
    if bulk.grids.superelements:
        notes.append(f"{bulk.grids.superelements} grids belong to superelements (SEID); all of the file is one model.")
    turned = int((bulk.grids.cd != 0).sum())
    if turned:
        notes.append(f"{turned} grids have axes of their own (CD); here all motions are along the basic axes.")
    named = [row[0].upper() for row in bulk.rows["PARAM"] if row and row[0].upper() != "WTMASS"]
    if named:
        notes.append(f"Parameters are not carried over: {', '.join(dict.fromkeys(named))}.")
    if scale != 1.0:
        notes.append(f"PARAM WTMASS = {scale:g} was multiplied into densities and masses.")
    return notes
