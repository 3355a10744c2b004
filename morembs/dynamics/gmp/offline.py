"""The offline stage of beams and solids: over which range equilibria are found, and when there are enough.

Grids of 3, 5, 9 and 17 Chebyshev points per angle hold each other, so that no equilibrium is lost when one is
refined.
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from morembs.base import progress
from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.base.worker_pool import WorkerPool
from morembs.dynamics.gmp.checkpoint import Checkpoint
from morembs.dynamics.gmp.envelope import target
from morembs.dynamics.gmp.equilibria import Equilibrium, NotFollowedError
from morembs.dynamics.gmp.plan import AngleRange, Plan, Report
from morembs.dynamics.gmp.sampling import Sampling, TabulatedMember, between, grid, shells
from morembs.dynamics.gmp.symmetry import Symmetry, symmetries
from morembs.dynamics.gmp.tolerances import TOL

LEVELS = (3, 5, 9, 17)


@dataclass(frozen=True, kw_only=True, eq=False)
class Tabulated:
    """Equilibria and samples on a grid of ``count`` points per angle, row by row, and the report."""

    reach: float
    count: int
    equilibria: list[Equilibrium]
    samples: list[Any]
    report: Report

    def stack_equilibria(self, name: str) -> Floats:
        """(count, count, ...) of a part of the equilibria."""
        values = np.array([getattr(equilibrium, name) for equilibrium in self.equilibria])
        return values.reshape(self.count, self.count, *values.shape[1:])


def tabulate_member(work: TabulatedMember, plan: Plan) -> Tabulated:
    """Equilibria and samples of a member as ``plan`` says.

    Raises:
        InputError: a range that crosses a bifurcation or has no equilibrium, a tolerance that is not met, a
            checkpoint of another component.
        OutputError: the checkpoint cannot be written.
    """
    begin = time.perf_counter()
    progress.stage("static equilibria")
    group = symmetries(work.component, work.length) if plan.symmetric else ()
    store = None
    if plan.checkpoint is not None:
        store = Checkpoint(plan.checkpoint, signature=_signature(work), options=_options(plan, group))
    with WorkerPool(work, plan.workers, threads=1) as pool:
        try:
            return _tabulate_range(work, pool, group, plan, store, begin)
        finally:
            if store is not None:
                store.save()


def _tabulate_range(
    work: TabulatedMember,
    pool: WorkerPool,
    group: tuple[Symmetry, ...],
    plan: Plan,
    store: Checkpoint | None,
    begin: float,
) -> Tabulated:
    """Over smaller and smaller ranges, where the range follows from an envelope."""
    notes: tuple[str, ...] = ()
    if not isinstance(plan.reach, AngleRange):
        asked = plan.reach
    elif store is not None and store.reach:
        asked, notes = store.reach, store.notes
    else:
        asked, notes = target(work, work.straight(), work.turns, plan.reach, group)
    reach = asked
    while True:
        if store is not None:
            store.begin(reach, notes)
        try:
            sampling = Sampling(work, pool, group, reach, store)
            count, errors = _fill_grid(sampling, plan)
            break
        except NotFollowedError as stuck:
            last = float(np.abs(stuck.reached).max())
            if not isinstance(plan.reach, AngleRange) or TOL.retried_reach * last < TOL.least_reach * asked:
                raise
            notes = (*notes, f"the range is +-{TOL.retried_reach * last:.4g} rad, not {reach:.4g}: {stuck}")
            reach = TOL.retried_reach * last
    keys = grid(count)
    report = Report(
        reach=reach,
        points=count,
        equilibria=len({*keys, *(between(count) if errors else ())}),
        solved=sampling.solved,
        restored=sampling.restored,
        symmetries=tuple(g.name for g in group),
        errors=errors,
        notes=notes,
        seconds=time.perf_counter() - begin,
    )
    return Tabulated(
        reach=reach,
        count=count,
        equilibria=[sampling.equilibria[key] for key in keys],
        samples=sampling.sample(keys),
        report=report,
    )


def _fill_grid(sampling: Sampling, plan: Plan) -> tuple[int, dict[str, float]]:
    """Number of points per angle and their errors, all equilibria being found."""
    if plan.points_per_angle is not None:
        if isinstance(plan.reach, AngleRange):
            sampling.ensure(shells(2)[-1])
        for shell in shells(plan.points_per_angle):
            sampling.ensure(shell)
        return plan.points_per_angle, {}
    for count in LEVELS:
        sampling.ensure(grid(count))
        sampling.ensure(between(count))
        errors = sampling.errors(count)
        worst = max(errors, key=lambda name: errors[name])
        progress.update(f"{count} points per angle: error {errors[worst]:.2g} ({worst})")
        if errors[worst] <= plan.tolerance:
            return count, errors
    raise InputError(
        f"tables of {LEVELS[-1]} points per angle on +-{sampling.reach:.4g} rad miss {worst} by {errors[worst]:.2g}; "
        f"tolerance = {plan.tolerance:g} was given. Take a larger tolerance or a smaller range, or divide the "
        "component into more members",
        keyword="tolerance",
    )


def _options(plan: Plan, group: tuple[Symmetry, ...]) -> str:
    reach = asdict(plan.reach) if isinstance(plan.reach, AngleRange) else plan.reach
    return json.dumps(
        {"reach": reach, "points_per_angle": plan.points_per_angle, "symmetries": [g.name for g in group]}
    )


def _signature(work: TabulatedMember) -> Floats:
    """Numbers (k,) that tell a component from others: its shape, energies and forces of two deflections."""
    component, random = work.component, np.random.default_rng(5)
    numbers = [float(component.size), work.length, float(component.reference @ random.uniform(1, 2, component.size))]
    for size in TOL.signature_deflections:
        x = component.reference + size * work.length * random.uniform(-1, 1, component.size)
        numbers += [work.energy(x), float(np.abs(component.force(x)) @ random.uniform(1, 2, component.size))]
    return np.array(numbers)
