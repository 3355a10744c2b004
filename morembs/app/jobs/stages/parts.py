"""``[[substructure]]`` and ``[[couple]]``: bodies as one model."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from morembs.app.jobs.job import Job
from morembs.app.jobs.stages.model import ReadModel
from morembs.fem import FEModel


class Parts(ReadModel):
    """The bodies of an assembly as one model."""

    tables = ("model", "substructure", "couple")

    def is_asked(self, job: Job) -> bool:
        return bool(job.tables.substructure)

    def reads(self, job: Job) -> Mapping[str, Path]:
        tables = job.tables.substructure
        files = enumerate(job.resolve(name) for name in dict.fromkeys(table.body for table in tables))
        bodies = {"a body" if not number else f"a body {number + 1}": file for number, file in files}
        return bodies | {f"the job of part {table.name}": job.resolve(table.job) for table in tables if table.job}

    def matrices(self, job: Job) -> FEModel:
        # Not at the top: most jobs have a mesh.
        from morembs.app.jobs.assembly import assembly_of

        return assembly_of(job)
