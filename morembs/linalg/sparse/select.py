"""The list of sparse solvers, and the choice of one."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

from morembs.base.errors import BudgetError, InputError, SolverError, enough_megabytes
from morembs.base.plugins import Registry, subclass_fault
from morembs.base.types import Floats
from morembs.linalg.sparse.amg import Amg
from morembs.linalg.sparse.cholmod import Cholmod
from morembs.linalg.sparse.mixed import Mixed
from morembs.linalg.sparse.mumps import EmbeddedMumps, Mumps, MumpsSolver
from morembs.linalg.sparse.mumps_ranks import RankedMumps
from morembs.linalg.sparse.pardiso import Pardiso
from morembs.linalg.sparse.rslab import Rslab
from morembs.linalg.sparse.solver import STRUCTURES, Analysis, Forecast, LinearSolver
from morembs.linalg.sparse.superlu import SuperLU
from morembs.linalg.sparse.symmetric import Lower
from morembs.linalg.sparse.tolerances import TOL
from morembs.linalg.sparse.umfpack import Umfpack

log = logging.getLogger(__name__)
AUTO = "auto"
# One name for each solver.
_OWN: tuple[type[LinearSolver], ...] = (
    Mumps,
    EmbeddedMumps,
    Pardiso,
    Mixed,
    Cholmod,
    Umfpack,
    Rslab,
    Amg,
    RankedMumps,
    SuperLU,
)
SOLVERS: Registry[type[LinearSolver]] = Registry(
    "morembs.solvers", {solver_class.name: solver_class for solver_class in _OWN}, subclass_fault(LinearSolver, "name")
)
# What "auto" takes, the best first: with room in memory, with less of it; where MUMPS comes from; who counts.
FAST = ("cholmod", "mumps", "mumps-embedded", "superlu")
LEAN = ("mumps", "mumps-embedded", "mumps-mixed", "amg", "superlu")
DIRECT = ("mumps", "mumps-embedded")
COUNTING = (*DIRECT, "superlu")


def available_solvers() -> dict[str, str]:
    """Name of every solver, the best first, with why it cannot run here (empty: it runs).

    >>> available_solvers()["superlu"]                               # empty: nothing is missing
    ''
    """
    return {name: solver.unavailable() for name, solver in SOLVERS.items()}


def select_solver(name: str = AUTO, *, memory: int | None = None, scratch: Path | None = None) -> LinearSolver:
    """The solver called ``name``; "auto" chooses one for every matrix, under its budget.

    Args:
        name: a key of ``SOLVERS`` or "auto".
        memory: budget in bytes, None for no limit.
        scratch: folder for what does not fit, None for the temporary folder.

    Raises:
        InputError: unknown name, or a solver that cannot run here.

    >>> select_solver("superlu").name
    'superlu'
    """
    if name == AUTO:
        return AutoSolver(memory=memory, scratch=scratch)
    if name not in SOLVERS:
        raise InputError(
            f"solver = {name!r} is not known; {SOLVERS.advice(name, AUTO)}", kind="unknown", keyword="solver"
        )
    reason = SOLVERS[name].unavailable()
    if reason:
        raise InputError(
            f"solver = {name!r} cannot run here: {reason}, or take solver = {AUTO!r}", kind="program", keyword="solver"
        )
    return SOLVERS[name](memory=memory, scratch=scratch)


@dataclass(frozen=True, kw_only=True)
class AutoSolver(LinearSolver):
    """The fastest solver that runs here and keeps the budget.

    With a budget, the analysis of MUMPS tells first where the factor has room: in memory, with a Sturm count
    and blocks of columns as well; on disk; on disk in single precision; nowhere, which leaves multigrid.
    """

    name: ClassVar[str] = AUTO
    structures: ClassVar[tuple[str, ...]] = STRUCTURES
    near_nullspace: Floats | None = field(default=None, compare=False, repr=False)

    @classmethod
    def unavailable(cls) -> str:
        return ""

    def _analyse(self, A: Lower, structure: str) -> Analysis:
        refused: list[SolverError] = []
        for candidate in self._candidates(A, structure):
            try:
                analysis = candidate.analyse(A, structure)
            except SolverError as error:
                refused.append(error)
                continue
            analysis.choice = _reason(analysis, refused, self.memory)
            log.info("%s", analysis.choice)
            return analysis
        needed = [error.needed for error in refused if isinstance(error, BudgetError)]
        if not needed or self.memory is None:
            raise refused[-1]
        raise BudgetError(
            f"{self.memory / 1e6:.1f} MB are left of the memory budget for a factorisation of {A.n} rows; the leanest "
            f"method needs {min(needed) / 1e6:.0f} MB: raise the budget by "
            f"{enough_megabytes(min(needed) - self.memory)} MB or more, or take a coarser mesh",
            needed=min(needed),
        )

    def _inertia(self, A: Lower, what: str) -> int:
        return self._counter().negative_eigenvalues(A, what)

    def _inertia_forecast(self, A: Lower) -> Forecast:
        return self._counter().inertia_forecast(A)

    def _counter(self) -> LinearSolver:
        """MUMPS, which counts without keeping the factor; else what is there."""
        return self._configure(next(name for name in COUNTING if not SOLVERS[name].unavailable()))

    def _configure(self, name: str) -> LinearSolver:
        return SOLVERS[name](memory=self.memory, scratch=self.scratch).with_near_null_space(self.near_nullspace)

    def _candidates(self, A: Lower, structure: str) -> Iterator[LinearSolver]:
        """Configurations in the order in which they are tried."""

        def able(name: str) -> bool:
            return structure in SOLVERS[name].structures and not lacks(SOLVERS[name], structure)

        direct = None if self.memory is None else next(filter(able, DIRECT), None)
        if direct is None or self._has_room(A, structure, direct):
            yield from (self._configure(name) for name in filter(able, FAST))
        if self.memory is not None:
            for name in filter(able, LEAN):
                if name == direct:
                    disk: dict[str, Any] = {"out_of_core": True}
                    yield replace(self._configure(name), **disk)
                elif name not in DIRECT:
                    yield self._configure(name)

    def _has_room(self, A: Lower, structure: str, direct: str) -> bool:
        """True if the factor and its workspace fit into memory."""
        with self._configure(direct).with_memory(None).analyse(A, structure) as analysis:
            in_core, on_disk = analysis.forecast, analysis.on_disk
            if on_disk is None or self.memory is None:
                return True
            # Whoever makes the factor keeps up to a fifth more than MUMPS; a Sturm count needs about what a factor
            # on disk does, and the values of K - sigma M.
            beside = TOL.count_margin * on_disk.memory + 8 * A.nnz
            beside += TOL.columns_beside_factor * 8 * A.n + TOL.bytes_beside_factor
            return max(in_core.memory, TOL.factor_margin * in_core.kept + beside) <= self.memory


def lacks(solver: type[LinearSolver], structure: str) -> str:
    """Why ``solver`` cannot factorise such a matrix here; empty: it can."""
    if issubclass(solver, MumpsSolver):
        return solver.lacks("double", structure)
    return solver.unavailable()


def _reason(analysis: Analysis, refused: list[SolverError], memory: int | None) -> str:
    """One line: what was chosen and why."""
    plan = analysis.forecast
    place = f"on disk ({plan.disk / 1e9:.2f} GB)" if plan.out_of_core else "in memory"
    if refused:
        why = f"as {refused[-1]}"
    elif memory is None:
        why = "the fastest of the solvers that run here"
    elif plan.out_of_core:
        why = f"as {memory / 1e9:.2f} GB left of the budget have no room for it"
    else:
        why = f"as it fits into the {memory / 1e9:.2f} GB left of the budget"
    return (
        f"{plan.backend}, {plan.precision} precision, {place}: {plan.factor_entries:.3g} factor entries, "
        f"{plan.flops:.2g} operations, {plan.memory / 1e9:.2f} GB at the peak; {why}"
    )
