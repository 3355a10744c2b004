"""Decks that CalculiX assembles."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from morembs.base.arguments import check_value
from morembs.base.errors import InputError
from morembs.base.limits import Count, Positive, one_of
from morembs.fem.material import Material
from morembs.importers.decks.flat import Choices
from morembs.importers.decks.formulations import DIALECTS
from morembs.importers.decks.model import Deck
from morembs.importers.decks.options import Boundary, deck_options
from morembs.importers.decks.tables import Supports
from morembs.importers.engines.calculix.model import Exported
from morembs.importers.engines.calculix.other_decks import complete_deck, flat_deck, with_others
from morembs.importers.engines.calculix.program import Ccx, find_ccx
from morembs.importers.engines.run import Program
from morembs.importers.for_calculix import read_for_calculix
from morembs.importers.imported import Imported
from morembs.importers.tolerances import TOL


def import_with_calculix(
    path: str | Path,
    *,
    executable: str = "",
    density: float | dict[str, float] | None = None,
    contact: str = "refuse",
    skip: list[str] | str = "",
    pretension: str = "auto",
    boundary: str = "drop",
    preload: int = 0,
    timeout: float = TOL.engine_seconds,
    keep_files: str = "",
    allow_includes_outside: bool = False,
    dialect: str = "auto",
    materials: tuple[Material, ...] = (),
    format: str = "abaqus",
) -> Imported:
    """A deck as CalculiX assembles it, in the deck's own units.

    One of another program is written as a flat deck; its masses, springs and average elements are
    added to the matrices.

    Args:
        executable: the path of ccx; "" looks for it.
        density: of materials with *ELASTIC and without *DENSITY, or set -> density, "all" standing for all.
        contact: "refuse" contact pairs, "skip" them, or "tie" them: glue their surfaces.
        pretension: bolts with *PRE-TENSION SECTION are "cut", as CalculiX has them ("auto" too), or "locked".
        skip: keywords and element types to leave out, although stiffness or mass may depend on them.
        boundary: "drop" what *BOUNDARY holds, for a free body, or "keep" it.
        preload: steps that run first; the matrices are those of small motions after them.
        timeout: seconds for each run of ccx.
        keep_files: a folder for what ccx read and wrote.
        allow_includes_outside: includes may name files beyond the folder of the deck.
        dialect: the program that the deck was written for; a model of one of Abaqus says that CalculiX differs.
        materials: of element sets that have none, or "all" of these, in the units of the deck.
        format: of the deck, one of ``for_calculix.FORMATS``.

    Peak memory: that of the matrices several times, and of ccx itself.

    Raises:
        DeckError: all that keeps the deck from becoming a model.
        InputError: no ccx, options that are not known, or a run that fails.
    """
    program = find_ccx(executable)
    check_value("dialect", dialect, Annotated[str, one_of(*DIALECTS)])
    choices = _choices(boundary, preload, timeout, materials)
    options = deck_options(density, contact, skip, pretension)
    deck = read_for_calculix(Path(path), format, options, dialect=dialect, outside=allow_includes_outside)
    keep = Path(keep_files) if keep_files else None
    return assemble_with_calculix(deck, choices, program=program, seconds=timeout, keep=keep)


def assemble_with_calculix(
    deck: Deck, choices: Choices, *, program: Program, seconds: float = TOL.engine_seconds, keep: Path | None = None
) -> Imported:
    """A deck of any program as CalculiX assembles it, in the deck's own units.

    Args:
        program: ccx, as ``find_ccx`` gives it.
        seconds: for each run of it.
        keep: a folder for its input and output files.

    Raises:
        DeckError: all that keeps the deck from becoming a model.
        InputError: a run that fails, or choices that the deck has nothing for.
    """
    if deck.cards is None:
        deck, flat = flat_deck(_ready(deck, choices))
    else:
        flat = deck.cards(choices)
    with Ccx(program=program, flat=flat, seconds=seconds, keep=keep) as ccx:
        read = ccx.export()
        imported = Exported(deck, flat, read, ccx.expansion(), held=choices.keep).convert(ccx, choices)
    return imported if deck.cards is not None else with_others(imported, deck)


def _ready(deck: Deck, choices: Choices) -> Deck:
    """A deck without cards that holds what is asked for.

    Raises:
        DeckError: all that keeps it from being written for CalculiX.
        InputError: steps or supports, which were not read.
    """
    if choices.preload:
        raise InputError(
            f"--preload {choices.preload} was given for {deck.name}, whose steps are not read; leave it out",
            kind="unsupported",
            keyword="preload",
        )
    deck = complete_deck(deck, choices.materials)
    if choices.keep and not len(deck.supports.nodes):
        raise InputError(
            f"--boundary keep was given for {deck.name}, whose supports are not read; leave it out, and hold the model "
            "by [[interface]] of a job",
            kind="unsupported",
            keyword="boundary",
        )
    # Along turned axes they would be equations, which stay.
    return deck if choices.keep else replace(deck, supports=Supports())


def readable_by_calculix(
    path: Path,
    *,
    density: dict[str, float] | None = None,
    contact: str = "refuse",
    skip: list[str] | str = "",
    pretension: str = "auto",
    allow_includes_outside: bool = False,
    materials: tuple[Material, ...] = (),
    format: str = "abaqus",
) -> None:
    """True if a deck can be written for CalculiX; it is not run.

    Raises:
        InputError: it cannot.
    """
    options = deck_options(density, contact, skip, pretension)
    deck = read_for_calculix(path, format, options, outside=allow_includes_outside)
    if deck.cards is not None:
        deck.cards(Choices(materials=materials))
        return
    flat_deck(complete_deck(deck, materials))


def _choices(boundary: str, preload: int, timeout: float, materials: tuple[Material, ...]) -> Choices:
    check_value("--boundary", boundary, Boundary)
    check_value("--preload", preload, Count)
    check_value("--engine-timeout", timeout, Positive)
    if preload and boundary == "drop":
        raise InputError(
            f"--preload {preload} was given with --boundary drop, but supports carry the load; give --boundary keep, "
            "or [preload] in the job",
            kind="conflict",
            keyword="preload",
        )
    return Choices(keep=boundary == "keep", preload=preload, materials=materials)
