"""Nastran bulk data with their labels: mesh, property sets, materials, rigid elements, concentrated masses.

Read here and not by meshio, which drops labels, coordinate systems, rigid elements, masses and materials.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.importers.abaqus_keywords import Card
from morembs.importers.deck_options import DeckOptions, deck_options, lacking_problems
from morembs.importers.formulations import Meaning, nastran_mass_warnings, nastran_meaning, warnings_of
from morembs.importers.imported import Imported, nodes_of, on_rows
from morembs.importers.nastran_cards import real, tables
from morembs.importers.nastran_geometry import SOLIDS, Grids, Solids, Systems, card_of
from morembs.importers.nastran_properties import Materials, Rows, Ties, labels_of, padded
from morembs.importers.nastran_springs import SCALARS, Springs
from morembs.importers.nastran_text import BulkText
from morembs.importers.problems import Problem, Problems
from morembs.model import ElementBlock, Mesh, Nodes
from morembs.model.constraints import Equations

Ints = NDArray[np.int64]
_SYSTEMS = ("CORD1R", "CORD1C", "CORD1S", "CORD2R", "CORD2C", "CORD2S")
_READ = (
    "PSOLID", "MAT1", "MAT9", "RBE2", "RBE3", "RBAR", "CONM1", "CONM2", "PARAM", "SET1", "GRDSET", "MPC", "MPCADD",
    "CBUSH", "PBUSH", *SCALARS, "PELAS", "PMASS", "PDAMP", *_SYSTEMS,
)  # fmt: skip
_RESTRAINTS = ("SPC", "SPC1", "SPCADD", "SPCD", "SUPORT", "SUPORT1")
# Neither stiffness nor mass of the model depends on these; they are left out with a note.
_NOTED = {
    *_RESTRAINTS, "EIGRL", "EIGR", "EIGB", "EIGC", "EIGP", "FORCE", "FORCE1", "MOMENT", "MOMENT1", "PLOAD", "PLOAD1",
    "PLOAD2", "PLOAD4", "GRAV", "RFORCE", "LOAD", "DLOAD", "LSEQ", "DAREA", "RLOAD1", "RLOAD2", "TLOAD1", "TLOAD2",
    "TABLED1", "TABLED2", "TABDMP1", "FREQ", "FREQ1", "FREQ2", "FREQ3", "FREQ4", "TSTEP", "TEMP", "TEMPD", "TEMPP1",
    "PLOTEL", "ASET", "ASET1", "QSET", "QSET1", "BSET", "BSET1", "CSET", "CSET1", "OMIT", "OMIT1", "SPOINT", "ECHOON",
    "ECHOOFF", "NLPARM", "SET3", "MDLPRM", "TABLEM1", "PBAR", "PBARL", "PBEAM", "PBEAML", "PSHELL", "PROD", "SPCOFF",
    "SPCOFF1", "SPCR", "SPCAX", "SPCD2", "USET", "USET1", "RELEASE", "EPOINT", "SEQGP", "SEQEP", "MATT2", "MATT3",
    "MATT8", "MATS1", "TABLES1", "TABLEST", "TABLED3", "TABLED4", "TABLEM2", "TABLEM3", "TABLEM4", "TABLE3D",
    "TABRND1", "RANDPS", "TSTEPNL", "TSTEP1", "NLPCI", "NLSTEP", "NLCNTL", "NLCNTL2", "FREQ5", "DPHASE", "DELAY",
    "ACSRCE", "PRESAX", "MOMAX", "FORCE2", "MOMENT2", "PLOADB3", "PLOADX1", "PLOAD3", "PLOADE1", "SLOAD", "DEFORM",
    "ACCEL", "ACCEL1", "TEMPRB", "TEMPP2", "TEMPP3", "TEMPAX", "TEMPF", "TEMPG", "TEMPBC", "MAT2", "MAT3", "MAT4",
    "MAT5", "MAT8", "MAT10", "MATT4", "MATT5", "PCOMP", "PCOMPG", "PSHEAR", "PTUBE", "PBCOMP", "PBEND", "PBMSECT",
    "PBRSECT", "PBEAM3", "PGAP", "PBUSH1D", "PBUSHT", "PELAST", "PDAMPT", "PVISC", "PWELD", "PFAST", "PAERO1",
    "CAERO1", "SPLINE1", "SPLINE2", "AERO", "AEROS", "FLUTTER", "FLFACT", "MKAERO1", "MKAERO2", "SET2", "AESURF",
    "AELIST", "AESTAT", "TRIM", "GUST", "DESVAR", "DRESP1", "DRESP2", "DRESP3", "DVPREL1", "DVPREL2", "DVMREL1",
    "DVCREL1", "DVGRID", "DCONSTR", "DCONADD", "DEQATN", "DLINK", "DOPTPRM", "DSCREEN", "DTABLE", "DDVAL", "TOPVAR",
    "DMI", "DMIJ", "DMIJI", "DTI", "EIGRLX", "MODTRAK", "SUPAX", "CBARAO", "SNORM", "BAROR", "BEAMOR", "CONVM",
    "CHBDYE", "CHBDYG", "CHBDYP", "QBDY1", "QBDY2", "QBDY3", "QHBDY", "QVECT", "QVOL", "RADBC", "RADM", "RADMT",
    "RADSET", "VIEW", "VIEW3D", "CONV", "PCONV", "TOPOPT", "BCPARA", "BCPROP", "BSURF", "BSURFS", "BCBODY", "BCPARM",
    "TICD", "TIC", "RESPONSE", "OUTPUT", "ENDDATA", "TABLEH1", "TABLEHT", "UXVEC", "DIVERG", "CSSCHD", "MONPNT1",
    "MONDSP1", "SEBULK", "PARTN", "USRDAT", "BLSEG", "STREAM", "TEMPB3", "ACCMETR", "TOMVAR", "ROTORG", "ROTORD",
    "UNBALNC", "RSPINR", "RSPINT",
}  # fmt: skip
# Materials that vary with temperature; the values of the material itself hold.
_OF_TEMPERATURE = ("MATT1", "MATT9")
_PARAM = re.compile(r"^[ \t]*PARAM[ \t]*,[ \t]*(\w+)[ \t]*,[ \t]*([^\s,]+)", re.MULTILINE | re.IGNORECASE)
# Values of PARAM COUPMASS that leave the mass lumped.
OFF = ("-1", "NO", "")
_SET = re.compile(r"^[ \t]*SET[ \t]+(\d{1,9})[ \t]*=((?:[^\n]*,[ \t]*\n)*[^\n]*)", re.MULTILINE | re.IGNORECASE)


class _Bulk:
    """The cards of a file, sorted by what they are; those that cannot be carried are problems."""

    def __init__(self, path: Path, *, outside: bool, options: DeckOptions | None = None) -> None:
        self.file, self.options = path.name, options or DeckOptions()
        self.problems = Problems(path.name, self.options.flags)
        self.skipped: dict[str, int] = {}
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
            elif self.options.skips(table.name):
                self.skipped[table.name] = self.skipped.get(table.name, 0) + len(table)
            elif table.name in self.rows:
                self.rows[table.name] += table.rows()
            elif table.name in _NOTED or table.name in _OF_TEMPERATURE:
                self.noted[table.name] = self.noted.get(table.name, 0) + len(table)
            else:
                refused[table.name] = refused.get(table.name, 0) + len(table)
        if refused:
            # Lines of a file that is no deck have names with other characters; they are not shown.
            listed = ", ".join(f"{count} {name if name.isalnum() else '(no name)'}" for name, count in refused.items())
            named = [name for name in refused if name.isalnum()]
            cure = f", or leave them out with --skip {','.join(named)}," if named else ""
            what = (
                f"{path.name} has cards that cannot be carried: {listed}; expected solids ({', '.join(SOLIDS)}), rigid "
                f"elements (RBE2, RBE3, RBAR), MPC, springs (CELAS1, CELAS2, CBUSH), dampers and masses (CONM1, CONM2, "
                f"CMASS1, CMASS2); take the others out{cure} if the model is right without them"
            )
            flags = tuple(f"--skip {name}" for name in named) if len(named) == len(refused) else ()
            self.problems.add(Problem(what=what, file=path.name, keyword=next(iter(refused)), flags=flags))
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
    ties = [name for name in ("RBE2", "RBE3", "RBAR", "CONM1", "CONM2", "MPC", "CBUSH", *SCALARS) if bulk.rows[name]]
    if ties:
        what = f"{bulk.file} has {', '.join(ties)}, which a mesh cannot carry; import the whole file, or take them out"
        bulk.problems.add(Problem(what=what, file=bulk.file, keyword=ties[0]))
    bulk.problems.refuse()
    return _mesh(bulk, np.empty(0, dtype=np.int64), [])[0]


def import_nastran(
    path: str | Path, *, density: float | dict[str, float] | None = None, skip: list[str] | str = "",
    allow_includes_outside: bool = False,
) -> Imported:  # fmt: skip
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
    bulk = _Bulk(Path(path), outside=allow_includes_outside, options=options)
    notes: list[str] = []
    with bulk.problems.ending():
        scale = bulk.mass_scale()
        ties, springs = Ties(bulk.grids, bulk.systems, scale), Springs(bulk.grids, bulk.systems, bulk.rows, scale)
        equations = _ties(bulk, ties, springs, notes)
        everything = Imported(
            source=bulk.file, rigid=tuple(ties.rigid), average=tuple(ties.average), masses=tuple(ties.masses),
            equations=equations, discrete=tuple(springs.found),
        )  # fmt: skip
        mesh, nodes, row = _mesh(bulk, nodes_of(everything.ties), notes)
        pids = [int(name.removeprefix("PSOLID_")) for name in mesh.element_sets if name.startswith("PSOLID_")]
        materials = Materials(bulk.file, scale)
        assigned = materials.of(pids, bulk.rows["PSOLID"], bulk.rows, bulk.systems, bulk.grids)
    given = DeckOptions(density={name: scale * value for name, value in options.density.items()})
    whole, lacking, said = given.completed(assigned, materials.lacking)
    if bulk.problems.found:
        bulk.problems.found += lacking_problems(bulk.file, lacking)
    bulk.problems.refuse()
    skipped = [
        f"{count} {name} left out as asked; stiffness or mass may depend on them [keywords-skipped]"
        for name, count in bulk.skipped.items()
    ]
    cold = [
        f"{name} makes materials depend on temperature; their own values were taken [temperature-first-row]"
        for name in _OF_TEMPERATURE
        if name in bulk.noted
    ]
    return Imported(
        source=bulk.file,
        nodes=nodes,
        mesh=mesh,
        materials=whole,
        rigid=on_rows(ties.rigid, row),
        average=on_rows(ties.average, row),
        equations=on_rows(equations, row),
        masses=on_rows(ties.masses, row),
        discrete=on_rows(springs.found, row),
        notes=(*_notes(bulk, scale), *notes, *materials.notes, *ties.notes),
        warnings=(*skipped, *cold, *said),
        incomplete=lacking,
    )


def _ties(bulk: _Bulk, ties: Ties, springs: Springs, notes: list[str]) -> tuple[Equations, ...]:
    """Rigid elements, masses and springs into ``ties`` and ``springs``, and the equations; faults are problems."""
    readers: dict[str, Callable[[list[str]], None]] = {
        "RBE2": ties.rbe2, "RBE3": ties.rbe3, "RBAR": ties.rbar, "CONM2": ties.conm2, "CONM1": springs.conm1,
        "CBUSH": springs.bush, **{name: partial(springs.scalar, name) for name in SCALARS},
    }  # fmt: skip
    for name, take in readers.items():
        for card in bulk.rows[name]:
            with bulk.problems.collected(Card(name, {}, bulk.file), (f"--skip {name}",)):
                take(card)
    equations = None
    with bulk.problems.collected(Card("MPC", {}, bulk.file), ("--skip MPC",)):
        equations = springs.mpc(bulk.text.head, notes)
    return (equations,) if equations else ()


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
