"""``[output]``: the body file, with where it comes from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from morembs.app.jobs.job import Job
from morembs.app.jobs.stages.body import BODIES
from morembs.app.jobs.stages.factor import FACTOR
from morembs.app.jobs.stages.stage import MODEL, JobStage, Result, Work
from morembs.body.file import write_body
from morembs.storage.contents import Content

INPUTS: Result[Mapping[str, Content]] = Result("inputs")
# The body file; what else is written beside it changes this, and comes before the picture.
WRITTEN: Result[Path] = Result("written")


class WriteBody(JobStage):
    """The body file of the job."""

    tables = ("output",)
    needs = (MODEL, BODIES, FACTOR, INPUTS)
    gives = (WRITTEN,)

    def writes(self, job: Job) -> Mapping[str, Path]:
        return {"[output] path": job.output}

    def run(self, work: Work) -> None:
        job, model, bodies, watch = work.job, work[MODEL], work[BODIES], work.watch
        with watch.stage("write"):
            write_body(
                job.output,
                bodies,
                # What was asked for and of what: the same for the same input.
                recipe={
                    **job.tables.values(without_none=True, but={"output", "solver"}),
                    "dofs": model.size,
                    "source": model.source,
                    **work.recipe,
                },
                provenance=_provenance(work),
                warnings=tuple(work.stored),
            )
        work.give(WRITTEN, job.output)


def _provenance(work: Work) -> dict[str, object]:
    job, factor, watch = work.job, work[FACTOR], work.watch
    return {
        "job": job.text,
        "changes": list(job.changes) or None,
        "inputs": [
            {"file": name, "target": content.target, "sha256": content.sha256} for name, content in work[INPUTS].items()
        ],
        "solver": factor.backend,
        "factor": asdict(factor),
        "seconds": {stage.name: stage.seconds for stage in watch.stages},
        "peak_memory_bytes": {stage.name: stage.peak_memory_bytes for stage in watch.stages},
        "job_peak_memory_bytes": watch.peak_memory_bytes,
    }
