"""Starts children, measures them, and prints and writes what they found.

Every measurement is a fresh process whose peak memory the operating system counts. The process that starts them
stays small (nothing here imports NumPy), because a child begins with the peak of its parent.
"""

from __future__ import annotations

import datetime
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
Row = dict[str, Any]
Rounds = dict[str, list[Row]]
# Libraries with threads of their own.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
_DIGITS = 5
# What the figures depend on; a commit with changes of theirs has a "+" behind its name.
_MEASURED = ("morembs", "benchmarks", "pipelines", "studies", ":!benchmarks/results")


@dataclass(frozen=True)
class Settings:
    """What the command line asks for; ``folder`` holds meshes, matrices, jobs and scratch files, and ``results``
    the figures as JSON (None: they are only printed). ``threads`` None: as many as the libraries take."""

    folder: Path
    results: Path | None
    quick: bool = False
    repeat: int = 3
    resume: bool = False
    threads: int | None = None

    def environment(self) -> dict[str, str]:
        """Environment of the children."""
        limits = {} if self.threads is None else dict.fromkeys(_THREADS, str(self.threads))
        return {**os.environ, **limits}


@dataclass(frozen=True)
class Finished:
    """A process that has ended: exit code, output, seconds, processor seconds, peak of its resident memory in bytes."""

    code: int
    output: str
    errors: str
    seconds: float
    processor: float
    peak: int

    def last_error(self) -> str:
        """The last line on standard error, which says what went wrong."""
        lines = self.errors.strip().splitlines()
        return lines[-1].removeprefix("error: ") if lines else f"ended with {self.code}"


def run(arguments: Sequence[str], settings: Settings) -> Finished:
    """Run a process to its end. Its peak memory is the larger one of it and of what it starts itself."""
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        start = time.perf_counter()
        process = subprocess.Popen(arguments, stdout=output, stderr=errors, env=settings.environment())
        try:
            _, status, usage = os.wait4(process.pid, 0)
        except BaseException:
            process.kill()
            process.wait()
            raise
        seconds = time.perf_counter() - start
        process.returncode = code = os.waitstatus_to_exitcode(status)
        texts = []
        for file in (output, errors):
            file.seek(0)
            texts.append(file.read().decode("utf-8", "replace"))
    unit = 1 if sys.platform == "darwin" else 1024
    return Finished(code, texts[0], texts[1], seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * unit)


def child(task: str, settings: Settings, **wanted: object) -> Row:
    """What a task of child.py found, with ``process_peak_bytes``; {"error": ...} where it failed."""
    text = json.dumps({"folder": str(settings.folder), **wanted})
    ended = run([sys.executable, str(HERE / "child.py"), task, text], settings)
    if ended.code == 0:
        return {**json.loads(ended.output.strip().splitlines()[-1]), "process_peak_bytes": ended.peak}
    return {"error": ended.last_error().replace(str(settings.folder), "FOLDER")}


def required(task: str, settings: Settings, **wanted: object) -> Row:
    """As ``child``, for what nothing else can be measured without."""
    row = child(task, settings, **wanted)
    if "error" in row:
        raise SystemExit(f"{task} failed: {row['error']}")
    return row


def in_rounds(measures: Mapping[str, Callable[[], Row]], repeat: int) -> Rounds:
    """Each measurement in turn, ``repeat`` times, so that a drift of the machine's speed hits all alike.

    One that fails is not tried again.
    """
    rounds: Rounds = {name: [] for name in measures}
    for _ in range(repeat):
        for name, measure in measures.items():
            if not rounds[name] or "error" not in rounds[name][-1]:
                say(f"  {name} ...")
                rounds[name].append(measure())
    return rounds


def say(text: str) -> None:
    """News, apart from the tables."""
    print(text, file=sys.stderr, flush=True)


def median(rows: Sequence[Row]) -> Row:
    """Medians of the numbers of ``rows``; texts are those of the last row."""
    last = rows[-1]
    if "error" in last:
        return dict(last)
    return {key: _median([row.get(key) for row in rows]) if _number(value) else value for key, value in last.items()}


def _median(values: Sequence[Any]) -> float | None:
    numbers = [value for value in values if _number(value)]
    return statistics.median(numbers) if numbers else None


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def ratios(rounds: Rounds, first: tuple[str, str], second: tuple[str, str]) -> list[float]:
    """``first`` over ``second`` (name of a row and key in it), round by round; empty where either is missing."""
    pairs = zip(rounds.get(first[0], []), rounds.get(second[0], []), strict=False)
    values = [(a.get(first[1]), b.get(second[1])) for a, b in pairs]
    return [a / b for a, b in values if a is not None and b]


@dataclass
class Report:
    """Tables and ratios of one case, printed as they come and written at the end."""

    case: str
    settings: Settings
    rows: dict[str, Row] = field(default_factory=dict)
    comparisons: dict[str, list[float]] = field(default_factory=dict)
    machine: Row = field(default_factory=dict)

    def add(self, rounds: Rounds) -> None:
        """Keep the medians of ``rounds``, and where there are several rounds the values of each."""
        origin = {"commit": commit(), "date": datetime.date.today().isoformat()}
        for name, rows in rounds.items():
            values = {**median(rows), "rounds": rows} if len(rows) > 1 else median(rows)
            self.rows[name] = {**values, **origin}

    def resume(self) -> None:
        """Take the rows that were written before, but for those that failed."""
        path = None if self.settings.results is None else self.settings.results / f"{self.case}.json"
        if path is not None and path.is_file():
            rows = json.loads(path.read_text(encoding="utf-8"))["rows"]
            self.rows = {name: row for name, row in rows.items() if "error" not in row}

    def table(self, title: str, columns: Sequence[tuple[str, str, str]]) -> None:
        """Print the rows; columns are (key, heading, unit of ``shown``)."""
        print(f"\n{title}")
        lines = [["", *(heading for _, heading, _ in columns)]]
        notes: dict[int, str] = {}
        for name, row in self.rows.items():
            if "error" in row:
                notes[len(lines)] = str(row["error"])
            lines.append([name, *(shown(row.get(key), unit) for key, _, unit in columns if "error" not in row)])
        widths = [max(len(line[i]) for line in lines if i < len(line)) for i in range(len(lines[0]))]
        for number, line in enumerate(lines):
            cells = [cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=False)]
            print("  ".join([line[0].ljust(widths[0]), *cells, *([notes[number]] if number in notes else [])]).rstrip())

    def compare(self, words: str, values: Sequence[float]) -> None:
        """Print a ratio: its median, and its values round by round."""
        if not values:
            print(f"{words}: not measured")
            return
        self.comparisons[words] = list(values)
        each = f" ({', '.join(f'{value:.3g}' for value in values)})" if len(values) > 1 else ""
        print(f"{words}: {statistics.median(values):.3g}{each}")

    def write(self, *, some: bool = False) -> None:
        """Write the figures where results are kept. Where ``some`` rows of the case were measured, others that are
        there from the same machine stay, each with the commit that it was measured on."""
        if self.settings.results is None:
            return
        self.settings.results.mkdir(parents=True, exist_ok=True)
        path = self.settings.results / f"{self.case}.json"
        self.machine = self.machine or required("machine", self.settings)
        machine = dict(self.machine)
        machine.pop("process_peak_bytes", None)
        for row in self.rows.values():
            row.setdefault("threads", machine["blas_threads"])
        compared = {words: {"median": statistics.median(v), "rounds": v} for words, v in self.comparisons.items()}
        earlier = json.loads(path.read_text(encoding="utf-8")) if some and path.exists() else {}
        if not _same_machine(earlier.get("machine", {}), machine):
            earlier = {}
        document = {
            "case": self.case,
            "quick": self.settings.quick,
            "repeat": self.settings.repeat,
            "machine": machine,
            "rows": {**earlier.get("rows", {}), **self.rows},
            "ratios": {**earlier.get("ratios", {}), **compared},
        }
        path.write_text(json.dumps(_rounded(document), indent=1) + "\n", encoding="utf-8")
        say(f"written: {os.path.relpath(path)}")


def commit() -> str:
    """Short name of the commit that is checked out, with a "+" where something that is measured was changed since."""
    try:
        name = subprocess.check_output(["git", "rev-parse", "--short=7", "HEAD"], cwd=ROOT, text=True).strip()
        changed = subprocess.run(["git", "diff", "--quiet", "HEAD", "--", *_MEASURED], cwd=ROOT, check=False).returncode
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return name + "+" * bool(changed)


def _same_machine(first: Row, second: Row) -> bool:
    return all(first.get(key) == second.get(key) for key in ("cores", "model", "system", "processor"))


def shown(value: Any, unit: str) -> str:
    """A figure in a table. Units: s, ms, MB, GB, GiB, G (10^9), % (of one), x (a ratio), e (an error), n (a count),
    text."""
    if value is None:
        return "-"
    if unit == "text":
        return str(value)
    if unit == "MB":
        return f"{value / 1e6:,.0f}"
    if unit in ("G", "GB"):
        return f"{value / 1e9:.3g}"
    if unit == "GiB":
        return f"{value / (1 << 30):.2f}"
    if unit == "ms":
        return f"{1e3 * value:.3g}"
    if unit == "n":
        return f"{value:,.0f}"
    if unit == "%":
        return f"{100 * value:.0f} %"
    if unit == "e":
        return f"{value:.1e}"
    return f"{value:.2f}" if unit in ("s", "x") else f"{value:.4g}"


def _rounded(value: Any) -> Any:
    """Figures with as many digits as are worth keeping."""
    if isinstance(value, dict):
        return {key: _rounded(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_rounded(part) for part in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def command(*arguments: str | Path) -> list[str]:
    """The command line of morembs with the Python that runs this."""
    return [sys.executable, "-m", "morembs", *map(str, arguments)]
