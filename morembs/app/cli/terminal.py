"""What the verbs of the command line share: progress, messages, exit codes, where output goes."""

from __future__ import annotations

import _thread
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from morembs.app.cli.completion import JOBS, files_with
from morembs.app.cli.messages import Failure, echo, failure, print_json, printing, tell, without_nan
from morembs.app.cli.tolerances import TOL
from morembs.base import stopping
from morembs.base.errors import InputError
from morembs.base.memory import release
from morembs.base.progress import SILENT, Progress, listening

if TYPE_CHECKING:
    from morembs.app.jobs.order import Order
    from morembs.app.pages.page import ReportRequest


EXIT_CODES = (
    "Exit codes: 0 done; 1 a fault of this program (a file holds the traceback); 2 input that cannot be used, a model "
    "that cannot be solved, or a result that cannot be written (one message on standard error); 129 the terminal was "
    "closed; 130 interrupted; 143 terminated; a second signal ends the run without cleaning up. Of several jobs one "
    "that fails does not stop the others; the exit code is then 2, or 1 where one was a fault of this program."
)

Jobs = Annotated[
    list[Path],
    typer.Argument(metavar="JOB.toml...", help="Job files.", show_default=False, autocompletion=files_with(*JOBS)),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print a list of JSON documents on standard output.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress on standard error.")]
Changes = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Another value, such as reduce.modes=40.")
]
Report = Annotated[Path | None, typer.Option(help="Write a report of all: an .html file.")]
Against = Annotated[
    Path | None,
    typer.Option(metavar="OLD.html|MANIFEST", help="Tell in the report what changed since an earlier one, or a batch."),
]
Within = Annotated[
    str | None, typer.Option(metavar="NAME=PART,...", help="Changes that are not red: frequencies, mass, error, time.")
]
Attached = Annotated[bool, typer.Option(hidden=True, help="End when standard input does.")]

# Plain values for JSON, and what prints them for people.
Done = tuple[dict[str, Any], Callable[[], None]]
Work = Callable[[Path, Progress], Done]


def leave_with_input() -> None:
    """End this process, as SIGTERM does, when its standard input ends: with the process that holds the other end."""

    def wait() -> None:
        with suppress(OSError, ValueError):
            while os.read(0, 4096):
                pass
        if sys.platform == "win32":
            # Another process cannot be asked to end there, and os.kill ends this one without cleaning up.
            _thread.interrupt_main(signal.SIGTERM)
        else:
            os.kill(os.getpid(), signal.SIGTERM)

    Thread(target=wait, daemon=True).start()


def example(command: str) -> str:
    """What stands below the options of a verb."""
    return f"Example: {command}"


def without_flag_types(parameters: list[Any]) -> list[Any]:
    """The parameters of a help page; options that are said or not, --help too, show no type."""
    for parameter in parameters:
        if getattr(parameter, "is_flag", False):
            parameter.metavar = ""
    return parameters


class Verb(TyperCommand):
    """A verb."""

    def get_params(self, ctx: Any) -> list[Any]:
        """As of typer."""
        return without_flag_types(super().get_params(ctx))


class LineProgress:
    """Lines on standard error where no terminal is: a stage that begins, and its progress each quarter of a minute.

    A thread looks at the clock, so that long calls of libraries are shown too, as far as they let other threads run.
    Work that takes less than ``patience`` seconds writes nothing.
    """

    def __init__(
        self,
        write: Callable[[str], object],
        clock: Callable[[], float] = time.monotonic,
        *,
        patience: float = TOL.lines_patience_seconds,
    ) -> None:
        self._write, self._clock, self._patience = write, clock, patience
        self._start = clock()
        self._stage, self._news, self._told = "", "", ""
        self._last = -TOL.repeat_seconds
        self._lock, self._end = Lock(), Event()

    def stage(self, name: str) -> None:
        """A new stage begins."""
        with self._lock:
            self._stage, self._news = name, ""
        self.look()

    def update(self, text: str) -> None:
        """News within the stage."""
        with self._lock:
            self._news = text
        self.look()

    def look(self) -> None:
        """Write a line if one is due."""
        with self._lock:
            elapsed = self._clock() - self._start
            since = elapsed - self._last
            due = since >= (TOL.stage_seconds if self._stage != self._told else TOL.repeat_seconds)
            if elapsed < self._patience or not due or not (self._stage or self._news):
                return
            self._told, self._last = self._stage, elapsed
            self._write(f"[{elapsed:,.0f} s] " + ": ".join(filter(None, (self._stage, self._news))))

    def _watch(self) -> None:
        while not self._end.wait(min(TOL.stage_seconds, TOL.repeat_seconds) / 2):
            self.look()

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


class Heeding:
    """Passes progress on, and ends the work where a signal has asked for that and its exception was lost."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def stage(self, name: str) -> None:
        """A new stage begins."""
        stopping.check()
        self._progress.stage(name)

    def update(self, text: str) -> None:
        """News within the stage."""
        stopping.check()
        self._progress.update(text)


@contextmanager
def progress_line(quiet: bool = False) -> Iterator[Progress]:
    """Progress on standard error while work goes on: one line that changes where somebody watches, else lines."""
    stopping.check()
    if quiet:
        yield Heeding(SILENT)
        return
    is_terminal = sys.stderr is not None and sys.stderr.isatty()
    if is_terminal:
        from morembs.app.cli.screen import Screen, TerminalProgress

        shown = TerminalProgress(Screen(stderr=True), True).shown()
    else:
        shown = LineProgress(tell).shown()
    with shown as progress:
        heeding = Heeding(progress)
        with listening(heeding):
            yield heeding


@contextmanager
def messages(failed: list[Failure] | None = None, prefix: str = "") -> Iterator[None]:
    """Turn errors into one message on standard error, and into an exit code or, for many jobs, an entry of ``failed``.

    Raises:
        typer.Exit: there was an error, and no list to keep it in.
        KeyboardInterrupt, SystemExit: a signal asked for the end before the error.
    """
    try:
        yield
    except typer.Exit:
        raise
    except Exception as error:
        # What a library makes of a signal that comes in the midst of it is no error of its own.
        stopping.check()
        fault = failure(error)
        tell(f"error: {prefix}{fault.message}")
        if failed is None:
            raise typer.Exit(fault.code) from None
        failed.append(fault)


def each_job(
    jobs: Sequence[Path],
    as_json: bool,
    work: Work,
    quiet: bool = False,
    order: Order | None = None,
    report: ReportRequest | None = None,
) -> None:
    """Do ``work`` for each job, assemblies after their parts, except jobs that ``order`` refuses."""
    sequence = range(len(jobs)) if order is None else order.sequence
    documents: list[dict[str, Any]] = []
    failed: list[Failure] = []
    lost: set[int] = set()
    for count, number in enumerate(sequence):
        stopping.check()
        path = jobs[number]
        with messages(failed, f"{path}: " if len(jobs) > 1 else ""):
            if order is not None:
                _refuse(order, number, [jobs[part] for part in order.parts.get(number, ()) if part in lost])
            _do(work, path, as_json, quiet, documents)
        if len(documents) == count:
            lost.add(number)
            documents.append({"job": str(path), **failed[-1].document()})
        # The next job shall not hold, nor report, what this one needed.
        release()
    if report is not None:
        words = None
        with messages(failed), progress_line(quiet) as progress:
            progress.stage("write report")
            # In the order that was asked for, whichever came first.
            asked = sorted(range(len(sequence)), key=lambda place: sequence[place])
            words = _write_report(report, [documents[place] for place in asked])
        if words and not quiet:
            tell(words)
        if words is not None and not as_json:
            with messages(failed), printing([str(report.path)]):
                echo(f"written: {report.path}")
    if as_json:
        with messages(failed), printing([name for document in documents for name in _list_files(document)]):
            print_json([without_nan(document) for document in documents])
    if failed:
        raise typer.Exit(min(fault.code for fault in failed))


def _refuse(order: Order, number: int, lost: Sequence[Path]) -> None:
    if number in order.refused:
        raise InputError(order.refused[number], kind="conflict")
    if lost:
        raise InputError(f"the job {lost[0]} of a part of this assembly failed; mend that job first")


def _do(work: Work, path: Path, as_json: bool, quiet: bool, documents: list[dict[str, Any]]) -> None:
    with progress_line(quiet) as progress:
        document, show = work(path, progress)
    documents.append(document)
    if not as_json:
        with printing(_list_files(document)):
            show()


def request_report(
    report: Path | None, against: Path | None, within: str | None, parts: Callable[[], int]
) -> ReportRequest | None:
    """The report of so many ``parts`` that was asked for, checked before the work begins; a message and the end where
    it cannot be."""
    if report is None and against is None and within is None:
        return None
    from morembs.app.pages.page import ReportRequest

    with messages():
        return ReportRequest.of(report, against, within, parts)


def _write_report(report: ReportRequest, documents: Sequence[Mapping[str, Any]]) -> str:
    from morembs.app.pages.page import write_report
    from morembs.app.pages.parts import Entry

    entries = [
        Entry(
            name=Path(document["job"]).stem,
            job=document["job"],
            state="failed" if "error" in document else "done",
            message=document.get("error", ""),
            output=document.get("output", ""),
            seconds=sum(document.get("seconds", {}).values()),
            peak_memory_bytes=document.get("job_peak_memory_bytes"),
            document=document if "bodies" in document else None,
        )
        for document in documents
    ]
    return write_report(report.path, entries, ", ".join(entry.name for entry in entries), report.earlier)


def _list_files(document: Mapping[str, Any]) -> list[str]:
    """The files of a finished job."""
    return document.get("written") or [document[key] for key in ("output",) if key in document]
