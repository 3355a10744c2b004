"""Ends before the end: every command is killed at random instants; no half file may stay, and a restart must agree.

An output is absent, the old one, or complete, whenever the run ends; the exit code says how it ended, and is 0 only
where everything is complete. The same run again gives the same datasets outside /provenance, and clears what the
killed one left.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import random
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

from benchmarks.attack import forked
from benchmarks.attack.scenarios import OLD, ROOT, SCENARIOS, SHARES
from benchmarks.measure import command

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
# Exit codes of a run that a signal ended: by the program, and by the system before the program or its end.
CODES = {signal.SIGINT: (130, -2), signal.SIGTERM: (143, -15), signal.SIGKILL: (-9,)}
# Parts of the trials: a whole process, the group rather than the process, the signal twice, an old output.
WHOLE, GROUP, TWICE, OLD_ONE = 0.03, 0.5, 0.1, 0.5
# The latest instant, as a part of the time of a whole run.
LATEST = 1.05


@dataclass(frozen=True)
class Trial:
    """What is drawn from the seed: the signal, the instant as a part of the run, and how."""

    kind: str
    number: int
    signal: signal.Signals
    instant: float
    group: bool
    twice: bool
    old: bool
    whole: bool


@dataclass
class Outcome:
    """How a killed run and the run after it ended, and what is wrong with that (kinds of failure, and words)."""

    trial: Trial
    code: int
    ended_before: bool
    left: int = 0
    failures: list[tuple[str, str]] = field(default_factory=list)

    def fail(self, kind: str, words: str) -> None:
        """One thing that is wrong."""
        self.failures.append((kind, words))


def draw(kind: str, number: int, seed: int, whole: float = WHOLE) -> Trial:
    """The trial with a number, for any share of ``whole`` processes."""
    dice = random.Random(f"kill {seed} {kind} {number}")
    number_of_signal, instant = dice.choice(SIGNALS), dice.uniform(0.0, LATEST)
    group, twice, old = dice.random() < GROUP, dice.random() < TWICE, dice.random() < OLD_ONE
    alone = bool(SCENARIOS[kind].cli) and dice.random() < whole
    return Trial(kind, number, number_of_signal, instant, group, twice, old, alone)


def counts(total: int, kinds: Sequence[str]) -> dict[str, int]:
    """How many trials each kind gets."""
    shares = {kind: SHARES[kind] for kind in kinds if kind in SHARES and len(kinds) > len(SHARES)}
    runs = {kind: max(1, round(share * total)) for kind, share in shares.items()}
    others = [kind for kind in kinds if kind not in runs]
    rest = max(total - sum(runs.values()), len(others))
    for place, kind in enumerate(others):
        runs[kind] = rest // len(others) + (place < rest % len(others))
    return {kind: runs[kind] for kind in kinds}


class Target:
    """One kind of run: its inputs, the time that it takes, and what it writes when nobody stops it."""

    def __init__(self, kind: str, folder: Path) -> None:
        self.kind, self.scenario, self.folder = kind, SCENARIOS[kind], folder / kind
        self.inputs = self.folder / "inputs"
        self.inputs.mkdir(parents=True)
        self.scenario.inputs(self.inputs)
        place = self.folder / "whole"
        shutil.copytree(self.inputs, place)
        # The first run also fills the caches of the disk.
        for _ in range(2):
            if self.scenario.checkpoint:
                (place / self.scenario.checkpoint).unlink(missing_ok=True)
            ended = forked.run(self.scenario.work, place, self.folder / "logs")
            if ended.code:
                raise SystemExit(f"{kind} fails when nobody kills it ({ended.code}): {ended.errors}")
        self.seconds = ended.seconds
        self.alone: float | None = None
        self.complete = {name: content(place / name) for name in self.scenario.outputs}
        if self._files(place, self.folder / "logs") - self._expected():
            raise SystemExit(f"{kind} leaves files when nobody kills it: {self._files(place, self.folder / 'logs')}")

    def attack(self, trial: Trial) -> Outcome:
        """Run, kill, look, run again, look again."""
        place, logs = self.folder / f"trial-{trial.number}", self.folder / f"logs-{trial.number}"
        shutil.copytree(self.inputs, place)
        for name in self.scenario.outputs if trial.old else ():
            (place / name).write_bytes(OLD)
        code, errors = self._whole(trial, place, logs) if trial.whole else self._forked(trial, place, logs)
        outcome = Outcome(trial, code, ended_before=code == 0)
        self._after_the_kill(outcome, place, logs, errors)
        again = forked.run(self.scenario.work, place, logs)
        if again.code:
            outcome.fail("restart", f"ends with {again.code}: {again.errors.strip()[-300:]}")
        for name, expected in self.complete.items():
            if content(place / name) != expected:
                outcome.fail("other result", f"{name} of the run after it is not that of a run alone")
        if strays := sorted(self._files(place, logs) - self._expected()):
            outcome.fail("stray", f"after the next run: {', '.join(strays)}")
        if not outcome.failures:
            shutil.rmtree(place)
            shutil.rmtree(logs)
        return outcome

    def _forked(self, trial: Trial, place: Path, logs: Path) -> tuple[int, str]:
        child = forked.begin(self.scenario.work, place, logs)
        try:
            time.sleep(trial.instant * self.seconds)
        except BaseException:
            child.send(signal.SIGKILL, group=True)
            raise
        # It is not waited for yet, so its number is its own, ended or not.
        for _ in range(1 + trial.twice):
            with contextlib.suppress(ProcessLookupError):
                child.send(trial.signal, group=trial.group)
            time.sleep(0.01 * trial.twice)
        ended = child.wait()
        return ended.code, ended.errors + ("" if _alone(child.pid) else "\na process of its group goes on")

    def _whole(self, trial: Trial, place: Path, logs: Path) -> tuple[int, str]:
        (logs / forked.TEMPORARY).mkdir(parents=True, exist_ok=True)
        environment = {**os.environ, "TMPDIR": str(logs / forked.TEMPORARY), "PYTHONPATH": str(ROOT)}
        if self.alone is None:
            shutil.copytree(place, spare := place.with_name("spare"))
            start = time.perf_counter()
            subprocess.run(command(*self.scenario.cli), cwd=spare, env=environment, capture_output=True, check=False)
            self.alone = time.perf_counter() - start
            shutil.rmtree(spare)
        with subprocess.Popen(
            command(*self.scenario.cli),
            cwd=place,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        ) as process:
            time.sleep(trial.instant * self.alone)
            for _ in range(1 + trial.twice):
                with contextlib.suppress(ProcessLookupError):
                    (os.killpg if trial.group else os.kill)(process.pid, trial.signal)
                time.sleep(0.01 * trial.twice)
            _, errors = process.communicate()
        if "KeyboardInterrupt" in errors and str(ROOT / "morembs") not in errors:
            return -trial.signal, ""  # Python itself was starting, and ends in its own way
        return process.returncode, errors

    def _after_the_kill(self, outcome: Outcome, place: Path, logs: Path, errors: str) -> None:
        trial, code = outcome.trial, outcome.code
        contents = {name: content(place / name) for name in self.complete}
        for name, what in contents.items():
            if what not in (None, OLD.decode(), self.complete[name]) or (what == OLD.decode() and not trial.old):
                outcome.fail("half file", f"{name} is neither the old one nor complete")
            elif what is None and trial.old:
                outcome.fail("lost file", f"{name}, which was there before, is gone")
        if code not in (0, *CODES[trial.signal]):
            outcome.fail("exit code", f"{code} after {trial.signal.name}: {errors.strip()[-300:]}")
        elif code == 0 and contents != self.complete:
            outcome.fail("exit code", f"0 after {trial.signal.name}, and not all outputs are complete")
        if code > 0 and "Traceback" in errors:
            outcome.fail("traceback", errors.strip()[-300:])
        if "a process of its group goes on" in errors:
            outcome.fail("orphan", "a process of its group goes on")
        kept = content(place / self.scenario.checkpoint) if self.scenario.checkpoint else None
        if kept is not None and kept.startswith("cannot be read"):
            outcome.fail("half file", f"{self.scenario.checkpoint} {kept}")
        for path in self.inputs.rglob("*"):
            if path.is_file() and path.read_bytes() != (place / path.relative_to(self.inputs)).read_bytes():
                outcome.fail("lost input", f"{path.name} was changed")
        strays = sorted(self._files(place, logs) - self._expected())
        outcome.left = len(strays)
        # Those that cannot know of their end leave files until the next run.
        if strays and code >= 0:
            outcome.fail("stray at once", f"code {code}: {', '.join(strays)}")

    def _expected(self) -> set[str]:
        inputs = {str(path.relative_to(self.inputs)) for path in self.inputs.rglob("*")}
        return inputs | set(self.scenario.outputs) | ({self.scenario.checkpoint} - {""})

    def _files(self, place: Path, logs: Path) -> set[str]:
        temporary = logs / forked.TEMPORARY
        paths = {str(path.relative_to(place)) for path in place.rglob("*")}
        return paths | {f"{forked.TEMPORARY}/{path.relative_to(temporary)}" for path in temporary.rglob("*")}


def content(path: Path) -> str | None:
    """What a file holds, to compare: None without a file, a digest of the datasets outside /provenance of HDF5."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return None
    if data == OLD:
        return OLD.decode()
    if path.suffix == ".png":
        # Some show how long their run took.
        return "a picture" if data.startswith(b"\x89PNG") and data[-8:-4] == b"IEND" else "cannot be read: cut off"
    if not data.startswith(b"\x89HDF"):
        return hashlib.sha256(data).hexdigest()
    digest = hashlib.sha256()
    try:
        with h5py.File(path, "r") as file:
            _digest(file, digest)
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        return f"cannot be read: {error}"
    return digest.hexdigest()


def _digest(group: h5py.Group, digest: hashlib._Hash) -> None:
    digest.update(repr(sorted((name, np.asarray(value).tolist()) for name, value in group.attrs.items())).encode())
    for name in sorted(group):
        item = group[name]
        digest.update(item.name.encode())
        if isinstance(item, h5py.Group):
            if item.name != "/provenance":
                _digest(item, digest)
            continue
        value = item[()]
        digest.update(f"{item.dtype} {item.shape}".encode())
        plain = isinstance(value, np.ndarray) and value.dtype != object
        digest.update(value.tobytes() if plain else repr(value).encode())


def _alone(group: int, patience: float = 60.0) -> bool:
    """Whether all processes of a group end soon."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.02)
    os.killpg(group, signal.SIGKILL)
    return False


def attacks(
    folder: Path, *, count: int, seed: int, kinds: Sequence[str] = (), only: int | None = None, whole: float = WHOLE
) -> Iterator[Outcome]:
    """All trials, or that with one number of one kind."""
    for kind, trials in counts(count, kinds or list(SCENARIOS)).items():
        target = Target(kind, folder)
        for number in range(trials) if only is None else [only]:
            yield target.attack(draw(kind, number, seed, whole))
        if only is None:
            shutil.rmtree(target.inputs)
