"""Verbs of the command line for modes of full models, and of bodies over their speed."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from morembs.app.cli.completion import JOBS, files_with
from morembs.app.cli.messages import console, print_json, printing, warn
from morembs.app.cli.terminal import AsJson, Changes, Verb, example, messages, progress_line
from morembs.base.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from morembs.app.jobs.modes import ModeRow
    from morembs.base.progress import Progress
    from morembs.body.floating.spin import Spinning

app = typer.Typer()


@app.command(cls=Verb, epilog=example("morembs modes part.toml --count 20"))
def modes(
    job: Annotated[
        Path,
        typer.Argument(metavar="JOB.toml", help="A job file.", show_default=False, autocompletion=files_with(*JOBS)),
    ],
    changes: Changes = None,
    complex_: Annotated[
        bool, typer.Option("--complex", help=r"Complex modes, at every speed of \[spin] where there is one.")
    ] = False,
    count: Annotated[int | None, typer.Option(help="How many.", show_default="[modes] count")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Write the table too: a .csv file.")] = None,
    as_json: AsJson = False,
) -> None:
    """Show the modes of the full model of a job: frequency, damping ratio, whirl, residual."""
    from morembs.app.jobs.job import load_job
    from morembs.app.jobs.modes import job_modes, write_csv
    from morembs.app.jobs.tables import ModesTable

    with messages():
        _check_ending(out, ".csv")
        loaded = load_job(job, changes or ())
        wanted = ModesTable.of(loaded)
        number = wanted.count if count is None else count
        if number < 1:
            raise InputError(f"--count {number} was given; expected 1 or more", keyword="count")
        with progress_line() as progress:
            table = job_modes(loaded, complex_=complex_ or wanted.kind == "complex", count=number, progress=progress)
        if out is not None:
            write_csv(out, table.rows)
        for warning in table.warnings:
            warn(warning)
        with printing([] if out is None else [str(out)]):
            if as_json:
                complete = {f"{speed:g}": words for speed, words in table.complete.items()}
                print_json([{"job": str(job), "modes": _documents(table.rows), "complete": complete}])
                return
            _print(table.rows)
            for speed, words in table.complete.items():
                at = f"at {speed:g} rad/s " if len(table.complete) > 1 else ""
                typer.echo(f"{at}{words}")
            if out is not None:
                typer.echo(f"written: {out}")


@app.command(cls=Verb, epilog=example("morembs campbell rotor.toml -o campbell.csv --png"))
def campbell(
    file: Annotated[
        Path, typer.Argument(metavar="JOB|BODY.h5", help=r"A job with \[spin], or its body file.", show_default=False)
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="The .csv file to write.", show_default=False)],
    changes: Changes = None,
    body: Annotated[str | None, typer.Option("--body", help="Which body, where there are several.")] = None,
    png: Annotated[bool, typer.Option("--png", help="Draw the diagram beside the table.")] = False,
    points: Annotated[int, typer.Option(help=r"Speeds from the lowest to the highest of \[spin].")] = 41,
    count: Annotated[int, typer.Option(help="Modes at each speed.")] = 12,
    as_json: AsJson = False,
) -> None:
    """Write the modes of one reduced body over its speed, and draw them."""
    from morembs.app.jobs.modes import draw_campbell, whirl_rows, write_csv
    from morembs.body.floating.spin import campbell as over_speed

    with messages():
        _check_ending(out, ".csv")
        if png:
            _check_ending(out.with_suffix(".png"), ".png")
        if points < 2 or count < 1:
            raise InputError(
                f"--points {points} --count {count} were given; expected 2 points and 1 mode at least", keyword="points"
            )
        with progress_line() as progress:
            source = _body(file, body, changes or (), progress)
        if source.spin is None:
            raise InputError(
                f"{file}: body {source.name!r} has no spin matrices; add a table [spin] to its job", kind="missing"
            )
        # Not at the top: help needs no numbers.
        import numpy as np

        speeds = np.linspace(source.spin.speeds.min(), source.spin.speeds.max(), points)
        rows = [row for whirl in over_speed(source, speeds.tolist(), count) for row in whirl_rows(whirl)]
        write_csv(out, rows)
        written = [out]
        if png:
            written.append(out.with_suffix(".png"))
            draw_campbell(written[-1], rows, f"{file.stem}, {source.name}")
        paths = [str(path) for path in written]
        with printing(paths):
            if as_json:
                print_json([{"file": str(file), "body": source.name, "written": paths, "modes": _documents(rows)}])
            else:
                typer.echo(f"written: {', '.join(paths)}; {len(rows)} modes of body {source.name} at {points} speeds")


def _body(file: Path, name: str | None, changes: Sequence[str], progress: Progress) -> Spinning:
    """The body of a file, or of a job that is run for it."""
    bodies: dict[str, Spinning]
    if file.suffix == ".toml":
        from morembs.app.jobs.job import load_job
        from morembs.app.jobs.run import run_job
        from morembs.app.jobs.stages.spin import SpinTable

        job = load_job(file, changes)
        if SpinTable.of(job) is None:
            raise InputError(
                f"{file} has no table [spin]; add one with speed = [LOWEST, .., HIGHEST] and axis", kind="missing"
            )
        bodies = {body.name: body for body in run_job(job, progress, warn).bodies}
    else:
        from morembs.body.file import read_body

        if changes:
            raise InputError("--set changes jobs; a body file was given", keyword="set")
        bodies = dict(read_body(file).bodies)
    if name is None and len(bodies) > 1:
        raise InputError(f"{file} has the bodies {', '.join(bodies)}; name one with --body")
    if name is not None and name not in bodies:
        raise InputError(f"{file} has no body {name!r}; it has {', '.join(bodies)}", kind="unknown")
    return bodies[next(iter(bodies)) if name is None else name]


def _check_ending(path: Path | None, ending: str) -> None:
    from morembs.storage.safefile import check_writable

    if path is None:
        return
    if path.suffix != ending:
        raise InputError(f"--out {str(path)!r} was given; expected a name that ends in {ending}", keyword="out")
    check_writable(path)


def _documents(rows: Sequence[ModeRow]) -> list[dict[str, Any]]:
    return [
        {key: None if isinstance(value, float) and math.isnan(value) else value for key, value in asdict(row).items()}
        for row in rows
    ]


def _print(rows: Sequence[ModeRow]) -> None:
    from morembs.app.report.text import plain_table, print_table

    spins = any(row.whirl for row in rows)
    of_speed: dict[float, list[ModeRow]] = {}
    for row in rows:
        of_speed.setdefault(row.speed, []).append(row)
    for speed, some in of_speed.items():
        more = ("whirl", "inertial Hz") if spins else ()
        table = plain_table("mode", "Hz", "ratio", "real part 1/s", "residual", *more)
        for row in some:
            residual = "" if math.isnan(row.residual) else f"{row.residual:.0e}"
            still = "" if math.isnan(row.inertial_hz) else f"{row.inertial_hz:.6g}"
            cells = [str(row.number), f"{row.damped_hz:.6g}", f"{row.ratio:.4g}", f"{row.real:.6g}", residual]
            table.add_row(*cells, *((row.whirl, still) if spins else ()))
        print_table(console(), f"Modes at {speed:g} rad/s" if spins else "Modes", table)
