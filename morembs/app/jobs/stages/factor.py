"""``[solver]``: whether it takes all matrices of the job, and what its one factor cost in the end."""

from __future__ import annotations

from morembs.app.jobs.job import Job
from morembs.app.jobs.solver import solver_of
from morembs.app.jobs.stages.body import BODIES
from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.preflight import shifted_of
from morembs.app.jobs.stages.response import RESPONSE
from morembs.app.jobs.stages.stage import JobStage, Result, Work
from morembs.base.errors import InputError
from morembs.linalg.sparse.select import lacks
from morembs.linalg.sparse.solver import FactorStats
from morembs.reducers import ProblemSummary

FACTOR: Result[FactorStats] = Result("factor")
CHOICE: Result[str] = Result("choice of the solver")


class FactorCost(JobStage):
    """The cost of the factor, and why this solver made it."""

    tables = ("solver",)
    needs = (PROBLEM, BODIES, RESPONSE)
    gives = (FACTOR, CHOICE)

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        """Refuse a solver that does not take what is factorised beside K."""
        solver = type(solver_of(job))
        for words, each in shifted_of(job, facts).items():
            takes = f"it takes {' or '.join(solver.structures)} ones"
            reason = lacks(solver, each.structure) if each.structure in solver.structures else takes
            if reason:
                raise InputError(
                    f"[solver]: solver = {solver.name!r} was given, and {words} factorises {each.structure} matrices "
                    f'({reason}); take name = "auto" and no ranks'
                )
        return ()

    def run(self, work: Work) -> None:
        factor = work[PROBLEM].statics.factor
        work.give(FACTOR, factor.stats)
        work.give(CHOICE, factor.analysis.choice if factor.analysis else "")
