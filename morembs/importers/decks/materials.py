"""Materials of a deck with those of the user: whole ones, and densities of sets that lack nothing else."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.types import Ints
from morembs.fem.material import Material
from morembs.importers.decks.labels import in_ranges, ranges_of
from morembs.importers.decks.options import lacking_problems, material_flags, refuse_both, unused_material
from morembs.importers.decks.problems import Problem, quote_option
from morembs.importers.decks.tables import DeckTables, ElasticMaterial, Section
from morembs.importers.imported import Lacking

Tables = TypeVar("Tables", bound=DeckTables)

# Sections by the kinds of elements that have no stiffness without their sizes.
_SECTIONS = {"shell": "SHELL SECTION", "membrane": "MEMBRANE SECTION", "beam": "BEAM SECTION", "truss": "SOLID SECTION"}


def complete(deck: Tables, materials: Sequence[Material] = ()) -> Tables:
    """The deck with a material in each section that lacks one, as far as it is given, and in sections of other solids.

    A material that is given is whole: its density counts as it is. That of a set comes before the density of the deck's
    options, and "all" stands behind both: for all other sets.

    Raises:
        InputError: a material or density for a set that is not there or lacks none, or both for one set.
    """
    options = replace(deck.options, density=_density_of_sets(deck))
    refuse_both(options.density, materials)
    given = {material.set.upper(): material for material in materials}
    known = dict.fromkeys([*deck.element_sets, *(section.set for section in deck.sections)])
    unknown = next((own.set for own in materials if own.set.upper() not in {"ALL", *map(str.upper, known)}), None)
    if unknown is not None:
        raise InputError(
            f"--material was given for the set {unknown!r}, which {deck.name} does not have; {nearest(unknown, known)}",
            kind="unknown",
        )
    lacking, densities = find_lacking(deck), {name.upper() for name in options.density}

    def key_of(name: str, lack: Lacking) -> str:
        """The key of the material that a set takes: its own, or that of all where it has no density of its own."""
        key = name.upper()
        return key if key in given or (key in densities and lack.stiffness is not None) else "ALL"

    keys = {name: key for name, lack in lacking.items() if (key := key_of(name, lack)) in given}
    done, used = _with_sections(_with_materials(deck, {name: given[key] for name, key in keys.items()}), given)
    idle = next((own.set for key, own in given.items() if key not in {*used, *keys.values()}), None)
    if idle is not None:
        raise InputError(_without_section(done, idle) or unused_material(idle))
    warnings = [f"{lacking[name].sentence}; the material that was given took its place" for name in keys]
    if not deck.options.are_taken:
        rest = {name: lack for name, lack in lacking.items() if name not in keys}
        completed, _, more = options.complete((), rest, deck.element_sets)
        warnings += more
        done = _with_densities(done, {own.set: deck.mass_scale * own.density for own in completed})
    return replace(done, warnings=(*deck.warnings, *warnings), options=replace(deck.options, are_taken=True))


def _without_section(deck: DeckTables, name: str) -> str:
    """The sentence on shells and the like of a set, or of "all", that a material leaves without a section; or none."""
    sets = [own for key, own in deck.element_sets.items() if key.upper() == name.upper()]
    for kind, word in _SECTIONS.items():
        ids = np.concatenate([np.empty(0, dtype=np.int64), *(own.ids for own in deck.elements if own.kind == kind)])
        bare = in_ranges(ids, sets[0]) if sets else np.ones(len(ids), dtype=bool)
        for section in deck.sections:
            if section.kind == kind:
                bare &= ~in_ranges(ids, deck.ranges(section.set))
        if bare.any():
            return (
                f"--material was given for {name!r}, where {int(bare.sum())} elements (first: {ids[bare][0]}) have no "
                f"section; give them a *{word} in {deck.name}"
            )
    return ""


def _density_of_sets(deck: DeckTables) -> dict[str, float]:
    """The densities that were given, those of materials for the sets of these."""
    sets = {section.set.upper() for section in deck.sections} | {name.upper() for name in deck.element_sets}
    result = dict[str, float]()
    for name, value in deck.options.density.items():
        key = name.upper()
        owners = [own.set for own in deck.sections if key not in {*sets, "ALL"} and own.material.upper() == key]
        result |= dict.fromkeys(owners or [name], value)
    return result


def find_lacking(deck: DeckTables) -> dict[str, Lacking]:
    """Sets of the sections that have no stiffness or no mass, and the missing properties."""
    return {section.set: lack for section in deck.sections if (lack := _lack(deck, section)) is not None}


def problems_of_solids(deck: DeckTables, materials: Sequence[Material]) -> Iterator[Problem]:
    """A problem for each section of solids that lacks something, and one for solids in no section; ``materials`` were
    given, so that cures name sets."""
    solid = {section.set for section in deck.sections if section.kind == "solid"}
    yield from lacking_problems(deck.name, {name: lack for name, lack in find_lacking(deck).items() if name in solid})
    solids, bare = _bare_solids(deck)
    if bare.any():
        what = f"{int(bare.sum())} solid elements have no section and so no material (first: {solids[bare][0]})"
        sets = deck.element_sets.items() if materials else ()
        members = {name: solids[in_ranges(solids, own)] for name, own in sets}
        flags = material_flags(solids[bare], members)
        what = f"{what}; {' '.join(map(quote_option, flags))}"
        yield Problem(what=what, kind="missing", file=deck.name, keyword="MATERIAL", flags=flags)


def _lack(deck: DeckTables, section: Section) -> Lacking | None:
    if section.kind == "solid":
        if section.stiffness is not None and section.density is not None:
            return None
        sentence = section.lacks or f"the section of the set {section.set} has no material"
        return Lacking(sentence=sentence, stiffness=section.stiffness)
    if section.lacks:
        return Lacking(sentence=section.lacks)
    names = [ply.material for ply in section.plies] or [section.material]
    own = [deck.materials[name] for name in names if name in deck.materials]
    of = f"of the set {section.set}"
    for material in own:
        # That of shells alone (MAT8, MAT2) has none in space, and is there.
        if material.stiffness is None and not material.constants.keys() & {"E1", "G11"}:
            return Lacking(sentence=f"the material {material.name} {of} has no linear stiffness")
    if not own or section.nonstructural or any(material.density for material in own):
        return None
    C = np.eye(6) if own[0].stiffness is None else own[0].stiffness
    return Lacking(sentence=f"the material {own[0].name} {of} has no density", stiffness=C)


def _with_densities(deck: Tables, density: dict[str, float]) -> Tables:
    """The deck with densities of its sections by their sets."""
    materials = dict(deck.materials)
    of_all = deck.mass_scale * deck.options.density["all"] if "all" in deck.options.density else None

    def complete_material(name: str, section: Section) -> str:
        """The name of the material of a section with its density: its own where all sections have the same."""
        given, value = deck.materials.get(name), density[section.set]
        if given is None or given.density:
            return name
        own = name if value == of_all else f"{name}_{section.set}"
        materials[own] = replace(given, name=own, density=value)
        return own

    sections = []
    for section in deck.sections:
        if section.set in density and _lack(deck, section) is not None:
            if section.kind == "solid":
                section = replace(section, density=density[section.set], lacks="")
            else:
                plies = tuple(replace(ply, material=complete_material(ply.material, section)) for ply in section.plies)
                section = replace(section, material=complete_material(section.material, section), plies=plies)
        sections.append(section)
    return replace(deck, sections=tuple(sections), materials=materials)


def _with_materials(deck: Tables, given: dict[str, Material]) -> Tables:
    """The deck with other materials of its sections by their sets."""
    sections, materials = list[Section](), dict(deck.materials)
    for section in deck.sections:
        if section.set in given and _lack(deck, section) is not None:
            own, name = given[section.set], f"{section.set}, given"
            if section.kind == "solid":
                section = replace(section, stiffness=own.stiffness, density=own.density, lacks="")
            else:
                materials[name] = ElasticMaterial(name=name, stiffness=own.stiffness, density=own.density)
                plies = tuple(replace(ply, material=name) for ply in section.plies)
                plate = None if section.plate is None else section.plate.of_material(name)
                section = replace(section, material="" if plies else name, plies=plies, plate=plate, lacks="")
        sections.append(section)
    return replace(deck, sections=tuple(sections), materials=materials)


def _bare_solids(deck: DeckTables) -> tuple[Ints, np.ndarray]:
    """Labels of all solids, and which of them are in no section."""
    none = np.empty(0, dtype=np.int64)
    solids = np.concatenate([none, *(part.ids for part in deck.elements if part.kind == "solid")])
    bare = np.ones(len(solids), dtype=bool)
    for section in deck.sections:
        if section.kind == "solid":
            bare &= ~in_ranges(solids, deck.ranges(section.set))
    return solids, bare


def _with_sections(deck: Tables, given: dict[str, Material]) -> tuple[Tables, set[str]]:
    """The deck with sections of solids in none, by sets and then of "all", and the keys of the materials they take."""
    used, sets = set[str](), dict(deck.element_sets)
    by_key, sections = {name.upper(): name for name in sets if name.upper() != "ALL"}, [*deck.sections]
    _, were_bare = _bare_solids(deck)
    for key in sorted(given, key=lambda key: key == "ALL"):
        solids, bare = _bare_solids(replace(deck, sections=tuple(sections), element_sets=sets))
        wanted = np.ones(len(solids), dtype=bool) if key == "ALL" else in_ranges(solids, sets[by_key[key]])
        own, name = bare & wanted, by_key.get(key, "all")
        if not own.any():
            continue
        if key != "ALL" and (wanted & were_bare & ~bare).any():
            raise InputError(
                f"--material was given for {name!r} and for a set that shares elements with it; give one",
                kind="conflict",
            )
        used.add(key)
        if not np.array_equal(own, wanted):
            name = f"{name} without a section"
            sets[name] = ranges_of(solids[own])
        sections.append(Section(set=name, stiffness=given[key].stiffness, density=given[key].density))
    return replace(deck, sections=tuple(sections), element_sets=sets), used
