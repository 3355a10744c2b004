"""Runs what is due on workers: checks first, then each job, assemblies after their parts, killed attempts once more.

Only the coordinator gives results their names. An attempt at a job writes files of its own; that of a process that was
killed, or of a worker that was lost and works on, is never taken once another has begun.
"""

from __future__ import annotations

import itertools
import json
from bisect import insort
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from graphlib import TopologicalSorter
from pathlib import Path
from types import MappingProxyType
from typing import Any

from morembs.app.batches.ledger import place_tasks
from morembs.app.batches.manifest import Ended, Manifest
from morembs.app.batches.plan import Part, find_unchanged
from morembs.app.batches.records import Listener, Record
from morembs.app.batches.tolerances import TOL
from morembs.app.batches.workers import Finished, Heard, Task, Worker, Workers
from morembs.app.jobs.solver import SolverTable
from morembs.base import stopping
from morembs.base.errors import ExitCode, MorembsError, OverwriteError
from morembs.storage.attempts import take
from morembs.storage.contents import Content, note_input, refuse_input


@dataclass(eq=False)
class _Work:
    """A task that waits or runs: the check of some jobs, or one job; the longest comes first."""

    parts: Sequence[Part]
    needs: Worker
    threads: int = 1
    checks: bool = False
    tries: int = 1
    token: str = ""
    worker: str = ""
    forecast: Mapping[str, Any] = field(default_factory=dict)

    def __lt__(self, other: _Work) -> bool:
        return self._turn() < other._turn()

    def _turn(self) -> tuple[bool, float, int]:
        return (not self.checks, -self.needs.seconds, self.parts[0].number)


class Coordinator:
    """A batch while it runs.

    Args:
        options: of the command line, for each job.
        retries: how often a job is begun again whose process was killed or whose worker is gone.
    """

    def __init__(
        self, parts: Sequence[Part], options: Sequence[str], manifest: Manifest | None, listener: Listener, retries: int
    ) -> None:
        self._parts = {part.number: part for part in parts}
        self._options, self._manifest, self._listener, self._retries = list(options), manifest, listener, retries
        self._records: dict[int, Record] = {}
        self._order: TopologicalSorter[int] = TopologicalSorter({number: () for number in self._parts})
        for part in parts:
            self._order.add(part.number, *part.takes)
        self._order.prepare()
        self._numbers = itertools.count(1)
        self._waiting: list[_Work] = []
        self._running: dict[int, _Work] = {}
        self._sound: list[_Work] = []
        self._checked = False

    def due(self, fresh: bool) -> list[Part]:
        """The jobs that can begin; this call ends jobs that are unchanged or cannot be run."""
        due: list[Part] = []
        while self._order.is_active() and (ready := self._order.get_ready()):
            for part in map(self._parts.__getitem__, ready):
                stopping.check()
                last = None if part.fault or fresh or not self._manifest else find_unchanged(part, self._manifest)
                lost = [self._parts[number] for number in part.takes if self._records[number].state == "failed"]
                if part.fault:
                    self._fail(part, str(part.fault), about=vars(part.fault))
                elif lost:
                    self._fail(part, f"the job {lost[0].name} of its part failed ({lost[0].path}); mend that job first")
                elif last is not None:
                    for name in last.inputs:
                        note_input(str(name))
                    self._end(part, state="unchanged", facts=last.facts)
                else:
                    due.append(part)
        return sorted(due, key=lambda part: part.number)

    def run(self, workers: Workers, due: Sequence[Part], fresh: bool, check_only: bool) -> None:
        """Check the jobs that are due, and run those without a fault and the assemblies that take their bodies."""
        self._workers, self._fresh, self._count = workers, fresh, len(due)
        self._listener.begin_checks(len(due))
        self._check(due)
        self._work()
        self._sound = [work for work in self._sound if self._overwrites_nothing(work)]
        self._checked = True
        if check_only:
            for work in self._sound:
                self._end(work.parts[0], state="sound", facts=work.forecast)
            for number in self._parts.keys() - self._records.keys():
                self._end(self._parts[number], state="waits", facts={}, message="checked once its parts are there")
            return
        self._waiting = sorted(self._sound)
        self._work()

    def records(self) -> tuple[Record, ...]:
        """How the jobs went, in their order."""
        return tuple(self._records[number] for number in self._parts)

    def _check(self, due: Sequence[Part]) -> None:
        """Have jobs checked, some by each process."""
        slots = max(1, self._workers.count * self._workers.largest.slots)
        count = max(min(slots, len(due)), -(-len(due) // TOL.jobs_per_check))
        needs = Worker(bytes=0.0, cores=1, slots=1, seconds=0.0)
        for first in range(count):
            insort(self._waiting, _Work(parts=due[first::count], needs=needs, checks=True))

    def _overwrites_nothing(self, work: _Work) -> bool:
        """True if no result takes the place of what other jobs were seen to open, includes among it; else it fails."""
        try:
            for path in work.parts[0].outputs:
                refuse_input(path)
        except OverwriteError as error:
            self._fail(work.parts[0], str(error), about=vars(error))
            return False
        return True

    def _work(self) -> None:
        """Until nothing waits or runs."""
        while self._waiting or self._running:
            stopping.check()
            self._place()
            self._workers.want(work.needs for work in itertools.chain(self._running.values(), self._waiting))
            heard = self._workers.next()
            if isinstance(heard, Heard):
                work = self._running.get(heard.number)
                if work is not None and not work.checks:
                    self._listener.report_step(work.parts[0], len(self._parts), heard.line)
            elif isinstance(heard, Finished) and heard.number in self._running:
                self._finish_work(self._running.pop(heard.number), heard)

    def _place(self) -> None:
        """Begin what has room."""
        running = [(work.worker, work.needs) for work in self._running.values()]
        begun = list(place_tasks(((work, work.needs) for work in self._waiting), running, self._workers.present))
        for work, worker in begun:
            self._waiting.remove(work)
            self._start(work, worker)

    def _start(self, work: _Work, worker: str) -> None:
        number, part = next(self._numbers), work.parts[0]
        paths = [str(each.path.absolute()) for each in work.parts]
        if work.checks:
            arguments = ["check", *paths, *self._options]
        else:
            if self._manifest is not None:
                work.token = self._manifest.record_start(
                    part.loaded.output,
                    part.key,
                    worker=worker,
                    MB=round(work.needs.bytes / 1e6),
                    cores=work.needs.cores,
                )
            arguments = ["reduce", *paths, *self._options, "--attempt", work.token]
            if work.tries == 1:
                self._listener.began(part, len(self._parts))
        work.worker = worker
        self._running[number] = work
        task = Task(
            number=number,
            arguments=tuple(arguments),
            threads=work.threads,
            cores=work.needs.cores,
            bytes=work.needs.bytes,
        )
        self._workers.start(task, worker)

    def _finish_work(self, work: _Work, end: Finished) -> None:
        if end.killed and work.tries <= self._retries:
            self._again(work, end)
            return
        documents = _documents(end, len(work.parts))
        if work.checks:
            for part, document in zip(work.parts, documents, strict=True):
                self._has_checked(part, document, end.code)
        else:
            self._has_run(work, documents[0], end)
        # Assemblies whose parts are there now, or have failed, come in their turn.
        for part in self.due(self._fresh):
            self._check([part])

    def _again(self, work: _Work, end: Finished) -> None:
        """Begin killed work once more: with more memory where the want of it may have been the reason."""
        largest_bytes, needs = self._workers.largest.bytes, work.needs.bytes
        if not end.lost and not work.checks:
            needs = max(needs, TOL.killed_margin * end.peak_memory_bytes) if end.peak_memory_bytes else largest_bytes
        self._listener.report_event(f"{work.parts[0].name}: {end.message}; begun again")
        if not work.checks and self._manifest is not None:
            self._manifest.record_loss(work.parts[0].loaded.output, worker=work.worker, message=end.message)
        again = _Work(
            parts=work.parts,
            needs=_with_bytes(work.needs, min(needs, largest_bytes)),
            threads=work.threads,
            checks=work.checks,
            tries=work.tries + 1,
        )
        insort(self._waiting, again)

    def _has_checked(self, part: Part, document: Mapping[str, Any], code: int) -> None:
        if "error" in document:
            self._fail(part, str(document["error"]), code, about=document)
            return
        for name in document["inputs"]:
            note_input(name)
        forecast, largest = float(document["peak_memory_bytes"]), self._workers.largest
        seconds = float(sum(document["seconds"].values()))
        if self._workers.limits and forecast > largest.bytes:
            self._fail(
                part,
                f"{part.path.name} needs {forecast / 1e9:.2g} GB by forecast; the largest worker has "
                f"{largest.bytes / 1e9:.2g} GB: give [solver] memory, or a larger worker",
            )
            return
        if seconds > largest.seconds:
            self._fail(
                part,
                f"{part.path.name} needs {seconds / 3600:.2g} h by forecast; a worker lives for "
                f"{largest.seconds / 3600:.2g} h: give [solver] threads, or a longer walltime",
            )
            return
        threads = self._workers.threads(SolverTable.of(part.loaded).threads, self._count)
        needs = Worker(
            bytes=min(TOL.forecast_margin * forecast, largest.bytes),
            cores=min(threads, largest.cores),
            slots=1,
            seconds=seconds,
        )
        work = _Work(parts=[part], needs=needs, threads=threads, forecast=document)
        if self._checked:
            if self._overwrites_nothing(work):
                insort(self._waiting, work)
        else:
            self._sound.append(work)

    def _has_run(self, work: _Work, document: Mapping[str, Any], end: Finished) -> None:
        """Judge a job whose process has ended, take its results and remember it."""
        part = work.parts[0]
        if "error" in document or end.code:
            self._fail(part, str(document.get("error", end.message)), end.code, end.seconds, about=document)
            return
        try:
            take(part.outputs, work.token)
            outputs = {path: Content.of(path) for path in part.outputs}
        except MorembsError as error:
            self._fail(part, str(error), about=vars(error))
            return
        except OSError as error:
            self._fail(part, f"{error.filename} is not there although the job ended well ({error.strerror})", 1)
            return
        facts = _trim_document(document)
        inputs = {Path(name): Content.from_plain(values) for name, values in document["inputs"].items()}
        if self._manifest:
            self._manifest.record_end(
                part.loaded.output,
                Ended(key=part.key, inputs=inputs, outputs=outputs, facts=facts),
                worker=work.worker,
                token=work.token,
                seconds=round(end.seconds, 3),
            )
        self._end(part, state="done", facts=facts, seconds=end.seconds)

    def _fail(
        self,
        part: Part,
        message: str,
        code: int = ExitCode.BAD_INPUT,
        seconds: float = 0.0,
        about: Mapping[str, Any] = MappingProxyType({}),
    ) -> None:
        """The end of a failed job; ``about`` has the kind and the keyword of its error."""
        if part.job is not None and self._manifest:
            self._manifest.record_failure(part.job.output, message)
        self._end(
            part,
            state="failed",
            facts={},
            message=message,
            kind=str(about.get("kind", "")),
            keyword=str(about.get("keyword", "")),
            code=code if code in ExitCode.ALL else ExitCode.BAD_INPUT,
            seconds=seconds,
        )

    def _end(self, part: Part, **values: Any) -> None:
        output = "" if part.job is None else str(part.job.output)
        record = Record(name=part.name, job=str(part.path), output=output, **values)
        self._records[part.number] = record
        if record.state not in ("sound", "waits"):
            self._order.done(part.number)
        self._listener.end_job(part, len(self._parts), record)


def _with_bytes(needs: Worker, size: float) -> Worker:
    return Worker(bytes=size, cores=needs.cores, slots=needs.slots, seconds=needs.seconds)


def _documents(end: Finished, count: int) -> Sequence[Mapping[str, Any]]:
    """What a process printed, or its last words for each of its jobs."""
    try:
        documents = json.loads(end.printed)
    except ValueError:
        documents = []
    return documents if len(documents) == count else [{"error": end.message}] * count


def _trim_document(document: Mapping[str, Any]) -> dict[str, Any]:
    """What is remembered of a finished job: the curves of certificates are in the body file."""
    files = ("inputs", "bodies", "output", "picture", "written")
    kept = {key: value for key, value in document.items() if key not in files}
    kept["bodies"] = {
        name: {**body, "certificate": _limits(body["certificate"])} for name, body in document["bodies"].items()
    }
    return kept


def _limits(certificate: Mapping[str, Any] | None) -> dict[str, Any] | None:
    keys = ("measure", "limits", "band_hz", "damping_floor", "bound_kind", "static_error")
    return None if certificate is None else {key: certificate[key] for key in keys}
