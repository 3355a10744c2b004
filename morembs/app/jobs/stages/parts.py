"""``[[substructure]]`` and ``[[couple]]``: bodies as one model."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from morembs.app.jobs.stages.model import ReadModel
from morembs.app.jobs.stages.unreduced import CoupleTable, SubstructureTable
from morembs.app.jobs.tables import Job, JobTables, ModelTable
from morembs.base.errors import InputError
from morembs.fem import FEModel


class Parts(ReadModel):
    """The bodies of an assembly as one model."""

    tables = (ModelTable, SubstructureTable, CoupleTable)

    def refuse_conflicts(self, tables: JobTables) -> None:
        model, parts = ModelTable.of(tables), SubstructureTable.of(tables)
        given = model.mesh or model.files
        if not given and not parts and "member" not in tables.given:
            raise InputError(
                '[model]: mesh is missing; expected the path of a mesh file such as "conrod.msh" (or file = a model '
                "deck or matrices, or tables [[substructure]], or [member])",
                kind="missing",
                keyword="model",
            )
        if given and (parts or CoupleTable.of(tables)):
            raise InputError(
                "[[substructure]] or [[couple]] was given beside a mesh or a model file; choose one",
                kind="conflict",
                keyword="substructure",
            )

    def is_asked(self, job: Job) -> bool:
        return bool(SubstructureTable.of(job))

    def reads(self, job: Job) -> Mapping[str, Path]:
        tables = SubstructureTable.of(job)
        files = enumerate(job.resolve(name) for name in dict.fromkeys(table.body for table in tables))
        bodies = {"a body" if not number else f"a body {number + 1}": file for number, file in files}
        return bodies | {f"the job of part {table.name}": job.resolve(table.job) for table in tables if table.job}

    def matrices(self, job: Job) -> FEModel:
        # Not at the top: most jobs have a mesh.
        from morembs.app.jobs.assembly import assembly_of

        return assembly_of(job)
