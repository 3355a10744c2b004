"""The picture of a job: shapes of the recommended body, and its response."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from morembs.app.jobs.stages.body import recommended_body
from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.response import RESPONSE
from morembs.app.jobs.stages.stage import BODIES, JobStage, Result, Work
from morembs.app.jobs.stages.write import WRITTEN
from morembs.app.jobs.tables import Job, OutputTable
from morembs.body.shapes import Shapes, mode_shapes

SHAPES: Result[Shapes | None] = Result("shapes")


class DrawnShapes(JobStage):
    """The shapes that the picture shows, while the full model is there."""

    tables = (OutputTable,)
    needs = (PROBLEM, BODIES, RESPONSE)
    gives = (SHAPES,)

    def is_asked(self, job: Job) -> bool:
        return job.picture is not None

    def run(self, work: Work) -> None:
        bodies = work[BODIES]
        work.give(SHAPES, mode_shapes(work[PROBLEM], recommended_body(bodies).reduced))


class Picture(JobStage):
    """The picture file."""

    tables = (OutputTable,)
    needs = (BODIES, SHAPES, RESPONSE, WRITTEN)
    step = "draw"

    def is_asked(self, job: Job) -> bool:
        return job.picture is not None

    def writes(self, job: Job) -> Mapping[str, Path]:
        return {} if job.picture is None else {"[output] picture": job.picture}

    def run(self, work: Work) -> None:
        # Not at the top: it loads the drawing library.
        from morembs.app.jobs.picture import draw

        if work.job.picture is not None:
            draw(work.job.picture, work[BODIES], work[SHAPES], work.get(RESPONSE))
