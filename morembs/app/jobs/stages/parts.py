"""``[[substructure]]`` and ``[[couple]]``: bodies as one model."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from morembs.app.jobs.stages.model import ReadModel
from morembs.app.jobs.tables import Job, JobTables, ModelTable, RepeatedTable, Six, Three
from morembs.base.errors import InputError
from morembs.base.key_tables import Table, described
from morembs.base.limits import Finite, length, text
from morembs.fem import FEModel


@dataclass(frozen=True, kw_only=True)
class RotationTable(Table):
    """A turn about an axis."""

    axis: Three = described("a direction [x, y, z]")
    degrees: Finite


@dataclass(frozen=True, kw_only=True)
class SubstructureTable(RepeatedTable):
    """``[[substructure]]``: a body that is a part of an assembly, and its place."""

    name: Annotated[str, text("a name without colons and slashes", r"^[^/:\s.\x00-\x1f][^/:\x00-\x1f]*$", longest=100)]
    body: Annotated[str, text('the path of a body file such as "link.h5"')]
    reduction: str | None = described("the body of the file, where it has several", None)
    job: Annotated[str, text('the path of the job file that made the body such as "link.toml"')] | None = None
    at: dict[str, Finite] = described("values of its parameters in SI units such as { E = 2.0e11 }", {})
    position: Three = described("[x, y, z] of the origin of its model", [0.0, 0.0, 0.0])
    rotation: RotationTable | None = described("a table { axis = [x, y, z], degrees = ... }", None)

    def refuse_conflicts(self) -> None:
        if self.job is not None and self.at:
            raise InputError("job was given beside at; a certificate against the unreduced part takes nominal values")


@dataclass(frozen=True, kw_only=True)
class CoupleTable(RepeatedTable):
    """``[[couple]]``: interfaces of two substructures that move as one, or that springs connect."""

    between: Annotated[list[str], length('two interfaces such as ["upper:TIP", "lower:ROOT"]', 2)]
    components: Annotated[list[int], length("one or more", 1, sys.maxsize)] = described(
        "some of [0, 1, 2, 3, 4, 5]", [0, 1, 2, 3, 4, 5]
    )
    stiffness: Six | None = described("six numbers, zero or more: springs, instead of one motion", None)
    damping: Six | None = described("six numbers, zero or more, beside stiffness", None)


class Parts(ReadModel):
    """The bodies of an assembly as one model."""

    tables = (ModelTable, SubstructureTable, CoupleTable)

    def refuse_conflicts(self, tables: JobTables) -> None:
        model, parts = ModelTable.of(tables), SubstructureTable.of(tables)
        given = model.mesh or model.file
        if not given and not parts:
            raise InputError(
                '[model]: mesh is missing; expected the path of a mesh file such as "conrod.msh" (or file = a model '
                "file, or tables [[substructure]])"
            )
        if given and (parts or CoupleTable.of(tables)):
            raise InputError("[[substructure]] or [[couple]] was given beside a mesh or a model file; choose one")

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
