"""Cases about solvers: the same matrix through several of them, in memory and on disk; and the modes of a body.

The matrices are the stiffness of a cube of ten-node tetrahedra on springs that hold its rigid-body modes.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from measure import Report, Rounds, Row, Settings, child, in_rounds, ratios, required

Spec = dict[str, Any]
DEFAULT = "default"
# Order of the dense product that the speed of factorisations is compared with.
ORDER, QUICK_ORDER = 4096, 1024
_FACTOR = (
    ("analyse_seconds", "analyse s", "s"),
    ("factor_seconds", "factor s", "s"),
    ("ready_seconds", "all s", "s"),
    ("solve_seconds", "solve s", "s"),
    ("columns", "columns", "n"),
    ("gflops", "GF/s", "f"),
    ("dgemm_gflops", "DGEMM", "f"),
    ("share_of_dgemm", "share", "%"),
    ("factor_peak_bytes", "factor MB", "MB"),
    ("peak_rise_bytes", "peak MB", "MB"),
    ("factor_entries", "1e9 entries", "G"),
    ("disk_bytes", "disk MB", "MB"),
    ("backward_error", "error", "e"),
    ("choice", "chosen", "text"),
)
_NOTE = (
    "all: analysis, factorisation and the check of the factor; factor MB: highest memory until then, peak MB: highest "
    "memory of the process, both less what was resident before"
)


def speed(settings: Settings) -> float:
    """DGEMM of NumPy now, in 10^9 operations per second."""
    order = QUICK_ORDER if settings.quick else ORDER
    return float(required("dgemm", settings, order=order)["gflops"])


class Beside:
    """Measurements between two of the speed of DGEMM each, so that the share is that of the same minutes.

    A quick run takes that speed once.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._before = speed(settings)

    def __call__(self, task: str, spec: Spec) -> Row:
        row = child(task, self.settings, **spec)
        before, self._before = self._before, self._before if self.settings.quick else speed(self.settings)
        if "error" in row:
            return row
        row["dgemm_gflops"] = 0.5 * (before + self._before)
        if row.get("flops"):
            row["gflops"] = 1e-9 * row["flops"] / row["factor_seconds"]
            row["share_of_dgemm"] = row["gflops"] / row["dgemm_gflops"]
        row["peak_rise_bytes"] = row["process_peak_bytes"] - row["resident_bytes"]
        return row


def compared(specs: Mapping[str, Spec], dofs: int, settings: Settings) -> Rounds:
    """Each of ``specs`` (name -> task and options of child.py) on the cube, round by round."""
    file = str(settings.folder / f"cube_{dofs}.npz")
    required("matrix", settings, shape="cube", dofs=dofs, file=file)
    beside = Beside(settings)

    def measurement(spec: Spec) -> Callable[[], Row]:
        options = {key: value for key, value in spec.items() if key != "task"}
        return lambda: beside(spec.get("task", "factor"), {"matrix": file, **options})

    return in_rounds({name: measurement(spec) for name, spec in specs.items()}, settings.repeat)


def total(rounds: Rounds, count: int) -> None:
    """Add the seconds from the matrix to the solution of ``count`` right-hand sides, where they were solved."""
    for row in (row for rows in rounds.values() for row in rows):
        if (seconds := row.get(f"solve_{count}_seconds")) is not None:
            row[f"total_{count}_seconds"] = row["ready_seconds"] + seconds


def small(settings: Settings) -> None:
    """SciPy's SuperLU, as one would call it, against the default of this package."""
    dofs = 6_000 if settings.quick else 26_000
    orders = {"splu COLAMD": None, "splu MMD_AT_PLUS_A": "MMD_AT_PLUS_A"}
    scipys: dict[str, Spec] = {name: {"task": "splu", "order": order} for name, order in orders.items()}
    specs = {DEFAULT: {"solver": "auto"}, **scipys}
    rounds = compared({name: {**spec, "columns": [100]} for name, spec in specs.items()}, dofs, settings)
    total(rounds, 100)
    report = Report("small", settings)
    report.add(rounds)
    report.table(f"small: cube of about {dofs:,} dofs, 100 right-hand sides\n{_NOTE}", _FACTOR)
    keys = {
        "ready_seconds": "seconds until the factor is ready",
        "factor_peak_bytes": "memory of the factorisation",
        "factor_entries": "factor entries",
        "total_100_seconds": "seconds with 100 right-hand sides",
    }
    for name in scipys:
        for key, words in keys.items():
            report.compare(f"{name} over default, {words}", ratios(rounds, (name, key), (DEFAULT, key)))
    report.write()


def medium(settings: Settings) -> None:
    """All solvers but SuperLU on one matrix: how near the default comes to the fastest."""
    dofs = 6_000 if settings.quick else 104_000
    names = ("mumps", "cholmod", "pardiso", "umfpack", "amg", "mumps-embedded")
    specs = {DEFAULT: {"solver": "auto"}, **{name: {"solver": name} for name in names}}
    rounds = compared({name: {**spec, "columns": [100]} for name, spec in specs.items()}, dofs, settings)
    total(rounds, 100)
    report = Report("medium", settings)
    report.add(rounds)
    report.table(f"medium: cube of about {dofs:,} dofs, 100 right-hand sides\n{_NOTE}", _FACTOR)
    # Multigrid has no factor: its work is in the solves.
    direct = [name for name in names if name != "amg"]
    for key, words, others in (
        ("factor_seconds", "numerical factorisation", direct),
        ("ready_seconds", "until the factor is ready", direct),
        ("total_100_seconds", "with 100 right-hand sides", names),
    ):
        known = {name: report.rows[name][key] for name in others if report.rows[name].get(key)}
        if known:
            best = min(known, key=lambda name: known[name])
            report.compare(
                f"default over the fastest ({best}), seconds {words}", ratios(rounds, (DEFAULT, key), (best, key))
            )
    report.write()


def large(settings: Settings) -> None:
    """A factor in memory, on disk, and in single precision."""
    dofs = 15_000 if settings.quick else 305_000
    specs: dict[str, Spec] = {
        "cholmod": {"solver": "cholmod", "columns": [30, 100]},
        "pardiso": {"solver": "pardiso", "columns": [30, 100]},
        "mumps": {"solver": "mumps", "columns": [30, 100], "out_of_core": False},
        "mumps on disk": {"solver": "mumps", "columns": [100], "out_of_core": True, "cold": True},
        "mumps-mixed": {"solver": "mumps-mixed", "columns": [30], "out_of_core": False},
    }
    rounds = compared(specs, dofs, settings)
    total(rounds, 30)
    for row in (row for row in rounds["mumps on disk"] if row.get("disk_bytes")):
        row["read_share"] = row["read_bytes"] / row["disk_bytes"]
    report = Report("large", settings)
    report.add(rounds)
    columns = (*_FACTOR[:-1], ("read_bytes", "read MB", "MB"), ("total_30_seconds", "all + 30 s", "s"))
    report.table(
        f"large: cube of about {dofs:,} dofs; before the solve on disk the system forgets the files\n{_NOTE}", columns
    )
    disk, mixed, core = "mumps on disk", "mumps-mixed", "mumps"
    for name, key, words in (
        (disk, "factor_seconds", "seconds of the factorisation"),
        (disk, "factor_peak_bytes", "memory of the factorisation"),
        (disk, "peak_rise_bytes", "peak memory with the solve"),
        (disk, "solve_100_seconds", "seconds for 100 right-hand sides, cold"),
        (mixed, "factor_seconds", "seconds of the factorisation"),
        (mixed, "factor_bytes", "bytes of the factor"),
        (mixed, "factor_peak_bytes", "memory of the factorisation"),
        (mixed, "total_30_seconds", "seconds with 30 right-hand sides"),
        ("cholmod", "factor_seconds", "seconds of the factorisation"),
        ("cholmod", "factor_peak_bytes", "memory of the factorisation"),
    ):
        report.compare(f"{name} over mumps in memory, {words}", ratios(rounds, (name, key), (core, key)))
    report.compare(
        "bytes read by the cold solve over the factor on disk",
        ratios(rounds, (disk, "read_bytes"), (disk, "disk_bytes")),
    )
    report.write()


# Solvers with a factor in memory, and thousands of dofs with the numbers of threads.
DIRECT = ("cholmod", "mumps", "mumps-embedded", "pardiso")
SIZES, QUICK_SIZES = ((59, (1, 2)), (104, (1, 2)), (305, (2,))), ((6, (1, 2)),)


def factor(settings: Settings) -> None:
    """Factorisations in memory on one thread and on two, beside DGEMM on as many."""
    report = Report("factor", settings)
    for size, counts in QUICK_SIZES if settings.quick else SIZES:
        for threads in counts:
            specs: dict[str, Spec] = {
                f"{name} {size}k, threads: {threads}": {"solver": name, "columns": [30]} for name in DIRECT
            }
            rounds = compared(specs, 1000 * size, replace(settings, threads=threads))
            report.add(rounds)
            first, second = (f"{name} {size}k, threads: {threads}" for name in ("mumps-embedded", "mumps"))
            key = "factor_cpu_seconds"
            report.compare(f"{first} over {second}, processor seconds", ratios(rounds, (first, key), (second, key)))
    columns = (*_FACTOR[:-2], ("factor_cpu_seconds", "processor s", "s"), _FACTOR[-2])
    report.table(f"factor: cubes on one thread and on two\n{_NOTE}", columns)
    report.write()


_MODES = (
    ("ready_seconds", "factor s", "s"),
    ("lanczos_seconds", "Lanczos s", "s"),
    ("count_seconds", "count s", "s"),
    ("all_seconds", "all s", "s"),
    ("all_processor", "processor s", "s"),
    ("solve_seconds", "solves s", "s"),
    ("solve_columns", "columns", "n"),
    ("passes", "passes", "n"),
    ("last_hz", "last Hz", "f"),
    ("residual", "residual", "e"),
    ("modes_peak_bytes", "peak MB", "MB"),
    ("dgemm_gflops", "DGEMM", "f"),
    ("solver", "solver", "text"),
)
# As stages.py has them, which this process must not import: it stays small.
STAGES = ("count", "solves", "solves_shifted", "products", "orthogonal", "vectors", "small", "rest")
# Shape, dofs (the rod has one mesh, and a small one), modes.
BODIES = (("cube", 104_000, 50), ("rod", 73_728, 12), ("beam", 104_000, 300))
QUICK_BODIES = (("cube", 6_000, 50), ("rod", 10_000, 12))
# ARPACK takes from minutes to an hour for each of these: measured once.
MANY_BODIES = (("cube", 104_000, 300), ("cube", 104_000, 1000), ("cube", 26_000, 2000))
QUICK_MANY_BODIES = (("cube", 6_000, 400),)


def modes(settings: Settings) -> None:
    """Lowest modes of free bodies with the Sturm count, against ARPACK with the same factor, and SLEPc with its own."""
    _modes_of(QUICK_BODIES if settings.quick else BODIES, settings)


def many_modes(settings: Settings) -> None:
    """Hundreds and thousands of modes, as rows of ``modes``."""
    _modes_of(QUICK_MANY_BODIES if settings.quick else MANY_BODIES, settings)


def _modes_of(bodies: Sequence[tuple[str, int, int]], settings: Settings) -> None:
    beside, ours, theirs = Beside(settings), "block Lanczos with count", ("ARPACK", "SLEPc")
    specs = {f"{count} modes, {shape}": {"shape": shape, "dofs": dofs, "count": count} for shape, dofs, count in bodies}
    both = in_rounds({name: lambda spec=spec: beside("modes", spec) for name, spec in specs.items()}, settings.repeat)
    rounds: Rounds = {}
    for name, rows in both.items():
        rounds[f"{name}: {ours}"] = [
            {k: v for k, v in row.items() if not k.startswith(("arpack", "slepc"))} for row in rows
        ]
        for other in theirs:
            rounds[f"{name}: {other} without count"] = [_of_other(row, other) for row in rows]
    report = Report("modes", settings)
    report.add(rounds)
    report.table(
        "modes: lowest modes of free bodies\n"
        "count: analysis and factorisation of K - sigma M; Lanczos: all else after the factorisation, solves at both "
        "shifts included; ARPACK: the same modes; stages: processor seconds after the factorisation",
        (*_MODES, *((f"{stage}_stage_processor", stage, "s") for stage in STAGES)),
    )
    for name, other in itertools.product(both, theirs):
        mine, beside_it = f"{name}: {ours}", f"{name}: {other} without count"
        for unit, words in (("seconds", "seconds"), ("processor", "processor seconds")):
            if other == theirs[0]:
                values = ratios(rounds, (mine, f"all_{unit}"), (mine, f"ready_{unit}"))
                report.compare(f"{name}: whole eigen-solution over its analysis and factorisation, {words}", values)
            values = ratios(rounds, (mine, f"all_{unit}"), (beside_it, f"all_{unit}"))
            report.compare(f"{name}: whole eigen-solution over that of {other}, {words}", values)
        values = ratios(rounds, (mine, "modes_processor"), (beside_it, "modes_processor"))
        report.compare(f"{name}: modes and count over modes of {other}, processor seconds", values)
    report.write(some=True)


def _of_other(row: Row, name: str) -> Row:
    """What another eigensolver did in the same process: ARPACK with the same factor, SLEPc with its own."""
    key = name.lower()
    own = {k.removeprefix(f"{key}_"): value for k, value in row.items() if k.startswith(f"{key}_")}
    if "error" in row or "error" in own:
        return {"error": row.get("error", own.get("error"))}
    ready = {"solver": row["solver"], "ready_seconds": row["ready_seconds"], "ready_processor": row["ready_processor"]}
    own = ready | own
    seconds = own.pop("seconds")
    return {
        **own,
        "dofs": row["dofs"],
        "lanczos_seconds": seconds,
        "all_seconds": own["ready_seconds"] + seconds,
        "all_processor": own["ready_processor"] + own["modes_processor"],
    }


CASES: dict[str, Callable[[Settings], None]] = {
    "small": small,
    "medium": medium,
    "large": large,
    "factor": factor,
    "modes": modes,
    "many-modes": many_modes,
}
