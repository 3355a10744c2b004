"""``[certify] witness``: files beside the body with which a stranger proves its certificates again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from morembs.app.jobs.equations import FlowTable
from morembs.app.jobs.stages.certificate import CertifyTable, refuse_witness, witness_bytes
from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.stage import MODEL, JobStage, Work
from morembs.app.jobs.stages.unreduced import PARTS, SubstructureTable
from morembs.app.jobs.stages.write import WRITTEN
from morembs.app.jobs.tables import Job, ModelTable
from morembs.base.types import Floats
from morembs.importers.model_file import is_model_file, write_model
from morembs.reducers import ProblemSummary

if TYPE_CHECKING:
    from morembs.fem import FEModel
    from morembs.problem import Problem


class Witness(JobStage):
    """The witness, and the model file that it is of where the job does not read one."""

    tables = (CertifyTable,)
    needs = (MODEL, PROBLEM, PARTS, WRITTEN)
    gives = (WRITTEN,)
    step = "witness"

    def is_asked(self, job: Job) -> bool:
        given = CertifyTable.of(job)
        return given is not None and bool(given.witness)

    def writes(self, job: Job) -> Mapping[str, Path]:
        written = {"the witness": job.output.with_suffix(".witness.h5")}
        return written if _model_of(job) is not None else written | {"its model": job.output.with_suffix(".model.h5")}

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        """Refuse what has no proof."""
        refuse_witness(facts)
        if SubstructureTable.of(job):
            # Not at the top: most jobs have a mesh.
            from morembs.dynamics.assembly import AssembledModel
            from morembs.dynamics.assembly.joint_file import frames_of

            if isinstance(facts.model, AssembledModel):
                frames_of(facts.model, facts.interfaces)
        return ()

    def witness_bytes(self, job: Job, facts: ProblemSummary) -> int:
        # Parts are stored with all their dofs.
        size = sum(part.problem.model.size for part in getattr(facts.model, "parts", ()) if part.problem is not None)
        return witness_bytes(size or facts.size, facts.inputs, facts.model.D is not None)

    def run(self, work: Work) -> None:
        from morembs.certificate.witness import write_witness

        job, problem, body, parts = work.job, work[PROBLEM], work[WRITTEN], work.get(PARTS)
        given, files = CertifyTable.require(job), self.writes(job)
        expand: Callable[[Floats], Floats] = np.asarray
        if parts is not None:
            from morembs.dynamics.assembly.joint_file import write_joined

            model, problem, expand = write_joined(files["its model"], parts), parts.problem, parts.in_parts
        else:
            model = _model_of(job) or _write_model(files["its model"], work[MODEL], problem)
        write_witness(
            files["the witness"],
            problem,
            given.band_hz,
            body=body,
            model=model,
            damping_floor=given.damping_floor,
            expand=expand,
        )
        work.give(WRITTEN, body)


def _write_model(path: Path, model: FEModel, problem: Problem) -> Path:
    """The model file, with the terms of parameters and what springs add to nominal values."""
    # Not at the top: few jobs have parameters.
    from morembs.parametric.stored_terms import terms_of
    from morembs.parametric.terms import AffineProblem

    if isinstance(problem, AffineProblem):
        return write_model(path, problem.model, terms=terms_of(problem.varied))
    return write_model(path, model)


def _model_of(job: Job) -> Path | None:
    """The model file that the job reads and takes as it is, None where it makes its model."""
    table = ModelTable.of(job)
    if table.file is None or FlowTable.of(job):
        return None
    path = job.resolve(table.file)
    return path if is_model_file(path) else None
