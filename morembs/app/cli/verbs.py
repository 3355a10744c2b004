"""The group of verbs: what people type beside them, and what is said of a command line that does not fit."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperGroup

from morembs.app.cli.messages import echo, failure, tell
from morembs.app.cli.terminal import without_flag_types
from morembs.app.kinds import BODY, JOB, MATRIX, PARTS, SURFACE, instead, kind_of
from morembs.base.errors import ExitCode, InputError, MorembsError
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
KEYS = {
    "certify": "the table [certify] of a job, with band_hz = [0, 2000]; then: morembs reduce JOB.toml",
    "plot": 'picture = "NAME.png" under [output] of a job, or morembs reduce JOB.toml --report PAGE.html',
    "view": "morembs reduce JOB.toml --report PAGE.html, or a body in ParaView, which opens its HDF5 file",
    "simulate": "morembs export BODY.h5 --to exudyn, or morembs.dynamics.multibody in Python",
}


class Verbs(TyperGroup):
    """The verbs, each with a ledger of its own: none of its results takes the place of what it has read."""

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
        if first == "help":
            args = [*args[1:], "--help"]
        elif first == "doctor":
            args = [*SYNONYMS["doctor"].split(), *args[1:]]
        elif first and not known and (Path(first).exists() or kind_of(Path(first)) is not None):
            args = _arguments_of_file(args)
        return super().parse_args(ctx, args)

    def get_params(self, ctx: Any) -> list[Any]:
        """As of typer."""
        return without_flag_types(super().get_params(ctx))


def _arguments_of_file(args: Sequence[str]) -> list[str]:
    """The verb for a file that stands in its place.

    Raises:
        InputError: there is none, or several; the message says the command.
    """
    file, path = args[0], Path(args[0])
    kind = kind_of(path)
    if not path.exists():
        raise InputError(f"{file} is not there; check the path")
    if path.is_dir():
        raise InputError(f"{file} is a folder: morembs batch {shlex.quote(file)} runs all jobs in it")
    if kind is JOB:
        return ["check", *args]
    if kind is BODY:
        return ["info", *args]
    if kind in PARTS:
        return ["init", "--show", *args]
    if kind is MATRIX or kind is SURFACE:
        raise InputError(f"{file}: {instead(path, 'a verb')}")
    raise InputError(f"{file}: its kind is not known by its ending; morembs import {shlex.quote(file)} --format NAME")


def _answer(error: Any) -> str:
    """One line about a command line that does not fit: what is wrong, and a command that fits."""
    said = error.format_message().strip().rstrip(".")
    context = error.ctx
    verb = context.info_name if context is not None and context.parent is not None else ""
    missing = said.partition("'")[2].partition("'")[0] if said.startswith("No such command") else ""
    if missing in SYNONYMS:
        return f"there is no verb {missing!r}; did you mean {SYNONYMS[missing]!r}?"
    if missing in KEYS:
        return f"there is no verb {missing!r}; take {KEYS[missing]}"
    if missing:
        return f"{said[0].lower()}{said[1:]}; morembs help lists all verbs"
    example = "" if context is None else (context.command.epilog or "").removeprefix("Example: ")
    cure = f"; for example: {example}" if example and verb else ""
    return f"{f'{verb}: ' if verb else ''}{said[:1].lower()}{said[1:]}{cure}; morembs help {verb}".rstrip()
