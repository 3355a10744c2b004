"""What a job will need, from the symbolic analysis of its stiffness: nothing is factorised.

The peak is that of the process: the larger one of two moments, the factorisation, and the Sturm count beside the
factor and the dense columns of the modes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import scipy.sparse as sp

from morembs.app.jobs.stages.couple import interfaces_of
from morembs.app.jobs.tables import Job, ModelTable
from morembs.app.jobs.tolerances import TOL
from morembs.base.budget import current_budget, memory_that_leaves
from morembs.base.errors import BudgetError, enough_megabytes
from morembs.fem import DofMap, FEModel, Mesh
from morembs.fem.assembly import check_mesh, mass_warnings, stiffness_pattern
from morembs.fem.interface import couple
from morembs.fem.material import Material
from morembs.linalg.congruence import congruence
from morembs.linalg.dynamic_stiffness import plan_at_shift
from morembs.linalg.sparse.solver import Forecast, LinearSolver
from morembs.linalg.sparse.symmetric import Lower
from morembs.linalg.sparse.threads import blas_threads, measured_speed
from morembs.linalg.sturm import require_room_to_count
from morembs.linalg.tolerances import TOL as LINALG
from morembs.problem.system import worker_bytes
from morembs.problem.tolerances import TOL as PROBLEM
from morembs.reducers.problem_summary import ShiftedFactorisations

# Part of the speed of a large dense product that a factorisation reaches, and seconds for each of its entries
# on top; of compact bodies of 100 to 300 thousand dofs, PARDISO's taken to be that of MUMPS.
_EFFICIENCY = {"cholmod": 0.56, "mumps": 0.48, "mumps-mixed": 1.0, "mumps-embedded": 0.30, "pardiso": 0.48}


@dataclass(frozen=True, kw_only=True)
class Cost:
    """The part of a ``JobForecast`` that comes from the matrices."""

    plan: Forecast
    choice: str
    columns: int
    peak: int
    seconds: float
    shift: Shift

    def forecast_fields(self) -> dict[str, Any]:
        """The fields of a ``JobForecast`` that this is."""
        plan, shift = self.plan, self.shift
        return {
            "solver": plan.backend,
            "choice": self.choice,
            "factor_entries": plan.factor_entries,
            "factor_flops": plan.flops,
            "factor_bytes": plan.kept,
            "scratch_bytes": plan.disk,
            "columns_bytes": self.columns,
            "peak_memory_bytes": self.peak,
            "factor_seconds": self.seconds,
            "threads": blas_threads(),
            "shift_factor_entries": shift.entries,
            "shift_factor_bytes": shift.kept,
            "shift_seconds": shift.seconds,
            "processes": shift.processes,
            "process_bytes": shift.each,
            "all_processes_bytes": self.peak + shift.processes * shift.each + shift.beside,
        }


@dataclass(frozen=True, kw_only=True)
class Shift:
    """The largest factor beside that of K, what one takes that is made here, the time of all of them; and how many
    other processes there are of how many bytes each: workers that make factors, or ranks. ``beside``: the
    process that workers are copied from."""

    entries: int = 0
    kept: int = 0
    here: int = 0
    seconds: float = 0.0
    processes: int = 0
    each: int = 0
    beside: int = 0


def forecast_cost(
    K: sp.csr_array,
    T: sp.csr_array,
    columns: int,
    solver: LinearSolver,
    start: int,
    modes: bool,
    shifted: Sequence[ShiftedFactorisations] = (),
    workers: int = 1,
) -> Cost:
    """Cost of reducing with a stiffness of the pattern of ``K`` (N, N) in coupled dofs of ``T`` (N, Nc).

    Args:
        columns: number of columns of the basis.
        start: resident memory of the process before any model was read.
        modes: whether modes are computed, and so counted.
        shifted: what is factorised beside K, by ``workers`` processes where there are several.

    Raises:
        SolverError: no method fits into the budget.
    """
    square = T.shape[0] == T.shape[1]
    lower = Lower.of(K if square else congruence(T, K))
    n, matrices = lower.n, _matrices(K, lower, square)
    del K
    budget = current_budget()
    room = None if budget.memory is None else budget.memory - start - resting_bytes(n)
    # What reduce loads and keeps later is not there yet when it looks at this.
    first = None if room is None else room + TOL.resting_bytes - TOL.loaded_bytes
    count = require_room_to_count(solver, lower, first) if modes else None
    limited = solver.with_memory(None if room is None else max(0, room))
    with limited.analyse(lower, "spd", "the stiffness matrix") as analysis:
        plan, choice = analysis.forecast, analysis.choice
    counting = count.memory if count else 0
    if count and budget.memory is None:
        # Without a budget its factor is kept, because it finds modes too.
        counting += 8 * count.factor_entries
    dense = 8 * n * (columns + min(TOL.krylov_columns_per_mode * columns + TOL.krylov_block_columns, n))
    # What the libraries of the reduction take, which are not loaded yet.
    before, here = start + TOL.loaded_bytes + matrices, plan
    left = None if budget.memory is None else budget.memory - before - plan.kept
    shift = _at_shifts(lower, shifted, solver, workers, left)
    if plan.ranks > 1:
        # Right-hand sides and solutions are all that is here.
        largest = max(plan.memory, plan.kept + max(counting, shift.here))
        shift = replace(shift, here=0, processes=plan.ranks, each=TOL.rank_bytes + largest // plan.ranks)
        here, counting = replace(plan, memory=0, kept=0), 0
    least_count = TOL.least_count_bytes if modes else 0
    peak = max(
        before + 8 * lower.nnz + here.memory,
        before + 16 * lower.nnz + here.kept + max(counting, shift.here) + dense + least_count,
    )
    if budget.memory is not None:
        # Matrices and columns rest in files when the factorisation needs their room.
        peak = min(peak, budget.memory)
    return Cost(plan=plan, choice=choice, columns=dense, peak=peak, seconds=_seconds(plan), shift=shift)


def _at_shifts(
    lower: Lower, shifted: Sequence[ShiftedFactorisations], solver: LinearSolver, workers: int, left: int | None
) -> Shift:
    """What ``shifted`` takes on up to ``workers`` processes that have ``left`` bytes together (None: no limit)."""
    if not shifted:
        return Shift()
    plans = {each.structure: plan_at_shift(lower, each.structure, solver) for each in shifted}
    each = max(worker_bytes(plans[x.structure][1], lower.n, x.columns, x.structure) for x in shifted)
    running = min(workers, max(x.at_once for x in shifted), workers if left is None else max(1, left // each))
    here = [plans[x.structure][1] for x in shifted if min(running, x.at_once) == 1]
    seconds = 0.0
    for x in shifted:
        products = TOL.products_of_complex if x.structure.startswith("complex") else 1
        seconds += products * _seconds(plans[x.structure][0]) * math.ceil(x.count / min(running, x.at_once))
    largest = max((plan for plan, _ in plans.values()), key=lambda plan: plan.kept)
    return Shift(
        entries=largest.factor_entries,
        kept=largest.kept,
        here=max(here, default=0),
        seconds=seconds,
        **({"processes": running, "each": each, "beside": PROBLEM.process_bytes} if running > 1 else {}),
    )


def require_room(job: Job, start: int, dofs: int, modes: bool, least: Callable[[], int]) -> None:
    """Refuse a memory budget that ``job`` with a model of ``dofs`` exceeds whatever it does.

    Args:
        start: resident memory of the process before any model was read.
        modes: whether modes are computed, and so counted.
        least: tells a budget that will do for the job.

    Raises:
        BudgetError: in these cases.
    """
    beside = resting_bytes(dofs)
    if modes:
        count = LINALG.count_bytes + TOL.least_count_bytes + 8 * LINALG.count_columns * dofs
        beside = max(beside, beside - TOL.resting_bytes + TOL.loaded_bytes + count)
    needed = start + beside
    if job.memory is not None and job.memory < needed:
        enough = max(needed, least())
        raise BudgetError(
            f"[solver]: memory = {job.memory / 1e6:.0f} MB is below what this program itself needs: {start / 1e6:.0f} "
            f"MB before it reads a model, and {beside / 1e6:.0f} MB for what has to stay in memory of a job of this "
            f"size; give at least {enough_megabytes(enough)} MB",
            needed=enough,
        )


def resting_bytes(dofs: int) -> int:
    """What a job with ``dofs`` keeps in memory even when all that can rest does."""
    return TOL.resting_bytes + TOL.resting_columns * 8 * dofs


def least_memory(
    job: Job, model: FEModel, solver: LinearSolver, start: int, modes: bool, K: sp.csr_array | None = None
) -> int:
    """A budget that will do for the modes of ``job``, from the symbolic analysis of ``K`` (by default that of
    ``model``); 0 where it has none. ``start`` and ``modes`` as in ``forecast_cost``.

    Raises:
        InputError: interfaces that do not fit.
    """
    if not modes:
        return 0
    K = model.K if K is None else K
    T = abs(couple(model, interfaces_of(job, model)).T)
    square = T.shape[0] == T.shape[1]
    lower = Lower.of(K if square else congruence(T, K))
    count = 0
    try:
        require_room_to_count(solver, lower, 0)
    except BudgetError as error:
        count = error.needed
    used = start + resting_bytes(lower.n) - TOL.resting_bytes + TOL.loaded_bytes
    matrices = _matrices(K, lower, square)
    return min(used + matrices + count, memory_that_leaves(count, used))


def outline_model(job: Job, mesh: Mesh, materials: Sequence[Material]) -> FEModel:
    """The model of ``mesh`` with empty matrices."""
    size = 3 * len(mesh.nodes)
    empty = sp.csr_array((size, size))
    return FEModel(
        K=empty,
        M=empty,
        nodes=mesh.nodes,
        dofs=DofMap.translations(len(mesh.nodes)),
        mesh=mesh,
        materials=tuple(materials),
        source=mesh.source,
        warnings=(*mesh.warnings, *mass_warnings(mesh, ModelTable.of(job).mass_integration)),
    )


def require_room_of_mesh(
    job: Job, mesh: Mesh, materials: Sequence[Material], solver: LinearSolver, start: int, modes: bool
) -> None:
    """As ``require_room``, for a model of ``mesh`` that is not assembled yet."""

    def least() -> int:
        pattern = stiffness_pattern(check_mesh(mesh, materials))
        return least_memory(job, outline_model(job, mesh, materials), solver, start, modes, pattern)

    require_room(job, start, 3 * len(mesh.nodes), modes, least)


def _matrices(K: sp.csr_array, lower: Lower, square: bool) -> int:
    """Bytes of K and M, as they came and coupled, and of their triangles."""
    held = (1 if square else 2) * TOL.entry_bytes * (K.nnz + K.nnz // 3)
    return int(held + TOL.triangle_entry_bytes * (lower.nnz + lower.nnz // 3))


def _seconds(plan: Forecast) -> float:
    rate = 1e9 * measured_speed().gemm_gflops * _EFFICIENCY.get(plan.backend, TOL.least_factor_speed)
    return plan.flops / rate + TOL.seconds_per_entry * plan.factor_entries / max(blas_threads(), 1)
