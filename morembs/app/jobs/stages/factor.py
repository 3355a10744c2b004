"""What the one factorisation of a job cost, once nothing solves with it any more."""

from __future__ import annotations

from morembs.app.jobs.stages.body import BODIES
from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.response import RESPONSE
from morembs.app.jobs.stages.stage import JobStage, Result, Work
from morembs.linalg.sparse.solver import FactorStats

FACTOR: Result[FactorStats] = Result("factor")
CHOICE: Result[str] = Result("choice of the solver")


class FactorCost(JobStage):
    """The cost of the factor, and why this solver made it."""

    needs = (PROBLEM, BODIES, RESPONSE)
    gives = (FACTOR, CHOICE)

    def run(self, work: Work) -> None:
        factor = work[PROBLEM].statics.factor
        work.give(FACTOR, factor.stats)
        work.give(CHOICE, factor.analysis.choice if factor.analysis else "")
