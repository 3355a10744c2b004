"""Runs a batch: all jobs are checked first, then each runs in a process of its own, as many as memory allows."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

from morembs import stopping
from morembs.batches.children import Children, Finished, Heard
from morembs.batches.manifest import Ended, Manifest
from morembs.batches.plan import Part, parts_of, unchanged
from morembs.errors import InputError
from morembs.memory import available_bytes
from morembs.storage.contents import Content

MANIFEST = "batch.manifest"
State = Literal["done", "unchanged", "failed", "sound"]
# Of the memory that is free at the start; and what a forecast is taken to be wrong by.
_SHARE, _MARGIN = 0.9, 1.15
# Exit codes that say themselves what happened.
_TOLD = (1, 2)


@dataclass(frozen=True, kw_only=True)
class Record:
    """How a job of a batch went: ``state``, the ``message`` of a failed one with its exit ``code``, the ``output``,
    and ``facts``, the plain values of ``morembs reduce --json``, of ``morembs check --json`` for a checked one."""

    name: str
    job: str
    output: str = ""
    state: State
    message: str = ""
    code: int = 0
    seconds: float = 0.0
    facts: Mapping[str, Any]


class Listener(Protocol):
    """What a batch tells while it goes on; ``count`` is the number of its jobs."""

    def checking(self, count: int) -> None:
        """The jobs that are due are checked."""

    def began(self, part: Part, count: int) -> None:
        """A job begins."""

    def said(self, part: Part, count: int, line: str) -> None:
        """A job says what it does."""

    def ended(self, part: Part, count: int, record: Record) -> None:
        """A job is done, is found unchanged, or has failed."""


class Nobody:
    """The default: nobody listens."""

    def checking(self, count: int) -> None: ...

    def began(self, part: Part, count: int) -> None: ...

    def said(self, part: Part, count: int, line: str) -> None: ...

    def ended(self, part: Part, count: int, record: Record) -> None: ...


def batch(
    jobs: Iterable[str | Path], *, changes: Sequence[str] = (), workers: int | None = None,
    manifest: str | Path | None = None, fresh: bool = False, check_only: bool = False,
    listener: Listener | None = None,
) -> tuple[Record, ...]:  # fmt: skip
    """Run jobs beside each other, those whose results are there and up to date left out.

    A job that fails does not stop the others. Each runs in a process of its own, which ends with this one.

    Args:
        jobs: job files, and folders with some.
        changes: keys that all jobs get with another value, such as ``"reduce.modes=40"``.
        workers: how many run at once at most; None: one for each processor. Fewer run where their forecasts
            exceed the free memory together.
        manifest: the file in which is remembered what was done; None: ``batch.manifest`` in the folder that
            holds all jobs, or the nearest above it within the working directory.
        fresh: run all, whatever is remembered.
        check_only: check those that are due, and run none.

    Returns:
        A record for each job, in the order of the jobs.

    Raises:
        InputError: no job, or a manifest that is another file or in use.
        OutputError: the manifest cannot be written.

    >>> from pathlib import Path
    >>> Path("night").mkdir()
    >>> batch(["night"])
    Traceback (most recent call last):
    ...
    morembs.errors.InputError: ...
    """
    if workers is not None and workers < 1:
        raise InputError(f"--jobs {workers} was given; expected a positive count of jobs to run at once")
    parts = parts_of(jobs, changes)
    if manifest is None and all(part.fault for part in parts):
        # Nothing to remember, and no folder to remember it in.
        return _Batch(parts, changes, workers, None, listener or Nobody()).run(fresh, check_only)
    place = Path(manifest) if manifest is not None else _nearest_manifest(parts)
    with Manifest(place) as remembered:
        return _Batch(parts, changes, workers, remembered, listener or Nobody()).run(fresh, check_only)


class _Batch:
    """A batch while it runs."""

    def __init__(
        self, parts: Sequence[Part], changes: Sequence[str], workers: int | None, manifest: Manifest | None,
        listener: Listener,
    ) -> None:  # fmt: skip
        self._parts, self._manifest, self._listener = parts, manifest, listener
        self._options = [word for change in changes for word in ("--set", change)]
        self._cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self._workers = workers or self._cores
        self._records: dict[int, Record] = {}

    def run(self, fresh: bool, check_only: bool) -> tuple[Record, ...]:
        due = []
        for part in self._parts:
            stopping.check()
            last = None if part.fault or fresh or not self._manifest else unchanged(part, self._manifest)
            if part.fault:
                self._fail(part, part.fault)
            elif last is not None:
                self._end(part, state="unchanged", facts=last.facts)
            else:
                due.append(part)
        # More threads for each where few run at once; a job's own setting goes before.
        threads = str(max(1, self._cores // max(1, min(self._workers, len(due)))))
        environment = {name: threads for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
        with Children(environment) as children:
            sound = self._check(children, due)
            if check_only:
                for part, forecast in sound:
                    self._end(part, state="sound", facts=forecast)
            else:
                self._reduce(children, sound)
        return tuple(self._records[part.number] for part in self._parts)

    def _check(self, children: Children, due: Sequence[Part]) -> list[tuple[Part, Mapping[str, Any]]]:
        """The parts without a fault, with their forecasts."""
        if due:
            self._listener.checking(len(due))
        for first in range(min(self._workers, len(due))):
            dealt = due[first :: self._workers]
            children.start(dealt, ["check", *(str(part.path) for part in dealt), *self._options])
        sound = []
        while children.running:
            heard = children.next()
            if not isinstance(heard, Finished):
                continue
            documents = heard.documents or [{"error": heard.message}] * len(heard.parts)
            for part, document in zip(heard.parts, documents, strict=True):
                if "error" in document:
                    self._fail(part, str(document["error"]), heard.code)
                else:
                    sound.append((part, document))
        return sound

    def _reduce(self, children: Children, sound: Sequence[tuple[Part, Mapping[str, Any]]]) -> None:
        """Run the jobs, the longest first (Graham 1969); one waits until the memory that it needs is free."""
        room = _SHARE * available_bytes()
        needs = {part.number: _MARGIN * float(forecast["peak_memory_bytes"]) for part, forecast in sound}
        waiting = deque(part for part, _ in sorted(sound, key=lambda each: (-_seconds(each[1]), each[0].number)))
        taken: dict[int, float] = {}
        again: set[int] = set()
        while waiting or taken:
            while waiting and len(taken) < self._workers:
                need = needs[waiting[0].number]
                if taken and sum(taken.values()) + need > room:
                    break
                part = waiting.popleft()
                taken[part.number] = need
                self._listener.began(part, len(self._parts))
                children.start([part], ["reduce", str(part.path), *self._options])
            heard = children.next()
            part = heard.parts[0]
            if isinstance(heard, Heard):
                self._listener.said(part, len(self._parts), heard.line)
                continue
            del taken[part.number]
            if heard.killed and part.number not in again:
                # Most likely by the system for want of memory: once more, alone.
                again.add(part.number)
                needs[part.number] = max(room, needs[part.number])
                waiting.append(part)
            else:
                self._ended(part, heard)

    def _ended(self, part: Part, end: Finished) -> None:
        """Judge and remember a job whose process has ended."""
        document: Mapping[str, Any] = end.documents[0] if end.documents else {"error": end.message}
        if "error" in document or end.code:
            self._fail(part, str(document.get("error", end.message)), end.code, end.seconds)
            return
        facts = _kept(document)
        inputs = {Path(name): Content.from_plain(values) for name, values in document["inputs"].items()}
        try:
            outputs = {path: Content.of(path) for path in part.outputs}
        except OSError as error:
            self._fail(part, f"{error.filename} is not there although the job ended well ({error.strerror})", 1)
            return
        if self._manifest:
            self._manifest.ended(part.loaded.output, Ended(key=part.key, inputs=inputs, outputs=outputs, facts=facts))
        self._end(part, state="done", facts=facts, seconds=end.seconds)

    def _fail(self, part: Part, message: str, code: int = 2, seconds: float = 0.0) -> None:
        if part.job is not None and self._manifest:
            self._manifest.failed(part.job.output, message)
        self._end(part, state="failed", facts={}, message=message, code=code if code in _TOLD else 2, seconds=seconds)

    def _end(self, part: Part, **values: Any) -> None:
        output = "" if part.job is None else str(part.job.output)
        record = Record(name=part.name, job=str(part.path), output=output, **values)
        self._records[part.number] = record
        self._listener.ended(part, len(self._parts), record)


def _kept(document: Mapping[str, Any]) -> dict[str, Any]:
    """What is remembered of a finished job: the curves of certificates are in the body file."""
    kept = {key: value for key, value in document.items() if key not in ("inputs", "bodies", "output")}
    kept["bodies"] = {
        name: {**body, "certificate": _limits(body["certificate"])} for name, body in document["bodies"].items()
    }
    return kept


def _limits(certificate: Mapping[str, Any] | None) -> dict[str, Any] | None:
    keys = ("measure", "limits", "band_hz", "damping_floor", "bound_kind", "static_error")
    return None if certificate is None else {key: certificate[key] for key in keys}


def _seconds(forecast: Mapping[str, Any]) -> float:
    return float(forecast["factor_seconds"] + sum(forecast["reduction_seconds"].values()))


def _nearest_manifest(parts: Sequence[Part]) -> Path:
    """One job of a folder is remembered with the others, whether it is run with them or alone.

    Above the folder of the jobs only the folders within the working directory are looked into: a manifest elsewhere
    belongs to others.
    """
    sound = [part for part in parts if not part.fault] or parts
    folder = Path(os.path.commonpath([part.path.resolve().parent for part in sound]))
    here = Path.cwd().resolve()
    above = [folder, *(each for each in folder.parents if each.is_relative_to(here))]
    there = (place for each in above if (place := each / MANIFEST).is_file())
    return next(there, folder / MANIFEST)
