"""Runs a batch: all jobs are checked first, then each runs in a process of its own, as many as memory allows."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from morembs.app.batches.children import Children
from morembs.app.batches.cluster_file import Place, place_of
from morembs.app.batches.coordinator import Coordinator
from morembs.app.batches.manifest import Manifest
from morembs.app.batches.plan import Part, parts_of
from morembs.app.batches.records import Listener, Nobody, Record
from morembs.app.batches.tolerances import TOL
from morembs.app.batches.workers import Worker, Workers
from morembs.base.errors import InputError
from morembs.base.memory import available_bytes
from morembs.storage.attempts import discard
from morembs.storage.contents import keeping_ledger

if TYPE_CHECKING:
    from distributed import Client

MANIFEST = "batch.manifest"


@keeping_ledger()
def batch(
    jobs: Iterable[str | Path],
    *,
    changes: Sequence[str] = (),
    workers: int | None = None,
    cluster: str | Path | None = None,
    client: Client | None = None,
    retries: int = 2,
    manifest: str | Path | None = None,
    fresh: bool = False,
    check_only: bool = False,
    listener: Listener | None = None,
) -> tuple[Record, ...]:
    """Run jobs beside each other, those whose results are there and up to date left out.

    A job that fails does not stop the others. Each runs in a process of its own, which ends with this one.

    Args:
        jobs: job files, and folders with some.
        changes: keys that all jobs get with another value, such as ``"reduce.modes=40"``.
        workers: how many run at once at most; None: one for each processor. Fewer run where their forecasts
            exceed the free memory together.
        cluster: where they run instead of here: ``"local:N"``, which is ``workers=N``, the address of a scheduler of
            dask such as ``"tcp://head:8786"``, or a file that describes workers to ask a queue for (``cluster.toml``).
        client: of dask, whose workers are taken; in place of ``cluster``.
        retries: how often a job is begun again whose process was killed or whose worker is gone; errors are final.
        manifest: the file in which is remembered what was done; None: ``batch.manifest`` in the folder that
            holds all jobs, or the nearest above it within the working directory.
        fresh: run all, whatever is remembered.
        check_only: check the jobs that are due, and run none.

    Returns:
        A record for each job, in the order of the jobs.

    Raises:
        InputError: no job, a manifest that is another file or in use, or workers that cannot be used.
        OutputError: the manifest cannot be written.

    >>> from pathlib import Path
    >>> Path("night").mkdir()
    >>> batch(["night"])
    Traceback (most recent call last):
    ...
    morembs.base.errors.InputError: ...
    """
    place = _place(workers, cluster, client)
    if retries < 0:
        raise InputError(f"--retries {retries} was given; expected a count, 0 for none", keyword="retries")
    parts = parts_of(jobs, changes)
    options = [word for change in changes for word in ("--set", change)]
    if manifest is None and all(part.fault for part in parts):
        # Nothing to remember, and no folder to remember it in.
        idle = Coordinator(parts, options, None, listener or Nobody(), retries)
        idle.due(fresh)
        return idle.records()
    outputs = [path for part in parts if part.job is not None for path in part.outputs]
    with Manifest(Path(manifest) if manifest is not None else _nearest_manifest(parts)) as remembered:
        coordinator = Coordinator(parts, options, remembered, listener or Nobody(), retries)
        discard(outputs)
        due = coordinator.due(fresh)
        if due:
            try:
                with closing(_workers(place, due, listener or Nobody())) as pool:
                    coordinator.run(pool, due, fresh, check_only)
            finally:
                discard(outputs)
        return coordinator.records()


def _place(workers: int | None, cluster: str | Path | None, client: Client | None) -> Place | Client | None:
    """Where the jobs run; None: here, as many at once as there are processors."""
    if workers is not None and workers < 1:
        raise InputError(
            f"--jobs {workers} was given; expected a positive count of jobs to run at once", keyword="jobs"
        )
    if sum(given is not None for given in (workers, cluster, client)) > 1:
        raise InputError(
            "jobs run here (--jobs N, local:N), on a cluster (--cluster), or by a client; choose one",
            kind="conflict",
            keyword="jobs",
        )
    if workers is not None:
        return Place(kind="local", workers=workers)
    return client if cluster is None else place_of(cluster)


def _workers(place: Place | Client | None, due: Sequence[Part], listener: Listener) -> Workers:
    if place is not None and not (isinstance(place, Place) and place.kind == "local"):
        try:
            # Not at the top: most do without dask.
            from morembs.app.batches.cluster import workers_of
        except ImportError as error:
            raise InputError(
                "--cluster needs dask: pip install 'morembs[cluster]'; local:N works without",
                kind="program",
                keyword="cluster",
            ) from error
        return workers_of(
            place, [path.resolve().parent for part in due for path in part.outputs], listener.report_event
        )
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    count = place.workers if isinstance(place, Place) else None
    room = Worker(
        bytes=TOL.memory_share * available_bytes(), cores=TOL.unlimited_cores if count else cores, slots=count or cores
    )
    return Children(room, cores)


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
