"""The verb ``batch``, and its lines on the terminal while it works."""

from __future__ import annotations

import os
import re
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from morembs.app.cli.completion import JOBS, files_with
from morembs.app.cli.messages import echo, print_json, printing, tell
from morembs.app.cli.terminal import (
    Against,
    AsJson,
    Changes,
    Quiet,
    Report,
    Verb,
    Within,
    example,
    messages,
    request_report,
)
from morembs.base.progress import duration_words

if TYPE_CHECKING:
    from morembs.app.batches.plan import Part
    from morembs.app.batches.records import Listener, Record

app = typer.Typer()
# A line of progress of a job, without the time that it has taken.
_STAGE = re.compile(r"\[[\d,]+ s\] (.+)")


@app.command(cls=Verb, epilog=example("morembs batch jobs --report night.html"))
def batch(
    jobs: Annotated[
        list[Path],
        typer.Argument(
            metavar="JOB.toml|FOLDER...",
            help="Jobs, folders with jobs.",
            show_default=False,
            autocompletion=files_with(*JOBS),
        ),
    ],
    workers: Annotated[int | None, typer.Option("--jobs", "-j", help="How many run at once at most.")] = None,
    cluster: Annotated[
        str | None,
        typer.Option(metavar="local:N|tcp://HOST:PORT|FILE.toml", help="Workers here, of dask, or of a queue."),
    ] = None,
    retries: Annotated[int, typer.Option(help="How often a job that was killed is begun again.")] = 2,
    changes: Changes = None,
    report: Report = None,
    against: Against = None,
    within: Within = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Run all jobs, also those up to date.")] = False,
    check_only: Annotated[bool, typer.Option("--check-only", help="Check the jobs that are due, run none.")] = False,
    manifest: Annotated[Path | None, typer.Option(help="What was done, batch.manifest beside the jobs.")] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Run many jobs beside each other; those whose results are up to date are left alone."""
    from morembs.app.batches.plan import parts_of
    from morembs.app.batches.run import batch as run
    from morembs.app.pages.page import write_report
    from morembs.app.pages.parts import Entry

    wanted = request_report(report, against, within, lambda: len(parts_of(jobs, changes or ())))
    with messages():
        with _shown(quiet) as listener:
            records = run(
                jobs,
                changes=changes or (),
                workers=workers,
                cluster=cluster,
                retries=retries,
                manifest=manifest,
                fresh=fresh,
                check_only=check_only,
                listener=listener,
            )
        if wanted is not None:
            entries = [
                Entry(
                    name=record.name,
                    job=record.job,
                    state=record.state,
                    message=record.message,
                    output=record.output,
                    seconds=record.seconds or sum(record.facts.get("seconds", {}).values()) or None,
                    peak_memory_bytes=record.facts.get("job_peak_memory_bytes"),
                    document=record.facts or None,
                )
                for record in records
            ]
            title = ", ".join(Path(os.path.abspath(job)).name for job in jobs)
            words = write_report(wanted.path, entries, title, wanted.earlier)
            if words and not quiet:
                tell(words)
        with printing([record.output for record in records if record.state == "done"]):
            if as_json:
                print_json([asdict(record) for record in records])
            else:
                echo(_summarise_records(records))
                if wanted is not None:
                    echo(f"written: {wanted.path}")
    codes = [record.code for record in records if record.state == "failed"]
    if codes:
        raise typer.Exit(min(codes))


def _summarise_records(records: Sequence[Record]) -> str:
    """``10 done, 1 unchanged, 1 failed``, and which failed."""
    counts: Counter[str] = Counter(record.state for record in records)
    states = ("sound", "waits", "done", "unchanged", "failed")
    failed = [f"failed: {record.name}: {record.message}" for record in records if record.state == "failed"]
    return "\n".join([*failed, ", ".join(f"{counts[state]} {state}" for state in states if counts[state])])


def _outcome(record: Record) -> str:
    """How a job went, in a line."""
    if record.state == "failed":
        return f"failed: {record.message}"
    if record.state in ("sound", "waits"):
        return f"{record.state}{record.message and ', '}{record.message}"
    bodies = record.facts.get("bodies", {})
    orders = "order " + ", ".join(str(body["order"]) for body in bodies.values())
    if record.state == "unchanged":
        return f"unchanged, {orders}"
    memory = record.facts["job_peak_memory_bytes"] / 1e9
    return f"done in {duration_words(record.seconds)}, {orders}, {memory:.2g} GB"


@contextmanager
def _shown(quiet: bool) -> Iterator[Listener]:
    """Lines on standard error; where somebody watches, a bar for the batch and a line for each job that runs."""
    if not quiet and sys.stderr is not None and sys.stderr.isatty():
        with _Bars().shown() as bars:
            yield bars
    else:
        yield _Lines(quiet)


class _Lines:
    """What a batch tells where nobody watches."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet

    def begin_checks(self, count: int) -> None:
        """The jobs that are due are checked."""
        self._tell(f"checking {count} job{'s' * (count > 1)}")

    def began(self, part: Part, count: int) -> None:
        """A job begins."""

    def report_step(self, part: Part, count: int, line: str) -> None:
        """A job reports its step, or warns."""
        stage = _STAGE.fullmatch(line)
        if stage is not None or line.startswith("warning: "):
            self._tell(f"{_place(part, count)}: {stage[1] if stage else line}")

    def end_job(self, part: Part, count: int, record: Record) -> None:
        """A job is done, is found unchanged, or has failed."""
        if record.state != "sound":
            self._tell(f"{_place(part, count)}: {_outcome(record)}")

    def report_event(self, line: str) -> None:
        """Something about the workers, or about an attempt that is made again."""
        self._tell(line)

    def _tell(self, line: str) -> None:
        if not self._quiet:
            tell(line)


class _Bars(_Lines):
    """The same above a bar for the batch and a line for each job that runs."""

    def __init__(self) -> None:
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

        from morembs.app.cli.screen import Screen

        super().__init__(quiet=False)
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
        self._bars = Progress(*columns, console=Screen(stderr=True), transient=True)
        self._whole = self._bars.add_task("batch", total=None)
        self._tasks: dict[int, Any] = {}

    @contextmanager
    def shown(self) -> Iterator[_Bars]:
        """Show them while the batch runs, and take them away afterwards."""
        self._bars.start()
        try:
            yield self
        finally:
            # A terminal that has gone does not end the work.
            with suppress(OSError):
                self._bars.stop()

    def began(self, part: Part, count: int) -> None:
        """A job begins."""
        self._tasks[part.number] = self._bars.add_task(_place(part, count), total=None)

    def report_step(self, part: Part, count: int, line: str) -> None:
        """A job reports its step, or warns."""
        stage, task = _STAGE.fullmatch(line), self._tasks.get(part.number)
        if stage is None:
            super().report_step(part, count, line)
        elif task is not None:
            self._bars.update(task, description=f"{_place(part, count)}: {stage[1]}")

    def end_job(self, part: Part, count: int, record: Record) -> None:
        """A job is done, is found unchanged, or has failed."""
        if part.number in self._tasks:
            self._bars.remove_task(self._tasks.pop(part.number))
        self._bars.update(self._whole, total=count, advance=1)
        super().end_job(part, count, record)

    def _tell(self, line: str) -> None:
        self._bars.console.print(line, highlight=False, soft_wrap=True, markup=False)


def _place(part: Part, count: int) -> str:
    return f"[{part.number}/{count}] {part.name}"
