"""The list of sparse solvers, and the choice of one."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from morembs.errors import BudgetError, InputError, SolverError, nearest
from morembs.linalg.amg import Amg
from morembs.linalg.cholmod import Cholmod
from morembs.linalg.mixed import Mixed
from morembs.linalg.mumps import EmbeddedMumps, Mumps
from morembs.linalg.pardiso import Pardiso
from morembs.linalg.solver import Analysis, Floats, Forecast, LinearSolver
from morembs.linalg.superlu import SuperLU
from morembs.linalg.symmetric import Lower
from morembs.linalg.umfpack import Umfpack

log = logging.getLogger(__name__)
AUTO = "auto"
SOLVERS: dict[str, type[LinearSolver]] = {
    solver.name: solver for solver in (Mumps, EmbeddedMumps, Pardiso, Mixed, Cholmod, Umfpack, Amg, SuperLU)
}
# What "auto" takes, the best first: fast in memory, then those that need less of it.
COUNTING = ("mumps", "mumps-embedded", "superlu")
FAST = ("cholmod", "mumps", "mumps-embedded", "superlu")
LEAN = ("mumps", "mumps-embedded", "mumps-mixed", "amg")


def available_solvers() -> dict[str, str]:
    """Name of every solver, the best first, with why it cannot run here (empty: it runs)."""
    return {name: solver.unavailable() for name, solver in SOLVERS.items()}


def select_solver(name: str = AUTO, *, memory: int | None = None, scratch: Path | None = None) -> LinearSolver:
    """The solver called ``name``; "auto" chooses one for every matrix, under its budget.

    Args:
        name: a key of ``SOLVERS`` or "auto".
        memory: budget in bytes, None for no limit.
        scratch: folder for what does not fit, None for the temporary folder.

    Raises:
        InputError: unknown name, or a solver that cannot run here.
    """
    if name == AUTO:
        return Automatic(memory=memory, scratch=scratch)
    if name not in SOLVERS:
        raise InputError(f"solver = {name!r} is not known; {nearest(name, [AUTO, *SOLVERS])}")
    reason = SOLVERS[name].unavailable()
    if reason:
        raise InputError(f"solver = {name!r} cannot run here: {reason}, or take solver = {AUTO!r}")
    return SOLVERS[name](memory=memory, scratch=scratch)


@dataclass(frozen=True, kw_only=True)
class Automatic(LinearSolver):
    """The fastest solver that runs here and keeps the budget."""

    name: ClassVar[str] = AUTO
    near_nullspace: Floats | None = field(default=None, compare=False, repr=False)

    @classmethod
    def unavailable(cls) -> str:
        return ""

    def _analyse(self, A: Lower, structure: str) -> Analysis:
        refused: list[SolverError] = []
        for candidate in self._candidates(structure):
            try:
                analysis = candidate.analyse(A, structure)
            except SolverError as error:
                refused.append(error)
                continue
            analysis.choice = _reason(analysis, refused)
            log.info("%s", analysis.choice)
            return analysis
        needed = [error.needed for error in refused if isinstance(error, BudgetError)]
        if not needed:
            raise refused[-1]
        raise BudgetError(
            f"{(self.memory or 0) / 1e6:.1f} MB are left of the memory budget for a factorisation of {A.n} rows; the "
            f"leanest method needs {min(needed) / 1e6:.0f} MB: raise the budget by "
            f"{(min(needed) - (self.memory or 0)) / 1e6:.0f} MB, or take a coarser mesh",
            needed=min(needed),
        )

    def _inertia(self, A: Lower, what: str) -> int:
        return self._counter().negative_eigenvalues(A, what)

    def _inertia_forecast(self, A: Lower) -> Forecast:
        return self._counter().inertia_forecast(A)

    def _counter(self) -> LinearSolver:
        """MUMPS, which counts without keeping the factor; else what is there."""
        name = next(name for name in COUNTING if not SOLVERS[name].unavailable())
        return SOLVERS[name](memory=self.memory, scratch=self.scratch)

    def _candidates(self, structure: str) -> list[LinearSolver]:
        """Configurations in the order in which they are tried."""
        found: list[LinearSolver] = []
        for name in dict.fromkeys((*FAST, *LEAN) if self.memory is not None else FAST):
            solver = SOLVERS[name]
            if structure in solver.structures and not _lacks(solver, structure):
                found.append(solver(memory=self.memory, scratch=self.scratch).knowing(self.near_nullspace))
        return found


def _lacks(solver: type[LinearSolver], structure: str) -> str:
    """Why ``solver`` cannot factorise such a matrix here; empty: it can."""
    if issubclass(solver, Mumps | EmbeddedMumps):
        return solver.lacks("double", structure)
    return solver.unavailable()


def _reason(analysis: Analysis, refused: list[SolverError]) -> str:
    """One line: what was chosen and why."""
    plan = analysis.forecast
    place = f"on disk ({plan.disk / 1e9:.2f} GB)" if plan.out_of_core else "in memory"
    why = "the fastest that runs here" if not refused else f"as {refused[0]}"
    return (
        f"{plan.backend}, {plan.precision} precision, {place}: {plan.factor_entries:.3g} factor entries, "
        f"{plan.flops:.2g} operations, {plan.memory / 1e9:.2f} GB at the peak; {why}"
    )
