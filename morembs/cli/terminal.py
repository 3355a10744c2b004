"""What the verbs of the command line share: progress, messages, exit codes, where output goes."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Timer
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress as Bar
from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

from morembs.errors import MorembsError
from morembs.progress import Progress

# Bad input, and the usual code of a process that Ctrl-C ends.
BAD_INPUT, INTERRUPTED = 2, 130
# Shorter work shows no progress.
PATIENCE_SECONDS = 1.0
PIPE_WIDTH = 160

EPILOG = (
    "Exit codes: 0 done; 1 a fault of this program; 2 input that cannot be used, a model that cannot be solved, or "
    "a result that cannot be written (one message on standard error); 130 interrupted; 143 terminated. Of several "
    "jobs one that fails does not stop the others; the exit code is then 2."
)

Jobs = Annotated[list[Path], typer.Argument(metavar="JOB.toml...", help="Job files.", show_default=False)]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document on standard output.")]

# Plain values for JSON, and what prints them for people.
Done = tuple[dict[str, Any], Callable[[], None]]
Work = Callable[[Path, Progress], Done]


class TerminalProgress:
    """A line on standard error that says what is going on, once that takes more than a second."""

    def __init__(self, screen: Console, visible: bool) -> None:
        columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
        self._bar = Bar(*columns, console=screen, transient=True, disable=not visible)
        self._task = self._bar.add_task("", total=None)
        self._timer = Timer(PATIENCE_SECONDS, self._bar.start)
        self._timer.daemon = True
        self._stage = ""

    def stage(self, name: str) -> None:
        """A new stage begins."""
        self._stage = name
        self._bar.update(self._task, description=name)

    def update(self, text: str) -> None:
        """News within the stage."""
        self._bar.update(self._task, description=f"{self._stage}: {text}" if self._stage else text)

    @contextmanager
    def shown(self) -> Iterator[Progress]:
        """Show the line while work goes on, and take it away afterwards."""
        self._timer.start()
        try:
            yield self
        finally:
            self._timer.cancel()
            self._timer.join()
            self._bar.stop()


@contextmanager
def progress_line() -> Iterator[Progress]:
    """Progress on standard error while work goes on, where somebody watches."""
    with TerminalProgress(Console(stderr=True), sys.stderr.isatty()).shown() as progress:
        yield progress


@contextmanager
def messages(failed: list[str], prefix: str = "") -> Iterator[None]:
    """Turn errors that a user can meet into one message on standard error."""
    try:
        yield
    except MorembsError as error:
        message = str(error)
    except MemoryError:
        message = (
            "the memory did not suffice; give [solver] a memory budget and a scratch folder, take fewer modes, "
            'or see "morembs check" for a forecast'
        )
    except KeyboardInterrupt:
        typer.echo("interrupted; no result was written by the running job", err=True)
        raise typer.Exit(INTERRUPTED) from None
    else:
        return
    failed.append(message)
    typer.echo(f"error: {prefix}{message}", err=True)


def each_job(jobs: Sequence[Path], as_json: bool, work: Work) -> None:
    """Do ``work`` for each job."""
    documents: list[dict[str, Any]] = []
    failed: list[str] = []
    for path in jobs:
        faults = len(failed)
        with messages(failed, f"{path}: " if len(jobs) > 1 else ""):
            with progress_line() as progress:
                document, show = work(path, progress)
            documents.append(document)
            if not as_json:
                show()
        if len(failed) > faults:
            documents.append({"job": str(path), "error": failed[-1]})
    if as_json:
        print_json(documents if len(jobs) > 1 else documents[0])
    if failed:
        raise typer.Exit(BAD_INPUT)


def console() -> Console:
    """Standard output; a pipe or a file has no width that tables must fit."""
    return Console() if sys.stdout.isatty() else Console(width=PIPE_WIDTH)


def print_json(document: object) -> None:
    typer.echo(json.dumps(document, indent=2, allow_nan=False))
