"""Nastran bulk data with their labels: mesh, property sets, materials, rigid elements, concentrated masses.

Read here and not by meshio, which drops labels, coordinate systems, rigid elements, masses and materials.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.importers.formulations import Meaning, nastran_mass_warnings, nastran_meaning, warnings_of
from morembs.importers.imported import Imported, nodes_of, on_rows
from morembs.importers.nastran_cards import real, tables
from morembs.importers.nastran_geometry import SOLIDS, Grids, Solids, Systems, card_of
from morembs.importers.nastran_properties import Materials, Rows, Ties, labels_of, padded
from morembs.importers.nastran_text import BulkText
from morembs.model import ElementBlock, Mesh, Nodes

Ints = NDArray[np.int64]
_SYSTEMS = ("CORD1R", "CORD1C", "CORD1S", "CORD2R", "CORD2C", "CORD2S")
_READ = ("PSOLID", "MAT1", "MAT9", "RBE2", "RBE3", "RBAR", "CONM2", "PARAM", "SET1", "GRDSET", *_SYSTEMS)
_RESTRAINTS = ("SPC", "SPC1", "SPCADD", "SPCD", "SUPORT", "SUPORT1")
# Neither stiffness nor mass of the model depends on these; they are left out with a note.
_NOTED = {
    *_RESTRAINTS, "EIGRL", "EIGR", "EIGB", "EIGC", "EIGP", "FORCE", "FORCE1", "MOMENT", "MOMENT1", "PLOAD", "PLOAD1",
    "PLOAD2", "PLOAD4", "GRAV", "RFORCE", "LOAD", "DLOAD", "LSEQ", "DAREA", "RLOAD1", "RLOAD2", "TLOAD1", "TLOAD2",
    "TABLED1", "TABLED2", "TABDMP1", "FREQ", "FREQ1", "FREQ2", "FREQ3", "FREQ4", "TSTEP", "TEMP", "TEMPD", "TEMPP1",
    "PLOTEL", "ASET", "ASET1", "QSET", "QSET1", "BSET", "BSET1", "CSET", "CSET1", "OMIT", "OMIT1", "SPOINT", "ECHOON",
    "ECHOOFF", "NLPARM", "SET3", "MATT1", "MATT9", "MDLPRM", "TABLEM1", "PBAR", "PBARL", "PBEAM", "PBEAML", "PSHELL",
    "PROD", "PELAS", "PBUSH",
}  # fmt: skip
_PARAM = re.compile(r"^[ \t]*PARAM[ \t]*,[ \t]*(\w+)[ \t]*,[ \t]*([^\s,]+)", re.MULTILINE | re.IGNORECASE)
# Values of PARAM COUPMASS that leave the mass lumped.
OFF = ("-1", "NO", "")
_SET = re.compile(r"^[ \t]*SET[ \t]+(\d{1,9})[ \t]*=((?:[^\n]*,[ \t]*\n)*[^\n]*)", re.MULTILINE | re.IGNORECASE)


class _Bulk:
    """The cards of a file, sorted by what they are."""

    def __init__(self, path: Path, *, outside: bool) -> None:
        self.file = path.name
        self.grids, self.solids, self.systems = Grids(path.name), Solids(path.name), Systems(path.name)
        self.rows: dict[str, Rows] = {name: [] for name in _READ}
        self.noted: dict[str, int] = {}
        refused: dict[str, int] = {}
        self.text = BulkText(path, outside=outside)
        for table in tables(self.text):
            if table.name == "GRID":
                self.grids.add(table)
            elif table.name in SOLIDS:
                self.solids.add(table)
            elif table.name in self.rows:
                self.rows[table.name] += table.rows()
            elif table.name in _NOTED:
                self.noted[table.name] = self.noted.get(table.name, 0) + len(table)
            else:
                refused[table.name] = refused.get(table.name, 0) + len(table)
        if refused:
            # Lines of a file that is no deck have names with other characters; they are not shown.
            listed = ", ".join(f"{count} {name if name.isalnum() else '(no name)'}" for name, count in refused.items())
            raise InputError(
                f"{path.name} has cards that cannot be carried: {listed}; expected solids ({', '.join(SOLIDS)}), RBE2, "
                "RBE3, RBAR and CONM2; take the others out if the model is right without them"
            )
        if len(self.rows["GRDSET"]) > 1:
            raise InputError(f"{path.name} has {len(self.rows['GRDSET'])} cards GRDSET; expected one")
        self.grids.sort(self.rows["GRDSET"][0] if self.rows["GRDSET"] else [])
        for name in _SYSTEMS:
            for row in self.rows[name]:
                self.systems.add(name, padded(row, 4))
        self.grids.place(self.systems)

    def mass_scale(self) -> float:
        """PARAM WTMASS."""
        value = real(self.parameter("WTMASS", "1."), f"{self.file}: PARAM WTMASS")
        if not value > 0:
            raise InputError(f"{self.file}: PARAM WTMASS = {value:g} was given; expected a positive number")
        return value

    def parameter(self, name: str, default: str) -> str:
        """Value of a PARAM, in the bulk data or above them.

        Raises:
            InputError: it is given twice with different values.
        """
        cards = [*self.rows["PARAM"], *([key.upper(), text] for key, text in _PARAM.findall(self.text.head))]
        given = {padded(row, 2)[1].upper() for row in cards if row and row[0].upper() == name}
        if len(given) > 1:
            raise InputError(f"{self.file} gives PARAM {name} as {' and as '.join(sorted(given))}; expected one value")
        return given.pop() if given else default


def read_nastran(path: Path, *, allow_includes_outside: bool = False) -> Mesh:
    """Mesh of bulk data in the units of the file; materials are not read.

    Raises:
        InputError: not bulk data, or cards that a mesh cannot carry.
    """
    bulk = _Bulk(path, outside=allow_includes_outside)
    ties = [name for name in ("RBE2", "RBE3", "RBAR", "CONM2") if bulk.rows[name]]
    if ties:
        raise InputError(
            f"{bulk.file} has {', '.join(ties)}, which a mesh cannot carry; import the whole file, or take them out"
        )
    return _mesh(bulk, np.empty(0, dtype=np.int64), [])[0]


def import_nastran(path: str | Path, *, allow_includes_outside: bool = False) -> Imported:
    """All of a file of bulk data that a model can carry, in the units of the file, along the basic axes.

    Elements of the property 3 are the set "PSOLID_3"; SET1 5 and SET 5 of case control are "SET1_5" and "SET_5". The
    rows of ``nodes`` are those of ``mesh.nodes``, and behind them grids that belong to no element but are named by a
    rigid element or a mass. Restraints and loads are not applied (``notes`` say so). ``allow_includes_outside`` lets
    INCLUDE name files beyond the folder of the file.

    Peak memory: the numbers of the mesh about twice, besides a piece of the file as tables (about 150 MB).

    Raises:
        InputError: the file is not bulk data, contradicts itself, or holds what a model cannot carry.
    """
    bulk = _Bulk(Path(path), outside=allow_includes_outside)
    scale = bulk.mass_scale()
    ties = Ties(bulk.grids, bulk.systems, scale)
    for name, take in (("RBE2", ties.rbe2), ("RBE3", ties.rbe3), ("RBAR", ties.rbar), ("CONM2", ties.conm2)):
        for card in bulk.rows[name]:
            take(card)
    notes: list[str] = []
    mesh, nodes, row = _mesh(bulk, nodes_of([*ties.rigid, *ties.average, *ties.masses]), notes)
    pids = [int(name.removeprefix("PSOLID_")) for name in mesh.element_sets if name.startswith("PSOLID_")]
    materials = Materials(bulk.file, scale)
    assigned = materials.of(pids, bulk.rows["PSOLID"], bulk.rows, bulk.systems, bulk.grids)
    return Imported(
        source=bulk.file,
        nodes=nodes,
        mesh=mesh,
        materials=tuple(assigned),
        rigid=on_rows(ties.rigid, row),
        average=on_rows(ties.average, row),
        masses=on_rows(ties.masses, row),
        notes=(*_notes(bulk, scale), *notes, *materials.notes, *ties.notes),
        incomplete=materials.lacking,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Part:
    """Solids (k,) of one type and meaning: labels, property ids and ``nodes`` (k, n), rows of grids."""

    type: str
    meaning: Meaning
    ids: Ints
    pids: Ints
    nodes: Ints


def _parts(bulk: _Bulk) -> list[_Part]:
    """All solids; ``bulk.solids`` gives them up."""
    full = [int(words[0]) for row in bulk.rows["PSOLID"] if _is_full(words := padded(row, 6))]
    parts = []
    for kind, ids, pids, nodes in bulk.solids.blocks(bulk.grids):
        whole = np.isin(pids, full)
        of = {given: nastran_meaning(card_of(kind), nodes.shape[1], full=given) for given in (False, True)}
        for meaning in dict.fromkeys(of.values()):
            rows = np.flatnonzero(np.where(whole, of[True] == meaning, of[False] == meaning))
            if len(rows):
                parts.append(_Part(type=kind, meaning=meaning, ids=ids[rows], pids=pids[rows], nodes=nodes[rows]))
    return parts


def _is_full(words: list[str]) -> bool:
    """Whether a PSOLID asks for full integration."""
    return words[0].isdigit() and words[5].upper() in ("1", "FULL") and words[3].upper() in ("2", "TWO", "3", "THREE")


def _warnings(bulk: _Bulk, parts: Sequence[_Part]) -> tuple[str, ...]:
    """What the element types mean otherwise in Nastran, and what the text warns of."""
    names = ((f"{card_of(part.type)} with {part.nodes.shape[1]} nodes", len(part.ids), part.meaning) for part in parts)
    consistent = bulk.parameter("COUPMASS", "-1").lstrip("+") not in OFF
    mass = nastran_mass_warnings(sum(len(part.ids) for part in parts), consistent=consistent)
    return (*warnings_of("Nastran", names), *mass, *bulk.text.warnings)


def _mesh(bulk: _Bulk, extra: Ints, notes: list[str]) -> tuple[Mesh, Nodes, Ints]:
    """Mesh, its nodes with ``extra`` rows behind them, and the row among these of all grids (or -1)."""
    grids = bulk.grids
    parts = _parts(bulk)
    used = np.zeros(len(grids.ids), dtype=bool)
    for part in parts:
        used[part.nodes] = True
    kept, loose = np.flatnonzero(used), np.unique(extra[~used[extra]])
    row = np.full(len(grids.ids), -1, dtype=np.int64)
    row[kept] = np.arange(len(kept))
    row[loose] = len(kept) + np.arange(len(loose))
    blocks = tuple(
        ElementBlock(
            type=part.type, nodes=row[part.nodes], ids=part.ids, formulation=part.meaning.formulation,
            mass=part.meaning.mass,
        )
        for part in parts
    )  # fmt: skip
    properties = [part.pids for part in parts]
    element_sets = {
        f"PSOLID_{pid}": tuple(np.flatnonzero(own == pid) for own in properties)
        for pid in np.unique(np.concatenate([np.unique(own) for own in properties])).tolist()
    }
    left = len(grids.ids) - len(kept) - len(loose)
    if left:
        notes.append(f"{left} grids belong to no element and were left out (first: {grids.ids[row < 0][0]}).")
    node_sets = _sets(bulk, row, blocks, element_sets, notes)
    inside = {name: rows[rows < len(kept)] for name, rows in node_sets.items()}
    mesh = Mesh(
        nodes=Nodes(ids=grids.ids[kept], xyz=grids.xyz[kept], sets={n: r for n, r in inside.items() if len(r)}),
        blocks=blocks, element_sets=element_sets, source=bulk.file, warnings=_warnings(bulk, parts),
    )  # fmt: skip
    if not len(loose):
        return mesh, mesh.nodes, row
    both = np.concatenate([kept, loose])
    return mesh, Nodes(ids=grids.ids[both], xyz=grids.xyz[both], sets=node_sets), row


def _sets(
    bulk: _Bulk, row: Ints, blocks: tuple[ElementBlock, ...], element_sets: dict[str, tuple[Ints, ...]],
    notes: list[str],
) -> dict[str, Ints]:  # fmt: skip
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
        known = np.sort(np.concatenate([block.ids for block in blocks]))
        labels = np.array(labels_of(words, what, known), dtype=np.int64)
        if np.isin(labels, known).all() and len(labels):
            element_sets[name] = tuple(np.flatnonzero(np.isin(block.ids, labels)) for block in blocks)
            notes.append(f"SET {number} of case control was read as a set of elements.")
        else:
            notes.append(f"SET {number} of case control names neither grids nor elements only and was left out.")
    return sets


def _notes(bulk: _Bulk, scale: float) -> list[str]:
    """What was left out, a sentence each."""
    notes = []
    if bulk.text.head.strip():
        notes.append("Executive and case control are not carried over, sets of labels excepted.")
    for name, count in bulk.noted.items():
        reason = "not applied; the body is free" if name in _RESTRAINTS else "not carried over"
        notes.append(f"{count} {name}: {reason}.")
    if bulk.grids.fixed:
        notes.append("Permanent restraints of grids (PS) are not applied; the body is free.")
    turned = int((bulk.grids.cd != 0).sum())
    if turned:
        notes.append(f"{turned} grids have axes of their own (CD); here all motions are along the basic axes.")
    named = [row[0].upper() for row in bulk.rows["PARAM"] if row and row[0].upper() != "WTMASS"]
    if named:
        notes.append(f"Parameters are not carried over: {', '.join(dict.fromkeys(named))}.")
    if scale != 1.0:
        notes.append(f"PARAM WTMASS = {scale:g} was multiplied into densities and masses.")
    return notes
