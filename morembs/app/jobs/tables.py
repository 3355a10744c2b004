"""A job, and the tables of its file: each is a class in the file of the stage that reads it.

Docs, messages and the JSON schema come from the hints of their keys. Here are the tables that a job has in any case.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Protocol, Self

from morembs.base.errors import InputError
from morembs.base.key_tables import Table, declare_key
from morembs.base.limits import Finite, length, number, text
from morembs.base.units import Units
from morembs.importers.options import ImportOptions, option
from morembs.reducers.base import Reducer
from morembs.storage.attempts import attempt_at

Three = Annotated[list[Finite], length("three numbers", 3)]
Six = Annotated[list[Finite], length("six numbers", 6)]
CurvePoints = Annotated[int, number("an integer from 2 to 100000", ge=2, le=100_000)]


class HasTables(Protocol):
    """A job, or all its tables."""

    def table(self, name: str) -> Any:
        """What the job file has under a name."""


class JobTable(Table):
    """A table of a job file. Its name there is that of its class: ``StateSpaceTable`` is ``[state_space]``."""

    @classmethod
    def key(cls) -> str:
        """Its name in the job file."""
        return re.sub(r"\B(?=[A-Z])", "_", cls.__name__.removesuffix("Table")).lower()

    @classmethod
    def entry(cls) -> tuple[Any, Any]:
        """Its hint among all tables, and its value where it is left out."""
        raise NotImplementedError


class SingleTable(JobTable):
    """A table that every job has; where it is left out all its keys have their defaults."""

    @classmethod
    def of(cls, job: HasTables) -> Self:
        """That of a job."""
        table: Self = job.table(cls.key())
        return table

    @classmethod
    def entry(cls) -> tuple[Any, Any]:
        needed = any(key.default is MISSING and key.default_factory is MISSING for key in fields(cls))
        return cls, field() if needed else field(default_factory=cls)


class OptionalTable(JobTable):
    """A table that asks for something by being there."""

    @classmethod
    def of(cls, job: HasTables) -> Self | None:
        """That of a job, None where it has none."""
        table: Self | None = job.table(cls.key())
        return table

    @classmethod
    def require(cls, job: HasTables) -> Self:
        """That of a job which has one.

        Raises:
            InputError: it has none.
        """
        table = cls.of(job)
        if table is None:
            raise InputError(f"the job has no table [{cls.key()}]; add one")
        return table

    @classmethod
    def entry(cls) -> tuple[Any, Any]:
        return cls | None, field(default=None)


class RepeatedTable(JobTable):
    """A table of which a job has several, ``least`` or more; ``expected`` is what messages ask for."""

    least: ClassVar[int] = 0
    expected: ClassVar[str] = ""

    @classmethod
    def of(cls, job: HasTables) -> list[Self]:
        """All of a job."""
        tables: list[Self] = job.table(cls.key())
        return tables

    @classmethod
    def entry(cls) -> tuple[Any, Any]:
        if cls.least:
            return Annotated[list[cls], length(cls.expected, cls.least, sys.maxsize)], field()  # type: ignore[valid-type]
        return list[cls], declare_key(cls.expected, []) if cls.expected else field(default_factory=list)  # type: ignore[valid-type]


class JobTables(Table):
    """All tables of a job file."""

    def table(self, name: str) -> Any:
        """The table, or the tables, of a name."""
        return getattr(self, name)


# Keys of [model] that go with mesh.
OF_MESHES = {"units", "mass_integration", "dialect", "allow_includes_outside"}


@dataclass(frozen=True, kw_only=True)
class ModelTable(SingleTable, ImportOptions):
    """``[model]``: a mesh, or files of a whole model with the options of their import; units of all numbers in the job.

    A job with tables ``[[substructure]]`` has neither; ``units`` are those of its places and springs.
    """

    mesh: Annotated[str, text('the path of a mesh file such as "conrod.msh"')] | None = option(
        "the file of a mesh, in place of file"
    )
    unsymmetric: Literal["refuse", "split", "symmetrise"] = option(
        "the skew parts of K and D: refused, split off as N and G, or dropped", "refuse"
    )

    @property
    def brings_matrices(self) -> bool:
        """True if files of a whole model are given, not a mesh alone."""
        return bool(self.files) and self.mesh is None

    def refuse_conflicts(self) -> None:
        if self.mesh is not None and (self.file is not None or self.matrices):
            raise InputError("mesh and file were both given; choose one", kind="conflict")
        if self.mesh is None:
            return
        if self.dialect != "auto" and not self.mesh.lower().endswith(".inp"):
            raise InputError(
                f'dialect = "{self.dialect}" was given without a deck .inp; leave it out',
                kind="conflict",
                keyword="dialect",
            )
        others = {entry.name for entry in fields(ImportOptions)} - OF_MESHES
        for name in sorted(others & self.given):
            raise InputError(
                f"{name} was given beside mesh, of which only nodes and elements are read; give file = ...",
                kind="conflict",
                keyword=name,
            )


@dataclass(frozen=True, kw_only=True)
class OutputTable(SingleTable):
    """``[output]``: the body file, and a picture if one is wanted."""

    path: Annotated[str, text('the path of the body file such as "conrod.h5", not of a folder', r"[^/\\]$")]
    nodes: Literal["all", "skin", "interfaces"] = "all"
    picture: Annotated[str, text("the path of a .png, .pdf or .svg file", r"\.(png|pdf|svg)$")] | None = None


@dataclass(frozen=True, kw_only=True)
class ModesTable(SingleTable):
    """``[modes]``: what ``morembs modes`` computes of the full model."""

    kind: Literal["real", "complex"] = "real"
    count: Annotated[int, number("a count of modes", ge=1, le=1000)] = 20
    held: list[str] = declare_key("names of the interfaces at rest, for complex modes", [])


def resolve_path(file: Path, path: str) -> Path:
    """A path that stands in ``file``, seen from the working directory.

    Raises:
        InputError: no file can have this path.
    """
    try:
        whole = file.parent / Path(path).expanduser()
        whole.exists()
    except (RuntimeError, ValueError, OSError) as error:
        raise InputError(f"the path {path[:100]!r} cannot be used ({error}); give another") from error
    return whole


@dataclass(frozen=True, kw_only=True, eq=False)
class Job:
    """A checked job: its tables, its text, and the reducers by name. Paths are relative to its folder.

    ``changes`` are the keys that were given another value, KEY=VALUE; the text is that of the file. ``attempt`` is the
    token of an attempt at the results, which then lie beside the files that they are for.
    """

    path: Path
    text: str
    tables: JobTables
    reducers: Mapping[str, Reducer]
    memory: int | None = None
    changes: tuple[str, ...] = ()
    attempt: str = ""

    def table(self, name: str) -> Any:
        """The table, or the tables, of a name."""
        return self.tables.table(name)

    def resolve(self, path: str) -> Path:
        """A path of the job file, seen from the working directory.

        Raises:
            InputError: no file can have this path.
        """
        return resolve_path(self.path, path)

    def result(self, path: str) -> Path:
        """The place of a file that the job writes, which the attempt writes beside it."""
        whole = self.resolve(path)
        return attempt_at(whole, self.attempt) if self.attempt else whole

    @property
    def units(self) -> Units:
        """The declared units."""
        return ModelTable.of(self).parsed_units

    @property
    def output(self) -> Path:
        """The body file."""
        return self.result(OutputTable.of(self).path)

    @property
    def picture(self) -> Path | None:
        """The picture, if one is wanted."""
        given = OutputTable.of(self).picture
        return None if given is None else self.result(given)
