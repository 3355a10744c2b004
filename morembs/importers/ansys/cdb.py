"""ANSYS archives (.cdb of CDWRITE): mesh, materials, components, point masses. Units are those of the file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem import Nodes
from morembs.fem.constraints import RigidElement, solved_for_first
from morembs.importers.ansys.archive import Archive, read_commands
from morembs.importers.ansys.elements import Rows, solids
from morembs.importers.ansys.names import CARRIERS, CONTACT, FAMILIES, HANGING, NAMES, SOLIDS, Routine, element_name
from morembs.importers.ansys.properties import section
from morembs.importers.ansys.structures import STRUCTURES, Structures
from morembs.importers.ansys.ties import Hanging, point_masses, rigid_beams, springs, sums
from morembs.importers.decks.formulations import ansys_meaning, warnings_of
from morembs.importers.decks.labels import Labels, distinct, ranges_by_number
from morembs.importers.decks.model import Deck
from morembs.importers.decks.options import DeckOptions, deck_options, describe_left_out
from morembs.importers.decks.problems import Problem, Problems
from morembs.importers.decks.tables import ElasticMaterial, Elements, LeftOut, Section
from morembs.importers.imported import DiscreteElement, PointMass

_KINDS = {"SHELL": "shell", "SOLSH": "shell", "BEAM": "beam", "LINK": "truss"}
_SUPPORTS = "not applied: the body is free, its interfaces hold it"
_LOADS = "left out: a body carries no loads"
_CARRIERS = "left out: they have neither stiffness nor mass"


@dataclass(frozen=True, kw_only=True, eq=False)
class AnsysArchive:
    """All ``nodes`` of an archive with its components; ``rotated`` are the labels of those with axes of their own."""

    nodes: Nodes
    rotated: Ints


def read_ansys_archive(path: str | Path) -> AnsysArchive:
    """Nodes of an archive, also those of no element.

    Raises:
        InputError: as ``read_ansys``, but for elements.
    """
    archive = read_commands(Path(path))
    ids, xyz, rotated = _nodes(archive)
    labels = Labels(ids, archive.name)
    sets = {name: labels.members(own, f"the set {name} names") for name, own in archive.node_sets.items()}
    return AnsysArchive(nodes=Nodes(ids=ids, xyz=xyz, sets=sets), rotated=rotated)


def read_ansys(
    path: str | Path,
    *,
    density: float | dict[str, float] | None = None,
    contact: str = "refuse",
    skip: list[str] | str = "",
) -> Deck:
    """All of an archive by labels.

    Elements of material n are in the set "material n", those of type n in "type n". Supports and loads are counted in
    the notes and left out. Memory is that of the mesh and about 150 bytes per line of an EBLOCK.

    Args:
        density: of materials without DENS, or set -> density, "all" standing for all.
        contact: "refuse" or "skip" elements of contact and their targets.
        skip: elements (such as SURF154) and commands to leave out, although stiffness or mass may depend on them.

    Raises:
        DeckError: what ends the reading, with all problems that were found before.
    """
    options = deck_options(density, contact, skip)
    if options.contact == "tie":
        raise InputError(
            "contact = 'tie' was given; contact of ANSYS archives is refused or skipped: contact = 'skip'",
            kind="unsupported",
            keyword="contact",
        )
    problems = Problems(Path(path).name, options.flags)
    with problems.ending():
        archive = read_commands(Path(path), problems, options)
        parts, hanging, structures = list[Elements](), list[Hanging](), Structures(archive, problems)
        for kind, rows in archive.elements:
            if kind not in archive.types:
                raise InputError(
                    f"{archive.name}: EBLOCK has elements of the type {kind}, which no ET defines", kind="unsupported"
                )
            routine, keys = archive.types[kind]
            if routine in HANGING and not _is_skipped(options, routine):
                hanging.append(Hanging(routine=routine, keys=keys, rows=rows))
            parts += _elements(archive, kind, rows, options, structures)
        return _deck(archive, parts, hanging, structures, options, problems)


def _deck(
    archive: Archive,
    parts: list[Elements],
    hanging: list[Hanging],
    structures: Structures,
    options: DeckOptions,
    problems: Problems,
) -> Deck:
    ids, xyz, rotated = _nodes(archive)
    own = [part for part in parts if part.kind == "solid"]
    has_couplings = bool(hanging or archive.equations or archive.coupled)
    of_solids = distinct(np.concatenate([ids[:0], *(part.nodes.ravel() for part in own if has_couplings)]))
    equations = sums(archive, of_solids, rotated, archive.notes)
    if len(rotated):
        archive.notes.append(
            f"{len(rotated)} nodes have rotated axes, which a mesh does not need; coordinates are global"
        )
    rigid, masses, discrete = list[RigidElement](), list[PointMass](), list[DiscreteElement]()
    labels = Labels(ids, archive.name)
    for given in hanging:
        with problems.collected(flags=(f"--skip {element_name(given.routine)}",)):
            if given.routine == Routine.MASS21:
                points, others = point_masses(given, archive.reals, archive.name)
                masses += points
                discrete += others
            elif given.routine == Routine.MPC184:
                rigid += rigid_beams(given, of_solids, archive.name)
            else:
                discrete += springs(given, archive.reals, labels, xyz, rotated, archive.name)
    remarks: list[str] = []
    sections = list(_sections(archive, own, remarks))
    out = _list_left_out(archive)
    if archive.supports:
        remarks.append(f"{archive.supports} supports (D) were {_SUPPORTS}")
    remarks += [f"{what} ({count} commands) were {_LOADS}" for what, count in archive.loads.items()]
    skipped = [describe_left_out(name, count) for name, count in archive.skipped.items()]
    return Deck(
        name=archive.name,
        program="ANSYS",
        ids=ids,
        xyz=xyz,
        elements=tuple(parts),
        node_sets=archive.node_sets,
        element_sets={
            **archive.element_sets,
            **_number_sets(own, "material"),
            **_number_sets(own, "type"),
            **structures.sets,
        },
        materials={**structures.materials(remarks), **{material.name: material for material, _ in sections}},
        sections=(*(each for _, each in sections), *structures.sections),
        rigid=tuple(rigid),
        masses=tuple(masses),
        discrete=tuple(discrete),
        equations=(solved_for_first("CE", equations),) if equations else (),
        turned=rotated,
        left_out=out,
        notes=tuple(archive.notes),
        remarks=tuple(remarks),
        warnings=(*skipped, *dict.fromkeys(archive.warnings)),
        mesh_warnings=tuple(warnings_of("ANSYS", ((part.code, len(part.ids), part.meaning) for part in own))),
        problems=tuple(problems.entries),
        options=options,
        seams=True,
    )


def _nodes(archive: Archive) -> tuple[Ints, Floats, Ints]:
    """Labels (n,), coordinates (n, 3), and the labels with axes of their own."""
    if not archive.ids:
        raise InputError(f"{archive.name} has no NBLOCK; expected an archive (CDWRITE,DB,model,cdb)", kind="missing")
    ids, xyz, angles = np.concatenate(archive.ids), np.concatenate(archive.xyz), np.concatenate(archive.angles)
    return ids, xyz, np.sort(ids[(angles != 0).any(axis=1)])


def _is_skipped(options: DeckOptions, routine: int) -> bool:
    contact = routine in CONTACT and options.contact == "skip"
    return contact or options.skips(element_name(routine), str(routine))


def _elements(
    archive: Archive, kind: int, rows: Rows, options: DeckOptions, structures: Structures
) -> Iterator[Elements]:
    """Elements of one type of the archive: solids by their shapes; what own assembly has not with the problem."""
    routine, keys = archive.types[kind]
    name, count = element_name(routine), len(rows.ids)
    numbers = {"type": np.full(count, kind), "material": rows.material, "real": rows.real, "system": rows.system}
    if _is_skipped(options, routine):
        archive.warnings.append(describe_left_out(f"elements {name}", count, contact=routine in CONTACT))
        word, problem = "none", None
    elif routine in CARRIERS:
        archive.notes.append(f"{count} elements {name} were {_CARRIERS}")
        word, problem = "none", None
    elif routine in SOLIDS:
        if routine in (Routine.SOLID45, Routine.SOLID95) and keys.get(1, 0) and rows.system.any():
            raise InputError(
                f"{archive.name}: {name} with axes along its edges (KEYOPT(1)) is not supported", kind="unsupported"
            )
        for shape, own, nodes in solids(routine, rows, archive.name):
            yield Elements(
                code=name,
                kind="solid",
                shape=shape,
                ids=rows.ids[own],
                nodes=nodes,
                meaning=ansys_meaning(routine, keys, shape),
                numbers={what: values[own] for what, values in numbers.items()},
            )
        return
    elif routine in HANGING:
        word, problem = "point", None
    else:
        remains = any(archive.types.get(other, (0,))[0] in SOLIDS for other, _ in archive.elements)
        problem = _refusal(archive.name, routine, rows, remains=remains)
        if routine in STRUCTURES:
            yield from structures.add(routine, keys, rows, numbers, problem)
            return
        family = next((family for family, numbers in FAMILIES.items() if routine in numbers), "")
        word = _KINDS.get(family, "none")
    yield Elements(code=name, kind=word, shape="", ids=rows.ids, nodes=rows.nodes, numbers=numbers, problem=problem)


def _refusal(file: str, routine: int, rows: Rows, *, remains: bool) -> Problem:
    """Why elements cannot be had; they are offered to be left out where something ``remains``."""
    name = element_name(routine)
    flag = "--contact skip" if routine in CONTACT else f"--skip {name if routine in NAMES else routine}"
    what = (
        f"{file} has {len(rows.ids)} elements {name} (first: {rows.ids[0]}), which are not supported; expected "
        f"{', '.join(f'SOLID{n}' for n in sorted(SOLIDS))}, MASS21, COMBIN14, MPC184; let ANSYS write K and M (.full) "
        f"and import these{f'; leave them out with {flag} if the body is right without them' if remains else ''}"
    )
    return Problem(what=what, file=file, keyword=name, flags=(flag,) if remains else ())


def _number_sets(parts: list[Elements], what: str) -> dict[str, Ints]:
    """A set for each number, such as "material 3"."""
    own = ranges_by_number((part.ids, part.numbers[what]) for part in parts)
    return {f"{what} {number}": ranges for number, ranges in own.items()}


def _sections(archive: Archive, parts: list[Elements], notes: list[str]) -> Iterator[tuple[ElasticMaterial, Section]]:
    """Material and section of the solids of each material, ascending."""
    numbers, systems = (
        np.concatenate([np.empty(0, dtype=np.int64), *(part.numbers[what] for part in parts)])
        for what in ("material", "system")
    )
    for number in np.unique(numbers).tolist():
        is_turned = bool(systems[numbers == number].any())
        yield section(number, archive.properties.get(number, {}), archive.tables.get(number, ""), notes, is_turned)


def _list_left_out(archive: Archive) -> dict[str, LeftOut]:
    out = {"D": LeftOut(archive.supports, _SUPPORTS)} if archive.supports else {}
    return out | {what: LeftOut(count, _LOADS) for what, count in archive.loads.items()}
