"""ANSYS archives (.cdb of CDWRITE): mesh, materials, components, point masses. Units are those of the file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.importers.ansys_archive import Archive, read_commands
from morembs.importers.ansys_elements import CARRIERS, CONTACT, MASS, NAMES, SOLIDS, Elements, element_name, solids
from morembs.importers.ansys_properties import material, point_masses
from morembs.importers.deck_options import DeckOptions, deck_options, lacking_problems
from morembs.importers.formulations import Meaning, ansys_meaning, warnings_of
from morembs.importers.imported import Imported, Lacking, PointMass
from morembs.importers.problems import Problem, Problems
from morembs.model import ElementBlock, Mesh, Nodes
from morembs.model.constraints import Term, solved_for_first
from morembs.model.material import Material

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


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
    return AnsysArchive(nodes=Nodes(ids=ids, xyz=xyz, sets=_node_sets(archive, ids, ids, [])), rotated=rotated)


def import_ansys_cdb(
    path: str | Path, *, density: float | dict[str, float] | None = None, contact: str = "refuse",
    skip: list[str] | str = "",
) -> Imported:  # fmt: skip
    """Mesh of an archive with its materials, components, point masses (MASS21), CE and CP.

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
        ids, xyz, rotated = _nodes(archive)
        notes = list(archive.notes)
        parts, masses = _sorted_elements(archive, options, problems, notes)
        if not parts:
            raise InputError(f"{archive.name} has no solid elements; expected an archive with a mesh of solids")
        named = [part.nodes.ravel() for part in parts] + [elements.nodes[:, 0] for _, elements in masses]
        of_solids = np.unique(np.concatenate([part.nodes.ravel() for part in parts]))
        sums = _sums(archive, of_solids, set(rotated.tolist()), notes)
        named.append(np.array([node for _, terms in sums for node, *_ in terms], dtype=np.int64))
        used = np.unique(np.concatenate(named))
        unknown = used[~np.isin(used, ids)]
        if len(unknown):
            some = ", ".join(map(str, unknown[:10].tolist()))
            raise InputError(f"{archive.name}: elements name the node {some}, which is not defined")
        sums = [(t, [(int(np.searchsorted(used, n)), c, value) for n, c, value in terms]) for t, terms in sums]
        equations = (solved_for_first("CE", sums),) if sums else ()
        blocks, materials_of, types_of, systems = _blocks(parts, used, archive.name)
        points: list[PointMass] = []
        for kind, elements in masses:
            row = {int(label): int(np.searchsorted(used, label)) for label in elements.nodes[:, 0]}
            points += point_masses(elements, archive.types[kind][1], archive.reals, row, archive.name)
        others = np.unique(np.concatenate([elements.ids for _, elements in archive.elements]))
        nodes = Nodes(ids=used, xyz=xyz[np.searchsorted(ids, used)], sets=_node_sets(archive, ids, used, notes))
        element_sets = _element_sets(archive, blocks, others, notes)
        for label, of in (("material", materials_of), ("type", types_of)):
            for number in np.unique(np.concatenate(of)):
                element_sets[f"{label} {number}"] = tuple(np.flatnonzero(values == number) for values in of)
        lacking: dict[str, Lacking] = {}
        materials = _materials(archive, materials_of, systems, notes, lacking)
    whole, rest, said = options.completed(materials, lacking)
    if problems.found:
        problems.found += lacking_problems(archive.name, rest)
    problems.refuse()
    _say_rest(archive, rotated, len(ids) - len(used), notes)
    inner = np.isin(used, of_solids)
    mesh_nodes = nodes if inner.all() else _of_solids(nodes, inner)
    inner_row = np.cumsum(inner) - 1
    mesh = Mesh(
        nodes=mesh_nodes, blocks=tuple(replace(block, nodes=inner_row[block.nodes]) for block in blocks),
        element_sets=element_sets, source=archive.name,
        warnings=tuple(warnings_of("ANSYS", ((part.name, len(part.ids), part.meaning) for part in parts))),
    )  # fmt: skip
    skipped = [
        f"{count} {name} left out as asked; stiffness or mass may depend on them [keywords-skipped]"
        for name, count in archive.skipped.items()
    ]
    return Imported(
        source=archive.name, nodes=nodes, mesh=mesh, materials=whole, masses=tuple(points), equations=equations,
        notes=tuple(notes), warnings=(*skipped, *dict.fromkeys(archive.warnings), *said), incomplete=rest,
    )  # fmt: skip


def _of_solids(nodes: Nodes, inner: NDArray[np.bool_]) -> Nodes:
    row = np.where(inner, np.cumsum(inner) - 1, -1)
    sets = {name: row[rows][row[rows] >= 0] for name, rows in nodes.sets.items()}
    return Nodes(
        ids=nodes.ids[inner], xyz=nodes.xyz[inner], sets={name: rows for name, rows in sets.items() if len(rows)}
    )


def _sums(
    archive: Archive, of_solids: Ints, rotated: set[int], notes: list[str]
) -> list[tuple[str, list[Term]]]:
    """Equations of CE and CP by labels; those of rotations that solids do not have are left out."""
    sums = [(title, terms) for title, terms in archive.equations if terms]
    for (number, component), nodes in archive.coupled.items():
        first, *others = dict.fromkeys(nodes)
        title = f"{archive.name}: CP {number}"
        sums += [(title, [(node, component, 1.0), (first, component, -1.0)]) for node in others]
    bad = [title for title, terms in sums if any(node in rotated for node, *_ in terms)]
    if bad:
        raise InputError(f"{bad[0]} is on nodes with rotated axes, which is not supported; --skip CE,CP leaves it out")
    solid = set(of_solids.tolist()) if sums else set()
    kept = [(t, terms) for t, terms in sums if not all(c > 2 and node in solid for node, c, _ in terms)]
    if len(kept) < len(sums):
        notes.append(f"{len(sums) - len(kept)} equations between rotations of solids, which have none, were left out")
    return kept


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
) -> tuple[list[_Part], list[tuple[int, Elements]]]:  # fmt: skip
    """Solids, and (type, elements) of point masses; everything else is refused, or noted where it has no stiffness."""
    parts: list[_Part] = []
    masses: list[tuple[int, Elements]] = []
    for kind, elements in archive.elements:
        if kind not in archive.types:
            raise InputError(f"{archive.name}: EBLOCK has elements of the type {kind}, which no ET defines")
        routine, keys = archive.types[kind]
        name, count = element_name(routine), len(elements.ids)
        if options.skips(name, str(routine)) or (routine in CONTACT and options.contact == "skip"):
            code = "contact-skipped" if routine in CONTACT else "keywords-skipped"
            archive.warnings.append(
                f"{count} elements {name} left out as asked; stiffness or mass may depend on them [{code}]"
            )
        elif routine in CARRIERS:
            notes.append(f"{count} elements {name} were left out: they have neither stiffness nor mass")
        elif routine == MASS:
            masses.append((kind, elements))
        elif routine in SOLIDS:
            if routine in (45, 95) and keys.get(1, 0) and elements.system.any():
                raise InputError(f"{archive.name}: {name} with axes along its edges (KEYOPT(1)) is not supported")
            parts += [
                _Part(
                    type=shape, name=name, meaning=ansys_meaning(routine, keys, shape), archive_type=kind,
                    ids=elements.ids[rows], nodes=nodes, material=elements.material[rows], system=elements.system[rows],
                )
                for shape, (rows, nodes) in solids(routine, elements, archive.name).items()
            ]  # fmt: skip
        else:
            flag = "--contact skip" if routine in CONTACT else f"--skip {name if routine in NAMES else routine}"
            problems.add(
                Problem(
                    what=f"{archive.name} has {count} elements {name} (first: {elements.ids[0]}), which are not "
                    f"supported; expected {', '.join(f'SOLID{n}' for n in sorted(SOLIDS))} or MASS21. Delete them, or "
                    f"leave them out with {flag} if the body is right without them",
                    file=archive.name, keyword=name, flags=(flag,),
                )
            )  # fmt: skip
    return parts, masses


def _blocks(
    parts: list[_Part], used: Ints, name: str
) -> tuple[tuple[ElementBlock, ...], list[Ints], list[Ints], list[Ints]]:  # fmt: skip
    """Blocks, one for each type and formulation, and for each the material, archive type and coordinate system of its
    elements."""
    blocks, materials, types, systems = [], [], [], []
    for kind, formulation, mass in dict.fromkeys(map(_key, parts)):
        same = [part for part in parts if _key(part) == (kind, formulation, mass)]
        nodes = np.concatenate([part.nodes for part in same])
        ids = np.concatenate([part.ids for part in same])
        blocks.append(
            ElementBlock(type=kind, nodes=np.searchsorted(used, nodes), ids=ids, formulation=formulation, mass=mass)
        )
        materials.append(np.concatenate([part.material for part in same]))
        types.append(np.concatenate([np.full(len(part.ids), part.archive_type) for part in same]))
        systems.append(np.concatenate([part.system for part in same]))
    labels = np.sort(np.concatenate([block.ids for block in blocks]))
    twice = labels[1:][np.diff(labels) == 0]
    if len(twice) or labels[0] < 1:
        what = f"the element {twice[0]} twice" if len(twice) else f"an element with the label {labels[0]}"
        raise InputError(f"{name} defines {what}; expected labels from 1, each once")
    return tuple(blocks), materials, types, systems


def _key(part: _Part) -> tuple[str, str, str]:
    return part.type, part.meaning.formulation, part.meaning.mass


def _members(ranges: Ints, ids: Ints, what: str, name: str) -> Ints:
    """Labels in ``ranges`` (k, 2), all of which must be among the ascending ``ids``."""
    low, high = np.searchsorted(ids, ranges[:, 0]), np.searchsorted(ids, ranges[:, 1], side="right")
    lacking = ranges[:, 1] - ranges[:, 0] + 1 - (high - low)
    if lacking.any():
        at = int(np.flatnonzero(lacking)[0])
        there = ids[low[at] : high[at]] - ranges[at, 0]
        first = ranges[at, 0] + int(np.flatnonzero(np.append(there, -1) != np.arange(len(there) + 1))[0])
        raise InputError(
            f"{name} names {lacking.sum()} {what} that are not defined (first: {first}); write the archive "
            "again with all selected (ALLSEL)"
        )
    mark = np.zeros(len(ids) + 1, dtype=np.int64)
    np.add.at(mark, low, 1)
    np.add.at(mark, high, -1)
    return ids[np.cumsum(mark[:-1]) > 0]


def _node_sets(archive: Archive, ids: Ints, used: Ints, notes: list[str]) -> dict[str, Ints]:
    sets = {}
    for name, ranges in archive.node_sets.items():
        labels = _members(ranges, ids, "nodes", f"{archive.name}: the component {name}")
        members = labels[np.isin(labels, used)]
        if len(members) < len(labels):
            notes.append(
                f"the component {name} has {len(labels) - len(members)} nodes of no solid, which were left out"
            )
        if len(members):
            sets[name] = np.searchsorted(used, members)
    return sets


def _element_sets(
    archive: Archive, blocks: tuple[ElementBlock, ...], all_ids: Ints, notes: list[str]
) -> dict[str, tuple[Ints, ...]]:  # fmt: skip
    sets = {}
    for name, ranges in archive.element_sets.items():
        labels = _members(ranges, all_ids, "elements", f"{archive.name}: the component {name}")
        picked = tuple(np.flatnonzero(np.isin(block.ids, labels)) for block in blocks)
        if (kept := sum(map(len, picked))) < len(labels):
            notes.append(
                f"the component {name} has {len(labels) - kept} elements that are no solids, which were left out"
            )
        if kept:
            sets[name] = picked
    return sets


def _materials(
    archive: Archive, materials_of: list[Ints], systems: list[Ints], notes: list[str],
    lacking: dict[str, Lacking],
) -> tuple[Material, ...]:  # fmt: skip
    numbers, turned = np.concatenate(materials_of), np.concatenate(systems) != 0
    materials = (
        material(
            int(number), f"material {number}", archive.properties.get(int(number), {}),
            bool(turned[numbers == number].any()), notes, lacking,
        )
        for number in np.unique(numbers)
    )  # fmt: skip
    found = tuple(each for each in materials if each is not None)
    for name, lack in lacking.items():
        table = archive.tables.get(int(name.split()[-1]))
        if table and lack.stiffness is None:
            lacking[name] = Lacking(sentence=f"{lack.sentence}, but a table TB,{table}, which is not read")
    return found


def _say_rest(archive: Archive, rotated: Ints, loose: int, notes: list[str]) -> None:
    if archive.supports:
        notes.append(f"{archive.supports} supports (D) were not applied: the body is free, its interfaces hold it")
    for what, count in archive.loads.items():
        notes.append(f"{what} ({count} commands) were left out: a body carries no loads")
    if len(rotated):
        notes.append(f"{len(rotated)} nodes have rotated axes, which a mesh does not need; coordinates are global")
    if loose:
        notes.append(f"{loose} nodes of no element were left out")
