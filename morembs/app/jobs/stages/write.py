"""``[output]``: the body file, with where it comes from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from morembs.app.jobs.stages.stage import BODIES, FACTOR, INPUTS, MODEL, JobStage, Result, Results, Work, select_stages
from morembs.app.jobs.tables import Job, OutputTable
from morembs.body.file import write_body
from morembs.storage.checksums import whole_sum

# The body file; what else is written beside it changes this, and comes before the picture.
WRITTEN: Result[Path] = Result("written")


class WriteBody(JobStage):
    """The body file of the job."""

    tables = (OutputTable,)
    needs = (MODEL, BODIES, FACTOR, INPUTS)
    gives = (WRITTEN,)
    step = "write"

    def writes(self, job: Job) -> Mapping[str, Path]:
        return {"[output] path": job.output}

    def run(self, work: Work) -> None:
        job, model, watch = work.job, work[MODEL], work.watch
        inputs = work[INPUTS].items()
        provenance: dict[str, object] = {
            "job": job.text,
            "changes": list(job.changes) or None,
            "inputs": [{"file": name, "target": each.target, "sha256": each.sha256} for name, each in inputs],
            "seconds": {stage.name: stage.seconds for stage in watch.stages},
            "peak_memory_bytes": {stage.name: stage.peak_memory_bytes for stage in watch.stages},
            "job_peak_memory_bytes": watch.peak_memory_bytes,
        }
        for stage in select_stages(job):
            provenance |= stage.provenance(work)
        write_body(
            job.output,
            work[BODIES],
            # What was asked for and of what: the same for the same input.
            recipe={
                **job.tables.values(without_none=True, but={"output", "solver"}),
                "dofs": model.size,
                "source": model.source,
                **work.recipe,
            },
            provenance=provenance,
            warnings=tuple(work.stored),
        )
        work.give(WRITTEN, job.output)

    def document(self, job: Job, results: Results) -> Mapping[str, Any]:
        picture = None if job.picture is None else str(job.picture)
        return {"output": str(job.output), "body_sha256": whole_sum(job.output), "picture": picture}
