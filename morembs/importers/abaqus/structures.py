"""Sections of shells, membranes, beams and trusses of an input deck, which own assembly or a program takes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.deck import STRUCTURES, VTK_ORDER, Contents, Rows, Scope, values
from morembs.importers.abaqus.keywords import Card
from morembs.importers.abaqus.materials import axes_of, elastic_of
from morembs.importers.abaqus.names import Placed
from morembs.importers.decks.tables import ElasticMaterial, Ply, Section
from morembs.importers.tolerances import TOL

# Words in place of the number of an offset.
_SIDES = {"SPOS": 0.5, "SNEG": -0.5}


@dataclass
class Structures:
    """``sections`` with the ``materials`` that they name, and ``values`` of elements by their names and numbers."""

    sections: list[Section] = field(default_factory=list)
    materials: dict[str, ElasticMaterial] = field(default_factory=dict)
    values: dict[str, dict[int, Floats]] = field(default_factory=dict)


def structures_of(contents: Contents, assembly: Assembly) -> Structures:
    """Sections of elements that are there; what is no section is a problem of the deck."""
    result = Structures()
    kinds: list[str] = []
    for code, labels, nodes in assembly.others:
        kinds += [STRUCTURES[code][0] if nodes.shape[1] else ""] * len(labels)
    start = assembly.solids + len(assembly.discrete)
    for placed, scope, card, rows in _cards(assembly):
        if card.options.get("ELSET", "").upper() not in placed.sets("element"):
            continue
        numbers = assembly.elements_of(placed, card.options["ELSET"])
        if not card.keyword.endswith("SECTION"):
            continue
        kind = {"SOLID": "truss"}.get(card.keyword.split()[0], card.keyword.split()[0].lower())
        own = [int(number) for number in numbers if number >= start and kinds[number - start] == kind]
        if own:
            with contents.problems.collected(card):
                section = _section(contents, assembly, placed, scope, card, [row for row in rows if row], kind)
                result.sections.append(section)
                if kind == "beam":
                    _offset(assembly, card, section, own, result)
                elif "NODAL THICKNESS" in card.options:
                    _nodal_thickness(assembly, card, own, result)
    for placed, _, card, rows in _cards(assembly):
        if card.keyword == "NORMAL":
            with contents.problems.collected(card):
                _normals(assembly, placed, card, [row for row in rows if row], result)
    named = [name for own in result.sections for name in (own.material, *(ply.material for ply in own.plies))]
    for name in dict.fromkeys(filter(None, named)):
        with contents.problems.collected():
            result.materials[name] = elastic_of(contents, name)
    return result


def _cards(assembly: Assembly) -> Iterator[tuple[Placed, Scope, Card, Rows]]:
    """Sections, normals and thicknesses with where they stand."""
    for placed in (*assembly.placed.values(), assembly.top):
        for scope in placed.contents:
            for card, rows in (*scope.sections, *scope.properties):
                yield placed, scope, card, rows


def _section(
    contents: Contents, assembly: Assembly, placed: Placed, scope: Scope, card: Card, rows: Rows, kind: str
) -> Section:
    """The section that a card is.

    Raises:
        InputError: data that are none.
    """
    name = assembly.final_name("element", placed, card.need("ELSET"))
    code = f"*{card.keyword}{', NODAL THICKNESS' if 'NODAL THICKNESS' in card.options else ''}"
    key, material = card.options.get("ORIENTATION", "").upper(), card.options.get("MATERIAL", "").upper()
    axes = axes_of(placed, scope, contents, key, name, material) @ placed.rotation.T if key else None
    section = Section(set=name, kind=kind, code=code, material=material, axes=axes)
    first = values(rows[0], card) if rows and "COMPOSITE" not in card.options else []
    if kind == "beam":
        given = values(rows[1], card)[:3] if len(rows) > 1 else [0.0, 0.0, -1.0]
        direction = placed.rotation @ np.array([*given, *[0.0] * 3][:3])
        profile, sizes = _profile(card, first, contents.dialect)
        return replace(section, profile=profile, dimensions=sizes, direction=direction)
    if kind == "truss":
        return replace(section, dimensions=tuple(first[:1] or [1.0]))
    if "COMPOSITE" in card.options:
        section = _with_plies(contents, placed, scope, card, rows, section)
    elif first:
        section = replace(section, thickness=first[0])
    text = card.options.get("OFFSET", "").upper()
    share = _SIDES[text] if text in _SIDES else values([text], card)[0]
    return replace(section, offset=-share * section.thickness)


def _profile(card: Card, sizes: list[float], dialect: str) -> tuple[str, tuple[float, ...]]:
    """Profile and dimensions of beams; CalculiX goes by four letters, and gives the axes of an ellipse for a circle."""
    profile = card.options.get("SECTION", "").upper()
    profile = profile[:4] if profile[:4] in ("RECT", "CIRC") else profile
    if profile != "CIRC" or dialect != "calculix" or not sizes:
        return profile, tuple(sizes)
    a, b = [*sizes, sizes[0]][:2]
    return ("CIRC", (a / 2,)) if a == b else ("ELLIPSE", (a, b))


def _with_plies(contents: Contents, placed: Placed, scope: Scope, card: Card, rows: Rows, section: Section) -> Section:
    """The section with its layers: thickness, points, material, and an orientation by its name or as an angle."""
    plies, axes = list[Ply](), section.axes
    for row in rows:
        words = row + [""] * (4 - len(row))
        angle, name = 0.0, words[3].upper()
        if name[:1] in "+-.0123456789":
            angle = values([name], card)[0]
        else:
            own = axes_of(placed, scope, contents, name, section.set, words[2]) @ placed.rotation.T
            axes = own if axes is None else axes
            if own[2] @ axes[2] < 1 - TOL.same_offset:
                raise InputError(
                    f"{card} of {section.set!r} has layers whose orientations have other normals", kind="unsupported"
                )
            angle = float(np.degrees(np.arctan2(own[0] @ axes[1], own[0] @ axes[0])))
        plies.append(Ply(material=words[2].upper(), thickness=values(words[:1], card)[0], angle=angle))
    return replace(section, plies=tuple(plies), thickness=sum(ply.thickness for ply in plies), axes=axes)


def _offset(assembly: Assembly, card: Card, section: Section, numbers: list[int], result: Structures) -> None:
    """Vectors of OFFSET1 and OFFSET2, in widths of the profile, of beams by their numbers."""
    shares = values([card.options.get("OFFSET1", ""), card.options.get("OFFSET2", "")], card)
    if not any(shares) or section.direction is None or not section.dimensions:
        return
    sizes = section.dimensions
    widths = (2 * sizes[0],) * 2 if section.profile == "CIRC" else (*sizes, *sizes)[:2]
    for number, nodes in _nodes_of(assembly, numbers):
        ends = assembly.xyz[nodes[:2]]
        line = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        first = section.direction - (line @ section.direction) * line
        first = first / np.linalg.norm(first)
        second = np.cross(line, first)
        # Offsets are the place of the node, measured from the axis.
        vector = -shares[0] * widths[0] * first - shares[1] * widths[1] * second
        result.values.setdefault("offset", {})[number] = np.array([vector, vector])


def _nodal_thickness(assembly: Assembly, card: Card, numbers: list[int], result: Structures) -> None:
    """Thicknesses of shells at their nodes.

    Raises:
        InputError: a node without one, or an offset in thicknesses, of which there are several.
    """
    if card.options.get("OFFSET"):
        raise InputError(f"{card} has NODAL THICKNESS and OFFSET; expected one of them", kind="conflict")
    given: dict[int, float] = {}
    for placed, _, own, rows in _cards(assembly):
        for row in rows if own.keyword == "NODAL THICKNESS" else []:
            if row:
                given |= dict.fromkeys(assembly.nodes_of(placed, row[0]).tolist(), values(row[1:2], own)[0])
    for number, nodes in _nodes_of(assembly, numbers):
        lost = [node for node in nodes.tolist() if not given.get(node, 0.0) > 0]
        if lost:
            raise InputError(
                f"{card}: node {assembly.ids[lost[0]]} has no *NODAL THICKNESS; expected a positive one", kind="missing"
            )
        result.values.setdefault("thickness", {})[number] = np.array([given[node] for node in nodes.tolist()])


def _normals(assembly: Assembly, placed: Placed, card: Card, rows: Rows, result: Structures) -> None:
    """Normals of elements at their nodes, NaN where there is none.

    Raises:
        InputError: a line without a direction, or with a node that its element does not have.
    """
    for row in rows:
        direction = placed.rotation @ np.array((values(row[2:5], card) + [0.0] * 3)[:3]) if len(row) > 2 else None
        if direction is None or not np.linalg.norm(direction) > 0:
            raise InputError(f"{card}: {', '.join(row)[:60]!r} was given; expected element, node and a direction")
        numbers = assembly.elements_of(placed, row[0]).tolist()
        wanted = assembly.nodes_of(placed, row[1])
        for number, nodes in _nodes_of(assembly, numbers):
            at = np.flatnonzero(np.isin(nodes, wanted))
            if not len(at):
                raise InputError(
                    f"{card}: the element {row[0]} does not have the node {row[1]}; mend the line", kind="unsupported"
                )
            none = np.full((len(nodes), 3), np.nan)
            own = result.values.setdefault("normal", {}).setdefault(number, none)
            own[at] = direction / np.linalg.norm(direction)


def _nodes_of(assembly: Assembly, numbers: list[int]) -> Iterator[tuple[int, Ints]]:
    """Shells, membranes, beams and trusses of ``numbers``, with rows of their nodes in VTK order."""
    start = assembly.solids + len(assembly.discrete)
    wanted = np.array(numbers, dtype=np.int64)
    for code, labels, nodes in assembly.others:
        order = VTK_ORDER.get(STRUCTURES[code][1] if nodes.shape[1] else "", slice(None))
        for number in wanted[(wanted >= start) & (wanted < start + len(labels))].tolist():
            yield number, nodes[number - start][order]
        start += len(labels)
