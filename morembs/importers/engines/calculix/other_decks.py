"""Decks of other programs for CalculiX: as flat decks, with what those cannot say beside the matrices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.fem import Nodes
from morembs.fem.material import Material
from morembs.importers.ansys.cdb import read_ansys
from morembs.importers.decks.labels import Labels, in_ranges, ranges_of
from morembs.importers.decks.model import Deck
from morembs.importers.decks.options import DeckOptions, lacking_problems, material_flags, unused_material
from morembs.importers.decks.problems import DeckError, Problem, Problems
from morembs.importers.decks.tables import NOT_WRITTEN, ElasticMaterial, Section
from morembs.importers.imported import Imported, Lacking, nodes_of, on_rows
from morembs.importers.nastran.importer import read_nastran
from morembs.importers.unv import read_unv

FORMATS = ("ansys", "nastran", "unv")


def read_other(path: Path, format: str, options: DeckOptions, materials: Sequence[Material], *, outside: bool) -> Deck:
    """A deck of one of ``FORMATS`` all of whose solids have a material.

    Raises:
        DeckError: all that keeps it from being written for CalculiX.
    """
    given, skip = dict(options.density) or None, sorted(options.skip)
    if format == "ansys":
        deck = read_ansys(path, density=given, contact=options.contact, skip=skip)
    elif format == "nastran":
        deck = read_nastran(path, density=given, skip=skip, allow_includes_outside=outside)
    else:
        deck = read_unv(path)
    problems = Problems(deck.name, options.flags)
    problems.entries = [*deck.problems, *(part.problem for part in deck.elements if part.problem)]
    with problems.ending():
        deck = with_materials(deck, materials, problems)
    problems.refuse()
    return deck


def with_materials(deck: Deck, materials: Sequence[Material], problems: Problems) -> Deck:
    """The deck with given materials and densities in sections that lack them, and in sections of all other solids."""
    given = {material.set.upper(): material for material in materials}
    sets = {name.upper(): name for name in deck.element_sets}
    unknown = next((material.set for key, material in given.items() if key not in ("ALL", *sets)), None)
    if unknown is not None:
        raise InputError(f"--material was given for the set {unknown!r}; {nearest(unknown, deck.element_sets)}")
    lacking, sections, used, said = dict[str, Lacking](), list[Section](), set[str](), list[str]()
    own_materials = dict(deck.materials)
    for section in deck.sections:
        material = given.get(section.set.upper(), given.get("ALL"))
        if section.kind == "solid" and (section.stiffness is None or section.density is None):
            if material is None:
                lacking[section.set] = Lacking(sentence=section.lacks, stiffness=section.stiffness)
            else:
                used.add(material.set.upper())
                section = replace(section, stiffness=material.stiffness, density=material.density)
                said += [f"{section.lacks}; the material that was given took its place"] * bool(section.lacks)
        elif section.kind != "solid" and material is not None and gives_no_mass(own_materials, section):
            used.add(material.set.upper())
            name = f"{section.set}, given"
            own_materials[name] = ElasticMaterial(name=name, stiffness=material.stiffness, density=material.density)
            what = f"the material {section.material} of the set {section.set} has no *DENSITY"
            said.append(f"{what}; the material that was given took its place")
            section = replace(section, material=name)
        sections.append(section)
    # Densities of other kinds are in their materials already.
    others = {word.upper() for own in sections if own.kind != "solid" for word in (own.set, own.material)}
    densities = {name: value for name, value in deck.options.density.items() if name.upper() not in others}
    done, rest, of_densities = replace(deck.options, density=densities).completed((), lacking, deck.element_sets)
    problems.entries += lacking_problems(deck.name, rest)
    whole = {material.set: deck.mass_scale * material.density for material in done}
    sections = [replace(own, density=whole[own.set]) if own.set in whole else own for own in sections]
    solids = np.concatenate(
        [np.empty(0, dtype=np.int64), *(part.ids for part in deck.elements if part.kind == "solid")]
    )
    bare, more = np.ones(len(solids), dtype=bool), dict(deck.element_sets)
    for section in sections:
        bare &= ~in_ranges(solids, deck.element_sets[section.set])
    for key in sorted(given, key=lambda key: key == "ALL"):
        own = bare & (True if key == "ALL" else in_ranges(solids, deck.element_sets[sets[key]]))
        if own.any():
            used.add(key)
            name = f"of {given[key].set} without a section"
            more[name] = ranges_of(solids[own])
            sections.append(Section(set=name, stiffness=given[key].stiffness, density=given[key].density))
            bare &= ~own
    if bare.any():
        what = f"{int(bare.sum())} solid elements have no section and so no material (first: {solids[bare][0]})"
        members = {name: solids[in_ranges(solids, deck.element_sets[name])] for name in sets.values() if given}
        flags = material_flags(solids[bare], members)
        problems.add(Problem(what=f"{what}; {' '.join(flags)}", file=deck.name, keyword="MATERIAL", flags=flags))
    for key in given.keys() - used:
        problems.add(Problem(what=unused_material(given[key].set), file=deck.name, keyword="MATERIAL"))
    return replace(
        deck,
        sections=tuple(sections),
        element_sets=more,
        materials=own_materials,
        warnings=(*deck.warnings, *of_densities, *said),
        # Densities that were given are in the sections now.
        options=replace(deck.options, density={}),
    )


def gives_no_mass(materials: Mapping[str, ElasticMaterial], section: Section) -> bool:
    """Whether a section that is none of solids has no mass, also none beside that of its material."""
    material = materials.get(section.material)
    return material is not None and not material.density and not section.nonstructural


def write_other(deck: Deck, folder: Path) -> tuple[Path, tuple[str, ...]]:
    """A flat deck without masses, springs and average elements, and what differs in it.

    Raises:
        InputError: what CalculiX cannot say.
    """
    path = folder / f"{Path(deck.name).stem}.inp"
    said = replace(deck, average=(), masses=(), discrete=()).write(path, "calculix")
    return path, tuple(sentence for sentence in said if NOT_WRITTEN not in sentence)


def with_others(imported: Imported, deck: Deck, said: Sequence[str]) -> Imported:
    """What CalculiX made of the flat deck, with masses, springs and average elements of the deck on its nodes.

    Raises:
        DeckError: they name nodes that are not there.
    """
    nodes = imported.nodes
    if nodes is None:
        raise DeckError(deck.name, [Problem(what=f"{deck.name} has no nodes after CalculiX; please report it")])
    wanted = nodes_of([*deck.average, *deck.masses, *deck.discrete])
    loose = np.setdiff1d(wanted, nodes.ids)
    at = Labels(deck.ids, deck.name, deck.node).rows(loose, "couplings name")
    nodes = Nodes(ids=np.append(nodes.ids, loose), xyz=np.vstack([nodes.xyz, deck.xyz[at]]), sets=nodes.sets)
    labels = Labels(nodes.ids, deck.name, deck.node)

    def rows(given: np.ndarray) -> np.ndarray:
        return labels.rows(given, "couplings name")

    return replace(
        imported,
        source=deck.name,
        nodes=nodes,
        average=(*imported.average, *on_rows(deck.average, rows)),
        masses=(*imported.masses, *on_rows(deck.masses, rows)),
        discrete=(*imported.discrete, *on_rows(deck.discrete, rows)),
        notes=(*imported.notes, *deck.notes, *deck.remarks),
        warnings=(*deck.warnings, *said, *imported.warnings),
    )
