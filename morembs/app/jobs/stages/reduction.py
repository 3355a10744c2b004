"""``[[reduce]]``: one reduced model for each table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.stage import JobStage, Result, Work
from morembs.app.jobs.tables import HasTables, Job, RepeatedTable
from morembs.app.jobs.tolerances import TOL
from morembs.base.errors import InputError, SolverError
from morembs.base.key_tables import declare_key
from morembs.base.limits import text
from morembs.base.options import read_options
from morembs.base.progress import duration_words
from morembs.reducers import REDUCERS, ProblemSummary, Reducer
from morembs.reducers.base import ReducedModel
from morembs.reducers.cost import mode_seconds
from morembs.reducers.problem_summary import ShiftedFactorisations

REDUCED: Result[Sequence[ReducedModel]] = Result("reduced")
# Names become groups of the HDF5 file.
SAFE_NAME = r"^[A-Za-z0-9_][A-Za-z0-9_.+-]*$"


@dataclass(frozen=True, kw_only=True)
class ReduceTable(RepeatedTable):
    """``[[reduce]]``: one reduced body. Further keys are the options of its method."""

    least: ClassVar[int] = 1
    expected: ClassVar[str] = "at least one table [[reduce]]"
    further: ClassVar[Mapping[str, Any]] = {}
    method: str = declare_key("one of " + ", ".join(REDUCERS.own))
    name: Annotated[str, text("a name of letters, digits, _, -, + and .", SAFE_NAME, longest=100)] | None = None

    def options(self) -> dict[str, object]:
        """Keys besides name and method."""
        return dict(self.further)


class Reduction(JobStage):
    """The factorisation, and the reductions of the job."""

    tables = (ReduceTable,)
    needs = (PROBLEM,)
    gives = (REDUCED,)
    steps = ("factorise", "reduce")

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        """Ask every reduction whether it can be made."""
        for name, reducer in reducers_of(job).items():
            if facts.inputs > TOL.max_interface_dofs and reducer.follows_responses:
                raise InputError(
                    f"[[reduce]] {name!r}: method = {reducer.method!r} follows the responses to each of {facts.inputs} "
                    f"interface degrees of freedom, and at most {TOL.max_interface_dofs} fit; take craig-bampton with "
                    "interface_up_to_hz, or rigid or average couplings",
                    kind="model",
                    keyword="method",
                )
            reason = reducer.why_not(facts)
            if reason:
                raise InputError(f"[[reduce]] {name!r}: {reason}", keyword="reduce")
        return tuple(_many_modes(job, facts.size))

    def plan_factorisations(self, job: Job, facts: ProblemSummary) -> Mapping[str, Sequence[ShiftedFactorisations]]:
        return {f"[[reduce]] {name!r}": reducer.plan_factorisations(facts) for name, reducer in job.reducers.items()}

    def columns(self, job: Job, facts: ProblemSummary) -> int:
        return facts.inputs + max(reducer.mode_count for reducer in job.reducers.values())

    def seconds(self, job: Job, facts: ProblemSummary, factor_entries: int) -> Mapping[str, float]:
        times = {name: reducer.seconds(facts, factor_entries) for name, reducer in job.reducers.items()}
        return {f"reduce {name}": seconds for name, seconds in times.items() if seconds is not None}

    def followed_seconds(self, job: Job, facts: ProblemSummary) -> Mapping[str, float]:
        return {
            repr(name): reducer.seconds(facts) or 0.0
            for name, reducer in job.reducers.items()
            if reducer.follows_responses
        }

    def computes_modes(self, job: Job) -> bool:
        return any(reducer.computes_modes for reducer in job.reducers.values())

    def named_steps(self, job: Job) -> Sequence[str]:
        return ("factorise", *(f"reduce {name}" for name in job.reducers))

    def run(self, work: Work) -> None:
        problem, reduced = work[PROBLEM], list[ReducedModel]()
        with work.watch.stage("factorise"):
            if work.counts_modes:
                problem.require_room_for_modes()
            _ = problem.statics
        for name, reducer in reducers_of(work.job).items():
            with work.watch.stage(f"reduce {name}"):
                try:
                    reduced.append(reducer.reduce(problem, name=name))
                except (InputError, SolverError) as error:
                    if type(error) not in (InputError, SolverError):
                        raise
                    words = f"[[reduce]] {name!r}: {error}"
                    raise type(error)(words, kind=error.kind, keyword=error.keyword) from error
        work.give(REDUCED, reduced)


def make_reducers(job: HasTables) -> dict[str, Reducer]:
    """Name -> reducer with its options, of the tables of a job.

    Raises:
        InputError: names that repeat, unknown methods, wrong options.
    """
    return {name: _reducer(name, table) for name, table in named_tables(job).items()}


def named_tables(job: HasTables) -> dict[str, ReduceTable]:
    """Name -> table of each reduction.

    Raises:
        InputError: names that repeat.
    """
    names = [table.name or table.method for table in ReduceTable.of(job)]
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise InputError(
            f"two [[reduce]] tables are named {repeated[0]!r}; give each its own name = ...", kind="conflict"
        )
    return dict(zip(names, ReduceTable.of(job), strict=True))


def _reducer(name: str, table: ReduceTable) -> Reducer:
    where = f"[[reduce]] {name!r}: "
    if table.method not in REDUCERS:
        raise InputError(
            f"{where}method = {table.method!r} was given; {REDUCERS.advice(table.method)}",
            kind="unknown",
            keyword="method",
        )
    kind = REDUCERS[table.method]
    options = read_options(
        kind, table.options(), f"method {table.method!r}", where=where, word="key", besides=("name", "method")
    )
    try:
        return kind(**options)
    except InputError as error:
        raise error.restate(f"{where}{error}") from error


def reducers_of(job: Job) -> dict[str, Reducer]:
    """Name -> reducer, selections of nodes in the declared units."""
    return {name: reducer.in_units(job.units.length) for name, reducer in job.reducers.items()}


def _many_modes(job: Job, size: int) -> list[str]:
    warnings = []
    for name, reducer in job.reducers.items():
        modes = reducer.mode_count
        if size > TOL.small_model_dofs and modes > min(TOL.many_modes_part * size, TOL.many_modes):
            took = duration_words(mode_seconds(size, modes, 0))
            warnings.append(
                f"[[reduce]] {name!r}: modes = {modes:,} of {size:,} dofs are many; to find them takes about {took} at "
                "the speed of this machine now, within a factor of three; ask for tens to a few hundred, or give "
                "up_to_hz two to three times the highest frequency of interest"
            )
    return warnings
