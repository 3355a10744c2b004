"""Abaqus and CalculiX input decks with their labels: mesh, sets, surfaces, materials, and all that ties or hangs on it.

Read here and not by meshio, which drops labels, sets named inside keywords, instances in their places and materials.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from morembs.base.arguments import check_value
from morembs.base.errors import InputError
from morembs.base.limits import one_of
from morembs.fem import Mesh
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.reader import read_deck
from morembs.importers.abaqus.whole import deck_of, mesh_deck
from morembs.importers.decks.expansion.sections import is_expanded
from morembs.importers.decks.formulations import DIALECTS
from morembs.importers.decks.model import Deck
from morembs.importers.decks.options import deck_options
from morembs.importers.decks.problems import Problem


def read_abaqus(path: Path, *, dialect: str = "auto", allow_includes_outside: bool = False) -> Mesh:
    """Mesh of an input deck in the deck's own units; its materials are not read.

    Raises:
        InputError: not a deck, an element type that is not supported, or couplings, springs and point masses, which a
            mesh cannot carry.
    """
    deck = read_deck(path, outside=allow_includes_outside, dialect=_check_dialect(dialect))
    scopes = [deck.top, *deck.parts.values(), *(instance.scope for instance in deck.instances.values())]
    ties = [card for scope in scopes for card, *_ in scope.constraints]
    if ties or any(scope.discrete for scope in scopes):
        what = f"*{ties[0].keyword}" if ties else "point masses or springs"
        deck.problems.add(
            Problem(
                what=f"{deck.name} has {what}, which a mesh cannot carry; import the whole deck, or take them out",
                file=deck.name,
                keyword=ties[0].keyword if ties else "ELEMENT",
            )
        )
    with deck.problems.ending():
        whole = mesh_deck(deck, Assembly(deck))
    if not any(part.kind == "solid" or is_expanded(part) for part in whole.elements):
        deck.problems.refuse()
        raise InputError(
            f"{deck.name} has no solid elements; a volume mesh is needed (tet, hex or wedge)", kind="missing"
        )
    return whole.mesh()


def read_abaqus_deck(
    path: str | Path,
    *,
    dialect: str = "auto",
    density: float | dict[str, float] | None = None,
    contact: str = "refuse",
    skip: list[str] | str = "",
    pretension: str = "auto",
    allow_includes_outside: bool = False,
) -> Deck:
    """All of an input deck as tables by labels of the whole, in the deck's own units.

    Boundary conditions and steps are not applied (``notes`` say so).

    Args:
        allow_includes_outside: includes may name files beyond the folder of the deck.
        dialect: the program whose element types are meant, "abaqus" or "calculix"; "auto" looks at keywords and
            comments.
        density: of materials with *ELASTIC and without *DENSITY, or set -> density, "all" standing for all.
        contact: "refuse" contact pairs, "skip" them, or "tie" them: glue their surfaces.
        skip: keywords and element types to leave out, although stiffness or mass may depend on them.
        pretension: bolts with *PRE-TENSION SECTION are "locked", as one piece, or "cut", so that the faces part along
            the normal by one dof; "auto" refuses them.

    Peak memory: the numbers of the mesh about twice, besides a piece of the file of a few MB and the text of loads,
    supports and properties.

    Raises:
        DeckError: it makes no sense; what else keeps it from becoming a model is among the ``problems`` of the deck.
        InputError: options that are not known.
    """
    options = deck_options(density, contact, skip, pretension)
    return deck_of(
        read_deck(Path(path), outside=allow_includes_outside, dialect=_check_dialect(dialect), options=options)
    )


def _check_dialect(dialect: str) -> str:
    check_value("dialect", dialect, Annotated[str, one_of(*DIALECTS)])
    return dialect
