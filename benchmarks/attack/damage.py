"""Damaged inputs: refused in one message, or taken; never a traceback, a hang, a full memory, a half file.

What is taken is compared with what the undamaged file gives: a model that differs without a word is reported, and
``mutations.REASONS`` says for which kinds of damage no reader can know.
"""

from __future__ import annotations

import json
import random
import re
import shutil
import signal
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.attack import forked, mutations
from benchmarks.attack.fingerprint import Prints, differences, fingerprint, printed
from benchmarks.attack.seeds import FORMATS, SLOW, Seed, seeds

# Limits of one run: seconds of the processor, growth of its memory in bytes, and of its addresses, which protects the
# machine; seconds after which one that waits is given up, however busy the machine is.
PROCESSOR, MEMORY, SPACE, PATIENCE = 20, 500_000_000, 3_000_000_000, 900
_PRINTS, _DAMAGE = "prints.json", "damage.json"
_OWN = ("error: ", "warning: ", "note: ", "[")
_FULL = "the memory did not suffice"


@dataclass
class Outcome:
    """What became of one damaged file.

    ``result``: refused, same, told (another model, with a new warning or note), silent, or a failure: traceback, hang,
    crash, memory, messages, noise, half output, exit code.
    """

    format: str
    number: int
    kind: str
    words: str
    result: str = ""
    detail: str = ""
    changed: list[str] = field(default_factory=list)


FAILURES = ("traceback", "hang", "crash", "memory", "messages", "noise", "half output", "exit code")


class Target:
    """One undamaged input: its files, and what they give. A run hangs that computes for more than ``processor``
    seconds, or waits for more than ``patience``."""

    def __init__(
        self, format: str, seed: Seed, folder: Path, *, processor: int = PROCESSOR, patience: int = PATIENCE
    ) -> None:
        self.format, self.seed, self.folder, self.processor, self.patience = format, seed, folder, processor, patience
        ended, place, logs = self._run(None, "whole")
        if ended.code:
            raise SystemExit(f"{format} is refused before it is damaged: {ended.output[-300:]} {ended.errors[-600:]}")
        self.prints = _prints(logs)
        self.sentences = _sentences(ended)
        shutil.rmtree(place)
        shutil.rmtree(logs)

    def attack(self, number: int, seed: int) -> Outcome:
        """Damage one file in one way, and run."""
        ended, place, logs = self._run(random.Random(f"damage {seed} {self.format} {number}"), f"trial-{number}")
        kind, words = json.loads((logs / _DAMAGE).read_text()) if (logs / _DAMAGE).is_file() else ("", "not damaged")
        outcome = Outcome(self.format, number, kind, words)
        self._judge(outcome, ended, place, logs)
        if outcome.result in FAILURES or outcome.result == "silent":
            (logs / "judged.json").write_text(json.dumps(vars(outcome), indent=1))
        else:
            shutil.rmtree(place)
            shutil.rmtree(logs)
        return outcome

    def _run(self, dice: random.Random | None, name: str) -> tuple[forked.Ended, Path, Path]:
        place, logs = self.folder / name, self.folder / f"{name}-logs"
        place.mkdir(parents=True)

        def work() -> None:
            for file, data in self.seed.files.items():
                Path(file).write_bytes(data)
            if dice is not None:
                done = mutations.damage(Path(dice.choice(self.seed.targets)), dice)
                (logs / _DAMAGE).write_text(json.dumps(done))
            try:
                self.seed.work()
            except SystemExit as end:
                if end.code:
                    raise
            if self.seed.output is not None:
                (logs / _PRINTS).write_text(json.dumps(fingerprint(Path(self.seed.output))))

        ended = forked.run(work, place, logs, seconds=self.patience, processor=self.processor, space=SPACE)
        if ended.code == 0 and self.seed.output is None:
            (logs / _PRINTS).write_text(json.dumps(printed(ended.output)))
        return ended, place, logs

    def _judge(self, outcome: Outcome, ended: forked.Ended, place: Path, logs: Path) -> None:
        lines = [line for line in ended.errors.splitlines() if line.strip()]
        last = lines[-1] if lines else ""
        files = {path.name for path in place.iterdir()} - set(self.seed.files)
        strays = files - {self.seed.output}
        first = next((i for i, line in enumerate(lines) if line.startswith("error: ")), len(lines))
        # A message may have several lines.
        noise = [line for line in lines[:first] if not line.startswith(_OWN)]
        outcome.detail = last[:300]
        if "Traceback" in ended.errors or ended.code == 1:
            faults = [path.read_text("utf-8", "replace") for path in (logs / forked.TEMPORARY).glob("*fault*")]
            outcome.result, outcome.detail = "traceback", _cause("\n".join([ended.errors, *faults]))
        elif ended.hung or ended.code == -signal.SIGXCPU:
            outcome.result = "hang"
            outcome.detail = f"more than {self.processor} s of the processor, or {self.patience} s of waiting"
        elif ended.code < 0:
            outcome.result, outcome.detail = "crash", f"signal {-ended.code}"
        elif ended.growth > MEMORY or _FULL in ended.errors:
            outcome.result, outcome.detail = "memory", f"{ended.growth / 1e6:.0f} MB more; {last[:200]}"
        elif ended.code not in (0, 2):
            outcome.result, outcome.detail = "exit code", f"{ended.code}: {last[:200]}"
        elif strays or (ended.code == 2 and files):
            outcome.result, outcome.detail = "half output", ", ".join(sorted(files))
        elif ended.code == 2 and sum(line.startswith("error: ") for line in lines) != 1:
            outcome.result, outcome.detail = "messages", ended.errors[-300:]
        elif noise:
            outcome.result, outcome.detail = "noise", noise[0][:300]
        elif ended.code == 2:
            outcome.result = "refused"
        else:
            outcome.changed = differences(self.prints, _prints(logs))
            new = _sentences(ended) - self.sentences
            outcome.result = "same" if not outcome.changed else "told" if new else "silent"
            outcome.detail = "; ".join(outcome.changed[:4])


def _prints(logs: Path) -> Prints:
    return dict(json.loads((logs / _PRINTS).read_text()))


def _sentences(ended: forked.Ended) -> set[str]:
    """Warnings, notes and findings, without their numbers."""
    sentences = [line for line in ended.errors.splitlines() if line.startswith(("warning: ", "note: "))]
    try:
        documents = json.loads(ended.output)
    except ValueError:
        documents = []
    for document in documents:
        for key in ("notes", "findings", "warnings"):
            sentences += [str(sentence) for sentence in document.get(key) or []]
    return {re.sub(r"\d[\d.e+-]*", "#", sentence) for sentence in sentences}


def _cause(errors: str) -> str:
    """The last line of a traceback, and the last place of the program in it."""
    places = re.findall(r'File "[^"]*?(morembs/[^"]+)", line (\d+)', errors)
    last = errors.strip().splitlines()[-1] if errors.strip() else "exit code 1 without a word"
    return f"{':'.join(places[-1]) if places else 'outside of the program'}: {last[:200]}"


def attacks(
    folder: Path, *, count: int, seed: int, kinds: Sequence[str] = (), only: int | None = None
) -> Iterator[Outcome]:
    """All trials, or that with one number of one format."""
    if wrong := [kind for kind in kinds if kind not in FORMATS]:
        raise SystemExit(f"no such format: {', '.join(wrong)}; expected some of {', '.join(FORMATS)}")
    of_format = seeds(folder / "seeds", list(kinds or FORMATS))
    weights = {format: 1 if format in SLOW else 2 for format in of_format}
    given = 0.0
    for format, weight in weights.items():
        targets = [Target(format, whole, folder / f"{format}-{i}") for i, whole in enumerate(of_format[format])]
        first, given = round(given), given + count * weight / sum(weights.values())
        for number in range(round(given) - first) if only is None else [only]:
            yield targets[number % len(targets)].attack(number, seed)
