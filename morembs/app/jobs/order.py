"""Jobs that run together: which cannot, and which take the bodies of others and so come after them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from morembs.app.jobs.files import inputs_of, results_of
from morembs.app.jobs.stages.model import mesh_of
from morembs.app.jobs.stages.unreduced import SubstructureTable
from morembs.app.jobs.tables import Job, ModelTable
from morembs.base.errors import InputError, MorembsError
from morembs.body.stored import FORMAT
from morembs.storage.contents import Place, own_files, place_of
from morembs.storage.hdf5 import holds_format

# Ends of files that no reader of models takes.
PICTURES = (".png", ".pdf", ".svg")


@dataclass(frozen=True, kw_only=True)
class Order:
    """Of jobs by their keys: ``refused`` says why some cannot run, ``parts`` which jobs make the bodies that one takes.

    ``sequence`` has all keys in the given order, but for assemblies, which come after their parts.
    """

    refused: Mapping[int, str]
    parts: Mapping[int, tuple[int, ...]]
    sequence: tuple[int, ...]


def order_of(jobs: Mapping[int, Job], keys: Collection[int] = ()) -> Order:
    """The order of ``jobs``; ``keys`` has further ones, of jobs that cannot be read."""
    given, unusable = jobs, {key: reason for key, job in jobs.items() if (reason := _why_no_files(job))}
    jobs = {key: job for key, job in given.items() if key not in unusable}
    written: dict[Place, int] = {}
    for key, job in jobs.items():
        written.setdefault(place_of(job.output), key)
    parts = {
        key: tuple(dict.fromkeys(maker for body in _bodies(job) if (maker := written.get(body, key)) != key))
        for key, job in jobs.items()
    }
    refused, graph = _clashes(jobs, written) | unusable, dict.fromkeys(sorted({*given, *keys}), ())
    while True:
        sorter = TopologicalSorter(graph)
        for key in jobs.keys() - refused.keys():
            sorter.add(key, *parts[key])
        try:
            return Order(refused=refused, parts=parts, sequence=tuple(sorter.static_order()))
        except CycleError as error:
            circle = list(dict.fromkeys(error.args[1]))
            names = ", ".join(str(jobs[key].path) for key in sorted(circle))
            refused |= dict.fromkeys(circle, f"each takes a body that another makes, in a circle: {names}; break it")


def read_ahead(jobs: Sequence[Job]) -> None:
    """Read the meshes of several jobs once where a result of one might be an include or a companion of another.

    A file that is not there yet is neither, nor is a body file or a picture of an earlier run.
    """
    jobs = [job for job in jobs if not _why_no_files(job)]
    with own_files():
        results = [path for job in jobs for path in results_of(job).values() if path.exists()]
        drawn = {path for path in results if path.suffix in PICTURES and not path.is_symlink()}
        known = all(path in drawn or holds_format(path, FORMAT) for path in results)
    for job in () if known or len(jobs) < 2 else jobs:
        with suppress(MorembsError):
            if ModelTable.of(job).mesh is not None:
                mesh_of(job)


def _why_no_files(job: Job) -> str:
    """Why a path of the job can be none; "" where all can."""
    try:
        _ = job.output, results_of(job), inputs_of(job)
    except InputError as error:
        return str(error)
    return ""


def _bodies(job: Job) -> set[Place]:
    """The body files that an assembly is made of."""
    return {place_of(job.resolve(table.body)) for table in SubstructureTable.of(job)}


def _clashes(jobs: Mapping[int, Job], bodies: Mapping[Place, int]) -> dict[int, str]:
    """Key of each job that must not be run with the others -> why: its results and a file of another are one file."""
    used: dict[Place, list[tuple[int, str, Path | None]]] = {}
    for key, job in jobs.items():
        parts = _bodies(job) & bodies.keys()
        for name, path in inputs_of(job).items():
            place = place_of(path)
            if place not in parts:
                used.setdefault(place, []).append((key, name, None))
        for name, path in results_of(job).items():
            used.setdefault(place_of(path), []).append((key, name, path))
    reasons: dict[int, str] = {}
    for uses in used.values():
        for key, name, written in uses:
            others = [(other, what) for other, what, _ in uses if other != key]
            if written is not None and others:
                other, what = others[0]
                whose = f"is {what} of {jobs[other].path} too; give each job files of its own"
                reasons.setdefault(key, f"{name}: the file {written.resolve()} {whose}")
    return reasons
