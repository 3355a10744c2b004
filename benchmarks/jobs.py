"""Cases about whole jobs, as processes of their own: large models within a budget, and forecasts against what comes.

Every job is a Craig-Bampton reduction with three rigid interfaces and 30 modes, from the mesh file to the body file.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from measure import Finished, Report, Rounds, Row, Settings, command, in_rounds, required, run, say

_GIB = 1 << 30
# Shape, dofs, budget in bytes, upper frequency in Hz of a certificate, if one is wanted.
Asked = tuple[str, int, int, float | None]
MILLION: tuple[Asked, ...] = (
    ("cube", 1_000_000, 8 * _GIB, None),
    ("crankshaft", 1_000_000, 4 * _GIB, None),
    ("crankshaft", 1_000_000, 5 * _GIB // 2, None),
    ("crankshaft", 1_000_000, 5 * _GIB // 2, 3000.0),
    ("beam", 2_000_000, 6 * _GIB, 2500.0),
)
QUICK_MILLION: tuple[Asked, ...] = (
    ("cube", 20_000, 400_000_000, None),
    ("crankshaft", 20_000, 300_000_000, None),
    ("beam", 20_000, 340_000_000, 2500.0),
)
SHAPES, SIZES = ("cube", "crankshaft", "beam"), (60_000, 150_000, 300_000)
# Smaller factors need less than the program itself, and no budget sends them to disk.
QUICK_SHAPES, QUICK_SIZES = ("crankshaft",), (60_000,)
# Budgets that are tried for one that forces the factor to disk, as parts of the peak without a budget.
PARTS = tuple(part / 100 for part in range(90, 25, -5))


def reduced(job: Path, settings: Settings) -> Row:
    """Run a job: seconds, peak memory, stages, and the figures of its factor."""
    ended = run(command("reduce", job, "--json"), settings)
    if ended.code:
        return _failed(ended, settings)
    (document,) = json.loads(ended.output)
    return {
        "dofs": document["dofs"],
        "solver": document["solver"],
        "seconds": ended.seconds,
        "process_peak_bytes": ended.peak,
        "stage_seconds": document["seconds"],
        "stage_peak_bytes": document["peak_memory_bytes"],
        "factor": document["factor"],
    }


def checked(job: Path, settings: Settings) -> Row:
    """The forecast of a job."""
    ended = run(command("check", job, "--json"), settings)
    return _failed(ended, settings) if ended.code else dict(json.loads(ended.output)[0])


def _failed(ended: Finished, settings: Settings) -> Row:
    return {"error": ended.last_error().replace(str(settings.folder), "FOLDER"), "seconds": ended.seconds}


def written(
    shape: str, dofs: int, budget: int | None, settings: Settings, more: str = "", reduction: Row | None = None
) -> Path:
    """Path of a job with a budget, in the folder of its model: one job of a model is there at a time.

    ``more`` are tables at its end, ``reduction`` that of another method.
    """
    to = settings.folder / f"{shape}_{dofs}"
    scratch = settings.folder / "scratch"
    scratch.mkdir(exist_ok=True)
    memory = None if budget is None else f"{budget} B"
    job = required(
        "job",
        settings,
        shape=shape,
        dofs=dofs,
        to=str(to),
        memory=memory,
        scratch=str(scratch),
        more=more,
        reduction=reduction,
    )
    return Path(job["job"])


def million(settings: Settings) -> None:
    """Large models in little memory. Each row is written when it is there, and is not measured again to ``resume``."""
    report = Report("million", settings)
    if settings.resume:
        report.resume()
    for asked in QUICK_MILLION if settings.quick else MILLION:
        shape, dofs, budget, hz = asked
        size = f"{budget / _GIB:.3g} GiB" if budget >= _GIB else f"{budget / 1e6:.0f} MB"
        name = f"{shape} {dofs:,} in {size}" + (", certified" if hz else "")
        if name not in report.rows:
            report.add(in_rounds({name: lambda asked=asked: _within(asked, settings)}, settings.repeat))
            report.write()
    stages = list(dict.fromkeys(key for row in report.rows.values() for key in row if key.startswith("stage: ")))
    report.table(
        "million: whole jobs within a budget, seconds by stage",
        [
            ("dofs", "dofs", "n"),
            ("seconds", "all s", "s"),
            *((stage, f"{stage.removeprefix('stage: ')} s", "s") for stage in stages),
            ("process_peak_bytes", "peak MB", "MB"),
            ("budget_bytes", "budget MB", "MB"),
            ("share", "share", "%"),
            ("disk_bytes", "disk MB", "MB"),
            ("passes", "passes", "n"),
            ("columns", "columns", "n"),
            ("over_factorise", "modes and all / factorise", "x"),
            ("solver", "solver", "text"),
            ("precision", "precision", "text"),
        ],
    )
    for name, row in report.rows.items():
        report.compare(f"{name}: peak memory over the budget", [row["share"]] if "share" in row else [])
    report.write()


def _within(asked: Asked, settings: Settings) -> Row:
    shape, dofs, budget, hz = asked
    job = written(shape, dofs, budget, settings, f"[certify]\nband_hz = [0.0, {hz}]\n" if hz else "")
    row = reduced(job, settings)
    for path in job.parent.iterdir():
        path.unlink()
    if "error" in row:
        return row
    stages = {f"stage: {name}": seconds for name, seconds in row.pop("stage_seconds").items()}
    factor = row["factor"]
    solved = sum(stages.get(f"stage: {name}", 0.0) for name in ("reduce craig-bampton", "certify", "compare"))
    return {
        **row,
        **stages,
        "budget_bytes": budget,
        "share": row["process_peak_bytes"] / budget,
        "disk_bytes": factor.get("disk_bytes"),
        "precision": factor.get("precision"),
        # There and back over the factor of the stiffness; a Sturm count is a factorisation of its own.
        "passes": factor.get("passes"),
        "columns": factor.get("columns"),
        "over_factorise": solved / stages["stage: factorise"],
    }


# Key of the forecast, what is measured, words.
_PAIRS = (
    ("factor_entries", "entries", "factor entries"),
    ("peak_memory_bytes", "peak", "peak memory"),
    ("scratch_bytes", "scratch", "scratch bytes of the factor"),
    ("factor_seconds", "seconds", "seconds of the factor"),
)


def forecast(settings: Settings) -> None:
    """Forecasts of "morembs check" against what "morembs reduce" then does, in memory and on disk."""
    rounds: Rounds = {}
    for shape in QUICK_SHAPES if settings.quick else SHAPES:
        for dofs in QUICK_SIZES if settings.quick else SIZES:
            say(f"  {shape} {dofs:,} ...")
            free = checked(written(shape, dofs, None, settings), settings)
            rounds[f"{shape} {dofs:,} in memory"] = _repeated(shape, dofs, None, free, settings)
            budget, plan = disk_budget(shape, dofs, free, settings)
            rounds[f"{shape} {dofs:,} on disk"] = _repeated(shape, dofs, budget, plan, settings)
    report = Report("forecast", settings)
    report.add(rounds)
    columns: list[tuple[str, str, str]] = [("budget_bytes", "budget MB", "MB")]
    for _, key, _ in _PAIRS:
        unit = {"entries": "G", "seconds": "s"}.get(key, "MB")
        heading = {"entries": "1e9 entries", "seconds": "factor s"}.get(key, f"{key} MB")
        columns += [(f"measured_{key}", heading, unit), (f"ratio_{key}", "ratio", "x")]
    columns += [("all_seconds", "job s", "s"), ("planned", "planned", "text"), ("solver", "solver", "text")]
    report.table("forecast: measured figures, and the ratio of the forecast to each", columns)
    for _, key, words in _PAIRS:
        values = [row[f"ratio_{key}"] for row in report.rows.values() if row.get(f"ratio_{key}")]
        report.compare(f"{words}, forecast over measured", values)
    report.write()


def disk_budget(shape: str, dofs: int, free: Row, settings: Settings) -> tuple[int, Row]:
    """A budget under which the factor goes to disk and what is forecast then; an error if there is none."""
    plan: Row = {"error": free.get("error", "no budget forces the factor to disk")}
    for part in PARTS if "error" not in free else ():
        budget = int(part * free["peak_memory_bytes"])
        plan = checked(written(shape, dofs, budget, settings), settings)
        if "error" in plan:
            return budget, {"error": f"no budget forces the factor to disk: {plan['error']}"}
        if plan["scratch_bytes"]:
            return budget, plan
    return 0, plan if "error" in plan else {"error": "no budget forces the factor to disk"}


def _repeated(shape: str, dofs: int, budget: int | None, plan: Row, settings: Settings) -> list[Row]:
    """The job against its forecast, as often as wanted."""
    if "error" in plan:
        return [plan]
    rows = []
    for _ in range(settings.repeat):
        row = reduced(written(shape, dofs, budget, settings), settings)
        rows.append(row if "error" in row else _against(plan, row, budget))
    return rows


def _against(plan: Row, row: Row, budget: int | None) -> Row:
    factor = row["factor"]
    measured: dict[str, Any] = {
        "entries": factor.get("factor_entries"),
        "peak": row["process_peak_bytes"],
        "scratch": factor.get("disk_bytes"),
        "seconds": factor.get("seconds"),
    }
    compared: Row = {
        "dofs": row["dofs"],
        "budget_bytes": budget,
        "planned": plan["solver"],
        "solver": row["solver"],
        "all_seconds": row["seconds"],
        "threads": factor.get("threads"),
    }
    for name, key, _ in _PAIRS:
        compared[f"forecast_{key}"], compared[f"measured_{key}"] = plan[name], measured[key]
        compared[f"ratio_{key}"] = plan[name] / measured[key] if measured[key] else None
    return compared


CASES: dict[str, Callable[[Settings], None]] = {"million": million, "forecast": forecast}
