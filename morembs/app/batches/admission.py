"""Which workers of other machines can be used: by the versions and folders that they have, before the first job runs.

A folder is shared where each side reads what the other writes there.
"""

from __future__ import annotations

import os
import platform
import secrets
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from morembs.app.batches.tolerances import TOL
from morembs.app.batches.workers import Worker
from morembs.base.closing import Closing
from morembs.base.scratch import PrivateFolder
from morembs.storage.safefile import PREFIX
from morembs.version import VERSION


def admit_workers(
    client: Any, fresh: Mapping[str, Mapping[str, Any]], probes: Probes, seconds: float
) -> tuple[dict[str, Worker], dict[str, str]]:
    """Resources of new workers that can be used, and faults of the others; by their addresses.

    Args:
        client: of dask.
        fresh: what the scheduler knows of each.
        seconds: how long they live.
    """
    versions = client.get_versions(packages=["morembs"])["workers"]
    faults = {name: _other_version(info["name"], versions.get(name)) for name, info in fresh.items()}
    able = [name for name in fresh if not faults[name]]
    answers = client.run(_room, probes.texts, workers=able, on_error="return") if able else {}
    faults |= {name: probes.fault(fresh[name]["name"], room) for name, room in answers.items()}
    sharing = Counter(room["host"] for name, room in answers.items() if not faults[name])
    rooms = {}
    for name in (name for name in answers if not faults[name]):
        known, room, slots = fresh[name]["resources"], answers[name], fresh[name]["nthreads"]
        size = TOL.memory_share * (room["limit"] or room["memory"] / sharing[room["host"]])
        size, cores = 1e6 * known.get("MB", size / 1e6), int(known.get("cores", slots))
        if not {"MB", "cores"} <= known.keys():
            client.run(_declare, size / 1e6, cores, workers=[name])
        rooms[name] = Worker(bytes=size, cores=cores, slots=slots, seconds=seconds)
    return rooms, {name: fault for name, fault in faults.items() if fault}


class Probes(Closing):
    """Files by which folders prove to be shared: one for each disk, with a text that a worker reads and answers."""

    def __init__(self, folders: Iterable[Path]) -> None:
        disks: dict[int, Path] = {}
        for folder in folders:
            with suppress(OSError):
                disks.setdefault(os.stat(folder).st_dev, folder)
        self.texts: dict[str, str] = {}
        self._folders: list[PrivateFolder] = []
        for folder in disks.values():
            with suppress(OSError):  # a job says so that cannot write there
                self._folders.append(PrivateFolder(folder, PREFIX))
                path, text = self._folders[-1].path / "probe", secrets.token_hex(16)
                path.write_text(text)
                self.texts[str(path)] = text

    def fault(self, worker: str, room: Mapping[str, Any] | BaseException) -> str:
        """What is wrong with the answers of a worker."""
        if isinstance(room, BaseException):
            return f"worker {worker} cannot be used ({room}); install morembs {VERSION} there"
        if room["version"] != VERSION:
            return f"worker {worker} has morembs {room['version']}, this is {VERSION}; install the same"
        for path, answer in room["answers"].items():
            folder = Path(path).parent.parent
            if not answer["file"]:
                return f"worker {worker} cannot write {folder} ({answer['fault']}); give a shared folder"
            if not _is_visible(Path(answer["file"]), self.texts[path]):
                return f"what worker {worker} writes in {folder} is not there for this machine; give a shared folder"
        return ""

    def close(self) -> None:
        """Remove them."""
        for folder in self._folders:
            folder.close()


def _is_visible(path: Path, text: str) -> bool:
    """True if a file with this text is there soon."""
    end = time.monotonic() + TOL.file_seconds
    while True:
        with suppress(OSError):
            os.listdir(path.parent)
            if path.read_text() == text:
                return True
        if time.monotonic() > end:
            return False
        time.sleep(TOL.file_look_seconds)


def answer(path: Path, text: str) -> dict[str, str]:
    """On the other machine: the ``file`` with the same text beside a probe, or the ``fault`` that keeps it away."""
    if not _is_visible(path, text):
        return {"file": "", "fault": "a file made here is not there"}
    written = path.with_name(f"{path.name}-{secrets.token_hex(4)}")
    try:
        written.write_text(text)
    except OSError as error:
        return {"file": "", "fault": error.strerror or str(error)}
    return {"file": str(written), "fault": ""}


def _other_version(worker: str, there: Any) -> str:
    """Difference of versions between a worker (``there`` is its own account) and this machine, "" without one."""
    if not isinstance(there, dict):
        return f"worker {worker} does not say what is installed there; install morembs {VERSION}"
    version, python = there["packages"].get("morembs"), str(there["host"]["python"])
    if version != VERSION:
        has = "no morembs" if version is None else f"morembs {version}"
        return f"worker {worker} has {has}, this is {VERSION}; install the same"
    here = platform.python_version_tuple()[:2]
    if tuple(python.split(".")[:2]) != here:
        return f"worker {worker} has Python {python}, this is {platform.python_version()}; install the same"
    return ""


# What runs on workers.


def _room(probes: Mapping[str, str], dask_worker: Any) -> dict[str, Any]:
    """What a worker has, and its answers to the probes."""
    import psutil

    answers = {path: answer(Path(path), text) for path, text in probes.items()}
    return {
        "version": VERSION,
        "host": platform.node(),
        "memory": psutil.virtual_memory().total,
        "answers": answers,
        "limit": dask_worker.memory_manager.memory_limit,
    }


async def _declare(size: float, cores: int, dask_worker: Any) -> None:
    """Give a worker the resources that it was started without."""
    await dask_worker.set_resources(MB=size, cores=cores)
