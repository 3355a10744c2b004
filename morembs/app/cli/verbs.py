"""The group of verbs: what people type beside them, and what is said of a command line that does not fit."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperGroup

from morembs.app.cli.messages import echo, failure, tell
from morembs.app.cli.terminal import without_flag_types
from morembs.app.kinds import BODY, JOB, MATRIX, MEMBER, PARTS, RESULT, SURFACE, SYSTEM, instead, kind_of
from morembs.base.errors import ExitCode, InputError, MorembsError, alike
from morembs.storage.contents import keeping_ledger
from morembs.version import VERSION

# Errors of a command line, of the copy of click that typer brings.
UsageError: Any = typer.BadParameter.__mro__[1]
# Words for verbs of other programs -> what does the same here.
SYNONYMS = {
    "run": "reduce",
    "solve": "reduce",
    "show": "info",
    "list": "info",
    "convert": "import",
    "read": "import",
    "new": "init",
    "create": "init",
    "eigen": "modes",
    "doctor": "import --check --dry-run",
}
# Verbs that are keys of a job.
KEYS = {"plot": 'picture = "NAME.png" under [output] of a job, or morembs reduce JOB.toml --report PAGE.html'}
# What people ask help about that is no verb -> where it is said.
TOPICS = {
    "units": 'units = "mm-t-s" under [model] of a job, --units mm-t-s of init and import: length, mass and time of all '
    "numbers of an input. In mm-t-s forces are in N, moduli in MPa, densities in t/mm3 (steel 7.85e-9); in m-kg-s "
    "in N, Pa and kg/m3. Body files are in m, kg and s.",
    "formats": "morembs import --list names the formats of input, morembs export --list the formats of output.",
    "methods": 'method = "NAME" under [[reduce]] of a job, or morembs reduce --method NAME '
    "(docs/background/methods.md).",
    "systems": "A system of bodies is a TOML file with the table [simulation], which morembs simulate runs "
    "(docs/howto/simulate.md).",
    "jobs": "morembs init PART writes a job with comments; morembs schema prints all of its keys.",
}


class Verbs(TyperGroup):
    """Each verb has a ledger of its own: no result replaces a file that the verb has read."""

    def main(self, args: Sequence[str] | None = None, standalone_mode: bool = True, **more: Any) -> Any:  # type: ignore[override]
        """As of typer, but what does not fit is answered in one line, with a command that fits."""
        try:
            code = super().main(args, standalone_mode=False, **more)
        except UsageError as error:
            if error.format_message():
                tell(f"error: {_answer(error)}")
            else:
                # Nothing was asked for: all verbs.
                error.show()
            code = ExitCode.BAD_INPUT
        except MorembsError as error:
            fault = failure(error)
            tell(f"error: {fault.message}")
            code = fault.code
        if standalone_mode:
            sys.exit(code if isinstance(code, int) else 0)
        return code

    def invoke(self, ctx: Any) -> Any:
        """Run the verb."""
        with keeping_ledger():
            return super().invoke(ctx)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Take what people type in place of a verb: help, version, doctor, or the name of a file."""
        first = args[0] if args else ""
        known = first in self.commands or first.startswith("-")
        if first == "version" and len(args) == 1:
            echo(f"morembs {VERSION}")
            raise typer.Exit
        if first == "help" and len(args) == 2 and args[1].lower() in TOPICS:
            echo(TOPICS[args[1].lower()])
            raise typer.Exit
        if first == "help":
            args = [*args[1:], "--help"]
        elif first == "doctor":
            args = [*SYNONYMS["doctor"].split(), *args[1:]]
        elif first and not known and (Path(first).exists() or kind_of(Path(first)) is not None):
            args = _arguments_of_file(args)
        _refuse_slash(args)
        return super().parse_args(ctx, args)

    def get_params(self, ctx: Any) -> list[Any]:
        """As of typer."""
        return without_flag_types(super().get_params(ctx))


def _refuse_slash(args: Sequence[str]) -> None:
    """Refuse a file to write whose name ends as that of a folder.

    Raises:
        InputError: in these cases.
    """
    outs = [word for before, word in pairwise(args) if before in ("-o", "--out")]
    outs += [word.partition("=")[2] for word in args if word.startswith("--out=")]
    for word in outs:
        if word.endswith(("/", "\\")) and Path(word).suffix and not Path(word).is_dir():
            raise InputError(f"-o {word} names a folder; expected a file: -o {word[:-1]}")


def _arguments_of_file(args: Sequence[str]) -> list[str]:
    """The verb for a file that stands in its place.

    Raises:
        InputError: there is none, or several; the message says the command.
    """
    file, path = args[0], Path(args[0])
    kind = kind_of(path)
    if not path.exists():
        raise InputError(f"{file} is not there; check the path", kind="file")
    if path.is_dir():
        raise InputError(f"{file} is a folder: morembs batch {shlex.quote(file)} runs all jobs in it")
    if kind in (JOB, SYSTEM):
        return ["check", *args]
    if kind in (BODY, MEMBER, RESULT):
        return ["info", *args]
    if kind in PARTS:
        return ["init", "--show", *args]
    if kind is MATRIX or kind is SURFACE:
        raise InputError(f"{file}: {instead(path, 'a verb')}")
    # Not at the top: the table of formats takes as long to load as a short command.
    from morembs.importers import refuse_compressed

    refuse_compressed(path)
    raise InputError(
        f"{file}: its kind is not known by its ending; morembs import {shlex.quote(file)} --format NAME", kind="unknown"
    )


def _answer(error: Any) -> str:
    """One line about a command line that does not fit: what is wrong, and a command that fits."""
    message = error.format_message().strip().rstrip(".")
    context = error.ctx
    verb = context.info_name if context is not None and context.parent is not None else ""
    missing = message.partition("'")[2].partition("'")[0] if message.startswith("No such command") else ""
    if missing in SYNONYMS:
        return f"there is no command {missing!r}; did you mean {SYNONYMS[missing]!r}?"
    if missing in KEYS:
        return f"there is no command {missing!r}; take {KEYS[missing]}"
    if missing:
        close = alike(missing, [*context.command.commands, "help", "version", "doctor"])
        return (
            f"there is no command {missing!r}; {f'did you mean {close!r}? ' if close else ''}"
            "morembs help lists all commands"
        )
    # The parser says for which option, and in its own words that the value is no number.
    for words, expected in (("valid integer", "a whole number"), ("valid number", "a number")):
        if words in message and (option := re.match(r"Invalid value for '([^']+)'", message)):
            message = f"{option[1]} takes {expected}"
    example = "" if context is None else (context.command.epilog or "").removeprefix("Example: ")
    cure = f"; for example: {example}" if example and verb else ""
    return f"{f'{verb}: ' if verb else ''}{message[:1].lower()}{message[1:]}{cure}; morembs help {verb}".rstrip()
