"""The tables of an assembly, and its unreduced parts, coupled: ``[[substructure]] job``."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.stage import JobStage, Result, Work
from morembs.app.jobs.tables import Job, RepeatedTable, Six, Three
from morembs.base.errors import InputError
from morembs.base.key_tables import Table, declare_key
from morembs.base.limits import Finite, length, text

if TYPE_CHECKING:
    from morembs.dynamics.assembly import Unreduced

PARTS: Result[Unreduced] = Result("parts")


@dataclass(frozen=True, kw_only=True)
class RotationTable(Table):
    """A turn about an axis."""

    axis: Three = declare_key("a direction [x, y, z]")
    degrees: Finite


@dataclass(frozen=True, kw_only=True)
class SubstructureTable(RepeatedTable):
    """``[[substructure]]``: a body that is a part of an assembly, and its place."""

    name: Annotated[str, text("a name without colons and slashes", r"^[^/:\s.\x00-\x1f][^/:\x00-\x1f]*$", longest=100)]
    body: Annotated[str, text('the path of a body file such as "link.h5"')]
    reduction: str | None = declare_key("the body of the file, where it has several", None)
    job: Annotated[str, text('the path of the job file that made the body such as "link.toml"')] | None = None
    at: dict[str, Finite] = declare_key("values of its parameters in SI units such as { E = 2.0e11 }", {})
    position: Three = declare_key("[x, y, z] of the origin of its model", [0.0, 0.0, 0.0])
    rotation: RotationTable | None = declare_key("a table { axis = [x, y, z], degrees = ... }", None)

    def refuse_conflicts(self) -> None:
        if self.job is not None and self.at:
            raise InputError(
                "job was given beside at; a certificate against the unreduced part takes nominal values",
                kind="conflict",
                keyword="job",
            )


@dataclass(frozen=True, kw_only=True)
class CoupleTable(RepeatedTable):
    """``[[couple]]``: interfaces of two substructures that move as one, or that springs connect."""

    between: Annotated[list[str], length('two interfaces such as ["upper:TIP", "lower:ROOT"]', 2)]
    components: Annotated[list[int], length("one or more", 1, sys.maxsize)] = declare_key(
        "some of [0, 1, 2, 3, 4, 5]", [0, 1, 2, 3, 4, 5]
    )
    stiffness: Six | None = declare_key("six numbers, zero or more: springs, instead of one motion", None)
    damping: Six | None = declare_key("six numbers, zero or more, beside stiffness", None)


class UnreducedParts(JobStage):
    """The unreduced parts, coupled, where the job names the models of its bodies."""

    tables = (SubstructureTable,)
    needs = (PROBLEM,)
    gives = (PARTS,)
    step = "couple parts"

    def is_asked(self, job: Job) -> bool:
        return any(table.job for table in SubstructureTable.of(job))

    def run(self, work: Work) -> None:
        # Not at the top: most jobs have a mesh.
        from morembs.dynamics.assembly import Unreduced

        work.give(PARTS, Unreduced(work[PROBLEM]))
