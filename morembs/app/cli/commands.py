"""The command line: its verbs on jobs; those on body files are in ``bodies``, on models in ``models``.

Each verb imports its own modules: imports of all would take most of the time of short commands.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from morembs.app.cli.batch import app as batches
from morembs.app.cli.bodies import app as bodies
from morembs.app.cli.certify import app as proofs
from morembs.app.cli.completion import JOBS, files_with, names_of
from morembs.app.cli.evaluate import app as evaluation
from morembs.app.cli.messages import console, echo, print_json, printing, warn
from morembs.app.cli.models import app as models
from morembs.app.cli.modes import app as modes
from morembs.app.cli.simulate import app as simulating
from morembs.app.cli.start import app as starting
from morembs.app.cli.terminal import (
    EXIT_CODES,
    Against,
    AsJson,
    Attached,
    Changes,
    Done,
    Jobs,
    Quiet,
    Report,
    Verb,
    Within,
    each_job,
    example,
    leave_with_input,
    messages,
    request_report,
)
from morembs.app.cli.update import app as updating
from morembs.app.cli.verbs import Verbs
from morembs.app.cli.view import app as viewing
from morembs.app.kinds import MATRICES, MATRICES_BY_NAME
from morembs.base.errors import InputError, MorembsError
from morembs.base.progress import Progress
from morembs.storage.contents import keeping_ledger
from morembs.version import VERSION

if TYPE_CHECKING:
    from morembs.app.jobs.order import Order
    from morembs.app.jobs.tables import Job

    Load = Callable[[Path, Sequence[str]], Job]

app = typer.Typer(
    name="morembs",
    cls=Verbs,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    epilog=EXIT_CODES,
    help="Reduces finite-element models to small elastic bodies for multibody simulation.",
)


@app.command(cls=Verb, epilog=example("morembs reduce part.toml"))
def reduce(
    jobs: Annotated[
        list[Path],
        typer.Argument(
            metavar="JOB.toml...",
            help="Job files, or matrices: K.mtx M.mtx [D.mtx], or one .mat, .npz.",
            show_default=False,
            autocompletion=files_with(*JOBS, *MATRICES, *MATRICES_BY_NAME),
        ),
    ],
    changes: Changes = None,
    method: Annotated[
        str | None,
        typer.Option(help="As --set reduce.method=NAME.", autocompletion=names_of("morembs.reducers", "REDUCERS")),
    ] = None,
    order: Annotated[int | None, typer.Option(help="As --set reduce.order=COUNT.")] = None,
    modes: Annotated[int | None, typer.Option(help="As --set reduce.modes=COUNT.")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="As --set output.path=BODY.h5.")] = None,
    loads: Annotated[
        Path | None,
        typer.Option(
            "--input",
            metavar="B.mtx",
            help="Inputs of matrices; in a .mat, .npz a name.",
            autocompletion=files_with(*MATRICES),
        ),
    ] = None,
    outputs: Annotated[
        Path | None,
        typer.Option("--output", metavar="C.mtx", help="Outputs of matrices.", autocompletion=files_with(*MATRICES)),
    ] = None,
    report: Report = None,
    against: Against = None,
    within: Within = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
    attached: Attached = False,
    attempt: Annotated[str, typer.Option(hidden=True, help="Token of an attempt.")] = "",
) -> None:
    """Reduce the models of job files and write their bodies."""
    from morembs.app.jobs.document import sections_of
    from morembs.app.jobs.run import run_job
    from morembs.app.report.text import print_document

    if attached:
        leave_with_input()
    wanted = request_report(report, against, within, lambda: len(jobs))
    with messages():
        jobs, load = _loader(jobs, loads, outputs)
    short = {"reduce.method": method, "reduce.order": order, "reduce.modes": modes, "output.path": out}
    every = [*(f"{key}={value}" for key, value in short.items() if value is not None), *(changes or ())]

    def work(path: Path, progress: Progress) -> Done:
        job = replace(load(path, every), attempt=attempt)
        shown: list[str] = []

        def tell(sentence: str) -> None:
            shown.append(sentence)
            warn(sentence)

        document = run_job(job, progress, tell).document()
        return document, lambda: print_document(console(), document, sections_of(document), shown)

    each_job(jobs, as_json, work, quiet, _order(jobs, every, load), wanted)


def _loader(files: list[Path], loads: Path | None, outputs: Path | None) -> tuple[list[Path], Load]:
    """Job files and what loads them; of matrices the one job that takes them.

    Raises:
        InputError: --input or --output without matrices, or matrices that make no job.
    """
    from morembs.app.jobs.job import job_of_text, load_job
    from morembs.app.kinds import MATRIX, MATRIX_FILE, kind_of

    alone = len(files) == 1 and kind_of(files[0]) is MATRIX_FILE
    if not alone and not all(kind_of(file) is MATRIX for file in files):
        if loads is not None or outputs is not None:
            raise InputError(
                "--input and --output belong to matrices: morembs reduce K.mtx M.mtx --input B.mtx", keyword="input"
            )
        return files, load_job
    from morembs.app.jobs.template import job_of_matrices

    # A job of the working directory, from which the command line names its files; in one file matrices have names.
    ends = [file if file is None or alone else file.absolute() for file in (loads, outputs)]
    text = job_of_matrices(files, *ends)

    def load(path: Path, changes: Sequence[str]) -> Job:
        try:
            job = job_of_text(text, path, changes)
            if not any(ends):
                _refuse_without_inputs(job, "B" if alone else "B.mtx")
        except InputError as error:
            raise error.restate(
                f"{error}; keys are flags here: --method NAME, --modes COUNT, --order COUNT, --input "
                f"{'B' if alone else 'B.mtx'}, others --set reduce.KEY=VALUE"
            ) from error
        return job

    return [Path(files[0].name.partition(".")[0] + ".toml")], load


def _refuse_without_inputs(job: Job, name: str) -> None:
    """Refuse methods that need inputs.

    Raises:
        InputError: in these cases.
    """
    for reducer in job.reducers.values():
        if reducer.needs_interfaces:
            raise InputError(
                f"method {reducer.method} needs inputs: --input {name}; or take --method modal --modes 20",
                kind="missing",
            )


@app.command(cls=Verb, epilog=example("morembs compare part.toml --picture compared.png"))
def compare(
    jobs: Jobs,
    changes: Changes = None,
    picture: Annotated[Path | None, typer.Option(help="Draw it: a .png, .pdf or .svg file.")] = None,
    report: Report = None,
    against: Against = None,
    within: Within = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Run jobs and set the reductions of each side by side: order, errors, time, memory."""
    from morembs.app.cli.report import print_contenders
    from morembs.app.jobs.files import results_of
    from morembs.app.jobs.job import load_job
    from morembs.app.jobs.order import PICTURES
    from morembs.app.jobs.pareto import contenders, draw_contenders
    from morembs.app.jobs.run import run_job
    from morembs.app.jobs.stages.certificate import certified_band
    from morembs.storage.safefile import check_writable, one_file

    wanted = request_report(report, against, within, lambda: len(jobs))

    def work(path: Path, progress: Progress) -> Done:
        if picture is not None:
            if len(jobs) > 1:
                raise InputError(
                    f"--picture {picture} was given for {len(jobs)} jobs; compare them one by one for it",
                    keyword="picture",
                )
            if picture.suffix not in PICTURES:
                raise InputError(
                    f"--picture {picture} was given; expected a name that ends in .png, .pdf or .svg", keyword="picture"
                )
            check_writable(picture)
        loaded = load_job(path, changes or ())
        if picture is not None and any(one_file(picture, path) for path in results_of(loaded).values()):
            raise InputError(
                f"--picture {picture} would overwrite a file of the job; give it a name of its own",
                kind="output",
                keyword="picture",
            )
        if certified_band(loaded) is None:
            raise InputError(
                "a comparison needs errors: add a table [certify] with band_hz = [LOW, HIGH] to the job", kind="missing"
            )
        result = run_job(loaded, progress, warn)
        compared = contenders(result)
        if picture is not None:
            draw_contenders(picture, compared, path.name)
        document = {
            "job": str(path),
            "output": str(loaded.output),
            "seconds": {stage.name: stage.seconds for stage in result.stages},
            "job_peak_memory_bytes": result.peak_memory_bytes,
            "contenders": [asdict(each) for each in compared],
        }
        written = [loaded.output, *(file for file in (loaded.picture, picture) if file is not None)]
        return document, lambda: print_contenders(console(), str(path), compared, written)

    each_job(jobs, as_json, work, quiet, _order(jobs, changes or ()), wanted)


@app.command(cls=Verb, epilog=example("morembs check part.toml"))
def check(
    jobs: Jobs, changes: Changes = None, as_json: AsJson = False, quiet: Quiet = False, attached: Attached = False
) -> None:
    """Check jobs and systems, and forecast size and memory; factorises nothing, writes nothing."""
    from morembs.app.cli.report import print_forecast
    from morembs.app.cli.simulate import checked_system
    from morembs.app.jobs.check import check_job
    from morembs.app.jobs.job import load_job
    from morembs.app.kinds import SYSTEM, kind_of

    if attached:
        leave_with_input()

    def work(path: Path, progress: Progress) -> Done:
        if kind_of(path) is SYSTEM:
            return checked_system(path, changes or (), progress)
        with keeping_ledger() as ledger:
            forecast = check_job(load_job(path, changes or ()), progress)
        document = {"job": str(path), **forecast.as_json(), "inputs": ledger.names()}
        return document, lambda: print_forecast(console(), document)

    each_job(jobs, as_json, work, quiet, _order(jobs, changes or ()))


@app.command(cls=Verb, epilog=example("morembs schema > job.schema.json"))
def schema(
    system: Annotated[bool, typer.Option("--system", help="That of system files, for morembs simulate.")] = False,
) -> None:
    """Print the JSON schema of job files, by which editors complete and check keys."""
    from morembs.base.key_tables import Table, json_schema

    with messages(), printing():
        tables: type[Table]
        if system:
            from morembs.app.simulations.tables import SystemTables

            tables = SystemTables
        else:
            from morembs.app.jobs.job import job_tables

            tables = job_tables()
        echo(json.dumps(json_schema(tables), indent=2))


def _order(jobs: Sequence[Path], changes: Sequence[str], load: Load | None = None) -> Order:
    """The order of jobs by their places; jobs that cannot be read report it in their turn."""
    from morembs.app.jobs.job import load_job
    from morembs.app.jobs.order import order_of, read_ahead

    loaded: dict[int, Job] = {}
    for number, path in enumerate(jobs):
        with suppress(MorembsError):
            loaded[number] = (load or load_job)(path, changes)
    read_ahead(list(loaded.values()))
    return order_of(loaded, range(len(jobs)))


app.add_typer(starting)
app.add_typer(batches)
app.add_typer(bodies)
app.add_typer(proofs)
app.add_typer(evaluation)
app.add_typer(updating)
app.add_typer(simulating)
app.add_typer(models)
app.add_typer(modes)
app.add_typer(viewing)


@app.command(cls=Verb, epilog=example("morembs solvers"))
def solvers(
    as_json: AsJson = False,
    tolerances: Annotated[
        bool, typer.Option("--tolerances", help="Tolerances and limits of all of morembs in place of that list.")
    ] = False,
) -> None:
    """List the sparse solvers, and why some cannot run here."""
    with messages(), printing():
        if tolerances:
            _list_tolerances(as_json)
            return
        from morembs.linalg.sparse.select import available_solvers

        known = available_solvers()
        if as_json:
            print_json([{"name": name, "available": not why, "reason": why} for name, why in known.items()])
            return
        for name, reason in known.items():
            typer.echo(f"{name}: {reason or 'available'}")
        typer.echo('Models differ: "auto" weighs the available solvers for each one, and says which it takes and why.')


def _list_tolerances(as_json: bool) -> None:
    """Room, name, value and reason of each."""
    from morembs.app.cli.tolerance_table import tolerances

    if as_json:
        # JSON has no complex numbers.
        print_json(
            [
                asdict(each) | ({"value": str(each.value)} if isinstance(each.value, complex) else {})
                for each in tolerances()
            ]
        )
        return
    for quantity in tolerances():
        typer.echo(f"{quantity.room}: {quantity.name} = {quantity.value!r}: {quantity.reason}")


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"morembs {VERSION}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", "-V", "-v", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Options of all verbs."""
