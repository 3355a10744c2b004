"""What the verbs of the command line share: progress, messages, exit codes, where output goes."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Lock, Thread, Timer
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress as Bar
from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

from morembs.errors import MorembsError
from morembs.progress import SILENT, Progress

# Bad input, and the usual code of a process that Ctrl-C ends.
BAD_INPUT, INTERRUPTED = 2, 130
# Shorter work shows no progress: on a terminal, and where lines are written.
PATIENCE_SECONDS, PATIENCE_OF_LINES = 1.0, 5.0
# Lines: a new stage is told after this, and a stage that goes on is told again each so many seconds.
STAGE_SECONDS, REPEAT_SECONDS = 1.0, 15.0
PIPE_WIDTH = 160

EPILOG = (
    "Exit codes: 0 done; 1 a fault of this program; 2 input that cannot be used, a model that cannot be solved, or "
    "a result that cannot be written (one message on standard error); 130 interrupted; 143 terminated. Of several "
    "jobs one that fails does not stop the others; the exit code is then 2."
)

Jobs = Annotated[list[Path], typer.Argument(metavar="JOB.toml...", help="Job files.", show_default=False)]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document on standard output.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress on standard error.")]

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


class LineProgress:
    """Lines on standard error where no terminal is: a stage that begins, and each quarter of a minute what it does.

    A thread looks at the clock, so that long calls of libraries are told too, as far as they let other threads run.
    Work that takes less than ``PATIENCE_OF_LINES`` writes nothing.
    """

    def __init__(self, write: Callable[[str], object]) -> None:
        self._write = write
        self._start = time.monotonic()
        self._stage, self._news, self._told = "", "", ""
        self._last = -REPEAT_SECONDS
        self._lock, self._end = Lock(), Event()

    def stage(self, name: str) -> None:
        """A new stage begins."""
        with self._lock:
            self._stage, self._news = name, ""
        self._look()

    def update(self, text: str) -> None:
        """News within the stage."""
        with self._lock:
            self._news = text
        self._look()

    def _look(self) -> None:
        """Write a line if one is due."""
        with self._lock:
            elapsed = time.monotonic() - self._start
            since = elapsed - self._last
            due = since >= (STAGE_SECONDS if self._stage != self._told else REPEAT_SECONDS)
            if elapsed < PATIENCE_OF_LINES or not due or not (self._stage or self._news):
                return
            self._told, self._last = self._stage, elapsed
            self._write(f"[{elapsed:,.0f} s] " + ": ".join(filter(None, (self._stage, self._news))))

    def _watch(self) -> None:
        while not self._end.wait(min(STAGE_SECONDS, REPEAT_SECONDS) / 2):
            self._look()

    @contextmanager
    def shown(self) -> Iterator[Progress]:
        """Write lines while work goes on."""
        watcher = Thread(target=self._watch, daemon=True)
        watcher.start()
        try:
            yield self
        finally:
            self._end.set()
            watcher.join()


@contextmanager
def progress_line(quiet: bool = False) -> Iterator[Progress]:
    """Progress on standard error while work goes on: one line that changes where somebody watches, else lines."""
    if quiet:
        yield SILENT
    elif sys.stderr.isatty():
        with TerminalProgress(Console(stderr=True), True).shown() as progress:
            yield progress
    else:
        with LineProgress(lambda line: typer.echo(line, err=True)).shown() as progress:
            yield progress


def warn(sentence: str) -> None:
    """A warning on standard error, before the work that it is about."""
    typer.echo(f"warning: {sentence}", err=True)


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


def each_job(jobs: Sequence[Path], as_json: bool, work: Work, quiet: bool = False) -> None:
    """Do ``work`` for each job."""
    documents: list[dict[str, Any]] = []
    failed: list[str] = []
    for path in jobs:
        faults = len(failed)
        with messages(failed, f"{path}: " if len(jobs) > 1 else ""):
            with progress_line(quiet) as progress:
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
