"""What solving with A(s) takes of a problem, and the processes that do so at several s at once."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base.budget import Budget
from morembs.base.crew import Crew
from morembs.base.memory import resident_bytes
from morembs.linalg.dynamic_stiffness import DynamicStiffness
from morembs.problem.damping import Damping
from morembs.problem.tolerances import TOL

if TYPE_CHECKING:
    from morembs.problem.problem import Problem

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, eq=False)
class Dynamics:
    """Matrices, rigid-body modes and damping of a problem, as ``Problem`` has them: what goes to other processes."""

    K: sp.csr_array
    M: sp.csr_array
    velocity_matrix: sp.csr_array | None
    N: sp.csr_array | None
    rigid: NDArray[Any]
    damping: Damping
    damps_rigid_motion: bool
    stiffness: DynamicStiffness
    budget: Budget


def crew_of(problem: Problem, others: Any, *, tasks: int, columns: int, structure: str) -> Crew:
    """Processes for ``tasks`` factorisations of A(s), each with ``columns`` solved for; ``Problem.workers`` at most.

    They share (dynamics, ``others``); where there is one process only, this one, the problem stands for the dynamics.
    As many run as have room within the budget. ``structure`` is that of A(s), the larger one where there are several.
    """
    budget, workers = problem.budget, max(1, min(problem.workers, tasks))
    share = None
    if budget.memory is not None and workers > 1:
        needed = worker_bytes(problem.stiffness.room_for_factor(structure), len(problem.rigid), columns, structure)
        budget.release_pages()
        left = max(0, budget.memory - resident_bytes())
        room = max(1, left // needed)
        if room < workers:
            log.warning(
                "%d of %d workers run: each needs %.2f GB, and %.2f GB are left of the memory budget",
                room,
                workers,
                needed / 1e9,
                left / 1e9,
            )
        workers = min(workers, room)
        share = left // workers
    if workers == 1:
        return Crew((problem, others))
    own = Budget(share, budget.scratch, in_memory=budget.in_memory, widest=budget.widest)
    dynamics = Dynamics(
        K=problem.K,
        M=problem.M,
        velocity_matrix=problem.velocity_matrix,
        N=problem.N,
        rigid=problem.rigid,
        damping=problem.damping,
        damps_rigid_motion=problem.damps_rigid_motion,
        stiffness=problem.stiffness.for_worker(own),
        budget=own,
    )
    return Crew((dynamics, others), workers, scratch=budget.scratch)


def worker_bytes(factor: int, size: int, columns: int, structure: str) -> int:
    """Memory of a process with a ``factor`` of so many bytes that solves for ``columns`` of length ``size``."""
    return (
        TOL.process_bytes + factor + TOL.solve_blocks * (16 if structure.startswith("complex") else 8) * size * columns
    )
