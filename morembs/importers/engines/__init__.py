"""Programs of others that assemble decks as a process of their own; the table is the contents page.

An engine takes a path, options as keyword arguments and the executable, and returns an ``Imported`` whose matrices are
those of the program, in the units of the deck.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from morembs.base.errors import InputError
from morembs.base.options import Text, list_options, read_options
from morembs.base.plugins import Registry
from morembs.fem.material import Material
from morembs.importers.decks.problems import DeckError
from morembs.importers.engines.calculix.importer import import_with_calculix, readable_by_calculix
from morembs.importers.engines.calculix.program import find_ccx
from morembs.importers.engines.mystran.importer import import_with_mystran, readable_by_mystran
from morembs.importers.engines.mystran.program import find_mystran
from morembs.importers.engines.run import Program
from morembs.importers.for_calculix import FORMATS
from morembs.importers.imported import Imported

# What lets own assembly or one of the engines take a deck, whichever does.
AUTO = "auto"
# What of the parameters is no option.
_NO_OPTIONS = ("executable", "materials", "format")
# What people call decks by their formats.
_KINDS = {
    "abaqus": "Abaqus or CalculiX",
    "nastran": "Nastran bulk data",
    "ansys": "an archive of ANSYS",
    "unv": "a universal file",
}


@dataclass(frozen=True, kw_only=True)
class Engine:
    """A ``program`` by the name of people: its line of description, the ``formats`` of decks that it reads and their
    usual names, how it is found (given a path or ""), the function that reads a deck, and one that raises where a
    deck cannot be for it."""

    about: str
    program: str
    formats: tuple[str, ...]
    decks: str
    find: Callable[[str], Program]
    read: Callable[..., Imported]
    readable: Callable[..., None]

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the options."""
        return tuple(name for name in list_options(self.read) if name not in _NO_OPTIONS)


_OWN: dict[str, Engine] = {
    "calculix": Engine(
        about="CalculiX (ccx) assembles decks of Abaqus and CalculiX, and solids of other decks",
        formats=FORMATS,
        decks="decks of Abaqus or CalculiX, and solids of Nastran, ANSYS and universal files",
        find=find_ccx,
        read=import_with_calculix,
        readable=readable_by_calculix,
        program="CalculiX",
    ),
    "mystran": Engine(
        about="MYSTRAN assembles Nastran bulk data, and solids, shells and beams of Abaqus and ANSYS decks",
        formats=("nastran", "abaqus", "ansys"),
        decks="Nastran bulk data, decks of Abaqus, and archives of ANSYS",
        find=find_mystran,
        read=import_with_mystran,
        readable=readable_by_mystran,
        program="MYSTRAN",
    ),
}
ENGINES: Registry[Engine] = Registry(
    "morembs.engines", _OWN, lambda _, entry: "" if isinstance(entry, Engine) else f"{entry!r} is no Engine"
)


def engine_of(text: str) -> tuple[Engine, str]:
    """The engine and the executable that NAME or NAME:PATH means.

    Raises:
        InputError: no such engine.
    """
    name, _, path = text.partition(":")
    if name not in ENGINES:
        raise InputError(f"--engine {text!r} was given; {ENGINES.advice(name, AUTO)}", kind="unknown", keyword="engine")
    return ENGINES[name], path


def engines_for(path: Path, format: str, options: Mapping[str, Any]) -> list[str]:
    """Names of the engines that would read a deck; none is run."""
    names = []
    for name, engine in ENGINES.items():
        own = {key: value for key, value in options.items() if key in list_options(engine.readable)}
        if format in engine.formats:
            with suppress(InputError):
                engine.readable(path, **own, **format_argument(engine.readable, format))
                names.append(name)
    return names


def import_with_engine(
    path: Path, format: str, text: str, options: Mapping[str, Any], materials: Sequence[Material] = ()
) -> Imported:
    """What the engine NAME or NAME:PATH makes of a deck of a format.

    Args:
        materials: of element sets that have none, or "all" of these, in the units of the deck.

    Raises:
        InputError: an unknown engine or option, a deck of another format, or what the engine refuses.
    """
    engine, executable = engine_of(text)
    name = text.partition(":")[0]
    if format not in engine.formats:
        raise InputError(
            f"--engine {name} reads {engine.decks}; {path.name} is {_KINDS.get(format, format)}",
            kind="unsupported",
            keyword="engine",
        )
    given = {key: Text(value) if isinstance(value, str) else value for key, value in options.items()}
    values = read_options(
        engine.read,
        given,
        f"the engine {name}",
        where=f"{path.name}: ",
        hidden=_NO_OPTIONS,
        cure="; give --set {key}=VALUE",
    )
    given_format = format_argument(engine.read, format)
    try:
        return engine.read(path, executable=executable, materials=tuple(materials), **given_format, **values)
    except DeckError as error:
        raise DeckError(error.source, error.problems, (f"--engine {text}", *error.given), hint=error.hint) from error


def format_argument(function: Callable[..., object], format: str) -> dict[str, str]:
    """The argument for the format of a deck, where a function of an engine takes several."""
    return {"format": format} if "format" in list_options(function) else {}
