"""Processes of their own: forks of this one, which saves them the seconds that imports take."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from benchmarks.attack.forked import Ended, program, run


def apart(work: Callable[[], object], folder: Path, logs: Path | None = None) -> Ended:
    """How ``work`` ends in a child that runs in ``folder``: exit code and what it printed.

    ``logs / "tmp"`` is its folder for temporary files.
    """
    with tempfile.TemporaryDirectory() as other:
        return run(work, folder, logs or Path(other))


def morembs(*arguments: object, folder: Path, logs: Path | None = None) -> Ended:
    """How the command ``morembs`` ends."""
    return apart(program([str(argument) for argument in arguments]), folder, logs)


def python(code: str, folder: Path) -> Ended:
    """How a program ends that is nothing but ``code``."""
    return apart(lambda: exec(compile(code, "<program>", "exec"), {"__name__": "__main__"}), folder)
