"""What the attacks found: failures in groups with the command that repeats each, and tables."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from benchmarks.attack import damage, kill, preload
from benchmarks.attack.mutations import REASONS, reason
from benchmarks.measure import Report, Settings

T = TypeVar("T")


def again(verb: str, kind: str, seed: int, number: int) -> str:
    """The command that repeats a trial."""
    return f"python -m benchmarks.attack {verb} --kind {kind} --seed {seed} --only {number} --keep kept"


def until_stopped(outcomes: Iterator[T]) -> Iterator[T]:
    """All of them, or those until Ctrl-C, of which the tables then tell."""
    try:
        yield from outcomes
    except KeyboardInterrupt:
        print("\nstopped before the end")


def groups(examples: dict[tuple[str, str], list[tuple[str, str]]]) -> None:
    """Print failures by what failed and where, the first with words and command."""
    for (failure, kind), cases in sorted(examples.items()):
        words, command = cases[0]
        print(f"\n{failure}, {kind}: {len(cases)}\n  {words}\n  {command}")


def killed(settings: Settings, count: int, seed: int, kinds: Sequence[str], only: int | None) -> int:
    """The verb ``kill``."""
    preload.everything()
    start = time.perf_counter()
    rows: dict[str, Counter[str]] = defaultdict(Counter)
    examples: dict[tuple[str, str], list[tuple[str, str]]] = defaultdict(list)
    for outcome in until_stopped(kill.attacks(settings.folder, count=count, seed=seed, kinds=kinds, only=only)):
        row = rows[outcome.trial.kind]
        row.update(
            runs=1,
            whole=outcome.trial.whole,
            ended=outcome.ended_before,
            left=outcome.left > 0,
            failed=bool(outcome.failures),
            **{outcome.trial.signal.name: 1},
        )
        for failure, words in outcome.failures:
            repeat = again("kill", outcome.trial.kind, seed, outcome.trial.number)
            examples[failure, outcome.trial.kind].append((f"{outcome.trial}: {words}", repeat))
    table = Report("attack-kill", settings, rows={kind: dict(row) for kind, row in rows.items()})
    columns = (
        ("runs", "runs"),
        *((column.name, column.name) for column in kill.SIGNALS),
        ("whole", "whole processes"),
        ("ended", "ended before"),
        ("left", "left files for a moment"),
        ("failed", "failed"),
    )
    table.rows["all"] = {key: sum(row[key] for row in rows.values()) for key, _ in columns}
    table.table(f"kill: seed {seed}, {time.perf_counter() - start:.0f} s", [(k, h, "n") for k, h in columns])
    table.rows["all"]["seed"] = seed
    groups(examples)
    table.write()
    return int(bool(examples))


def damaged(settings: Settings, count: int, seed: int, kinds: Sequence[str], only: int | None) -> int:
    """The verb ``damage``."""
    preload.everything()
    start = time.perf_counter()
    rows: dict[str, Counter[str]] = defaultdict(Counter)
    examples: dict[tuple[str, str], list[tuple[str, str]]] = defaultdict(list)
    silent: dict[tuple[str, str], list[tuple[str, str]]] = defaultdict(list)
    for outcome in until_stopped(damage.attacks(settings.folder, count=count, seed=seed, kinds=kinds, only=only)):
        rows[outcome.format].update({"files": 1, outcome.result: 1})
        case = f"{outcome.words}\n  {outcome.detail}", again("damage", outcome.format, seed, outcome.number)
        if outcome.result in damage.FAILURES:
            place = outcome.detail if outcome.result == "traceback" else outcome.format
            examples[outcome.result, place].append(case)
        elif outcome.result == "silent":
            silent[outcome.kind, outcome.format].append(case)
        if only is not None:
            print(f"{outcome.result}: {outcome.kind}: {case[0]}")
    results = ("files", "refused", "same", "told", "silent", *damage.FAILURES)
    names = {"told": "changed, told", "silent": "changed, not told", "same": "taken, the same"}
    table = Report("attack-damage", settings, rows={kind: dict(row) for kind, row in rows.items()})
    table.rows["all"] = {key: sum(row[key] for row in rows.values()) for key in results}
    title = f"damage: seed {seed}, {time.perf_counter() - start:.0f} s"
    table.table(title, [(key, names.get(key, key), "n") for key in results])
    unknown = {key: cases for key, cases in silent.items() if reason(*key) is None}
    print("\nchanged, not told, where no reader can know:")
    for kind in sorted({kind for kind, _ in silent.keys() - unknown.keys()}):
        each = {
            format: cases
            for (other, format), cases in silent.items()
            if other == kind and (other, format) not in unknown
        }
        words, command = next(iter(each.values()))[0]
        table.rows[f"not told: {kind}"] = {format: len(cases) for format, cases in each.items()} | {
            "because": REASONS[kind]
        }
        print(f"  {kind}: {', '.join(f'{format} {len(cases)}' for format, cases in each.items())}")
        print(f"    because: {REASONS[kind]}\n    such as: {words.splitlines()[0]}\n    {command}")
    table.rows["all"]["seed"] = seed
    groups(examples | {(f"not told, {kind}", format): cases for (kind, format), cases in unknown.items()})
    table.write()
    return int(bool(examples or unknown))


VERBS: dict[str, Callable[[Settings, int, int, Sequence[str], int | None], int]] = {"kill": killed, "damage": damaged}
