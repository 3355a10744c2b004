"""What a batch has to do: its jobs, whether their results are there already, and which jobs cannot be run together."""

from __future__ import annotations

import hashlib
import json
import os
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from morembs.app.batches.manifest import Ended, Manifest
from morembs.app.jobs.files import results_of
from morembs.app.jobs.job import load_job
from morembs.app.jobs.order import order_of
from morembs.app.jobs.tables import Job
from morembs.base.errors import InputError, MorembsError
from morembs.body.file import FormatVersion
from morembs.version import VERSION

# Tables and keys that do not change what is in a body.
_BESIDE = {
    "solver": {"threads", "memory", "scratch", "workers", "ranks"},
    "output": {"path", "picture"},
    "state_space": {"path"},
}


@dataclass(frozen=True, kw_only=True)
class Part:
    """A job of a batch; ``number`` counts from 1, ``name`` is what people call it, ``fault`` why it cannot be run.

    ``takes`` has the numbers of the jobs that make the bodies of an assembly.
    """

    number: int
    name: str
    path: Path
    job: Job | None = None
    fault: MorembsError | None = None
    takes: tuple[int, ...] = ()

    @cached_property
    def key(self) -> str:
        """SHA-256 of what is asked for, not of the files it is asked of."""
        tables = self.loaded.tables.values()
        asked = {
            table: {key: value for key, value in values.items() if key not in _BESIDE.get(table, ())}
            if isinstance(values, dict)
            else values
            for table, values in tables.items()
        }
        text = json.dumps([asked, VERSION, FormatVersion.LATEST], sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def loaded(self) -> Job:
        """The job of a part without a fault."""
        if self.job is None:
            raise InputError(str(self.fault))
        return self.job

    @property
    def outputs(self) -> tuple[Path, ...]:
        """The files that the job writes."""
        return tuple(results_of(self.loaded).values())


def parts_of(given: Iterable[str | Path], changes: Sequence[str] = ()) -> tuple[Part, ...]:
    """The jobs of files and folders, each once, those of a folder in the order of their paths.

    Raises:
        InputError: a folder without a job.
    """
    paths: dict[Path, Path] = {}
    for place in map(Path, given):
        held = _jobs_below(place) if place.is_dir() else [place]
        if not held:
            raise InputError(
                f"{place} holds no job: no .toml file with a table [model] or [[substructure]], or [member]",
                kind="missing",
                keyword="jobs",
            )
        for path in held:
            paths.setdefault(path.resolve(), path)
    if not paths:
        raise InputError("a batch needs jobs; give job files, or folders that hold some", kind="missing")
    jobs: dict[int, Job] = {}
    faults: dict[int, MorembsError] = {}
    for number, path in enumerate(paths.values()):
        try:
            jobs[number] = load_job(path, changes)
        except MorembsError as error:
            faults[number] = error
    order = order_of(jobs, faults)
    faults |= {key: InputError(why, kind="conflict") for key, why in order.refused.items() if key not in faults}
    # A link to a job has its own name.
    names = _names([path.absolute() for path in paths.values()])
    return tuple(
        Part(
            number=at + 1,
            name=names[at],
            path=path,
            job=None if at in faults else jobs[at],
            fault=faults.get(at),
            takes=() if at in faults else tuple(number + 1 for number in order.parts.get(at, ())),
        )
        for at, path in enumerate(paths.values())
    )


def find_unchanged(part: Part, manifest: Manifest) -> Ended | None:
    """How a job ended whose results are there, of the same job and the same inputs, and as it wrote them."""
    last = manifest.last(part.loaded.output)
    return last if last is not None and last.holds(part.key, part.outputs) else None


def _jobs_below(folder: Path) -> list[Path]:
    return sorted((path for path in folder.rglob("*.toml") if _is_job(path)), key=_as_counted)


def _as_counted(path: Path) -> list[list[tuple[int, str]]]:
    """The order of paths, by the numbers in them: part2 before part10."""
    return [
        [(int(piece), "") if piece.isdecimal() else (-1, piece) for piece in re.split(r"(\d+)", name)]
        for name in path.parts
    ]


def _is_job(path: Path) -> bool:
    """True if a file has a table of a job; of a file that is no TOML its text decides."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    try:
        tables = tomllib.loads(text)
        one = any(isinstance(tables.get(name), dict) for name in ("model", "member"))
        return one or isinstance(tables.get("substructure"), list)
    except (ValueError, RecursionError):
        return any(head in text for head in ("[model]", "[[substructure]]", "[member]"))


def _names(paths: Sequence[Path]) -> list[str]:
    """The stems of the files, with as many folders in front as tell equal ones apart."""
    names, depth = [path.stem for path in paths], 1
    while depth < max(len(path.parts) for path in paths):
        repeated = {name for name, count in Counter(names).items() if count > 1}
        if not repeated:
            break
        depth += 1
        for at, path in enumerate(paths):
            if names[at] in repeated:
                names[at] = os.path.join(*path.with_suffix("").parts[-depth:])
    return names
