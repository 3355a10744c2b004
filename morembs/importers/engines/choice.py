"""``auto``: own assembly where it takes a deck, else the first program there that reads it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from morembs.base.errors import InputError
from morembs.base.options import list_options
from morembs.importers.decks.problems import DeckError, Problem
from morembs.importers.engines import AUTO, ENGINES, Engine, format_argument, import_with_engine
from morembs.importers.imported import Imported

# Options of programs that say nothing of the model: own assembly does without them.
_OF_RUNS = ("timeout", "keep_files", "jobs", "grids")


def import_by_choice(
    path: Path,
    format: str,
    options: Mapping[str, Any],
    own: Callable[[Mapping[str, Any]], Imported],
    own_options: Collection[str],
    **given: Any,
) -> Imported:
    """A deck as own assembly makes it, else as the first engine that is there and reads it; a note says which and why.

    Args:
        options: of own assembly and of engines; each gets its own.
        own: the deck by own assembly with options, of which it has ``own_options``.
        given: further arguments of engines, such as materials.

    Raises:
        InputError: nobody takes the deck: what keeps it from the one that needs least.
    """
    # The program of the format comes first.
    by_fit = sorted(ENGINES.items(), key=lambda item: item[1].formats[0] != format)
    engines = {name: engine for name, engine in by_fit if format in engine.formats}
    plain = {key: value for key, value in options.items() if key not in _OF_RUNS}
    known_there = {key for engine in engines.values() for key in engine.options}
    if not set(plain) <= {*own_options, *known_there}:
        return own(plain)  # which says that there is no such option
    beyond = [key for key in plain if key not in own_options]
    try:
        if beyond:
            raise InputError(f"own assembly has no --{beyond[0]}", kind="unsupported")
        imported = own(plain)
    except InputError as error:
        refused = error
    else:
        return _note(imported, "own assembly, which takes all elements of the deck")
    errors, notes = [refused], list[str]()
    for name, engine in engines.items():
        lacked = sorted(set(plain) - set(engine.options))
        if lacked:
            # Left out, the option would not reach the model.
            notes.append(f"{engine.program} has no --{lacked[0]}")
            continue
        its_options = {key: value for key, value in options.items() if key in engine.options}
        try:
            executable = engine.find("")
        except InputError:
            notes += _would_read(path, format, engine, {**options, **given})
            continue
        try:
            imported = import_with_engine(path, format, f"{name}:{executable.path}", its_options, **given)
        except DeckError as error:
            errors.append(error)
        except InputError as error:
            notes.append(f"{engine.program} fails: {error}")
        else:
            return _note(imported, f"{engine.program}, as own assembly refuses the deck: {_first(refused)}")
    least = min(errors, key=_needs)
    if isinstance(least, DeckError):
        hint = "; ".join(filter(None, [least.hint, *notes]))
        given_flags = [flag for flag in least.given if not flag.startswith("--engine ")]
        raise DeckError(least.source, least.problems, (f"--engine {AUTO}", *given_flags), hint=hint) from least
    raise InputError("; ".join([str(least), *notes]), kind="unsupported", keyword="engine") from least


def _note(imported: Imported, who: str) -> Imported:
    return replace(imported, notes=(f"Assembled by {who} (auto).", *imported.notes))


def _would_read(path: Path, format: str, engine: Engine, options: Mapping[str, Any]) -> list[str]:
    """A word on a program that is not there and would read the deck."""
    try:
        own = {key: value for key, value in options.items() if key in list_options(engine.readable)}
        engine.readable(path, **own, **format_argument(engine.readable, format))
    except InputError:
        return []
    return [f"{engine.program} would read this deck and was not found; install it"]


def _first(error: InputError) -> str:
    """The first thing that keeps a deck from own assembly, without its cure."""
    text = error.problems[0].what if isinstance(error, DeckError) and error.problems else str(error)
    return text.split("; ")[0].rstrip(".")


def _needs(error: InputError) -> tuple[bool, int, int]:
    """Cost of an answer to an error: whether options answer it at all, features that it skips, and problems."""
    problems = error.problems if isinstance(error, DeckError) else (Problem(what=str(error)),)
    flags = [flag for problem in problems for flag in problem.flags]
    lost = sum(flag.startswith("--skip") for flag in flags)
    return not all(problem.flags for problem in problems), lost, len(problems)
