"""The entry point of the command line, and what is so short that reading its options would take most of the time."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from collections.abc import Sequence
from typing import Any

from morembs.app.cli.messages import echo, failure, print_json, printing, tell
from morembs.base import stopping
from morembs.base.errors import ExitCode
from morembs.base.python_warnings import speak_plainly
from morembs.linalg.sparse.interruptible import calls_running
from morembs.version import VERSION


def main() -> None:
    """Do what ``sys.argv`` says, as the command ``morembs`` does, for a program that may go on afterwards.

    Raises:
        SystemExit: always, with the exit code of the command.
    """
    sys.exit(_run(ends=False))


def console() -> None:
    """Entry point of the command ``morembs``, whose process ends with it."""
    # Until its own end is known: a library that ends the process has failed.
    stopping.end_with(ExitCode.FAULT)
    code = _run(ends=True)
    stopping.end_with(code)
    _print_the_rest()
    if calls_running():
        # A library still computes in another thread; ending as usual would take its memory from under it.
        os._exit(code)
    sys.exit(code)


def _print_the_rest() -> None:
    """Empty the buffer of standard output; what cannot be printed is dropped, of which the user knows already."""
    if sys.stdout is not None:
        try:
            sys.stdout.flush()
        except OSError:
            # The interpreter flushes once more, and would complain.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _run(*, ends: bool) -> int:
    """Run the command; its exit code."""
    with stopping.handle_signals(ends=ends), warnings.catch_warnings():
        speak_plainly()
        code = _exit_code()
        number = stopping.stop_signal()
        if number is not None:
            code = ExitCode.of_signal(number)
            end = "interrupted" if number == signal.SIGINT else "terminated"
            tell(f"{end}; what was not written yet is lost, and every file that is there is whole")
    return code


def _exit_code() -> int:
    """Run the command; the code that it ends with if no signal came."""
    try:
        _work(sys.argv[1:])
    except SystemExit as end:
        if isinstance(end.__context__, OSError):
            # Typer leaves without a word where nobody reads its help.
            return ExitCode.BAD_INPUT
        return end.code if isinstance(end.code, int) else ExitCode.BAD_INPUT
    except KeyboardInterrupt:
        return ExitCode.of_signal(signal.SIGINT)
    except Exception as error:
        number = stopping.stop_signal()
        if number is not None:
            # A library made another exception of the signal that came while it called back.
            return ExitCode.of_signal(number)
        fault = failure(error)
        tell(f"error: {fault.message}")
        return fault.code
    return 0


def _work(arguments: Sequence[str]) -> None:
    """Do what the ``arguments`` say: here where they are as plain as can be, else as the verbs of ``commands`` do."""
    plain = [argument for argument in arguments if argument != "--json"]
    if list(arguments) == ["--version"]:
        echo(f"morembs {VERSION}")
    elif plain[:1] == ["info"] and len(plain) == 2 and plain[1].endswith(".h5") and len(arguments) - len(plain) < 2:
        from morembs.app.cli.report_stored import show

        documents: list[dict[str, Any]] = []
        try:
            show(plain[1], documents if "--json" in arguments else None)
        finally:
            # Of a body that contradicts itself too.
            if documents:
                with printing():
                    print_json(documents)
    else:
        import typer.main

        from morembs.app.cli.commands import app

        # Called itself it would take the place of ``sys.excepthook``, which knows of signals.
        typer.main.get_command(app)(prog_name="morembs")
