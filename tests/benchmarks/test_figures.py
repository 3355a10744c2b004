"""Figures of README and docs are those of benchmarks/results, and say on which commit they were measured."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import figures
from measure import Report, Settings
from tables import FIGURES, TABLES, Table

TABLE = Table(
    "case",
    "body",
    (("seconds", "seconds", "s"), ("twice", lambda row: 2 * row["seconds"], "s")),
    (("first", "a"), ("second", "b"), ("third", "c")),
)
MACHINE = {"cores": 2, "model": "some processor", "system": "Linux", "blas_threads": 1}


def measured(seconds: float, commit: str) -> dict[str, object]:
    """A row of results."""
    return {"seconds": seconds, "commit": commit, "date": "2026-01-02", "threads": 1}


def test_pages_have_the_figures_of_the_results() -> None:
    assert not figures.stale(), "run benchmarks/figures.py"


def test_every_table_and_figure_is_on_a_page() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in figures.PAGES)
    marks = re.findall(r"<!-- (measured|figure): (.*?) -->", text)
    assert sorted(marks) == sorted([("measured", name) for name in TABLES] + [("figure", name) for name in FIGURES])


def test_a_table_says_what_it_was_measured_on_and_what_is_missing() -> None:
    rows = {"a": measured(1.5, "1234567"), "b": {"error": "no such solver", "commit": "1234567", "date": "2026-01-02"}}
    lines = figures.in_markdown(TABLE, {"machine": MACHINE, "rows": rows}).splitlines()
    assert lines[0] == "| body | seconds | twice |"
    assert lines[2:5] == [
        "| first | 1.50 | 3.00 |",
        "| second | no such solver |  |",
        "| third | not measured yet |  |",
    ]
    for words in ("run.py case", "1234567", "2026-01-02", "some processor", "1 thread "):
        assert words in lines[-1]
    rows["b"] = measured(2.0, "89abcde")
    lines = figures.in_markdown(TABLE, {"machine": MACHINE, "rows": rows}).splitlines()
    assert lines[2:4] == ["| first | 1.50 | 3.00 | 1234567 |", "| second | 2.00 | 4.00 | 89abcde |"]


def test_rows_that_were_not_measured_again_stay_with_their_commit(tmp_path: Path) -> None:
    settings = Settings(folder=tmp_path, results=tmp_path)
    for name, machine in (("a", MACHINE), ("b", MACHINE)):
        report = Report("case", settings, machine=machine)
        report.add({name: [{"seconds": 1.0}]})
        report.write(some=True)
        written = json.loads((tmp_path / "case.json").read_text())
        assert written["rows"][name]["threads"] == 1 and written["rows"][name]["commit"]
    assert set(written["rows"]) == {"a", "b"}
    # Figures of two machines are never in one table.
    report = Report("case", settings, machine={**MACHINE, "model": "another"})
    report.add({"c": [{"seconds": 1.0}]})
    report.write(some=True)
    assert set(json.loads((tmp_path / "case.json").read_text())["rows"]) == {"c"}
