"""ANSYS archives (.cdb of CDWRITE): mesh, materials, components, point masses. Units are those of the file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem import ElementBlock, Mesh, Nodes
from morembs.fem.constraints import Equations, solved_for_first
from morembs.fem.material import Material
from morembs.importers.ansys.archive import Archive, read_commands
from morembs.importers.ansys.elements import (
    CARRIERS,
    CONTACT,
    HANGING,
    NAMES,
    SOLIDS,
    Elements,
    Routine,
    element_name,
    solids,
)
from morembs.importers.ansys.properties import material
from morembs.importers.ansys.sets import element_sets_of, node_sets
from morembs.importers.ansys.ties import ends, sums, ties_of
from morembs.importers.decks.formulations import Meaning, ansys_meaning, warnings_of
from morembs.importers.decks.missing_middles import filled, middle_equations
from morembs.importers.decks.options import DeckOptions, deck_options, left_out
from morembs.importers.decks.problems import Problem, Problems
from morembs.importers.imported import Imported, Lacking, picked_nodes


@dataclass(frozen=True, kw_only=True, eq=False)
class AnsysArchive:
    """All ``nodes`` of an archive with its components; ``rotated`` are the labels of those with axes of their own."""

    nodes: Nodes
    rotated: Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class _Part:
    """Solids (k,) of one type of morembs from one type of the archive: labels and ``nodes`` (k, n) by label."""

    type: str
    name: str
    meaning: Meaning
    archive_type: int
    ids: Ints
    nodes: Ints
    material: Ints
    system: Ints


def read_ansys_archive(path: str | Path) -> AnsysArchive:
    """Nodes of an archive, also those of no element.

    Raises:
        InputError: as ``import_ansys_cdb``, but for elements.
    """
    archive = read_commands(Path(path))
    ids, xyz, rotated = _nodes(archive)
    return AnsysArchive(nodes=Nodes(ids=ids, xyz=xyz, sets=node_sets(archive, ids, ids, [])), rotated=rotated)


def import_ansys_cdb(
    path: str | Path,
    *,
    density: float | dict[str, float] | None = None,
    contact: str = "refuse",
    skip: list[str] | str = "",
) -> Imported:
    """Mesh of an archive with materials, components, masses (MASS21), springs (COMBIN14), rigid beams (MPC184), CE, CP.

    Elements of material n are in the set "material n", those of type n in "type n". Supports and loads are counted in
    the notes and left out. Memory is that of the mesh and about 150 bytes per line of an EBLOCK.

    Args:
        density: of materials without DENS, or set -> density, "all" standing for all.
        contact: "refuse" or "skip" elements of contact and their targets.
        skip: elements (such as SURF154) and commands to leave out, although stiffness or mass may depend on them.

    Raises:
        DeckError: all that keeps the archive from becoming a model: an ``InputError`` with ``problems``.
    """
    options = deck_options(density, contact, skip)
    if options.contact == "tie":
        raise InputError("contact = 'tie' was given; contact of ANSYS archives is refused or skipped: contact = 'skip'")
    problems = Problems(Path(path).name, options.flags)
    with problems.ending():
        archive = read_commands(Path(path), problems, options)
        notes = list(archive.notes)
        parts, hanging = _sorted_elements(archive, options, problems, notes)
        if not parts:
            raise InputError(f"{archive.name} has no solid elements; expected an archive with a mesh of solids")
        nodes, blocks, attributes, solid, ties = _joined(archive, parts, hanging, notes, problems)
        everything = np.unique(np.concatenate([elements.ids for _, elements in archive.elements]))
        element_sets = element_sets_of(archive, blocks, everything, notes)
        for label, of in (("material", attributes.material), ("type", attributes.kind)):
            for number in np.unique(np.concatenate(of)):
                element_sets[f"{label} {number}"] = tuple(np.flatnonzero(values == number) for values in of)
        lacking: dict[str, Lacking] = {}
        materials = _materials(archive, attributes, notes, lacking)
    whole, rest, said = options.all_materials(problems, materials, lacking)
    _say_rest(archive, notes)
    inner_row = np.cumsum(solid) - 1
    mesh = Mesh(
        nodes=nodes if solid.all() else picked_nodes(nodes, np.flatnonzero(solid)),
        blocks=tuple(replace(block, nodes=inner_row[block.nodes]) for block in blocks),
        element_sets=element_sets,
        source=archive.name,
        warnings=tuple(warnings_of("ANSYS", ((part.name, len(part.ids), part.meaning) for part in parts))),
    )
    skipped = [left_out(name, count) for name, count in archive.skipped.items()]
    return replace(
        ties,
        nodes=nodes,
        mesh=mesh,
        materials=whole,
        notes=tuple(notes),
        incomplete=rest,
        seams=True,
        warnings=(*skipped, *dict.fromkeys(archive.warnings), *said),
    )


def _joined(
    archive: Archive, parts: list[_Part], hanging: list[tuple[int, Elements]], notes: list[str], problems: Problems
) -> tuple[Nodes, tuple[ElementBlock, ...], _Attributes, NDArray[np.bool_], Imported]:
    """Nodes of elements and ties, blocks of solids with their attributes, which nodes are of solids, and the ties."""
    ids, xyz, rotated = _nodes(archive)
    labels = np.concatenate([part.nodes.ravel() for part in parts])
    of_solids = np.unique(labels[labels > 0])
    equations = sums(archive, of_solids, set(rotated.tolist()), notes)
    of_equations = np.array([node for _, terms in equations for node, *_ in terms], dtype=np.int64)
    used = np.unique(np.concatenate([of_solids, of_equations, *(ends(archive, *each).ravel() for each in hanging)]))
    unknown = used[~np.isin(used, ids)]
    if len(unknown):
        some = ", ".join(map(str, unknown[:10].tolist()))
        raise InputError(f"{archive.name}: elements name the node {some}, which is not defined")
    if len(ids) > len(used):
        notes.append(f"{len(ids) - len(used)} nodes of no element were left out")
    if len(rotated):
        notes.append(f"{len(rotated)} nodes have rotated axes, which a mesh does not need; coordinates are global")
    blocks, attributes, pairs = _blocks(parts, used, archive.name)
    places, solid = xyz[np.searchsorted(ids, used)], np.isin(used, of_solids)
    joined: list[Equations] = []
    if equations:
        rows = [(t, [(int(np.searchsorted(used, n)), c, value) for n, c, value in terms]) for t, terms in equations]
        joined.append(solved_for_first("CE", rows))
    ties = ties_of(archive, hanging, used, places, solid, np.isin(used, rotated), problems)
    if len(pairs):
        joined.append(middle_equations(pairs, len(used)))
        notes.append(
            f"{len(pairs)} edges of quadratic elements have no middle node; nodes with labels from {ids[-1] + 1} were "
            "added, which move as the means of their corners"
        )
        places = np.concatenate([places, places[pairs].mean(axis=1)])
        used, solid = (
            np.concatenate([part, more])
            for part, more in ((used, ids[-1] + 1 + np.arange(len(pairs))), (solid, np.ones(len(pairs), dtype=bool)))
        )
    nodes = Nodes(ids=used, xyz=places, sets=node_sets(archive, ids, used, notes))
    return nodes, blocks, attributes, solid, replace(ties, equations=tuple(joined))


def _nodes(archive: Archive) -> tuple[Ints, Floats, Ints]:
    """Labels (n,) ascending, coordinates (n, 3), and the labels with axes of their own."""
    if not archive.ids:
        raise InputError(f"{archive.name} has no NBLOCK; expected an archive (CDWRITE,DB,model,cdb)")
    ids, xyz, angles = np.concatenate(archive.ids), np.concatenate(archive.xyz), np.concatenate(archive.angles)
    order = np.argsort(ids, kind="stable")
    ids = ids[order]
    twice = ids[1:][np.diff(ids) == 0]
    if len(twice):
        raise InputError(f"{archive.name} defines the node {twice[0]} twice; expected each node once")
    return ids, xyz[order], ids[(angles[order] != 0).any(axis=1)]


def _sorted_elements(
    archive: Archive, options: DeckOptions, problems: Problems, notes: list[str]
) -> tuple[list[_Part], list[tuple[int, Elements]]]:
    """Solids, and (type, elements) of masses, springs and rigid beams; others are refused, or noted where they have no
    stiffness."""
    parts: list[_Part] = []
    hanging: list[tuple[int, Elements]] = []
    for kind, elements in archive.elements:
        if kind not in archive.types:
            raise InputError(f"{archive.name}: EBLOCK has elements of the type {kind}, which no ET defines")
        routine, keys = archive.types[kind]
        name, count = element_name(routine), len(elements.ids)
        if options.skips(name, str(routine)) or (routine in CONTACT and options.contact == "skip"):
            archive.warnings.append(left_out(f"elements {name}", count, contact=routine in CONTACT))
        elif routine in CARRIERS:
            notes.append(f"{count} elements {name} were left out: they have neither stiffness nor mass")
        elif routine in HANGING:
            hanging.append((kind, elements))
        elif routine in SOLIDS:
            if routine in (Routine.SOLID45, Routine.SOLID95) and keys.get(1, 0) and elements.system.any():
                raise InputError(f"{archive.name}: {name} with axes along its edges (KEYOPT(1)) is not supported")
            parts += [
                _Part(
                    type=shape,
                    name=name,
                    meaning=ansys_meaning(routine, keys, shape),
                    archive_type=kind,
                    ids=elements.ids[rows],
                    nodes=nodes,
                    material=elements.material[rows],
                    system=elements.system[rows],
                )
                for shape, (rows, nodes) in solids(routine, elements, archive.name).items()
            ]
        else:
            flag = "--contact skip" if routine in CONTACT else f"--skip {name if routine in NAMES else routine}"
            problems.add(
                Problem(
                    what=f"{archive.name} has {count} elements {name} (first: {elements.ids[0]}), which are not "
                    f"supported; expected {', '.join(f'SOLID{n}' for n in sorted(SOLIDS))}, MASS21, COMBIN14, MPC184. "
                    "Let ANSYS write K and M (.full) and import these, or leave them out with "
                    f"{flag} if the body is right without them",
                    file=archive.name,
                    keyword=name,
                    flags=(flag,),
                )
            )
    return parts, hanging


@dataclass(frozen=True, kw_only=True, eq=False)
class _Attributes:
    """For each block the material, archive type and coordinate system of its elements."""

    material: list[Ints]
    kind: list[Ints]
    system: list[Ints]


def _blocks(parts: list[_Part], used: Ints, name: str) -> tuple[tuple[ElementBlock, ...], _Attributes, Ints]:
    """Blocks, one for each type and formulation, their attributes, and the corners (m, 2) of the nodes behind ``used``
    that stand for middle nodes left out."""
    groups = [[part for part in parts if _key(part) == key] for key in dict.fromkeys(map(_key, parts))]
    labels = [np.concatenate([part.nodes for part in group]) for group in groups]
    rows = [np.where(own > 0, np.searchsorted(used, own), -1) for own in labels]
    whole, pairs = filled([(group[0].type, own) for group, own in zip(groups, rows, strict=True)], len(used))
    blocks = tuple(
        ElementBlock(
            type=group[0].type,
            nodes=own,
            ids=np.concatenate([part.ids for part in group]),
            formulation=group[0].meaning.formulation,
            mass=group[0].meaning.mass,
        )
        for group, own in zip(groups, whole, strict=True)
    )
    ids = np.sort(np.concatenate([block.ids for block in blocks]))
    twice = ids[1:][np.diff(ids) == 0]
    if len(twice) or ids[0] < 1:
        what = f"the element {twice[0]} twice" if len(twice) else f"an element with the label {ids[0]}"
        raise InputError(f"{name} defines {what}; expected labels from 1, each once")
    attributes = _Attributes(
        material=[np.concatenate([part.material for part in group]) for group in groups],
        kind=[np.concatenate([np.full(len(part.ids), part.archive_type) for part in group]) for group in groups],
        system=[np.concatenate([part.system for part in group]) for group in groups],
    )
    return blocks, attributes, pairs


def _key(part: _Part) -> tuple[str, str, str]:
    return part.type, part.meaning.formulation, part.meaning.mass


def _materials(
    archive: Archive, attributes: _Attributes, notes: list[str], lacking: dict[str, Lacking]
) -> tuple[Material, ...]:
    numbers, turned = np.concatenate(attributes.material), np.concatenate(attributes.system) != 0
    materials = (
        material(
            int(number),
            f"material {number}",
            archive.properties.get(int(number), {}),
            bool(turned[numbers == number].any()),
            notes,
            lacking,
        )
        for number in np.unique(numbers)
    )
    complete = tuple(each for each in materials if each is not None)
    for name, lack in lacking.items():
        table = archive.tables.get(int(name.split()[-1]))
        if table and lack.stiffness is None:
            lacking[name] = Lacking(sentence=f"{lack.sentence}, but a table TB,{table}, which is not read")
    return complete


def _say_rest(archive: Archive, notes: list[str]) -> None:
    if archive.supports:
        notes.append(f"{archive.supports} supports (D) were not applied: the body is free, its interfaces hold it")
    for what, count in archive.loads.items():
        notes.append(f"{what} ({count} commands) were left out: a body carries no loads")
