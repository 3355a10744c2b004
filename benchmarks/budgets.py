"""Case about budgets in force: twenty models and budgets, whose peak memory may not pass the budget by more than 5 %.

A budget that is refused is raised to the one that the message names, which then has to do.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace

from jobs import reduced, written
from measure import Report, Row, Settings, in_rounds

MOST = 1.05
# Messages may send a job to a larger budget: before the model is read, once its dofs are known, and once
# its factor is.
TRIES = 4
CERTIFIED = "\n[certify]\nband_hz = [0, 2000]\n"
STRESSED = '\n[stress]\nnodes = "skin"\n'
# Reductions beside the one by Craig-Bampton that every job has.
MODAL = '\n[[reduce]]\nmethod = "modal"\nmodes = 60\n'
FREE = '\n[[reduce]]\nmethod = "free-interface"\nmodes = 60\n'
KRYLOV = '\n[[reduce]]\nmethod = "krylov"\nshifts_hz = [0.0, 1000.0]\nmoments = 2\n'
GRAMIAN = '\n[[reduce]]\nmethod = "gramian"\nband_hz = [0, 2000]\ntolerance = 1e-3\n'
AUTO = '\n[[reduce]]\nmethod = "auto"\nband_hz = [0, 2000]\ntolerance = 1e-3\n'


@dataclass(frozen=True)
class Case:
    """A model of ``shape`` with about ``dofs``, tables on top of its plain job, a budget as a part of the peak memory
    that the plain job has without one."""

    shape: str
    dofs: int
    part: float
    extra: str = ""

    @property
    def name(self) -> str:
        """Words for the table."""
        methods = re.findall(r'method = "([^"]+)"', self.extra) or re.findall(r"\[(\w+)\]", self.extra)
        extra = "".join(f"{word} " for word in methods)
        return f"{self.shape} {self.dofs:,} {extra}{100 * self.part:.0f} %"


QUICK: tuple[Case, ...] = (Case("cube", 3_000, 0.5), Case("beam", 3_000, 0.5), Case("beam", 6_000, 0.95))
# The least parts are below what the program itself needs, and have to be refused.
ALL: tuple[Case, ...] = (
    Case("beam", 6_000, 0.5),
    *(Case("beam", 20_000, part) for part in (0.6, 0.9)),
    *(Case("cube", 20_000, part) for part in (0.5, 0.7, 0.9)),
    *(Case("crankshaft", 20_000, part) for part in (0.7, 0.8, 0.95)),
    *(Case("crankshaft", 20_000, 0.7, extra) for extra in (CERTIFIED, STRESSED, MODAL, FREE, KRYLOV, GRAMIAN, AUTO)),
    *(Case("crankshaft", 60_000, part) for part in (0.4, 0.5, 0.75)),
    Case("crankshaft", 60_000, 0.5, CERTIFIED + STRESSED),
)


def budgets(settings: Settings) -> None:
    """Peak memory over the budget; the ratios of the report are what the case is about."""
    free: dict[tuple[str, int], Row] = {}
    measures: dict[str, Callable[[], Row]] = {
        case.name: lambda case=case: _measured(case, free, settings) for case in (QUICK if settings.quick else ALL)
    }
    rounds = in_rounds(measures, settings.repeat)
    report = Report("budgets", settings)
    report.add(rounds)
    report.table(
        f"budgets: peak memory within a budget, at most {100 * (MOST - 1):.0f} % above it",
        [
            ("dofs", "dofs", "n"),
            ("free_bytes", "free MB", "MB"),
            ("asked_bytes", "asked MB", "MB"),
            ("refused", "refused", "n"),
            ("budget_bytes", "budget MB", "MB"),
            ("process_peak_bytes", "peak MB", "MB"),
            ("share", "share", "%"),
            ("disk_bytes", "disk MB", "MB"),
            ("solver", "solver", "text"),
            ("stage", "peak stage", "text"),
        ],
    )
    shares = [row["share"] for row in report.rows.values() if "share" in row]
    report.compare("peak memory over the budget, each model", shares)
    print(f"above {100 * (MOST - 1):.0f} %: {sum(share > MOST for share in shares)} of {len(report.rows)}")
    report.write()


def _measured(case: Case, free: dict[tuple[str, int], Row], settings: Settings) -> Row:
    """Without a budget first, then with one, raised as far as the messages say."""
    model = (case.shape, case.dofs)
    if model not in free:
        free[model] = _run(replace(case, extra=""), None, settings)
    if "error" in free[model]:
        return free[model]
    unlimited = free[model]["process_peak_bytes"]
    asked = budget = int(case.part * unlimited)
    for refused in range(TRIES):  # noqa: B007
        row = _run(case, budget, settings)
        least = re.search(r"give at least (\d+) MB", row.get("error", ""))
        more = re.search(r"raise the budget by (\d+) MB", row.get("error", ""))
        if least is None and more is None:
            break
        budget = 1_000_000 * int(least[1]) if least else budget + 1_000_000 * int(more[1])
    if "error" in row:
        return {**row, "asked_bytes": asked, "budget_bytes": budget}
    return {
        **row,
        "free_bytes": unlimited,
        "asked_bytes": asked,
        "refused": refused,
        "budget_bytes": budget,
        "share": row["process_peak_bytes"] / budget,
    }


def _run(case: Case, budget: int | None, settings: Settings) -> Row:
    model = settings.folder / f"{case.shape}_{case.dofs}" / f"{case.shape}_{case.dofs}.toml"
    if not model.exists():
        written(case.shape, case.dofs, None, settings)
    text = model.read_text(encoding="utf-8")
    if budget is not None:
        text = text.replace("[solver]\n", f'[solver]\nmemory = "{budget} B"\n')
    job = model.with_stem(f"{model.stem}_within")
    job.write_text(text + case.extra, encoding="utf-8")
    row = reduced(job, settings)
    if "error" in row:
        return row
    peaks = row.pop("stage_peak_bytes")
    return {
        "dofs": row["dofs"],
        "solver": row["solver"],
        "seconds": row["seconds"],
        "process_peak_bytes": row["process_peak_bytes"],
        "stage": max(peaks, key=peaks.__getitem__),
        "stage_peak_bytes": peaks,
        "disk_bytes": row["factor"].get("disk_bytes"),
    }


CASES: dict[str, Callable[[Settings], None]] = {"budgets": budgets}
