"""Decks that CalculiX assembles."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from morembs.base.arguments import check_value
from morembs.base.errors import InputError
from morembs.base.limits import Count, Positive, one_of
from morembs.base.scratch import ScratchFolder
from morembs.fem.material import Material
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.deck import Contents
from morembs.importers.decks.formulations import DIALECTS
from morembs.importers.decks.options import Boundary, DeckOptions, deck_options
from morembs.importers.decks.tables import Supports
from morembs.importers.engines.calculix.flat import Choices, flat_deck
from morembs.importers.engines.calculix.model import Exported
from morembs.importers.engines.calculix.other_decks import FORMATS, read_other, with_others, write_other
from morembs.importers.engines.calculix.program import Ccx, find_ccx
from morembs.importers.engines.calculix.read import read_for_engine
from morembs.importers.engines.calculix.ties import Flat
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

    One of another program becomes a flat deck first (``Deck.write``); its masses, springs and average elements are
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
        format: of the deck, "abaqus" or one of ``other_decks.FORMATS``.

    Peak memory: that of the matrices several times, and of ccx itself.

    Raises:
        DeckError: all that keeps the deck from becoming a model.
        InputError: no ccx, options that are not known, or a run that fails.
    """
    program = find_ccx(executable)
    check_value("dialect", dialect, Annotated[str, one_of(*DIALECTS)])
    choices = _choices(deck_options(density, contact, skip, pretension), boundary, preload, timeout, materials)
    if format in FORMATS:
        if preload:
            raise InputError(
                f"--preload {preload} was given for {Path(path).name}, whose steps are not read; leave it out"
            )
        other = read_other(Path(path), format, choices.options, materials, outside=allow_includes_outside)
        if boundary == "keep" and not len(other.supports.nodes):
            raise InputError(
                f"--boundary keep was given for {Path(path).name}, whose supports are not read; leave it out, and hold "
                "the model by [[interface]] of a job"
            )
        if boundary == "drop":
            # Along turned axes they would be equations, which stay.
            other = replace(other, supports=Supports())
        with closing(ScratchFolder(None)) as scratch:
            flat_path, said = write_other(other, scratch.path)
            imported = import_with_calculix(
                flat_path,
                executable=str(program.path),
                boundary=boundary,
                timeout=timeout,
                keep_files=keep_files,
                dialect="calculix",
            )
        return with_others(imported, other, said)
    deck, assembly, flat = _flat(Path(path), choices, outside=allow_includes_outside)
    deck.dialects = deck.dialects if dialect == "auto" else {dialect}
    keep = Path(keep_files) if keep_files else None
    with Ccx(program=program, flat=flat.deck, seconds=timeout, keep=keep) as ccx:
        read = ccx.export()
        model = Exported(deck, assembly, flat, read, ccx.expansion(), held=choices.keep)
        return model.imported(ccx, choices)


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
    """Whether a deck can be written for CalculiX; it is not run.

    Raises:
        InputError: it cannot.
    """
    choices = Choices(options=deck_options(density, contact, skip, pretension), materials=materials)
    if format in FORMATS:
        other = read_other(path, format, choices.options, materials, outside=allow_includes_outside)
        with closing(ScratchFolder(None)) as scratch:
            write_other(other, scratch.path)
        return
    _flat(path, choices, outside=allow_includes_outside)


def _flat(path: Path, choices: Choices, *, outside: bool) -> tuple[Contents, Assembly, Flat]:
    deck = read_for_engine(path, choices.options, outside=outside)
    with deck.problems.ending():
        assembly = Assembly(deck)
        return deck, assembly, flat_deck(deck, assembly, choices)


def _choices(
    options: DeckOptions, boundary: str, preload: int, timeout: float, materials: tuple[Material, ...]
) -> Choices:
    check_value("--boundary", boundary, Boundary)
    check_value("--preload", preload, Count)
    check_value("--engine-timeout", timeout, Positive)
    if preload and boundary == "drop":
        raise InputError(
            f"--preload {preload} was given with --boundary drop, but supports carry the load; give --boundary keep, "
            "or [preload] in the job"
        )
    return Choices(options=options, keep=boundary == "keep", preload=preload, materials=materials)
