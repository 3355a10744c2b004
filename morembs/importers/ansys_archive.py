"""Commands of an ANSYS archive (CDWRITE, or the ds.dat of Workbench), read into plain tables."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.importers import ansys_blocks as blocks
from morembs.importers.ansys_elements import Elements, from_plain_form, from_solid_form
from morembs.importers.ansys_properties import ELASTIC, SAID

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# What ties nodes together: without it the model would be another one.
TIES = {
    "CE": "constraint equations", "CP": "coupled dofs", "CERIG": "rigid regions", "RBE3": "RBE3 constraints",
    "CEINTF": "constraint equations", "CPINTF": "coupled dofs", "CPLGEN": "coupled dofs", "CPNGEN": "coupled dofs",
    "CECYC": "cyclic constraints", "CPCYC": "cyclic constraints", "EINTF": "interface elements",
}  # fmt: skip
ELSEWHERE = {"CDREAD": "another archive", "/INPUT": "another file", "*USE": "a macro"}
LOADS = {
    "F": "nodal forces", "SF": "surface loads", "SFE": "surface loads", "BF": "body loads", "BFE": "body loads",
    "BFBLOCK": "body loads", "SFEBLOCK": "surface loads",
}  # fmt: skip
# Tables that change the elastic stiffness; those of plasticity and the like act beyond it.
ELASTIC_TABLES = ("ELAS", "ANEL", "HYPE", "FOAM", "GASK", "COMP", "USER", "PELA", "SMA", "BB", "MOONEY", "CAST")


@dataclass
class Archive:
    """What an archive holds, by label; ``types`` type -> (number of the element, key options)."""

    name: str
    ids: list[Ints] = field(default_factory=list)
    xyz: list[Floats] = field(default_factory=list)
    angles: list[Floats] = field(default_factory=list)
    elements: list[tuple[int, Elements]] = field(default_factory=list)
    types: dict[int, tuple[int, dict[int, int]]] = field(default_factory=dict)
    plain: list[tuple[int, Ints]] = field(default_factory=list)
    # Ranges (k, 2) of labels: written out, a damaged file could fill the memory.
    node_sets: dict[str, Ints] = field(default_factory=dict)
    element_sets: dict[str, Ints] = field(default_factory=dict)
    properties: dict[int, dict[str, float]] = field(default_factory=dict)
    reals: dict[int, list[float]] = field(default_factory=dict)
    supports: int = 0
    loads: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    current_type: int = 1
    current_real: int = 0


def read_commands(path: Path) -> Archive:
    """All commands of an archive that matter to a model.

    Raises:
        InputError: the file is missing, not an archive, cut off or damaged, or holds what a model cannot carry.
    """
    archive = Archive(path.name)
    lines = blocks.Lines(path)
    for line in lines:
        text = line.decode("latin-1").split("!")[0].strip()
        if not text:
            continue
        fields = [part.strip() for part in text.split(",")]
        command = fields[0].upper()
        try:
            _take(archive, command, fields, lines)
        except (ValueError, IndexError, OverflowError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(
                f"{path.name}, line {lines.number}: {text[:60]!r} cannot be read; expected an archive with numbers "
                "(CDWRITE,DB,model,cdb), not a program with parameters"
            ) from error
    for kind, table in archive.plain:
        if kind not in archive.types:
            raise InputError(f"{path.name}: EBLOCK has elements of the type {kind}, which no ET defines")
        routine = archive.types[kind][0]
        archive.elements.append((kind, from_plain_form(table, routine, path.name)))
    return archive


def _take(archive: Archive, command: str, fields: list[str], lines: blocks.Lines) -> None:
    if command == "NBLOCK":
        for values, store in zip(
            blocks.node_block(lines, fields), (archive.ids, archive.xyz, archive.angles), strict=True
        ):
            store.append(values)  # type: ignore[attr-defined]
    elif command == "EBLOCK":
        solid, table = blocks.element_block(lines, fields)
        if not solid:
            archive.plain.append((archive.current_type, table))
        elif len(table):
            parts = from_solid_form(table, archive.name)
            held, count = sum(len(part.ids) for _, part in parts), blocks.announced(fields, 4)
            if count and held != count:
                raise InputError(
                    f"{archive.name}: EBLOCK holds {held} elements where it announces {count}; it is cut off"
                )
            archive.elements.extend(parts)
    elif command in ("CMBLOCK", "ETBLOCK", "RLBLOCK"):
        _take_table(archive, command, fields, lines)
    elif command in ("ET", "KEYOP", "KEYOPT", "TYPE", "R", "RMORE", "RMODIF"):
        _take_type(archive, command, fields)
    elif command in ("MP", "MPDATA", "MPTEMP", "UIMP", "TB"):
        _take_material(archive, command, fields)
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
    elif command in TIES:
        raise InputError(
            f"{archive.name} holds {TIES[command]} ({command}), which are not read; delete them (CEDELE, CPDELE) and "
            "couple the nodes as an interface of the job, or export the matrices with HBMAT, where they are eliminated"
        )
    elif command in ELSEWHERE and len(fields) > 1:
        raise InputError(
            f"{archive.name} reads {ELSEWHERE[command]} ({command},{fields[1]}), which is not followed; write one "
            "archive (CDWRITE,DB,model,cdb)"
        )
    elif command in ("N", "EN", "E", "EMORE") and not (fields[1].upper().startswith("R5") and "-1" in fields):
        raise InputError(
            f"{archive.name}, line {lines.number}: {command} defines a node or element by itself, which is not read; "
            "write the archive in blocks (CDWRITE,DB,model,cdb without UNBLOCKED)"
        )


def _take_table(archive: Archive, command: str, fields: list[str], lines: blocks.Lines) -> None:
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
    if command == "TYPE":
        archive.current_type = int(fields[1])
    elif command == "ET":
        digits = "".join(c if c.isdigit() else " " for c in fields[2]).split()
        keys = {i: int(float(word)) for i, word in enumerate(fields[3:9], start=1) if word}
        archive.types[int(fields[1])] = int(digits[-1]), keys
    elif command in ("KEYOP", "KEYOPT"):
        kind = int(fields[1])
        if kind not in archive.types:
            raise InputError(f"{archive.name}: KEYOPT names the element type {kind}, which no ET defines before it")
        archive.types[kind][1][int(fields[2])] = int(float(fields[3] or 0)) if len(fields) > 3 else 0
    elif command == "RMODIF":
        raise InputError(f"{archive.name} changes real constants (RMODIF), which is not read; write it again (CDWRITE)")
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
        if fields[1].upper().startswith(ELASTIC_TABLES):
            raise InputError(
                f"{archive.name} gives elastic constants in a table (TB,{fields[1]}), which is not read; give EX, NUXY "
                "and DENS (MP), or the material in the job"
            )
        archive.notes.append(f"the material table TB,{fields[1]},{fields[2]} was left out: it is not linear elastic")
        return
    if command == "UIMP":
        for label, value in zip(fields[2:5], fields[5:8], strict=False):
            _set(archive, label, int(fields[1]), [value])
        return
    if command == "MP":
        _set(archive, fields[1], int(fields[2]), fields[3:4] + [w for w in fields[4:8] if w and _number(w)])
        return
    at = 3 if fields[1].upper().startswith("R") and "." in fields[1] else 1
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
    if any(value != values[0] for value in values) or known.get(label, values[0]) != values[0]:
        raise InputError(
            f"{archive.name}: {label} of material {number} depends on temperature (or is given twice); expected one "
            "value, that of the temperature of interest"
        )
    known[label] = values[0]


def _number(word: str) -> float:
    value = float(word or 0)
    if not math.isfinite(value):
        raise ValueError(word)
    return value
