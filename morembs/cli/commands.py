"""The command line: its verbs on jobs, and the entry point; verbs on body files are in ``cli_bodies``."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from morembs import stopping
from morembs.body.file import check_writable
from morembs.cli.bodies import app as bodies
from morembs.cli.models import app as models
from morembs.cli.report import (
    print_contenders,
    print_forecast,
    print_result,
    result_json,
    without_nan,
)
from morembs.cli.terminal import (
    BAD_INPUT,
    EPILOG,
    AsJson,
    Done,
    Jobs,
    Quiet,
    console,
    each_job,
    failure,
    messages,
    print_json,
    printing,
    tell,
    warn,
)
from morembs.errors import InputError, MorembsError
from morembs.jobs.check import check_job
from morembs.jobs.inputs import clashes, source_of
from morembs.jobs.job import Job, load_job
from morembs.jobs.pareto import contenders, draw_contenders
from morembs.jobs.run import run_job
from morembs.linalg.sparse.interruptible import calls_running
from morembs.linalg.sparse.select import available_solvers
from morembs.progress import Progress
from morembs.version import VERSION

app = typer.Typer(
    name="morembs", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, epilog=EPILOG,
    help="Reduces finite-element models to small elastic bodies for multibody simulation.",
)  # fmt: skip


@app.command(epilog=EPILOG)
def reduce(jobs: Jobs, as_json: AsJson = False, quiet: Quiet = False) -> None:
    """Reduce the models of job files and write their bodies."""

    def work(path: Path, progress: Progress) -> Done:
        job = load_job(path)
        told: list[str] = []

        def tell(sentence: str) -> None:
            told.append(sentence)
            warn(sentence)

        result = run_job(job, progress, tell)
        return result_json(result), lambda: print_result(console(), result, told)

    each_job(jobs, as_json, work, quiet, _in_each_others_way(jobs))


@app.command(epilog=EPILOG)
def compare(
    job: Annotated[Path, typer.Argument(metavar="JOB.toml", help="A job with errors to compare.", show_default=False)],
    picture: Annotated[Path | None, typer.Option(help="Draw it: a .png, .pdf or .svg file.")] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Run a job and set its reductions side by side: order, errors, time, memory."""

    def work(path: Path, progress: Progress) -> Done:
        if picture is not None:
            if picture.suffix not in (".png", ".pdf", ".svg"):
                raise InputError(f"--picture {picture} was given; expected a name that ends in .png, .pdf or .svg")
            check_writable(picture)
        loaded = load_job(path)
        if picture is not None and picture.resolve() in {
            one.resolve() for one in (loaded.path, source_of(loaded), loaded.output, loaded.picture) if one is not None
        }:
            raise InputError(f"--picture {picture} would overwrite a file of the job; give it a name of its own")
        if loaded.tables.certify is None and not any(table.method == "auto" for table in loaded.tables.reduce):
            raise InputError("a comparison needs errors: add a table [certify] with band_hz = [LOW, HIGH] to the job")
        found = contenders(run_job(loaded, progress, warn))
        if picture is not None:
            draw_contenders(picture, found, path.name)
        document = {
            "job": str(path),
            "contenders": [{key: without_nan(value) for key, value in asdict(one).items()} for one in found],
        }
        return document, lambda: print_contenders(console(), str(path), found)

    each_job([job], as_json, work, quiet)


@app.command(epilog=EPILOG)
def check(jobs: Jobs, as_json: AsJson = False, quiet: Quiet = False) -> None:
    """Check job files and forecast size and memory; factorises nothing, writes nothing."""

    def work(path: Path, progress: Progress) -> Done:
        forecast = check_job(load_job(path), progress)
        return {"job": str(path), **forecast.as_json()}, lambda: print_forecast(console(), str(path), forecast)

    each_job(jobs, as_json, work, quiet, _in_each_others_way(jobs))


def _in_each_others_way(jobs: Sequence[Path]) -> dict[int, str]:
    """Place of a job -> why it is not run beside the others; jobs that cannot be read say so in their turn."""
    loaded: dict[int, Job] = {}
    for number, path in enumerate(jobs):
        with suppress(MorembsError):
            loaded[number] = load_job(path)
    return clashes(loaded)


app.add_typer(bodies)
app.add_typer(models)


@app.command(epilog=EPILOG)
def solvers(as_json: AsJson = False) -> None:
    """List the sparse solvers, the best first, and why some cannot run here."""
    with messages(), printing():
        found = available_solvers()
        if as_json:
            print_json({name: {"available": not reason, "reason": reason} for name, reason in found.items()})
            return
        for name, reason in found.items():
            typer.echo(f"{name}: {reason or 'available'}")


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"morembs {VERSION}")
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
    with stopping.heeded():
        code = _exit_code()
        number = stopping.asked()
        if number is not None:
            code = 128 + number
            end = "interrupted" if number == signal.SIGINT else "terminated"
            tell(f"{end}; what was not written yet is lost, and every file that is there is whole")
    if calls_running():
        # A library still computes in another thread; ending as usual would take its memory from under it.
        with suppress(OSError):
            sys.stdout.flush()
        os._exit(code)
    sys.exit(code)


def _exit_code() -> int:
    """Run the command; the code that it ends with if no signal came."""
    try:
        app()
    except SystemExit as end:
        if isinstance(end.__context__, OSError):
            # Typer leaves without a word where nobody reads its help.
            return BAD_INPUT
        return end.code if isinstance(end.code, int) else BAD_INPUT
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    except Exception as error:
        number = stopping.asked()
        if number is not None:
            return 128 + number
        found = failure(error)
        tell(f"error: {found.message}")
        return found.code
    return 0


if __name__ == "__main__":
    main()
