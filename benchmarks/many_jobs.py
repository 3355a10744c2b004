"""What a batch of very many jobs costs beside their work: processor time and memory of the coordinator, and its report.

usage: python -m benchmarks.many_jobs [--jobs 10000] [--workers 40] [--rows 10000]
       python -m benchmarks.many_jobs --dofs 30000 30000 30000 30000 30000 30000 30000 30000

The work of each job is a stub: a file that is there at once. The report has so many parts with one small body;
Chromium, where it is installed, says what it takes to open it and how long a click on a head takes.

With --dofs real jobs of so many degrees of freedom, one BLAS thread each, are run by local:1 and by local:2: how long
each takes, whether the bodies are equal bit by bit, and the largest part of its memory that a job took.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

from benchmarks.attack.scenarios import ROOT
from morembs.app.batches.coordinator import Coordinator
from morembs.app.batches.manifest import Manifest
from morembs.app.batches.plan import parts_of
from morembs.app.batches.records import Nobody
from morembs.app.batches.workers import Finished, Heard, Task, Worker
from morembs.app.jobs.job import load_job
from morembs.app.pages.page import write_report
from morembs.app.pages.parts import Entry
from morembs.base.memory import peak_memory_bytes
from morembs.storage.attempts import attempt_at
from morembs.storage.checksums import whole_sum

sys.path.insert(0, str(ROOT))

from tests.support import decks
from tests.support.browser import CHROMIUM, browser

CLICK = """(() => {
var head = Array.from(document.querySelectorAll('#parts th')).find(th => th.textContent === 'time');
document.body.offsetHeight;
var begun = performance.now(); head.click(); document.body.offsetHeight;
return performance.now() - begun;
})()"""


class Stubs:
    """Workers whose processes end well at once."""

    limits = True

    def __init__(self, count: int) -> None:
        self.count, self.largest = count, Worker(bytes=32e9, cores=4, slots=4)
        self.present = {f"w{number}": self.largest for number in range(count)}
        self._news: deque[Finished] = deque()

    def threads(self, asked: int | None, tasks: int) -> int:
        """One each."""
        return asked or 1

    def want(self, needs: Iterable[Worker]) -> None:
        """There are as many as there are."""

    def start(self, task: Task, worker: str) -> None:
        """Do what the process would have done."""
        paths = [Path(word) for word in task.arguments if word.endswith(".toml")]
        forecast = {"peak_memory_bytes": 2e9, "seconds": {"factorise": 1.0 + task.number % 7}, "inputs": {}}
        documents: list[dict[str, object]] = [forecast for _ in paths]
        if task.arguments[0] == "reduce":
            attempt_at(load_job(paths[0]).output, task.arguments[-1]).write_bytes(b"a body")
            documents = [{"bodies": {}, "inputs": {}, "mass": 1.0}]
        self._news.append(Finished(number=task.number, code=0, printed=json.dumps(documents), message="", seconds=1.0))

    def next(self) -> Heard | Finished | None:
        """The oldest."""
        return self._news.popleft() if self._news else None

    def close(self) -> None:
        """Nothing runs."""


def coordinate(folder: Path, count: int, workers: int) -> None:
    """Run so many stubs, and once more when all is done."""
    for number in range(count):
        (folder / f"p{number}.toml").write_text(decks.job({"output": f'path = "p{number}.h5"'}))
    for what in ("first run", "second run"):
        begun, wall = time.process_time(), time.perf_counter()
        parts = parts_of([folder])
        read = time.process_time() - begun
        with Manifest(folder / "batch.manifest") as manifest:
            coordinator = Coordinator(parts, [], manifest, Nobody(), 2)
            due = coordinator.due(False)
            if due:
                coordinator.run(Stubs(workers), due, False, False)
        states = {record.state for record in coordinator.records()}
        taken = time.process_time() - begun
        written = (folder / "batch.manifest").stat().st_size
        print(
            f"{what}: {count} jobs, {len(due)} due, {states}: {1e3 * taken / count:.2f} ms of processor time a job "
            f"({1e3 * read / count:.2f} of them for reading job files), {time.perf_counter() - wall:.0f} s, "
            f"peak {peak_memory_bytes() / 1e6:.0f} MB, manifest {written / 1e6:.1f} MB",
            flush=True,
        )


def browse(folder: Path, rows: int) -> None:
    """Open a report of so many parts in Chromium, until nothing moves, and sort it."""
    job = decks.folder(folder)
    subprocess.run(
        [sys.executable, "-m", "morembs", "reduce", str(job), "-q"],
        check=True,
        capture_output=True,
        stdin=subprocess.DEVNULL,
    )
    body, report = next(folder.glob("*.h5")), folder / "many.html"
    entries = [
        Entry(name=f"part {n}", job=str(job), output=str(body), state="done", seconds=(7919 * n) % rows)
        for n in range(rows)
    ]
    # All parts have one body: the pictures of the first are those of the others.
    write_report(report, entries[:1], "many")
    begun = time.process_time()
    write_report(report, entries, "many")
    written = time.process_time() - begun
    with browser(folder) as page:
        time.sleep(3)
        begun = _processor_seconds(os.getpid())
        page.open(report)
        taken, before = _processor_seconds(os.getpid()), 0.0
        while taken - before > 0.05:
            time.sleep(1)
            taken, before = _processor_seconds(os.getpid()), taken
        print(
            f"report of {rows} parts, {report.stat().st_size / 1e6:.1f} MB, written in {written:.1f} s of processor "
            f"time: open after {taken - begun:.1f} s of processor time, sorted in {page.run(CLICK) / 1e3:.2f} s"
        )


def _processor_seconds(parent: int) -> float:
    """What the processes below one have taken."""
    children: dict[int, list[tuple[int, int]]] = {}
    for file in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended
            words = file.read_text().rpartition(")")[2].split()
            children.setdefault(int(words[1]), []).append((int(file.parent.name), int(words[11]) + int(words[12])))
    ticks, due = 0, [parent]
    while due:
        for process, taken in children.get(due.pop(), []):
            ticks += taken
            due.append(process)
    return ticks / os.sysconf("SC_CLK_TCK")


def compare(folder: Path, sizes: Sequence[int]) -> None:
    """Run solid beams with so many dofs by one worker and by two."""
    taken, sums = {}, {}
    for place in ("local:1", "local:2"):
        for number, dofs in enumerate(sizes):
            cells = itertools.product(range(max(1, round(dofs / 363 - 1))), range(10), range(10))
            (own := folder / place[-1] / f"p{number}").mkdir(parents=True)
            decks.folder(own, {"solver": "threads = 1"}, decks.deck(list(cells))).rename(own / f"p{number}.toml")
        begun = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "morembs", "batch", str(folder / place[-1]), "--cluster", place, "-q"],
            check=True,
            stdin=subprocess.DEVNULL,
        )
        taken[place] = time.perf_counter() - begun
        sums[place] = [whole_sum(folder / place[-1] / f"p{number}" / "part.h5") for number in range(len(sizes))]
        parts = _peaks((folder / place[-1] / "batch.manifest").read_text().splitlines())
        print(
            f"{place}: {len(sizes)} jobs in {taken[place]:.1f} s; {sum(part <= 1 for part in parts)} of "
            f"{len(parts)} took no more memory than was asked for, the largest {max(parts):.2f} times as much",
            flush=True,
        )
    equal = "equal" if sums["local:1"] == sums["local:2"] else "NOT equal"
    print(f"local:2 takes {taken['local:2'] / taken['local:1']:.2f} of the time of local:1; the bodies are {equal}")


def _peaks(lines: Iterable[str]) -> list[float]:
    """Peak memory of each job of a manifest as part of what was asked for it."""
    asked, parts = {}, []
    for event in map(json.loads, lines):
        if event["event"] == "started":
            asked[event["output"]] = 1e6 * event["MB"]
        elif event["event"] == "ended":
            parts.append(max(event["facts"]["peak_memory_bytes"].values()) / asked[event["output"]])
    return parts


def main() -> None:
    """Both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=10000)
    parser.add_argument("--workers", type=int, default=40)
    parser.add_argument("--rows", type=int, default=10000)
    parser.add_argument("--dofs", type=int, nargs="+", default=[])
    given = parser.parse_args()
    if given.dofs:
        with tempfile.TemporaryDirectory() as name:
            compare(Path(name), given.dofs)
        return
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "jobs").mkdir()
        coordinate(Path(name) / "jobs", given.jobs, given.workers)
        if given.rows and CHROMIUM:
            (Path(name) / "report").mkdir()
            browse(Path(name) / "report", given.rows)


if __name__ == "__main__":
    main()
