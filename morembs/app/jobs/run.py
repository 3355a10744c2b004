"""Runs a job: mesh file to body file, every stage measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from morembs.app.jobs.compare import FrequencyResponse
from morembs.app.jobs.files import prepare_output
from morembs.app.jobs.job import Job
from morembs.app.jobs.solver import budget_of, solver_of
from morembs.app.jobs.stages.body import BODIES
from morembs.app.jobs.stages.factor import CHOICE, FACTOR
from morembs.app.jobs.stages.model import materials_of
from morembs.app.jobs.stages.picture import SHAPES
from morembs.app.jobs.stages.response import RESPONSE
from morembs.app.jobs.stages.stage import MODEL, Work, asked, computes_modes, run_stages, unheard
from morembs.app.jobs.stages.write import INPUTS
from morembs.base.memory import PeakMemory, resident_bytes
from morembs.base.progress import Progress, Stage, Stopwatch, listening
from morembs.base.summary import summarised
from morembs.body import Body
from morembs.body.shapes import Shapes
from morembs.fem import Mesh
from morembs.linalg.sparse.solver import FactorStats
from morembs.linalg.sparse.threads import limit_threads
from morembs.storage.contents import Content, keeping_ledger

# What is told of a finished job.
RESULTS = (MODEL, BODIES, FACTOR, CHOICE, RESPONSE, SHAPES, INPUTS)


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class JobResult:
    """A finished job: what it made and what it cost. ``dofs`` counts those of the finite-element model,
    ``peak_memory_bytes`` is the peak resident memory of the process during the job, ``factor`` the cost of the one
    factorisation and ``choice`` says why this solver made it; ``warnings`` are sentences about the model and the
    bodies; ``inputs`` what was in each file that the model was read from, by the name that was opened."""

    job: Job
    nodes: int
    elements: int
    dofs: int
    bodies: tuple[Body, ...]
    factor: FactorStats
    choice: str
    stages: tuple[Stage, ...]
    peak_memory_bytes: int
    response: FrequencyResponse | None = None
    shapes: Shapes | None = None
    warnings: tuple[str, ...] = ()
    inputs: Mapping[str, Content] = field(default_factory=dict)

    def _facts(self) -> dict[str, object]:
        return {
            "job": self.job.path.name,
            "dofs": self.dofs,
            "solver": self.solver,
            "bodies": ", ".join(f"{body.name} (order {body.reduced.order})" for body in self.bodies),
            "seconds": sum(stage.seconds for stage in self.stages),
            "warnings": len(self.warnings) or None,
        }

    @property
    def solver(self) -> str:
        """Name of the solver that made the factor."""
        return self.factor.backend


@keeping_ledger()
def run_job(job: Job, progress: Progress | None = None, warn: Callable[[str], None] = unheard) -> JobResult:
    """Reduce the model of ``job`` and write its body file and picture.

    ``warn`` hears each warning about the model and the cost of its reductions before the long work begins.

    Raises:
        MorembsError: input that cannot be used, a singular model, or a result that cannot be written.
    """
    start = resident_bytes()
    prepare_output(job)
    solver = solver_of(job)
    materials_of(job)  # faults of materials are told before the mesh is read
    with listening(progress), limit_threads(job.tables.solver.threads), budget_of(job, solver), PeakMemory() as memory:
        work = Work(
            job=job, solver=solver, start=start, watch=Stopwatch(memory), counts_modes=computes_modes(job), warn=warn
        )
        with keeping_ledger() as ledger:
            left = run_stages(work, asked(job), RESULTS, until=MODEL)
            work.give(INPUTS, ledger.contents())
        run_stages(work, left, RESULTS)
    model = work[MODEL]
    return JobResult(
        job=job,
        nodes=len(model.nodes),
        elements=count_elements(model.mesh),
        dofs=model.size,
        bodies=work[BODIES],
        factor=work[FACTOR],
        choice=work[CHOICE],
        stages=tuple(work.watch.stages),
        peak_memory_bytes=work.watch.peak_memory_bytes,
        response=work.get(RESPONSE),
        shapes=work.get(SHAPES),
        warnings=tuple(work.warnings),
        inputs=work[INPUTS],
    )


def count_elements(mesh: Mesh | None) -> int:
    """Number of elements of all types, none without a mesh."""
    return sum(len(block.ids) for block in mesh.blocks) if mesh is not None else 0
