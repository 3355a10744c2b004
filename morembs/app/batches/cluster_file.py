"""Where a batch runs: here, on workers of a scheduler of dask, or on workers that a queue starts (``cluster.toml``)."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from morembs.app.jobs.job import parse_memory
from morembs.base.errors import InputError
from morembs.base.key_tables import Table, declare_key, read_table
from morembs.base.limits import number, text

QUEUES = ("slurm", "pbs", "lsf", "sge")


@dataclass(frozen=True, kw_only=True)
class Place(Table):
    """``[cluster]``: where the jobs of a batch run."""

    kind: Literal["slurm", "pbs", "lsf", "sge", "local", "address"]
    workers: Annotated[int, number("how many workers at most, a positive count", ge=1)] = 1
    cores: Annotated[int, number("the cores of a worker, a positive count", ge=1)] = 1
    memory: str = declare_key('the memory of a worker, a text such as "32 GiB"', "")
    walltime: (
        Annotated[str, text('the time that a worker may run, such as "04:00:00"', r"^\d+:[0-5]\d:[0-5]\d$")] | None
    ) = None
    queue: Annotated[str, text("the name of a queue")] | None = None
    prologue: list[str] = declare_key("lines of shell before a worker starts", [])
    directives: list[str] = declare_key('options of the queue such as "--account=fem"', [])
    address: Annotated[str, text('the address of a scheduler such as "tcp://head:8786"', r"^[a-z]+://\S+$")] | None = (
        None
    )
    options: dict[str, Any] = declare_key("further options of the cluster in dask-jobqueue", {})

    def refuse_conflicts(self) -> None:
        if self.kind in QUEUES and not self.memory:
            raise InputError(
                'memory is missing; expected the memory of a worker, a text such as "32 GiB"',
                kind="missing",
                keyword="memory",
            )
        if (self.kind == "address") != (self.address is not None):
            raise InputError(
                'address goes with kind = "address"; expected both keys, or neither', kind="conflict", keyword="address"
            )

    @property
    def bytes(self) -> int:
        """Memory of a worker of a queue."""
        return parse_memory(self.memory, "[cluster]")

    @property
    def seconds(self) -> float:
        """How long a worker lives."""
        if self.walltime is None:
            return float("inf")
        hours, minutes, seconds = map(int, self.walltime.split(":"))
        return 3600.0 * hours + 60.0 * minutes + seconds


def place_of(given: str | Path) -> Place:
    """The place that ``--cluster`` names: ``local:N``, an address, or a file.

    Raises:
        InputError: something else, or a file with faults.
    """
    name, colon, rest = str(given).partition(":")
    if name == "local" and colon:
        if not rest.isdecimal() or int(rest) < 1:
            raise InputError(
                f"--cluster {given} was given; expected local:N with a positive count N", keyword="cluster"
            )
        return Place(kind="local", workers=int(rest))
    if rest.startswith("//"):
        return Place(kind="address", address=str(given))
    path = Path(given)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"--cluster {given} was given, a file that cannot be read ({error.strerror}); expected local:N, "
            "tcp://HOST:PORT, or a file with a table [cluster]",
            kind="file",
            keyword="cluster",
        ) from error
    except ValueError as error:
        raise InputError(
            f"{path} is not valid TOML: {error}; correct that line", kind="file", keyword=path.name
        ) from error
    table = data.get("cluster")
    if not isinstance(table, dict) or len(data) > 1:
        raise InputError(f"{path} has the tables {', '.join(data) or 'none'}; expected one table [cluster]")
    try:
        place = read_table(Place, table, "[cluster]")
    except InputError as error:
        raise error.restate(f"{path}: " + "; ".join(str(error).splitlines())) from error
    if place.kind in QUEUES:
        _ = place.bytes
    return place
