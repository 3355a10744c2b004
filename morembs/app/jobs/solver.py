"""``[solver]``: the solver of a job, and the memory for its arrays."""

from __future__ import annotations

from dataclasses import fields, replace

from morembs.app.jobs.job import Job
from morembs.base.budget import Budget
from morembs.base.errors import InputError
from morembs.linalg.sparse.mumps_ranks import RankedMumps
from morembs.linalg.sparse.select import SOLVERS, select_solver
from morembs.linalg.sparse.solver import LinearSolver


def solver_of(job: Job) -> LinearSolver:
    """The solver with its budget and scratch folder."""
    given = job.tables.solver
    scratch = None if given.scratch is None else job.resolve(given.scratch)
    if scratch is not None and not scratch.is_dir():
        raise InputError(f"[solver]: scratch = {given.scratch!r} is not a folder; make it, or leave the key out")
    name = given.name if given.ranks is None else RankedMumps.name
    solver = select_solver(name, memory=job.memory, scratch=scratch)
    if given.ranks is not None:
        solver = replace(solver, ranks=given.ranks)  # type: ignore[call-arg]
    if not given.out_of_core:
        return solver
    able = {name: kind for name, kind in SOLVERS.items() if any(field.name == "out_of_core" for field in fields(kind))}
    if name not in able:
        raise InputError(f"[solver]: out_of_core = true needs a solver that can; name one: {', '.join(able)}")
    return replace(solver, out_of_core=True)  # type: ignore[call-arg]


def budget_of(job: Job, solver: LinearSolver) -> Budget:
    """The memory for the arrays of the job; none stays there where all is to be out of core."""
    return Budget(solver.memory, solver.scratch, in_memory=0 if job.tables.solver.out_of_core else None)
