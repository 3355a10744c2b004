"""Case about one body on several processes: shifts on workers, and a factor spread over ranks of MPI.

Whole jobs of a cube, as a user runs them. The operating system counts the peak memory and the processor time of each
process that a job starts: a worker and its like are looked at while they run.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from jobs import written
from measure import Report, Row, Settings, child, command, in_rounds, ratios, required, run

# Dofs; expansion points in Hz, which lie within the lower modes of the cube.
DOFS, QUICK_DOFS = 104_000, 6_000
SHIFTS = tuple(float(hz) for hz in range(4_500, 40_000, 4_500))
KRYLOV = {"method": "krylov", "shifts_hz": SHIFTS}
MODES = {"method": "craig-bampton", "modes": 30}
# Words -> method, threads of each process, and other keys of [solver].
ALONE, BOTH, THREADS = "8 shifts, 1 worker", "8 shifts, 2 workers", "8 shifts, 1 worker, 2 threads"
ONE, TWO = "30 modes, 1 process", "30 modes, 2 ranks"
RUNS: dict[str, tuple[dict[str, Any], int, tuple[str, ...]]] = {
    ALONE: (KRYLOV, 1, ()),
    BOTH: (KRYLOV, 1, ("workers=2",)),
    THREADS: (KRYLOV, 2, ()),
    ONE: (MODES, 1, ("name=mumps",)),
    TWO: (MODES, 1, ("ranks=2",)),
}
# How often processes are looked at, in seconds.
_PERIOD = 0.02
_RANK, _MAIN = "morembs.linalg.sparse.rank", "morembs\0reduce"
_MPI = ("OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "OMPI_MCA_rmaps_base_oversubscribe")


class Watch(threading.Thread):
    """Peak memory in bytes and processor seconds of every process below this one, by its number, until ``stop``."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.seen: dict[int, tuple[str, int, float]] = {}
        self._ended = threading.Event()

    def run(self) -> None:
        while not self._ended.wait(_PERIOD):
            parents = {}
            for path in Path("/proc").glob("[0-9]*"):
                try:
                    parents[int(path.name)] = int((path / "stat").read_text().rpartition(")")[2].split()[1])
                except OSError:
                    continue
            below = {os.getpid()}
            while more := {pid for pid, parent in parents.items() if parent in below} - below:
                below |= more
            for pid in below - {os.getpid()}:
                self._look(pid)

    def _look(self, pid: int) -> None:
        try:
            words = Path(f"/proc/{pid}/cmdline").read_text()
            used = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            status = Path(f"/proc/{pid}/status").read_text()
        except OSError:
            return
        if "VmHWM" in status:
            peak = 1024 * int(status.split("VmHWM:")[1].split()[0])
            self.seen[pid] = words, peak, (int(used[11]) + int(used[12])) / os.sysconf("SC_CLK_TCK")

    def stop(self) -> Row:
        """Figures of the job and of what it started."""
        self._ended.set()
        self.join()
        main = next((pid for pid, (words, *_) in self.seen.items() if _MAIN in words), None)
        helpers = [peak for words, peak, _ in self.seen.values() if _is_helper(words)]
        return {
            "process_peak_bytes": self.seen[main][1] if main in self.seen else None,
            "each_peak_bytes": max(helpers, default=None),
            "all_peak_bytes": sum(peak for _, peak, _ in self.seen.values()),
            "cpu_seconds": sum(used for *_, used in self.seen.values()),
        }


def _is_helper(words: str) -> bool:
    # The process that workers are copied from does nothing else, and has their command line.
    return (_RANK in words and "mpirun" not in words) or "multiprocessing.forkserver" in words


def workers(settings: Settings) -> None:
    """Workers and threads at several shifts, ranks and one process for modes; what they give, and what they take."""
    dofs = QUICK_DOFS if settings.quick else DOFS
    os.environ.update(dict.fromkeys(_MPI, "1"))
    measures = {words: _measure(words, dofs, settings) for words in RUNS}
    rounds = in_rounds(measures, settings.repeat)
    bodies = {words: str(_body(words, settings)) for words in RUNS}
    for first, second in ((ALONE, BOTH), (ONE, TWO)):
        if "error" not in rounds[second][-1]:
            _add(rounds[second][-1], required("same", settings, first=bodies[first], second=bodies[second]))
    matrix = str(settings.folder / f"cube_{dofs}.npz")
    required("matrix", settings, shape="cube", dofs=dofs, file=matrix)
    for words, ranks in ((ONE, 1), (TWO, 2)):
        _add(rounds[words][-1], child("pivots", settings, matrix=matrix, ranks=ranks))
    report = Report("workers", settings)
    report.add(rounds)
    report.table(
        "workers: one body on several processes",
        (
            ("dofs", "dofs", "n"),
            ("seconds", "job s", "s"),
            ("reduce_seconds", "reduction s", "s"),
            ("cpu_seconds", "CPU s", "s"),
            ("process_peak_bytes", "peak MB", "MB"),
            ("each_peak_bytes", "each MB", "MB"),
            ("all_peak_bytes", "all MB", "MB"),
            ("negative_pivots", "negative pivots", "n"),
            ("frequency_difference", "frequencies", "e"),
            ("matrix_difference", "matrices", "e"),
        ),
    )
    for words, first, second, key in (
        ("2 workers over 1, wall", BOTH, ALONE, "reduce_seconds"),
        ("2 workers over 2 threads, wall", BOTH, THREADS, "reduce_seconds"),
        ("2 ranks over 1 process, processor time", TWO, ONE, "cpu_seconds"),
    ):
        report.compare(words, ratios(rounds, (first, key), (second, key)))
    for words, first, key, second in (
        ("a worker of 2 over the job alone, memory", BOTH, "each_peak_bytes", ALONE),
        ("a rank of 2 over one process, memory", TWO, "each_peak_bytes", ONE),
    ):
        report.compare(words, ratios(rounds, (first, key), (second, "process_peak_bytes")))
    report.write()


def _add(row: Row, found: Row) -> None:
    """What was found of the results of a job; the memory that finding it took is none of the job's."""
    row |= {key: value for key, value in found.items() if key != "process_peak_bytes"}


def _body(words: str, settings: Settings) -> Path:
    return settings.folder / f"{words.replace(', ', '_').replace(' ', '_')}.h5"


def _measure(words: str, dofs: int, settings: Settings) -> Callable[[], Row]:
    method, threads, keys = RUNS[words]

    def measured() -> Row:
        job = written("cube", dofs, None, settings, reduction=method)
        body = _body(words, settings)
        body.unlink(missing_ok=True)
        changes = [f"solver.{key}" for key in (f"threads={threads}", *keys)]
        changes += [f'output.path="{body}"', "check.full_modes=0"]
        given = [word for change in changes for word in ("--set", change)]
        watch = Watch()
        watch.start()
        ended = run(command("reduce", job, "--json", *given), replace(settings, threads=threads))
        found = watch.stop()
        if ended.code:
            return {"error": ended.last_error().replace(str(settings.folder), "FOLDER")}
        (document,) = json.loads(ended.output)
        return {
            "dofs": document["dofs"],
            "seconds": ended.seconds,
            "threads": threads,
            **found,
            "reduce_seconds": document["seconds"][f"reduce {method['method']}"],
        }

    return measured


CASES: dict[str, Callable[[Settings], None]] = {"workers": workers}
