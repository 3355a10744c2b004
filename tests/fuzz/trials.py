"""One trial: the files of a job, command lines under a limit of processor seconds, and the verdict."""

from __future__ import annotations

import hashlib
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.attack import forked
from tests.fuzz.jobs import Job, draw
from tests.fuzz.judge import judge

# Processor seconds of one command, and seconds of the wall clock, which only end what waits for ever.
PROCESSOR, PATIENCE = 30, 900
# Verdicts, those of faults first.
FAULTS = ("wrong", "traceback", "library warning", "input changed", "leftovers", "over the limit", "crash")
RESULTS = (*FAULTS, "good", "refused", "refused as it must be")
_WARNED = re.compile(r"(Runtime|Deprecation|User|Future)Warning|site-packages|^Warning: ", re.MULTILINE)
_LEFT = re.compile(r"\.morembs|listener-|\.tmp|\.lock$")
# What a search for a basis found, which the next run of the job takes until there is a body.
_SEARCH = ".search-"


@dataclass
class Outcome:
    """What became of a job. ``result`` is one of ``RESULTS``; ``words`` say why."""

    number: int | str
    result: str = "good"
    words: str = ""
    features: dict[str, str] = field(default_factory=dict)
    valid: bool = True
    command: str = ""
    proven: int = 0
    estimates: int = 0
    excess: int = 0
    points: int = 0
    bodies: int = 0
    seconds: float = 0.0

    def fail(self, result: str, words: str) -> None:
        """Keep the gravest."""
        if self.result not in FAULTS or FAULTS.index(result) < FAULTS.index(self.result):
            self.result, self.words = result, words


class Folder:
    """A folder with inputs that no command may change, and the commands that run in it."""

    def __init__(self, place: Path, outcome: Outcome) -> None:
        self.place, self.outcome, self.logs = place, outcome, place.with_name(place.name + "-logs")
        self.sums: dict[str, str] = {}
        place.mkdir(parents=True)
        self.logs.mkdir()

    def seal(self) -> None:
        """From here on the files that are there are inputs, as far as they were not before."""
        for path in self.place.rglob("*"):
            if path.is_file():
                self.sums.setdefault(str(path.relative_to(self.place)), _sum(path))

    def run(self, arguments: Sequence[str]) -> forked.Ended:
        """A command line; what is wrong with its end goes to the outcome."""
        work: Callable[[], object] = forked.program(arguments)
        ended = forked.run(work, self.place, self.logs, seconds=PATIENCE, processor=PROCESSOR)
        line = "morembs " + " ".join(arguments)
        if ended.code in (-24, -9) or ended.hung:
            self.outcome.fail("over the limit", f"{line}: more than {PROCESSOR} s of the processor")
        elif ended.code == 1 or "Traceback" in ended.errors:
            self.outcome.fail("traceback", f"{line}: {last_line(ended.errors)}")
        elif ended.code not in (0, 2):
            self.outcome.fail("crash", f"{line}: exit code {ended.code}: {last_line(ended.errors)}")
        if found := _WARNED.search(ended.errors):
            start = ended.errors.rfind("\n", 0, found.start()) + 1
            self.outcome.fail("library warning", f"{line}: {ended.errors[start : start + 200]!r}")
        return ended

    def check(self) -> None:
        """Inputs are as they were, and nothing private is left."""
        for name, sum_ in self.sums.items():
            path = self.place / name
            if not path.is_file():
                self.outcome.fail("input changed", f"{name} is gone")
            elif _sum(path) != sum_:
                self.outcome.fail("input changed", f"{name} was written over")
        places = [*self.place.rglob("*"), *self.logs.glob(f"{forked.TEMPORARY}/*")]
        done = (self.place / "body.h5").is_file()
        if left := [path.name for path in places if _LEFT.search(path.name) or (done and _SEARCH in path.name)]:
            self.outcome.fail("leftovers", ", ".join(left[:4]))

    def close(self) -> None:
        """Remove all."""
        shutil.rmtree(self.place, ignore_errors=True)
        shutil.rmtree(self.logs, ignore_errors=True)


def trial(number: int, seed: int, folder: Path, *, keep: bool = False) -> Outcome:
    """Job ``number`` of ``seed``, in a folder of its own, which is removed where nothing is wrong."""
    outcome = Outcome(number, command=f'make attack ARGS="jobs --seed {seed} --only {number}"')
    place = Folder(folder / f"job-{seed}-{number}", outcome)
    rng = np.random.default_rng([seed, number])
    job = draw(rng, place.place)
    (place.place / "job.toml").write_text(job.text)
    outcome.features, outcome.valid = job.features, job.valid
    place.seal()
    try:
        _run(job, place, rng)
    finally:
        place.check()
        if outcome.result not in FAULTS and not keep:
            place.close()
    return outcome


def _run(job: Job, place: Folder, rng: np.random.Generator) -> None:
    outcome = place.outcome
    for arguments in job.prepare:
        if not _passed(place, place.run(arguments), job):
            return
        place.seal()
    # The forecast of a check measures the machine, which takes as long as the job.
    checked = place.run(["check", "job.toml"]) if rng.random() < 0.2 else None
    reduced = place.run(["reduce", "job.toml", "--quiet"])
    if checked and checked.code == 2 and reduced.code == 0:
        outcome.fail("wrong", f"check refuses what reduce takes: {reason(checked.errors)}")
    if not _passed(place, reduced, job):
        return
    outcome.bodies += 1
    if not (place.place / "body.h5").is_file():
        outcome.fail("wrong", "exit code 0 and no body file")
        return
    if job.judged:
        _judge(job, place, rng)
    for arguments in job.after:
        ended = place.run(arguments)
        if ended.code == 2 and arguments[0] == "info":
            outcome.fail("wrong", f"info refuses the body: {reason(ended.errors)}")
        elif ended.code == 2 and outcome.result == "good":
            outcome.features["afterwards"] = f"{' '.join(arguments[:1] + arguments[2:4])}: {reason(ended.errors)}"
    if job.evaluation and (place.place / "at.h5").is_file():
        verdict = job.evaluation.judge(place.place, job.truth, rng, job.floor)
        for sentence in verdict.wrong:
            outcome.fail("wrong", sentence)


def _passed(place: Folder, ended: forked.Ended, job: Job) -> bool:
    if ended.code == 0:
        return True
    if ended.code == 2:
        outcome = place.outcome
        outcome.result = (
            outcome.result if outcome.result in FAULTS else "refused" if job.valid else "refused as it must be"
        )
        outcome.words = outcome.words or reason(ended.errors)
    return False


def _judge(job: Job, place: Folder, rng: np.random.Generator) -> None:
    exact = {drawn.name for drawn in job.reductions if drawn.whole}
    promises = {drawn.name: drawn.promise for drawn in job.reductions if drawn.promise}
    kinds = {drawn.name: drawn.kind for drawn in job.reductions}
    verdict = judge(place.place / "body.h5", job.truth, rng, exact=exact, tolerances=promises, promised=kinds)
    outcome = place.outcome
    if verdict.wrong:
        outcome.fail("wrong", " | ".join(verdict.wrong[:4]))
    outcome.proven, outcome.estimates = verdict.proven, verdict.estimates
    outcome.excess, outcome.points = verdict.excess, verdict.points


def reason(errors: str) -> str:
    """The message of a refusal, without numbers and names: what refusals are counted by."""
    text = next((line for line in errors.splitlines() if "error:" in line), last_line(errors))
    text = re.sub(r"^.*?error: ", "", text)
    text = re.sub(r"'[^']*'|\"[^\"]*\"", "'...'", text)
    return re.sub(r"-?\d[\d.,]*(e[+-]?\d+)?", "N", text)[:300]


def last_line(errors: str) -> str:
    """Of what was printed."""
    return next((line for line in reversed(errors.strip().splitlines()) if line.strip()), "nothing on standard error")


def _sum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
