"""The list of sparse solvers, and the choice of one."""

from __future__ import annotations

from pathlib import Path

from morembs.errors import InputError, nearest
from morembs.linalg.mumps import EmbeddedMumps, Mumps
from morembs.linalg.solver import LinearSolver
from morembs.linalg.superlu import SuperLU

AUTO = "auto"
# The best one first: "auto" takes the first that runs.
SOLVERS: dict[str, type[LinearSolver]] = {solver.name: solver for solver in (Mumps, EmbeddedMumps, SuperLU)}


def available_solvers() -> dict[str, str]:
    """Name of every solver, the best first, with why it cannot run here (empty: it runs)."""
    return {name: solver.unavailable() for name, solver in SOLVERS.items()}


def select_solver(
    name: str = AUTO, *, memory: int | None = None, scratch: Path | None = None
) -> LinearSolver:
    """The solver called ``name``, or the best one that runs for "auto".

    Args:
        name: a key of ``SOLVERS`` or "auto".
        memory: budget for factors in bytes, None for no limit.
        scratch: folder for factors that exceed the budget, None for the temporary folder.

    Raises:
        InputError: unknown name, or a solver that cannot run here.
    """
    if name == AUTO:
        name = next(key for key, solver in SOLVERS.items() if not solver.unavailable())
    if name not in SOLVERS:
        raise InputError(f"solver = {name!r} is not known; {nearest(name, [AUTO, *SOLVERS])}")
    reason = SOLVERS[name].unavailable()
    if reason:
        raise InputError(f"solver = {name!r} cannot run here: {reason}, or take solver = {AUTO!r}")
    return SOLVERS[name](memory=memory, scratch=scratch)
