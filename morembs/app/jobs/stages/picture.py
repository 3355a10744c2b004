"""The picture of a job: shapes of the recommended body, and its response."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from morembs.app.jobs.job import Job
from morembs.app.jobs.stages.body import BODIES, recommended_body
from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.response import RESPONSE
from morembs.app.jobs.stages.stage import JobStage, Result, Work
from morembs.app.jobs.stages.write import WRITTEN
from morembs.body.shapes import Shapes, mode_shapes

SHAPES: Result[Shapes | None] = Result("shapes")


class DrawnShapes(JobStage):
    """The shapes that the picture shows, while the full model is there."""

    tables = ("output",)
    needs = (PROBLEM, BODIES, RESPONSE)
    gives = (SHAPES,)

    def is_asked(self, job: Job) -> bool:
        return job.picture is not None

    def run(self, work: Work) -> None:
        bodies = work[BODIES]
        work.give(SHAPES, mode_shapes(work[PROBLEM], recommended_body(bodies).reduced))


class Picture(JobStage):
    """The picture file."""

    tables = ("output",)
    needs = (BODIES, SHAPES, RESPONSE, WRITTEN)

    def is_asked(self, job: Job) -> bool:
        return job.picture is not None

    def writes(self, job: Job) -> Mapping[str, Path]:
        return {} if job.picture is None else {"[output] picture": job.picture}

    def run(self, work: Work) -> None:
        # Not at the top: it loads the drawing library.
        from morembs.app.jobs.picture import draw

        bodies = work[BODIES]
        if work.job.picture is not None:
            with work.watch.stage("draw"):
                draw(work.job.picture, bodies, work[SHAPES], work.get(RESPONSE))
