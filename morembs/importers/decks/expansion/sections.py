"""What shells and beams are made of: the last section of each element, and the material of the solids they become."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from morembs.base.types import Floats, Ints
from morembs.importers.decks.formulations import Meaning, meaning_of
from morembs.importers.decks.labels import in_ranges, ranges_of
from morembs.importers.decks.problems import Problem, Problems
from morembs.importers.decks.tables import DeckTables, ElasticMaterial, Elements, Section
from morembs.importers.tolerances import TOL

# What each type means, mostly by the solid of CalculiX that it becomes.
SOLIDS: Mapping[str, Meaning] = MappingProxyType(
    {
        "S3": meaning_of("C3D6", "calculix"),
        "S4": meaning_of("C3D8I", "calculix"),
        "S4R": meaning_of("C3D8R", "calculix"),
        "S6": meaning_of("C3D15", "calculix"),
        "S8": meaning_of("C3D20", "calculix"),
        "S8R": meaning_of("C3D20R", "calculix"),
        "B31": meaning_of("C3D8I", "calculix"),
        "B31R": meaning_of("C3D8R", "calculix"),
        "B32": meaning_of("C3D20", "calculix"),
        "B32R": Meaning("bar", "reduced"),
    }
)
KINDS = ("shell", "beam")
# Profiles of beams.
PROFILES = ("RECT", "CIRC", "ELLIPSE")


@dataclass(frozen=True, kw_only=True, eq=False)
class Structure:
    """Shells or beams of one type and ``section``; ``widths`` (2,) are thicknesses along the normal of shells, along
    first and second axis of beams, whose profile may be an ellipse (``is_round``)."""

    elements: Elements
    section: Section
    widths: Floats
    is_round: bool


def structures_of(deck: DeckTables, problems: Problems) -> list[Structure]:
    """Elements by types and sections; all problems but no elements where some cannot be expanded."""
    found, refused = list[Structure](), dict[tuple[str, str], int]()
    for part in deck.elements:
        if not is_expanded(part):
            continue
        owner = np.full(len(part.ids), -1)
        for number, section in enumerate(deck.sections):
            if section.kind == part.kind and section.set in deck.element_sets:
                owner[in_ranges(part.ids, deck.element_sets[section.set])] = number
        for number in np.unique(owner).tolist():
            rows = owner == number
            values = {name: own[rows] for name, own in part.values.items() if not np.isnan(own[rows]).all()}
            own = replace(part, ids=part.ids[rows], nodes=part.nodes[rows], values=values, numbers={})
            why = _why_not(deck, own, deck.sections[number]) if number >= 0 else "elements without a section"
            if why:
                refused[part.code, why] = refused.get((part.code, why), 0) + int(rows.sum())
                continue
            found.append(_structure(own, deck.sections[number]))
    if refused:
        problems.add(
            describe_unsupported(deck.name, refused, is_all=not any(part.kind == "solid" for part in deck.elements))
        )
        return []
    return found


def is_expanded(part: Elements) -> bool:
    """True if elements become solids."""
    return part.code in SOLIDS and part.kind in KINDS and part.problem is None


def _structure(elements: Elements, section: Section) -> Structure:
    widths = np.array([section.thickness, 0.0])
    if section.kind == "beam":
        widths = np.array([*section.dimensions, *section.dimensions][:2])
        widths = np.full(2, 2 * widths[0]) if section.profile == "CIRC" else widths
    is_round = section.profile in ("CIRC", "ELLIPSE")
    return Structure(elements=elements, section=section, widths=widths, is_round=is_round)


def describe_unsupported(name: str, counts: dict[tuple[str, str], int], *, is_all: bool) -> Problem:
    """The problem of elements (type, why) -> count that own assembly has not; ``is_all``: nothing is left without."""
    codes = dict.fromkeys(code for code, _ in counts)
    listed = ", ".join(f"{n} of the type {code!r}{f' ({why})' if why else ''}" for (code, why), n in counts.items())
    cure = f"; if the model is right without these elements, leave them out with --skip {','.join(codes)}"
    return Problem(
        what=f"{name} has elements that are not supported: {listed}{'' if is_all else cure}; "
        "--engine calculix may assemble them",
        file=name,
        keyword="ELEMENT",
        flags=() if is_all else tuple(f"--skip {code}" for code in codes),
    )


def _why_not(deck: DeckTables, part: Elements, section: Section) -> str:
    """Why elements of a type and a section cannot be expanded here; empty if they can."""
    material = deck.materials.get(section.material)
    if section.plies:
        return "layers"
    if part.kind == "beam" and "normal" in part.values:
        # CalculiX leaves such beams without a first axis.
        return "*NORMAL of a beam"
    if "NODAL THICKNESS" in section.code and part.kind == "beam":
        return "*NODAL THICKNESS"
    if part.kind == "beam" and section.profile not in PROFILES:
        return f"SECTION={section.profile or 'GENERAL'}"
    if section.profile in ("CIRC", "ELLIPSE") and part.shape == "line2":
        return "SECTION=CIRC of a linear beam"
    sizes = section.dimensions if part.kind == "beam" else (section.thickness,)
    if "NODAL THICKNESS" not in section.code and (not sizes or not min(sizes) > 0):
        return "no thickness"
    if material is not None and material.stiffness is not None and not _is_isotropic(material.stiffness):
        return "a material that is not isotropic"
    return ""


def _is_isotropic(C: Floats) -> bool:
    mu, lam = C[3, 3], C[0, 1]
    alike = np.diag([2 * mu] * 3 + [mu] * 3)
    alike[:3, :3] += lam
    return bool(np.abs(C - alike).max() <= TOL.same_modulus * np.abs(C).max())


def solid_sections(deck: DeckTables, parts: Sequence[Structure]) -> tuple[dict[str, Ints], list[Section]]:
    """Sections of the solids, and the sets that they need beside those of the deck."""
    sets, sections, taken = dict[str, Ints](), list[Section](), set[str]()
    solids = np.concatenate([np.empty(0, dtype=np.int64), *(p.ids for p in deck.elements if p.kind != "point")])
    for section in dict.fromkeys(part.section for part in parts):
        own = np.concatenate([part.elements.ids for part in parts if part.section is section])
        name = section.set
        if name in taken or in_ranges(solids, deck.element_sets[name]).sum() != len(own):
            name = f"{section.set} of {section.code.removeprefix('*')}"
            while name in deck.element_sets or name in sets:
                name += " again"
            sets[name] = ranges_of(own)
        taken.add(name)
        material = deck.materials.get(section.material, ElasticMaterial(name=section.material))
        lost = [
            f"*{word}"
            for word, value in (("ELASTIC", material.stiffness), ("DENSITY", material.density))
            if value is None
        ]
        sections.append(
            Section(
                set=name,
                code=section.code,
                material=section.material,
                stiffness=material.stiffness,
                density=material.density,
                lacks=f"the material {section.material} of the set {name} has no {' and no '.join(lost)}"
                if lost
                else "",
            )
        )
    return sets, sections
