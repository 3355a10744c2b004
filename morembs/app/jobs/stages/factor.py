"""``[solver]``: whether it takes all matrices of the job, and what its one factor cost in the end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from morembs.app.jobs.solver import SolverTable, solver_of
from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.preflight import collect_factorisations
from morembs.app.jobs.stages.response import RESPONSE
from morembs.app.jobs.stages.stage import BODIES, FACTOR, JobStage, Result, Results, Work
from morembs.app.jobs.tables import Job
from morembs.app.report.sections import Place, Section
from morembs.base.errors import InputError
from morembs.linalg.sparse.select import lacks
from morembs.reducers import ProblemSummary

CHOICE: Result[str] = Result("choice of the solver")


class FactorCost(JobStage):
    """The cost of the factor, and why this solver made it."""

    tables = (SolverTable,)
    needs = (PROBLEM, BODIES, RESPONSE)
    gives = (FACTOR, CHOICE)
    tells = (FACTOR, CHOICE)

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        """Refuse a solver that does not take what is factorised beside K."""
        solver = type(solver_of(job))
        for words, each in collect_factorisations(job, facts).items():
            takes = f"it takes {' or '.join(solver.structures)} ones"
            reason = lacks(solver, each.structure) if each.structure in solver.structures else takes
            if reason:
                raise InputError(
                    f"[solver]: solver = {solver.name!r} was given, and {words} factorises {each.structure} matrices "
                    f'({reason}); take name = "auto" and no ranks',
                    keyword="solver",
                )
        return ()

    def run(self, work: Work) -> None:
        factor = work[PROBLEM].statics.factor
        work.give(FACTOR, factor.stats)
        work.give(CHOICE, factor.analysis.choice if factor.analysis else "")

    def provenance(self, work: Work) -> Mapping[str, object]:
        return {"solver": work[FACTOR].backend, "factor": asdict(work[FACTOR])}

    def document(self, job: Job, results: Results) -> Mapping[str, Any]:
        factor = results[FACTOR]
        return {"solver": factor.backend, "choice": results[CHOICE], "factor": asdict(factor)}

    def sections(self, document: Mapping[str, Any]) -> Sequence[Section]:
        if "solver" not in document:
            return ()
        counts = ", ".join(
            f"{document[key]:,} {words}"
            for key, words in (("nodes", "nodes"), ("elements", "elements"), ("dofs", "degrees of freedom"))
        )
        choice = [f"  solver: {document['choice']}"] if document["choice"] else []
        return [Section(place=Place.SUMMARY, lines=[f"{counts}, solver {document['solver']}", *choice])]
