"""``[solver]``: the solver of a job, and the memory for its arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Annotated

from morembs.app.jobs.tables import Job, SingleTable
from morembs.base.budget import Budget
from morembs.base.errors import InputError
from morembs.base.key_tables import declare_key
from morembs.base.limits import number, text
from morembs.linalg.sparse.mumps_ranks import RankedMumps
from morembs.linalg.sparse.select import SOLVERS, select_solver
from morembs.linalg.sparse.solver import LinearSolver


@dataclass(frozen=True, kw_only=True)
class SolverTable(SingleTable):
    """``[solver]``: the sparse solver and its limits."""

    name: str = declare_key('"auto" or a name that "morembs solvers" lists', "auto")
    memory: str | None = declare_key('a text such as "4 GiB" or "500 MB"', None)
    threads: Annotated[int, number("a count of threads from 1 to 4096", ge=1, le=4096)] | None = None
    scratch: Annotated[str, text("the path of a folder for temporary files")] | None = None
    out_of_core: bool = declare_key("true to keep the factor and all arrays on disk, or false", False)
    ranks: Annotated[int, number("a count of MPI processes from 1 to 65536", ge=1, le=65536)] | None = None
    workers: Annotated[int, number("a count of processes from 1 to 1024", ge=1, le=1024)] = 1

    def refuse_conflicts(self) -> None:
        if self.ranks is not None and self.name not in ("auto", "mumps-ranks"):
            raise InputError(
                f'ranks was given beside name = "{self.name}"; only "mumps-ranks" takes ranks',
                kind="conflict",
                keyword="ranks",
            )
        if self.ranks is not None and self.workers > 1:
            raise InputError("ranks and workers were both given; choose one", kind="conflict", keyword="ranks")


def solver_of(job: Job) -> LinearSolver:
    """The solver with its budget and scratch folder."""
    given = SolverTable.of(job)
    scratch = None if given.scratch is None else job.resolve(given.scratch)
    if scratch is not None and not scratch.is_dir():
        raise InputError(
            f"[solver]: scratch = {given.scratch!r} is not a folder; make it, or leave the key out",
            kind="file",
            keyword="scratch",
        )
    name = given.name if given.ranks is None else RankedMumps.name
    solver = select_solver(name, memory=job.memory, scratch=scratch)
    if given.ranks is not None:
        solver = replace(solver, ranks=given.ranks)  # type: ignore[call-arg]
    if not given.out_of_core:
        return solver
    able = {name: kind for name, kind in SOLVERS.items() if any(field.name == "out_of_core" for field in fields(kind))}
    if name not in able:
        raise InputError(
            f"[solver]: out_of_core = true needs a solver that can; name one: {', '.join(able)}",
            kind="missing",
            keyword="solver",
        )
    return replace(solver, out_of_core=True)  # type: ignore[call-arg]


def budget_of(job: Job, solver: LinearSolver) -> Budget:
    """The memory for the arrays of the job; none stays there where all is to be out of core."""
    return Budget(solver.memory, solver.scratch, in_memory=0 if SolverTable.of(job).out_of_core else None)
