"""``[preload]``: loads whose stress stiffens the body before it is reduced."""

from __future__ import annotations

from morembs.app.jobs.job import Job
from morembs.app.jobs.stages.couple import INTERFACES, PROBLEM, VARIED, coupled
from morembs.app.jobs.stages.stage import MODEL, JobStage, Work
from morembs.base.errors import InputError
from morembs.body.floating.preload import Preload, preloaded
from morembs.body.floating.stiffening_terms import why_no_stiffening
from morembs.fem.fe_model import has_places
from morembs.reducers import ProblemSummary


class PreloadStress(JobStage):
    """The stress of the preload in the model, and the problem of that."""

    tables = ("preload",)
    needs = (MODEL, VARIED, INTERFACES, PROBLEM)
    gives = (MODEL, VARIED, PROBLEM)

    def is_asked(self, job: Job) -> bool:
        return job.tables.preload is not None

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        """Refuse loads on nothing, and bodies that carry no stress or are held."""
        preload_of(job).check(facts.interfaces)
        reason = why_no_stiffening(facts.model)
        if reason:
            raise InputError(f"preload: {reason}")
        if rigid != 6 or not has_places(facts.model):
            raise InputError(f"preload: the body has {rigid} rigid-body motions; expected a free body with six")
        return ()

    def run(self, work: Work) -> None:
        preload, varied = preload_of(work.job), work.get(VARIED)
        with work.watch.stage("preload"), work[PROBLEM] as problem:
            found = preloaded(problem, preload)
            model = found.model
            if varied is not None:
                # Not at the top: most jobs have no parameters.
                from morembs.app.jobs.stages.parameters import stressed

                varied = stressed(varied, work[MODEL], preload, found)
                model = varied.model(varied.box.nominal, work.budget)
                work.give(VARIED, varied)
            work.give(MODEL, model)
            work.give(PROBLEM, coupled(work, model, varied))
        work.recipe |= dict(found.notes)


def preload_of(job: Job) -> Preload:
    """The preload in SI units, of a job that has one."""
    given, units = job.tables.preload, job.units
    if given is None:
        raise InputError("the job has no table [preload]; add one")
    force, acceleration = units.mass * units.length / units.time**2, units.length / units.time**2
    scale = [force] * 3 + [force * units.length] * 3
    return Preload(
        wrench={name: [value * s for value, s in zip(f, scale, strict=True)] for name, f in given.wrench.items()},
        speed=given.speed / units.time,
        axis=given.axis,
        point=[units.length * value for value in given.point],
        acceleration=[acceleration * value for value in given.acceleration],
        held=tuple(given.held),
        follows=tuple(given.follows),
    )
