"""Solid sections of an input deck with their materials."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats
from morembs.fem.material import Material, isotropic, orthotropic
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.deck import Contents, Rows, Scope, values
from morembs.importers.abaqus.keywords import Card
from morembs.importers.abaqus.names import Placed
from morembs.importers.decks.algebra import frame_of, rotate_stiffness
from morembs.importers.decks.tables import ElasticMaterial, Section

# What has a stiffness of its own, but no linear one.
_NOT_LINEAR = {
    "HYPERELASTIC",
    "HYPERFOAM",
    "USER MATERIAL",
    "HYPOELASTIC",
    "POROUS ELASTIC",
    "EOS",
    "LOW DENSITY FOAM",
    "FLUID CONSTANTS",
    "ACOUSTIC MEDIUM",
    "FABRIC",
    "JOINTED MATERIAL",
}
_TWO_WAYS = {"NO TENSION", "NO COMPRESSION"}
# Where the constants of anisotropic elasticity go; Abaqus orders shear 12, 13, 23, which is 5, 4, 3 here.
_ORDER = (0, 1, 2, 5, 4, 3)
_ORTHOTROPIC = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2), (3, 3), (4, 4), (5, 5))
_ANISOTROPIC = tuple((i, j) for j in range(6) for i in range(j + 1))


@dataclass
class SectionMaterials:
    """Solid sections with their materials, and what is to be said."""

    sections: list[Section] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def materials_of(deck: Contents, assembly: Assembly) -> SectionMaterials:
    """The materials of a deck; sections that name what is not there are problems of it."""
    result = SectionMaterials()
    sections = [
        (placed, scope, card)
        for placed in (*assembly.placed.values(), assembly.top)
        for scope in placed.contents
        for card, _ in scope.properties
        if card.keyword == "SOLID SECTION"
    ]
    owner = np.full(assembly.solids, -1)
    for number, (placed, _, card) in enumerate(sections):
        with deck.problems.collected(card):
            own = assembly.elements_of(placed, card.need("ELSET"))
            owner[own[own < assembly.solids]] = number
    for number, (placed, scope, card) in enumerate(sections):
        if card.options.get("ELSET", "").upper() in placed.sets("element"):
            with deck.problems.collected(card):
                _section(deck, assembly, placed, scope, card, result, owner == number)
    if not deck.materials:
        result.notes.append("The deck has no materials of its own.")
    result.notes[:] = dict.fromkeys(result.notes)
    result.warnings[:] = dict.fromkeys(result.warnings)
    return result


def _section(
    deck: Contents,
    assembly: Assembly,
    placed: Placed,
    scope: Scope,
    card: Card,
    result: SectionMaterials,
    last: NDArray[np.bool_],
) -> None:
    """The material of a section, which is the ``last`` (solids,) of some elements."""
    elset, name = card.need("ELSET"), card.need("MATERIAL")
    for option in ("COMPOSITE", "SYMMETRIC", "REF NODE"):
        if option in card.options:
            raise InputError(
                f"{card} of {elset!r} is given with {option}; expected a section of one material", kind="conflict"
            )
    numbers = assembly.elements_of(placed, elset)
    if not (numbers < assembly.solids).any():
        result.notes.append(f"The solid section of {elset} has no elements and was left out.")
        return
    solids = numbers[numbers < assembly.solids]
    if deck.dialect == "calculix" and not last[solids].all():
        result.warnings.append(
            f"{int((~last[solids]).sum())} elements of the set {elset} are in a later *SOLID SECTION too, whose "
            "material they have, as in CalculiX"
        )
        if not last[solids].any():
            return
        elset = assembly.new_elements(placed, f"{elset} in its last section", solids[last[solids]])
    if name.upper() not in deck.materials:
        raise InputError(
            f"{card} of {elset!r} names the material {name!r}; {_materials_like(name, deck)}", kind="unknown"
        )
    given = _properties(deck, name, result)
    final = assembly.final_name("element", placed, elset)
    of_set = f"the material {name} of the set {final}"
    section = Section(set=final, code=f"*{card.keyword}", material=name)
    if "ELASTIC" not in given:
        other = [own.keyword for own, _ in deck.materials[name.upper()] if own.keyword in _NOT_LINEAR]
        missing = "ELASTIC" if "DENSITY" in given else "ELASTIC and no *DENSITY"
        sentence = f"is *{other[0]} only, which is not linear elastic" if other else f"has no *{missing}"
        result.sections.append(replace(section, lacks=f"{of_set} {sentence}"))
        return
    elastic, rows = given["ELASTIC"]
    axes = None
    if elastic.options.get("TYPE", "ISO").upper()[:3] != "ISO":
        orientation = card.options.get("ORIENTATION", "").upper()
        own_axes = np.eye(3)
        # CalculiX takes the global axes where a section names none.
        if orientation or deck.dialect != "calculix":
            own_axes = axes_of(placed, scope, deck, orientation, elset, name)
        axes = own_axes @ placed.rotation.T
    if "DENSITY" not in given:
        stiffness = _elastic(elastic, rows, final, name, 1.0, axes, result.warnings).stiffness
        result.sections.append(replace(section, stiffness=stiffness, lacks=f"{of_set} has no *DENSITY"))
        return
    density = _numbers(*given["DENSITY"], 1, name, result.warnings)[0]
    material = _elastic(elastic, rows, final, name, density, axes, result.warnings)
    result.sections.append(replace(section, stiffness=material.stiffness, density=density))


def _materials_like(name: str, deck: Contents) -> str:
    return nearest(name, deck.materials) if deck.materials else "the deck defines no *MATERIAL"


def elastic_of(deck: Contents, name: str) -> ElasticMaterial:
    """A material along its own axes, without a stiffness where it has no linear one in space.

    Raises:
        InputError: it is not there, or its constants cannot be read.
    """
    if name.upper() not in deck.materials:
        raise InputError(
            f"{deck.name}: a section names the material {name!r}; {_materials_like(name, deck)}", kind="unknown"
        )
    given = _properties(deck, name, SectionMaterials())
    density = _numbers(*given["DENSITY"], 1, name, [])[0] if "DENSITY" in given else None
    if "ELASTIC" not in given or given["ELASTIC"][0].options.get("TYPE", "").upper().startswith("LAMINA"):
        return ElasticMaterial(name=name, density=density)
    return ElasticMaterial(
        name=name, stiffness=_elastic(*given["ELASTIC"], name, name, 1.0, None, []).stiffness, density=density
    )


def _properties(deck: Contents, name: str, result: SectionMaterials) -> dict[str, tuple[Card, Rows]]:
    """*ELASTIC and *DENSITY of a material."""
    given: dict[str, tuple[Card, Rows]] = {}
    for own, rows in deck.materials[name.upper()]:
        if own.keyword in given:
            raise InputError(
                f"{own} is given twice in the material {name!r}; expected one, the one that holds", kind="conflict"
            )
        rows = [row for row in rows if row]
        if own.keyword in ("ELASTIC", "DENSITY"):
            given[own.keyword] = own, rows
        elif own.keyword == "DEFORMATION PLASTICITY" and rows:
            # Its first two constants are Young's modulus and Poisson's ratio.
            given["ELASTIC"] = Card("ELASTIC", {}, own.file, own.line), [rows[0][:2]]
            result.notes.append(f"Material {name}: of *{own.keyword} the elastic constants were taken.")
        elif own.keyword in _TWO_WAYS:
            result.warnings.append(f"material {name}: *{own.keyword} is not linear; it is elastic both ways here")
        elif own.keyword not in _NOT_LINEAR:
            result.notes.append(f"Material {name}: *{own.keyword} is not carried over.")
    return given


def _numbers(card: Card, rows: Rows, count: int, name: str, warnings: list[str]) -> list[float]:
    """``count`` constants, eight on a line; of a table the first temperature, which may stand behind them."""
    lines = -(-count // 8)
    if len(rows) > lines or card.options.get("DEPENDENCIES"):
        warnings.append(
            f"*{card.keyword} of the material {name} is a table; its first line was taken [temperature-first-row]"
        )
    flat = [number for row in rows[:lines] for number in values(row, card)]
    if len(flat) < count or (len(flat) > count + 1 and not card.options.get("DEPENDENCIES")):
        raise InputError(f"{card} of the material {name!r} has {len(flat)} constants; expected {count}")
    return flat[:count]


def _elastic(
    card: Card, rows: Rows, final: str, name: str, density: float, axes: Floats | None, warnings: list[str]
) -> Material:
    kind = " ".join(card.options.get("TYPE", "ISOTROPIC").upper().split())
    if kind.startswith("ISO"):
        young, poisson = _numbers(card, rows, 2, name, warnings)
        return isotropic(set=final, young=young, poisson=poisson, density=density)
    if kind.startswith("ENGINEERING"):
        c = _numbers(card, rows, 9, name, warnings)
        return orthotropic(
            set=final,
            young=(c[0], c[1], c[2]),
            poisson=(c[3], c[4], c[5]),
            shear=(c[6], c[7], c[8]),
            density=density,
            axes=axes,
        )
    places = {"ORTHO": _ORTHOTROPIC, "ANISO": _ANISOTROPIC}.get(kind[:5])
    if places is None:
        raise InputError(
            f"{card} of the material {name!r} is of the type {kind}; expected ISOTROPIC, ENGINEERING CONSTANTS, "
            "ORTHOTROPIC or ANISOTROPIC",
            kind="unsupported",
        )
    C = np.zeros((6, 6))
    for (i, j), value in zip(places, _numbers(card, rows, len(places), name, warnings), strict=True):
        i, j = _ORDER[i], _ORDER[j]
        C[i, j] = C[j, i] = value
    return Material(set=final, stiffness=C if axes is None else rotate_stiffness(C, axes), density=density)


def axes_of(placed: Placed, scope: Scope, deck: Contents, key: str, elset: str, name: str) -> Floats:
    """Rows are the material directions 1, 2, 3 in the axes of the part."""
    orientation = scope.orientations.get(key) or deck.top.orientations.get(key)
    if not orientation:
        raise InputError(
            f"{deck.name}: the material {name!r} of {elset!r} is not isotropic and its section names no *ORIENTATION "
            f"that is defined ({key or 'none'} was given); expected one",
            kind="missing",
        )
    card, rows = orientation
    rows = [row for row in rows if row]
    system = card.options.get("SYSTEM", "RECTANGULAR").upper()
    if not system.startswith("RECT") or card.options.get("DEFINITION", "COORDINATES").upper() != "COORDINATES":
        raise InputError(f"{card} {key!r} is not a rectangular one given by coordinates, which is expected")
    numbers = values(rows[0], card) if rows else []
    if len(numbers) not in (6, 9):
        raise InputError(f"{card} {key!r} has {len(numbers)} coordinates; expected two or three points")
    origin = np.array(numbers[6:9]) if len(numbers) == 9 else np.zeros(3)
    a, b = np.array(numbers[:3]) - origin, np.array(numbers[3:6]) - origin
    axes = frame_of(a, b)
    if axes is None:
        raise InputError(f"{card} {key!r}: the points lie on a line, so they give no directions", kind="model")
    if len(rows) > 1:
        turn = values(rows[1], card)
        axis, angle = int(turn[0]) - 1, np.radians(turn[1] if len(turn) > 1 else 0.0)
        if turn[0] not in (1.0, 2.0, 3.0):
            raise InputError(f"{card} {key!r} turns about the axis {turn[0]:g}; expected 1, 2 or 3")
        j, k = (axis + 1) % 3, (axis + 2) % 3
        c, s = np.cos(angle), np.sin(angle)
        axes[[j, k]] = c * axes[j] + s * axes[k], c * axes[k] - s * axes[j]
    return axes
