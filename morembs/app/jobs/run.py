"""Runs a job: mesh file to body file, every stage measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from morembs.app.jobs.document import merge_tables
from morembs.app.jobs.files import prepare_output, results_of
from morembs.app.jobs.solver import SolverTable, budget_of, solver_of
from morembs.app.jobs.stages.stage import (
    BODIES,
    FACTOR,
    INPUTS,
    MODEL,
    STAGES,
    Result,
    Results,
    T,
    Work,
    computes_modes,
    run_stages,
    select_stages,
    unheard,
)
from morembs.app.jobs.tables import Job
from morembs.base.memory import PeakMemory, resident_bytes
from morembs.base.progress import Progress, Stage, Stopwatch, listening
from morembs.base.summary import summarised
from morembs.body import Body
from morembs.linalg.sparse.solver import FactorStats
from morembs.linalg.sparse.threads import limit_threads
from morembs.storage.contents import Content, keeping_ledger

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class JobResult:
    """A finished job: results of its stages, ``result[NAME]``, its time and memory. ``peak_memory_bytes`` is the peak
    resident memory of the process during the job; ``warnings`` are sentences about the model and the bodies."""

    job: Job
    results: Results
    stages: tuple[Stage, ...]
    peak_memory_bytes: int
    warnings: tuple[str, ...] = ()

    def __getitem__(self, result: Result[T]) -> T:
        return self.results[result]

    def _facts(self) -> dict[str, object]:
        return {
            "job": self.job.path.name,
            "dofs": self.dofs if self.bodies else None,
            "solver": self.solver if self.bodies else None,
            "bodies": ", ".join(f"{body.name} (order {body.reduced.order})" for body in self.bodies) or None,
            "seconds": sum(stage.seconds for stage in self.stages),
            "warnings": len(self.warnings) or None,
        }

    def plot_cost(self) -> Figure:
        """Time and peak memory of the process by stage, drawn with Matplotlib."""
        from morembs.body.charts import cost_chart

        seconds = {stage.name: stage.seconds for stage in self.stages}
        return cost_chart(seconds, {stage.name: stage.peak_memory_bytes for stage in self.stages}).figure()

    @property
    def bodies(self) -> tuple[Body, ...]:
        """The bodies, in the order of the job; none of a job with a planar member."""
        return self.results.get(BODIES) or ()

    @property
    def dofs(self) -> int:
        """Number of those of the finite-element model."""
        return self[MODEL].size

    @property
    def factor(self) -> FactorStats:
        """Cost of the one factorisation."""
        return self[FACTOR]

    @property
    def solver(self) -> str:
        """Name of the solver that made the factor."""
        return self.factor.backend

    @property
    def inputs(self) -> Mapping[str, Content]:
        """What was in each file that the model was read from, by the name that was opened."""
        return self[INPUTS]

    def document(self) -> dict[str, Any]:
        """All there is to tell, SI units: what the stages tell, with warnings, inputs and costs."""
        document: dict[str, Any] = {"job": str(self.job.path)}
        used = select_stages(self.job)
        for stage in STAGES.values():
            if stage in used:
                merge_tables(document, stage.document(self.job, self.results))
        return document | {
            "warnings": list(self.warnings),
            "inputs": {name: asdict(content) for name, content in self.inputs.items()},
            "written": [str(path) for path in results_of(self.job).values()],
            "seconds": {stage.name: stage.seconds for stage in self.stages},
            "peak_memory_bytes": {stage.name: stage.peak_memory_bytes for stage in self.stages},
            "job_peak_memory_bytes": self.peak_memory_bytes,
        }


@keeping_ledger()
def run_job(job: Job, progress: Progress | None = None, warn: Callable[[str], None] = unheard) -> JobResult:
    """Reduce the model of ``job`` and write its files.

    ``warn`` hears each warning about the model and the cost of its reductions before the long work begins.

    Args:
        job: of ``load_job``.
        progress: listener to the stages.
        warn: takes each warning before the long work begins.

    Raises:
        MorembsError: input that cannot be used, a singular model, or a result that cannot be written.
    """
    start = resident_bytes()
    prepare_output(job)
    solver = solver_of(job)
    for stage in select_stages(job):
        stage.prepare(job)
    with (
        listening(progress),
        limit_threads(SolverTable.of(job).threads),
        budget_of(job, solver),
        PeakMemory() as memory,
    ):
        watch, counts_modes = Stopwatch(memory), computes_modes(job)
        work = Work(job=job, solver=solver, start=start, watch=watch, counts_modes=counts_modes, warn=warn)
        stages = select_stages(job)
        available = [INPUTS, *(result for stage in stages for result in stage.tells)]
        with keeping_ledger() as ledger:
            left = run_stages(work, stages, available, until=MODEL)
            work.give(INPUTS, ledger.contents())
        run_stages(work, left, available)
    return JobResult(
        job=job,
        results=work,
        stages=tuple(watch.stages),
        peak_memory_bytes=watch.peak_memory_bytes,
        warnings=tuple(work.warnings),
    )
