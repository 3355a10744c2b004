"""What a stage of a job is, and the work that goes from stage to stage."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from morembs.app.jobs.tables import Job, JobTable, JobTables
from morembs.app.report.sections import Section
from morembs.base.progress import Stopwatch
from morembs.fem import FEModel, Mesh
from morembs.linalg.sparse.solver import FactorStats, LinearSolver
from morembs.storage.contents import Content

if TYPE_CHECKING:
    from morembs.body import Body
    from morembs.reducers import ProblemSummary
    from morembs.reducers.problem_summary import ShiftedFactorisations

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)


def unheard(_: str) -> None:
    """The default for warnings: they are in the result too."""


@dataclass(frozen=True)
class Result(Generic[T_co]):
    """The name of what one stage gives and others need."""

    name: str


# What every job gives, whichever stages it has.
MODEL: Result[FEModel] = Result("model")
BODIES: Result[tuple[Body, ...]] = Result("bodies")
FACTOR: Result[FactorStats] = Result("factor")
# The files that were read up to the model, by the names that were opened.
INPUTS: Result[Mapping[str, Content]] = Result("inputs")


@dataclass(kw_only=True, eq=False)
class Results:
    """What stages have given, each by its name."""

    _given: dict[Result[Any], Any] = field(default_factory=dict)

    def __getitem__(self, result: Result[T]) -> T:
        value: T = self._given[result]
        return value

    def get(self, result: Result[T]) -> T | None:
        """What was given under this name, None where no stage of the job gives it."""
        return self._given.get(result)

    def give(self, result: Result[T], value: T) -> None:
        """Have a result for the stages that need it, in place of one that was there."""
        self._given[result] = value

    def close(self, kept: Sequence[Result[Any]] = ()) -> None:
        """Close and forget the results that are not ``kept``, the latest first."""
        for result in [each for each in reversed(self._given) if each not in kept]:
            value = self._given.pop(result)
            if hasattr(value, "__exit__"):
                value.__exit__(None, None, None)


@dataclass(kw_only=True, eq=False)
class Work(Results):
    """A job at work: its means, results of its stages so far, and its warnings.

    ``start`` is the resident memory of the process before any model was read, ``counts_modes`` says whether modes are
    computed. ``warnings`` are those of the job, ``stored`` those of the body file, ``recipe`` has entries that
    stages add to the recipe of the file.
    """

    job: Job
    solver: LinearSolver
    start: int
    watch: Stopwatch
    counts_modes: bool = False
    warn: Callable[[str], None] = unheard
    warnings: list[str] = field(default_factory=list)
    stored: list[str] = field(default_factory=list)
    recipe: dict[str, object] = field(default_factory=dict)

    def tell(self, *sentences: str, stored: bool = True, heard: bool = True) -> None:
        """Warnings of the job, ``heard`` at once or only in the result, and ``stored`` in its body file or not."""
        for sentence in sentences if heard else ():
            self.warn(sentence)
        self.warnings += sentences
        self.stored += sentences if stored else ()


@dataclass(frozen=True, kw_only=True)
class JobForecast:
    """What a job will need. Bytes are those of memory but ``scratch_bytes`` and ``witness_bytes``; ``extent`` (3,)
    in m.

    ``choice`` says in one line which solver will be taken and why; ``factor_seconds`` is that of the one
    factorisation with ``threads`` threads at the speed of this machine, ``reduction_seconds`` that of each
    reduction beside it where it can be estimated, within a factor of three, ``seconds`` that of the whole job by stage,
    named as in the document of the finished job, and of the ``start`` of the program. ``shift_factor_...`` is of the
    largest factor beside that of K, 0 where there is none, ``shift_seconds`` the time of all of these. Workers or
    ranks are ``processes`` beside this one, of up to ``process_bytes`` each; ``all_processes_bytes`` is the peak of all
    at once.
    """

    solver: str
    choice: str
    nodes: int
    elements: int
    dofs: int
    coupled_dofs: int
    rigid_modes: int
    stiffness_nonzeros: int
    mass_nonzeros: int
    matrices_bytes: int
    factor_entries: int
    factor_flops: float
    factor_bytes: int
    scratch_bytes: int
    columns_bytes: int
    peak_memory_bytes: int
    factor_seconds: float
    threads: int
    shift_factor_entries: int
    shift_factor_bytes: int
    shift_seconds: float
    processes: int
    process_bytes: int
    all_processes_bytes: int
    extent: tuple[float, float, float]
    interface_nodes: dict[str, int]
    reduction_seconds: dict[str, float] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    witness_bytes: int = 0
    warnings: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """The fields as plain values."""
        return {**asdict(self), "warnings": list(self.warnings)}


class JobStage:
    """A stage of a job: all that is known of one feature. A new one is a file here and a line in ``STAGES``.

    ``tables`` are the tables of the job file that it reads. It runs after all stages that give results in ``needs``;
    it changes a result that it needs and ``gives``. Results in ``needs`` that no stage of a job gives are absent.
    Results that it ``tells`` of, in ``document``, stay until the job is done.

    A job that has it has none of the stages ``instead``.

    ``step`` is its line of progress and its row among the costs; a stage that runs in several steps, or not always in
    one, has them as ``steps`` and measures them itself. ``on_page`` says that pages show its sections too.
    """

    tables: ClassVar[tuple[type[JobTable], ...]] = ()
    needs: ClassVar[tuple[Result[Any], ...]] = ()
    gives: ClassVar[tuple[Result[Any], ...]] = ()
    tells: ClassVar[tuple[Result[Any], ...]] = ()
    instead: ClassVar[tuple[type[JobStage], ...]] = ()
    step: ClassVar[str] = ""
    steps: ClassVar[tuple[str, ...]] = ()
    on_page: ClassVar[bool] = False

    def refuse_conflicts(self, tables: JobTables) -> None:
        """Refuse tables that do not go together, each of which is right by itself.

        Raises:
            InputError: in these cases.
        """

    def is_asked(self, job: Job) -> bool:
        """True if the job has this stage."""
        return True

    def reads(self, job: Job) -> Mapping[str, Path]:
        """The files that it reads, by the words for each."""
        return {}

    def writes(self, job: Job) -> Mapping[str, Path]:
        """The files that it writes, by the words for each."""
        return {}

    def prepare(self, job: Job) -> None:
        """Refuse values that are wrong by themselves, before any file is read.

        Raises:
            InputError: in these cases.
        """

    def matrices(self, job: Job) -> FEModel | None:
        """The model whose matrices it reads, None for a stage that reads none.

        Raises:
            InputError: files that cannot be used.
        """
        return None

    def forecast(self, job: Job) -> JobForecast | None:
        """What a job will need that has no finite-element model, None for a stage of such a model."""
        return None

    def check_mesh(self, job: Job, mesh: Mesh) -> None:
        """Refuse what does not fit the mesh of the job.

        Raises:
            InputError: in these cases.
        """

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        """Warnings before anything is factorised; ``rigid`` is the number of rigid-body motions.

        Raises:
            InputError: input that ``run`` would refuse, as far as that is known before.
        """
        return ()

    def plan_factorisations(self, job: Job, facts: ProblemSummary) -> Mapping[str, Sequence[ShiftedFactorisations]]:
        """What it factorises beside K, by the words for what asks for it."""
        return {}

    def witness_bytes(self, job: Job, facts: ProblemSummary) -> int:
        """Size of the witness that it writes, about."""
        return 0

    def columns(self, job: Job, facts: ProblemSummary) -> int:
        """Columns as long as there are dofs that it has at once."""
        return 0

    def seconds(self, job: Job, facts: ProblemSummary, factor_entries: int) -> Mapping[str, float]:
        """Time of its linear algebra by the names of its steps, factorisations not included, as far as known.

        What every step takes for each degree of freedom is added to it.
        """
        return {}

    def followed_seconds(self, job: Job, facts: ProblemSummary) -> Mapping[str, float]:
        """Time of what follows the responses to all interface degrees of freedom, by the words for it."""
        return {}

    def computes_modes(self, job: Job) -> bool:
        """True if it computes modes, which are counted."""
        return False

    def named_steps(self, job: Job) -> Sequence[str]:
        """Its steps in such a job, as documents name them."""
        return (self.step,) if self.step else self.steps

    def run(self, work: Work) -> None:
        """Do the work and give its results."""

    def provenance(self, work: Work) -> Mapping[str, object]:
        """What it adds to the provenance in the body file."""
        return {}

    def document(self, job: Job, results: Results) -> Mapping[str, Any]:
        """What it adds to the document of the finished job: plain values and arrays; tables in it are joined."""
        return {}

    def sections(self, document: Mapping[str, Any]) -> Sequence[Section]:
        """What reports show of such a document, whether it was just made or read."""
        return ()


# Filled where all stages are known, in the order in which a document tells of them.
STAGES: dict[str, JobStage] = {}


def select_stages(job: Job) -> list[JobStage]:
    """The stages of a job, in the order in which they run."""
    stages = [stage for stage in STAGES.values() if stage.is_asked(job)]
    return list(in_order([stage for stage in stages if not any(_replaces(other, stage) for other in stages)]))


def _replaces(stage: JobStage, other: JobStage) -> bool:
    return stage is not other and isinstance(other, stage.instead)


def computes_modes(job: Job) -> bool:
    """True if any stage computes modes, which are counted."""
    return any(stage.computes_modes(job) for stage in select_stages(job))


def in_order(stages: Sequence[JobStage]) -> Iterator[JobStage]:
    """Each stage after those whose results it needs; beyond that as they are given."""
    left = list(stages)
    while left:
        ready = next((stage for stage in left if not any(_waits(stage, other) for other in left)), left[0])
        left.remove(ready)
        yield ready


def _waits(stage: JobStage, other: JobStage) -> bool:
    """True if ``stage`` needs a result of ``other``; a change does not come before its inputs from ``stage``."""
    changes_later = not set(stage.gives).isdisjoint(other.needs)
    return stage is not other and any(
        result in other.gives and not (result in other.needs and changes_later) for result in stage.needs
    )


def run_stages(
    work: Work, stages: Sequence[JobStage], kept: Sequence[Result[Any]] = (), until: Result[Any] | None = None
) -> list[JobStage]:
    """Run the stages, or those ``until`` a result is there; returns the stages that are left.

    A result is closed and forgotten after the last stage that needs it, if it is not ``kept``.

    Raises:
        MorembsError: a stage refuses its input or fails.
    """
    left = list(stages)
    try:
        while left and (until is None or work.get(until) is None):
            stage = left.pop(0)
            with work.watch.stage(stage.step) if stage.step else nullcontext():
                stage.run(work)
            work.close([*kept, *(result for each in left for result in each.needs)])
    except BaseException:
        work.close()
        raise
    return left
