"""Commands of an ANSYS archive (CDWRITE, or the ds.dat of Workbench), read into plain tables."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem.constraints import Term
from morembs.importers.ansys import blocks
from morembs.importers.ansys.elements import Rows, from_plain_form, from_solid_form
from morembs.importers.ansys.lines import Lines
from morembs.importers.ansys.properties import ELASTIC, SAID
from morembs.importers.ansys.sections import SectionData
from morembs.importers.ansys.singles import Singles
from morembs.importers.decks.options import DeckOptions
from morembs.importers.decks.problems import Problems

# What ties nodes together, and would have to be worked out: without it the model would be another one.
REFUSED = {
    "CERIG": "rigid regions",
    "RBE3": "RBE3 constraints",
    "CEINTF": "constraint equations",
    "CPINTF": "coupled dofs",
    "CPLGEN": "coupled dofs",
    "CPNGEN": "coupled dofs",
    "CECYC": "cyclic constraints",
    "CPCYC": "cyclic constraints",
    "EINTF": "interface elements",
}
DIRECTIONS = {"UX": 0, "UY": 1, "UZ": 2, "ROTX": 3, "ROTY": 4, "ROTZ": 5}
ELSEWHERE = {"CDREAD": "another archive", "/INPUT": "another file", "*USE": "a macro"}
LOADS = {
    "F": "nodal forces",
    "SF": "surface loads",
    "SFE": "surface loads",
    "BF": "body loads",
    "BFE": "body loads",
    "BFBLOCK": "body loads",
    "SFEBLOCK": "surface loads",
}
# Tables that change the elastic stiffness; those of plasticity and the like act beyond it.
ELASTIC_TABLES = ("ELAS", "ANEL", "HYPE", "FOAM", "GASK", "COMP", "USER", "PELA", "SMA", "BB", "MOONEY", "CAST")


_TITLES = ("/COM", "/TITLE", "/STITLE", "C***")
# Commands may be cut to their first four letters.
_SHORT = {
    name[:4]: name
    for name in (
        "NBLOCK",
        "EBLOCK",
        "CMBLOCK",
        "ETBLOCK",
        "RLBLOCK",
        "KEYOPT",
        "RMORE",
        "RMODIF",
        "MPDATA",
        "MPTEMP",
        "TBDATA",
        "CMGRP",
        "CDREAD",
        "EMORE",
        "SECTYPE",
        "SECDATA",
        "SECBLOCK",
        "SECOFFSET",
        "SECCONTROL",
        "SECNUM",
        "BFBLOCK",
        "SFEBLOCK",
        *(name for name in REFUSED if len(name) > 4),
    )
}


@dataclass(frozen=True)
class Place:
    """Where a command stands, for a problem with it."""

    file: str
    line: int
    keyword: str


@dataclass
class Archive:
    """What an archive holds, by label; ``types`` type -> (number of the element, key options)."""

    name: str
    ids: list[Ints] = field(default_factory=list)
    xyz: list[Floats] = field(default_factory=list)
    angles: list[Floats] = field(default_factory=list)
    elements: list[tuple[int, Rows]] = field(default_factory=list)
    types: dict[int, tuple[int, dict[int, int]]] = field(default_factory=dict)
    plain: list[tuple[int, Ints]] = field(default_factory=list)
    # Ranges (k, 2) of labels: written out, a damaged file could fill the memory.
    node_sets: dict[str, Ints] = field(default_factory=dict)
    element_sets: dict[str, Ints] = field(default_factory=dict)
    properties: dict[int, dict[str, float]] = field(default_factory=dict)
    reals: dict[int, list[float]] = field(default_factory=dict)
    supports: int = 0
    skipped: Counter[str] = field(default_factory=Counter)
    loads: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    # What to call each and its terms (node, component, coefficient), which vanish together.
    equations: list[tuple[str, list[Term]]] = field(default_factory=list)
    numbers: dict[int, int] = field(default_factory=dict)
    coupled: dict[tuple[int, int], list[int]] = field(default_factory=dict)
    tables: dict[int, str] = field(default_factory=dict)
    table: tuple[int, str] = (0, "")
    current_real: int = 0
    sections: SectionData = field(default_factory=SectionData)
    singles: Singles = field(default_factory=Singles)


def read_commands(path: Path, problems: Problems | None = None, options: DeckOptions | None = None) -> Archive:
    """All commands of an archive that matter to a model; commands that it cannot carry are among the ``problems``.

    Raises:
        InputError: the file is missing, not an archive, cut off or damaged, or has commands that a model cannot carry.
    """
    archive = Archive(path.name)
    problems, options = problems or Problems(path.name), options or DeckOptions()
    lines = Lines(path)
    for text in _commands(lines):
        fields = [part.strip() for part in text.split(",")]
        command = _SHORT.get(fields[0].upper()[:4], fields[0].upper())
        if options.skips(command, fields[0]):
            archive.skipped[command] += 1
            continue
        try:
            if command in REFUSED:
                with problems.collected(Place(path.name, lines.number, command), (f"--skip {command}",)):
                    _refuse(archive, command, fields)
                continue
            _take(archive, command, fields, lines)
        except (ValueError, IndexError, OverflowError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(
                f"{path.name}, line {lines.number}: {text[:60]!r} cannot be read; expected an archive with numbers "
                "(CDWRITE,DB,model,cdb), not a program with parameters",
                kind="file",
                keyword=path.name,
            ) from error
    archive.warnings += lines.warnings
    if archive.singles.nodes:
        stores = archive.ids, archive.xyz, archive.angles
        for store, values in zip(stores, archive.singles.node_tables(), strict=True):
            store.append(values)  # type: ignore[attr-defined]
    archive.elements.extend(archive.singles.element_tables())
    for kind, table in archive.plain:
        if kind not in archive.types:
            raise InputError(
                f"{path.name}: EBLOCK has elements of the type {kind}, which no ET defines", kind="unsupported"
            )
        routine = archive.types[kind][0]
        archive.elements.append((kind, from_plain_form(table, routine, path.name)))
    return archive


def _commands(lines: Lines) -> Iterator[str]:
    """Commands without comments; a line may hold several, between dollar signs (Mechanical APDL Command Reference, 2.1,
    free-format input), as HyperMesh writes TYPE, 1 $ MAT, 1."""
    for line in lines:
        text = line.decode("latin-1")
        if text.lstrip().upper().startswith(_TITLES):
            continue
        for command in text.split("!")[0].split("$"):
            if command.strip():
                yield command.strip()


def _take(archive: Archive, command: str, fields: list[str], lines: Lines) -> None:
    if command == "NBLOCK":
        for values, store in zip(
            blocks.node_block(lines, fields), (archive.ids, archive.xyz, archive.angles), strict=True
        ):
            store.append(values)  # type: ignore[attr-defined]
    elif command == "EBLOCK":
        solid, table = blocks.element_block(lines, fields)
        if not solid:
            archive.plain.append((archive.singles.current["TYPE"], table))
        elif len(table):
            parts = from_solid_form(table, archive.name)
            held, count = sum(len(part.ids) for _, part in parts), blocks.announced_count(fields, 4)
            if count and held != count:
                raise InputError(
                    f"{archive.name}: EBLOCK holds {held} elements where it announces {count}; it is cut off",
                    kind="file",
                )
            archive.elements.extend(parts)
    elif command in ("CMBLOCK", "ETBLOCK", "RLBLOCK"):
        _take_table(archive, command, fields, lines)
    elif command in archive.singles.current and len(fields) > 1:
        archive.singles.current[command] = int(fields[1] or 0)
    elif command.startswith("SEC"):
        archive.sections.take(command, fields, lines)
    elif command in ("ET", "KEYOPT", "R", "RMORE", "RMODIF"):
        _take_type(archive, command, fields)
    elif command in ("MP", "MPDATA", "MPTEMP", "UIMP", "TB"):
        _take_material(archive, command, fields)
    elif command == "TBDATA" and archive.table[1].startswith("ELAS") and fields[1] in ("", "1"):
        # Isotropic elasticity: Young's modulus and Poisson's ratio.
        known = archive.properties.setdefault(archive.table[0], {})
        if archive.tables.pop(archive.table[0], "") and len(fields) == 4:
            known |= {"EX": _number(fields[2]), "PRXY": _number(fields[3])}
    elif command == "D" and len(fields) > 1:
        archive.supports += 1
    elif command in LOADS:
        archive.loads[LOADS[command]] += 1
    elif command == "/UNITS" and len(fields) > 1:
        archive.notes.append(f"{archive.name} says that its units are {fields[1].upper()} (/UNITS)")
    elif command == "CM":
        archive.notes.append(
            f"CM,{fields[1]} makes a component of what is selected, which a file does not say; left out"
        )
    elif command == "CMGRP":
        archive.notes.append(f"the assembly of components {fields[1]} (CMGRP) was left out; its components are there")
    elif command in ("CE", "CP"):
        (_take_equation if command == "CE" else _take_coupling)(archive, fields, lines.number)
    elif command in ELSEWHERE and len(fields) > 1:
        raise InputError(
            f"{archive.name} reads {ELSEWHERE[command]} ({command},{fields[1]}), which is not followed; write one "
            "archive (CDWRITE,DB,model,cdb)",
            kind="unsupported",
        )
    elif command in ("N", "EN", "E", "EMORE") and not (fields[1].upper().startswith("R5") and "-1" in fields):
        archive.singles.take(command, fields, f"{archive.name}, line {lines.number}")


def _refuse(archive: Archive, command: str, fields: list[str]) -> None:
    raise InputError(
        f"{archive.name} holds {REFUSED[command]} ({command}), which are not read; delete them, leave them out with "
        f"--skip {command}, or export the matrices with HBMAT, where they are eliminated",
        kind="unsupported",
    )


def _take_equation(archive: Archive, fields: list[str], line: int) -> None:
    """CE, number, constant, then node, direction and coefficient; or CE,R5.0,DEFI and lines CE,R5.0,NODE."""
    title = f"{archive.name}, line {line}: CE"
    given = fields[1:]
    if given[0].upper().startswith("R"):
        if given[1].upper().startswith("DEFI"):
            archive.equations.append((title, []))
            return
        terms = given[2:]
    else:
        number = archive.numbers.setdefault(int(given[0]), len(archive.equations))
        if number == len(archive.equations):
            archive.equations.append((title, []))
        terms = given[2:]
    of = archive.equations[-1 if given[0].upper().startswith("R") else number][1]
    for at in range(0, len(terms), 3):
        node, label, value = (*terms[at : at + 3], "", "", "")[:3]
        if node and int(node):
            if label.upper() not in DIRECTIONS:
                raise InputError(f"{title} is on the motion {label!r}; expected one of {', '.join(DIRECTIONS)}")
            of.append((int(node), DIRECTIONS[label.upper()], _number(value)))


def _take_coupling(archive: Archive, fields: list[str], line: int) -> None:
    """CP, set, direction, nodes; lines of one set add nodes to it."""
    given = [word for word in fields[1:] if word]
    if given[0].upper().startswith("R"):
        given = given[1:]
    at = next((i for i, word in enumerate(given) if word.upper() in DIRECTIONS), None)
    nodes = [] if at is None else [abs(int(word)) for word in given[at + 1 :] if word.upper() != "NODE"]
    if at is None or at < 1 or not nodes:
        raise InputError(
            f"{archive.name}, line {line}: CP gives no direction of some nodes; expected CP,1,UX,12,13", kind="missing"
        )
    key = int(given[at - 1]), DIRECTIONS[given[at].upper()]
    archive.coupled.setdefault(key, []).extend(nodes)


def _take_table(archive: Archive, command: str, fields: list[str], lines: Lines) -> None:
    if command == "ETBLOCK":
        for row in blocks.element_types(lines):
            archive.types[row[0]] = row[1], {i: value for i, value in enumerate(row[2:], start=1) if value}
        return
    if command == "RLBLOCK":
        archive.reals |= blocks.real_constants(lines, fields)
        return
    kind = fields[2].upper()
    ranges = blocks.component_block(lines, fields)
    if kind.startswith("NODE"):
        archive.node_sets[fields[1]] = ranges
    elif kind.startswith("ELEM"):
        archive.element_sets[fields[1]] = ranges
    else:
        archive.notes.append(f"the component {fields[1]} of {kind} (geometry) was left out")


def _take_type(archive: Archive, command: str, fields: list[str]) -> None:
    if command == "ET":
        digits = "".join(c if c.isdigit() else " " for c in fields[2]).split()
        keys = {i: int(float(word)) for i, word in enumerate(fields[3:9], start=1) if word}
        archive.types[int(fields[1])] = int(digits[-1]), keys
    elif command == "KEYOPT":
        kind = int(fields[1])
        if kind not in archive.types:
            raise InputError(
                f"{archive.name}: KEYOPT names the element type {kind}, which no ET defines before it",
                kind="unsupported",
            )
        archive.types[kind][1][int(fields[2])] = int(float(fields[3] or 0)) if len(fields) > 3 else 0
    elif command == "RMODIF":
        raise InputError(
            f"{archive.name} changes real constants (RMODIF), which is not read; write it again (CDWRITE)", kind="file"
        )
    else:
        if command == "R":
            archive.current_real = int(fields[1])
        old = archive.reals.get(archive.current_real, []) if command == "RMORE" else []
        values = [_number(word) for word in fields[2 if command == "R" else 1 :]]
        archive.reals[archive.current_real] = [*old, *values, *[0.0] * (6 - len(values))]


def _take_material(archive: Archive, command: str, fields: list[str]) -> None:
    if command == "MPTEMP":
        return
    if command == "TB":
        archive.table = int(fields[2]), fields[1].upper()
        if fields[1].upper().startswith(ELASTIC_TABLES):
            archive.tables[int(fields[2])] = fields[1].upper()
            return
        archive.notes.append(f"the material table TB,{fields[1]},{fields[2]} was left out: it is not linear elastic")
        return
    if command == "UIMP":
        for label, value in zip(fields[2:5], fields[5:8], strict=False):
            _set(archive, label, int(fields[1]), [value])
        return
    if command == "MP":
        _set(archive, fields[1], int(fields[2]), fields[3:4] + [w for w in fields[4:8] if w and _number(w)])
        return
    at = 3 if fields[1].upper() == "UNBL" or (fields[1].upper().startswith("R") and "." in fields[1]) else 1
    _set(archive, fields[at], int(fields[at + 1]), [word for word in fields[at + 3 :] if word])


def _set(archive: Archive, label: str, number: int, words: list[str]) -> None:
    label = label.upper()
    if label in SAID and words:
        archive.notes.append(
            f"material {number} has a {SAID[label]} ({label}), which was left out; give damping in the job"
        )
    if label not in ELASTIC:
        return
    values = [_number(word) for word in words]
    known = archive.properties.setdefault(number, {})
    if not values:
        return
    if any(value != values[0] for value in values) or known.get(label, values[0]) != values[0]:
        archive.warnings.append(
            f"{label} of material {number} depends on temperature; its first value was taken [temperature-first-row]"
        )
    known.setdefault(label, values[0])


def _number(word: str) -> float:
    value = float(word or 0)
    if not math.isfinite(value):
        raise ValueError(word)
    return value
