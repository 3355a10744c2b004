"""The command line: verbs, exit codes, and where messages go."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from threading import Timer
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress as Bar
from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

from morembs import __version__
from morembs.check import check_job
from morembs.errors import InputError, MorembsError
from morembs.job import load_job
from morembs.linalg.interruptible import calls_running
from morembs.linalg.select import available_solvers
from morembs.pareto import contenders, draw_contenders
from morembs.progress import Progress
from morembs.report import (
    print_contenders,
    print_forecast,
    print_result,
    print_stored,
    result_json,
    stored_json,
    without_nan,
)
from morembs.run import run_job
from morembs.storage import check_writable, read_body

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

app = typer.Typer(
    name="morembs", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, epilog=EPILOG,
    help="Reduces finite-element models to small elastic bodies for multibody simulation.",
)  # fmt: skip
Jobs = Annotated[list[Path], typer.Argument(metavar="JOB.toml...", help="Job files.", show_default=False)]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document on standard output.")]

# Plain values for JSON, and what prints them for people.
Done = tuple[dict[str, Any], Callable[[], None]]
Work = Callable[[Path, Progress], Done]


class TerminalProgress:
    """A line on standard error that says what is going on, once that takes more than a second."""

    def __init__(self, console: Console, visible: bool) -> None:
        columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
        self._bar = Bar(*columns, console=console, transient=True, disable=not visible)
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
def _messages(failed: list[str], prefix: str = "") -> Iterator[None]:
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


def _each_job(jobs: Sequence[Path], as_json: bool, work: Work) -> None:
    """Do ``work`` for each job."""
    documents: list[dict[str, Any]] = []
    failed: list[str] = []
    for path in jobs:
        faults = len(failed)
        with _messages(failed, f"{path}: " if len(jobs) > 1 else ""):
            with TerminalProgress(Console(stderr=True), sys.stderr.isatty()).shown() as progress:
                document, show = work(path, progress)
            documents.append(document)
            if not as_json:
                show()
        if len(failed) > faults:
            documents.append({"job": str(path), "error": failed[-1]})
    if as_json:
        _print_json(documents if len(jobs) > 1 else documents[0])
    if failed:
        raise typer.Exit(BAD_INPUT)


def _console() -> Console:
    """Standard output; a pipe or a file has no width that tables must fit."""
    return Console() if sys.stdout.isatty() else Console(width=PIPE_WIDTH)


def _print_json(document: object) -> None:
    typer.echo(json.dumps(document, indent=2, allow_nan=False))


@app.command(epilog=EPILOG)
def reduce(jobs: Jobs, as_json: AsJson = False) -> None:
    """Reduce the models of job files and write their bodies."""

    owner: dict[Path, Path] = {}

    def work(path: Path, progress: Progress) -> Done:
        job = load_job(path)
        other = owner.setdefault(job.output.resolve(), path)
        if other is not path:
            raise InputError(f"the output {job.output} is that of {other} too; give each job its own [output] path")
        result = run_job(job, progress)
        return result_json(result), lambda: print_result(_console(), result)

    _each_job(jobs, as_json, work)


@app.command(epilog=EPILOG)
def compare(
    job: Annotated[Path, typer.Argument(metavar="JOB.toml", help="A job with errors to compare.", show_default=False)],
    picture: Annotated[Path | None, typer.Option(help="Draw it: a .png, .pdf or .svg file.")] = None,
    as_json: AsJson = False,
) -> None:
    """Run a job and set its reductions side by side: order, errors, time, memory."""

    def work(path: Path, progress: Progress) -> Done:
        if picture is not None:
            if picture.suffix not in (".png", ".pdf", ".svg"):
                raise InputError(f"--picture {picture} was given; expected a name that ends in .png, .pdf or .svg")
            check_writable(picture)
        loaded = load_job(path)
        if picture is not None and picture.resolve() in {
            one.resolve() for one in (loaded.path, loaded.output, loaded.picture) if one is not None
        }:
            raise InputError(f"--picture {picture} would overwrite a file of the job; give it a name of its own")
        if loaded.tables.certify is None and not any(table.method == "auto" for table in loaded.tables.reduce):
            raise InputError("a comparison needs errors: add a table [certify] with band_hz = [LOW, HIGH] to the job")
        found = contenders(run_job(loaded, progress))
        if picture is not None:
            draw_contenders(picture, found, path.name)
        document = {
            "job": str(path),
            "contenders": [{key: without_nan(value) for key, value in asdict(one).items()} for one in found],
        }
        return document, lambda: print_contenders(_console(), str(path), found)

    _each_job([job], as_json, work)


@app.command(epilog=EPILOG)
def check(jobs: Jobs, as_json: AsJson = False) -> None:
    """Check job files and forecast size and memory; factorises nothing, writes nothing."""

    def work(path: Path, progress: Progress) -> Done:
        forecast = check_job(load_job(path), progress)
        return {"job": str(path), **forecast.as_json()}, lambda: print_forecast(_console(), str(path), forecast)

    _each_job(jobs, as_json, work)


@app.command(epilog=EPILOG)
def info(
    file: Annotated[Path, typer.Argument(metavar="FILE.h5", help="A body file.", show_default=False)],
    as_json: AsJson = False,
) -> None:
    """Show what a body file holds."""
    failed: list[str] = []
    with _messages(failed):
        stored = read_body(file)
        if as_json:
            _print_json(stored_json(str(file), stored))
        else:
            print_stored(_console(), str(file), stored)
    if failed:
        raise typer.Exit(BAD_INPUT)


@app.command(epilog=EPILOG)
def solvers(as_json: AsJson = False) -> None:
    """List the sparse solvers, the best first, and why some cannot run here."""
    found = available_solvers()
    if as_json:
        _print_json({name: {"available": not reason, "reason": reason} for name, reason in found.items()})
        return
    for name, reason in found.items():
        typer.echo(f"{name}: {reason or 'available'}")


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"morembs {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Options of all verbs."""


def main() -> None:
    """Entry point of the command ``morembs``."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _stop)
    try:
        app()
    except SystemExit as end:
        if calls_running():
            # A library still computes in another thread; ending as usual would take its memory from under it.
            sys.stdout.flush()
            os._exit(end.code if isinstance(end.code, int) else BAD_INPUT)
        raise
    except OSError as error:
        # Everything else that cannot be written has its own message: this is standard output.
        typer.echo(f"error: the output cannot be printed ({error.strerror}); the results are written", err=True)
        sys.exit(BAD_INPUT)


def _stop(number: int, _: object) -> None:
    """Leave through every ``with``, so that temporary files and factors on disk go."""
    sys.exit(128 + number)


if __name__ == "__main__":
    main()
