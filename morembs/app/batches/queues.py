"""Workers that a queue of a cluster starts. The only file that imports dask-jobqueue."""

from __future__ import annotations

from typing import Any

from morembs.app.batches.cluster_file import Place
from morembs.app.batches.tolerances import TOL
from morembs.app.batches.workers import Worker
from morembs.base.errors import InputError

_QUEUES = {"slurm": "SLURMCluster", "pbs": "PBSCluster", "lsf": "LSFCluster", "sge": "SGECluster"}


def queue_of(place: Place) -> Any:
    """A cluster of dask-jobqueue that has no workers yet.

    Raises:
        InputError: it is not installed, or does not take the options.
    """
    try:
        # Not at the top: those who have a scheduler do without.
        import dask_jobqueue
    except ImportError as error:
        raise InputError(
            "--cluster needs dask-jobqueue: pip install 'morembs[cluster]'", kind="program", keyword="cluster"
        ) from error
    room = room_of(place)
    walltime = place.walltime
    if walltime is not None and place.kind == "lsf":
        walltime = walltime.rpartition(":")[0]
    given = {
        "cores": place.cores,
        "processes": 1,
        "memory": f"{place.bytes}B",
        "walltime": walltime,
        "queue": place.queue,
        "job_script_prologue": place.prologue,
        "job_extra_directives": place.directives,
        # Behind its own limit of memory, which would not see the processes of the jobs.
        "worker_extra_args": ["--memory-limit", "0", "--resources", f"MB={int(room.bytes / 1e6)},cores={place.cores}"],
        **place.options,
        "scheduler_options": {
            "dashboard": False,
            "dashboard_address": ":0",
            **place.options.get("scheduler_options", {}),
        },
    }
    try:
        return getattr(dask_jobqueue, _QUEUES[place.kind])(**given)
    except (TypeError, ValueError, OSError, RuntimeError) as error:
        raise InputError(f"[cluster] is not taken by dask-jobqueue: {error}", keyword="cluster") from error


def room_of(place: Place) -> Worker:
    """What a worker of a queue has."""
    return Worker(bytes=TOL.memory_share * place.bytes, cores=place.cores, slots=place.cores, seconds=place.seconds)
