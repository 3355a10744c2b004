"""Where a batch runs: here, on workers of a scheduler of dask, or on workers that a queue starts (``cluster.toml``)."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from morembs.app.jobs.job import parse_memory
from morembs.app.jobs.schema import Table
from morembs.base.errors import InputError
from morembs.base.options import in_toml

QUEUES = ("slurm", "pbs", "lsf", "sge")


class Place(Table):
    """``[cluster]``: where the jobs of a batch run."""

    kind: Literal["slurm", "pbs", "lsf", "sge", "local", "address"] = Field(
        description='"slurm", "pbs", "lsf", "sge", "local" or "address"'
    )
    workers: int = Field(default=1, ge=1, description="how many workers at most, a positive count")
    cores: int = Field(default=1, ge=1, description="the cores of a worker, a positive count")
    memory: str = Field(default="", description='the memory of a worker, a text such as "32 GiB"')
    walltime: str | None = Field(
        default=None, pattern=r"^\d+:[0-5]\d:[0-5]\d$", description='the time that a worker may run, such as "04:00:00"'
    )
    queue: str | None = Field(default=None, min_length=1, description="the name of a queue")
    prologue: list[str] = Field(default_factory=list, description="lines of shell before a worker starts")
    directives: list[str] = Field(default_factory=list, description='options of the queue such as "--account=fem"')
    address: str | None = Field(
        default=None, pattern=r"^[a-z]+://\S+$", description='the address of a scheduler such as "tcp://head:8786"'
    )
    options: dict[str, Any] = Field(default_factory=dict, description="further options of the cluster in dask-jobqueue")

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.kind in QUEUES and not self.memory:
            raise ValueError('memory is missing; expected the memory of a worker, a text such as "32 GiB"')
        if (self.kind == "address") != (self.address is not None):
            raise ValueError('an address goes with kind = "address", and is needed there')
        return self

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
            raise InputError(f"--cluster {given} was given; expected local:N with a positive count N")
        return Place(kind="local", workers=int(rest))
    if rest.startswith("//"):
        return Place(kind="address", address=str(given))
    path = Path(given)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"--cluster {given} was given, a file that cannot be read ({error.strerror}); expected local:N, "
            "tcp://HOST:PORT, or a file with a table [cluster]"
        ) from error
    except ValueError as error:
        raise InputError(f"{path} is not valid TOML: {error}; mend that line") from error
    table = data.get("cluster")
    if not isinstance(table, dict) or len(data) > 1:
        raise InputError(f"{path} has the tables {', '.join(data) or 'none'}; expected one table [cluster]")
    try:
        place = Place.model_validate(table)
    except ValidationError as error:
        raise InputError(f"{path}: " + "; ".join(_fault(fault, table) for fault in error.errors())) from error
    if place.kind in QUEUES:
        _ = place.bytes
    return place


def _fault(fault: Any, table: dict[str, Any]) -> str:
    key = str(fault["loc"][0]) if fault["loc"] else ""
    if fault["type"] == "extra_forbidden":
        return f"[cluster]: unknown key {key!r}; known are {', '.join(Place.model_fields)}"
    if fault["type"] == "value_error":
        return f"[cluster]: {fault['msg'].removeprefix('Value error, ')}"
    expected = Place.model_fields[key].description
    if fault["type"] == "missing":
        return f"[cluster]: {key} is missing; expected {expected}"
    return f"[cluster]: {key} = {in_toml(table.get(key))} was given; expected {expected}"
