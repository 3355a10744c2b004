"""Case about budgets in force: twenty models and budgets, whose peak memory may not pass the budget by more than 5 %.

A budget that is refused is raised to the one that the message names, which then has to do.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from jobs import reduced
from measure import Report, Row, Settings, in_rounds, required

MOST = 1.05
# Messages may send a job to a larger budget: before the model is read, once its matrices are known, and by rounding.
TRIES = 4
CERTIFIED = "\n[certify]\nband_hz = [0, 2000]\n"
STRESSED = '\n[stress]\nnodes = "skin"\n'
FREE = '\n[[reduce]]\nmethod = "free-interface"\nname = "free"\nmodes = 60\n'


@dataclass(frozen=True)
class Case:
    """A model of ``shape`` with about ``dofs``, a budget of ``part`` of its peak memory without one, tables on top."""

    shape: str
    dofs: int
    part: float
    extra: str = ""

    @property
    def name(self) -> str:
        """Words for the table."""
        extra = "".join(f"{table} " for table in re.findall(r"(?<=\[)\w+(?=\])", self.extra))
        return f"{self.shape} {self.dofs:,} {extra}{100 * self.part:.0f} %"


QUICK: tuple[Case, ...] = (
    Case("cube", 3_000, 0.5), Case("beam", 3_000, 0.5), Case("beam", 6_000, 0.9),
    *(Case(shape, 20_000, part) for shape in ("cube", "beam", "crankshaft") for part in (0.85, 0.95)),
    *(Case("crankshaft", 20_000, 0.8, extra) for extra in (CERTIFIED, STRESSED, FREE)),
    *(Case(shape, 60_000, part) for shape in ("cube", "crankshaft") for part in (0.4, 0.55, 0.75)),
    Case("crankshaft", 60_000, 0.5, CERTIFIED), Case("crankshaft", 60_000, 0.5, STRESSED),
)  # fmt: skip
ALL: tuple[Case, ...] = (
    *(Case(one.shape, 5 * one.dofs, one.part, one.extra) for one in QUICK[3:]), *QUICK[:3],
)  # fmt: skip


def budgets(settings: Settings) -> None:
    """Peak memory over the budget; the ratios of the report are what the case is about."""
    free: dict[tuple[str, int, str], Row] = {}
    measures: dict[str, Callable[[], Row]] = {
        one.name: lambda one=one: _measured(one, free, settings) for one in (QUICK if settings.quick else ALL)
    }
    rounds = in_rounds(measures, settings.repeat)
    report = Report("budgets", settings)
    report.add(rounds)
    report.table(
        f"budgets: peak memory within a budget, at most {100 * (MOST - 1):.0f} % above it",
        [
            ("dofs", "dofs", "n"), ("free_bytes", "free MB", "MB"), ("asked_bytes", "asked MB", "MB"),
            ("refused", "refused", "n"), ("budget_bytes", "budget MB", "MB"), ("process_peak_bytes", "peak MB", "MB"),
            ("share", "share", "%"), ("solver", "solver", "text"), ("stage", "peak stage", "text"),
        ],
    )  # fmt: skip
    shares = [row["share"] for row in report.rows.values() if "share" in row]
    report.compare("peak memory over the budget, each model", shares)
    print(f"above {100 * (MOST - 1):.0f} %: {sum(share > MOST for share in shares)} of {len(report.rows)}")
    report.write()


def _measured(one: Case, free: dict[tuple[str, int, str], Row], settings: Settings) -> Row:
    """Without a budget first, then with one, raised as far as the messages say."""
    model = (one.shape, one.dofs, one.extra)
    if model not in free:
        free[model] = _run(one, None, settings)
    if "error" in free[model]:
        return free[model]
    unlimited = free[model]["process_peak_bytes"]
    asked = budget = int(one.part * unlimited)
    for refused in range(TRIES):  # noqa: B007  (its last value is a result)
        row = _run(one, budget, settings)
        least = re.search(r"give at least (\d+) MB", row.get("error", ""))
        more = re.search(r"raise the budget by (\d+) MB", row.get("error", ""))
        if least is None and more is None:
            break
        # The words round to MB.
        budget = 1_000_000 * (int(least[1]) if least else budget // 1_000_000 + int(more[1]) + 2)
    if "error" in row:
        return {**row, "asked_bytes": asked, "budget_bytes": budget}
    return {
        **row, "free_bytes": unlimited, "asked_bytes": asked, "refused": refused, "budget_bytes": budget,
        "share": row["process_peak_bytes"] / budget,
    }  # fmt: skip


def _run(one: Case, budget: int | None, settings: Settings) -> Row:
    scratch = settings.folder / "scratch"
    scratch.mkdir(exist_ok=True)
    to, memory = settings.folder / f"budgets_{one.shape}_{one.dofs}", None if budget is None else f"{budget} B"
    job = Path(
        required(
            "job", settings, shape=one.shape, dofs=one.dofs, to=str(to), memory=memory, scratch=str(scratch)
        )["job"]
    )  # fmt: skip
    with job.open("a", encoding="utf-8") as file:
        file.write(one.extra)
    row = reduced(job, settings)
    if "error" in row:
        return row
    peaks = row.pop("stage_peak_bytes")
    return {
        "dofs": row["dofs"], "solver": row["solver"], "seconds": row["seconds"],
        "process_peak_bytes": row["process_peak_bytes"], "stage": max(peaks, key=peaks.__getitem__),
        "stage_peak_bytes": peaks,
    }  # fmt: skip


CASES: dict[str, Callable[[Settings], None]] = {"budgets": budgets}
