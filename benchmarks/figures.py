"""Writes the measured figures of README and docs from benchmarks/results; run.py does so after its last case.

usage: python benchmarks/figures.py [--check]

A table stands between the lines <!-- measured: NAME --> and <!-- end -->, a figure within a sentence between
<!-- figure: NAME --> and <!-- end -->; what is around them is written by hand, and tables.py has their rows. Below each
table stands what it was measured on. With --check nothing is written, and the exit code is 1 where a page is stale.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from measure import HERE, ROOT, Row, shown
from tables import FIGURES, TABLES, Table

RESULTS = HERE / "results"
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
_MARK = re.compile(r"<!-- (measured|figure): (.*?) -->.*?<!-- end -->", re.DOTALL)


@cache
def results(case: str) -> dict[str, Any]:
    """What a case wrote; nothing where it has not run."""
    path = RESULTS / f"{case}.json"
    document = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    # The case of decks writes a list of them.
    return {"rows": {row["deck"]: row for row in document}} if isinstance(document, list) else dict(document)


def in_markdown(table: Table, document: dict[str, Any]) -> str:
    """A table with the line below it that says where its figures come from."""
    rows: dict[str, Row] = document.get("rows", {})
    present = [rows[name] for _, name in table.rows if name in rows]
    origins = list(dict.fromkeys((row["commit"], row["date"]) for row in present))
    lines = [[table.head, *(heading for heading, _, _ in table.columns)], ["---"] * (len(table.columns) + 1)]
    for words, name in table.rows:
        row = rows.get(name, {"error": "not measured yet"})
        cells = [_cell(row, key, unit) for _, key, unit in table.columns]
        if "error" in row:
            cells = [str(row["error"]), *[""] * (len(cells) - 1)]
        lines.append([words, *cells])
    if len(origins) > 1:
        # Rows that were measured on different days say which.
        ends = ["commit", "---", *(rows.get(name, {}).get("commit", "") for _, name in table.rows)]
        lines = [[*line, end] for line, end in zip(lines, ends, strict=True)]
    text = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    return f"{text}\n\n{_origin(table, document, origins, present)}"


def _cell(row: Row, key: str | Callable[[Row], Any], unit: str) -> str:
    if "error" in row:
        return ""
    return shown(key(row) if callable(key) else row.get(key), unit)


def _origin(table: Table, document: dict[str, Any], origins: list[tuple[str, str]], rows: list[Row]) -> str:
    if not origins:
        return f"(`benchmarks/run.py {table.case}` has not run yet.)"
    machine, threads = document["machine"], sorted({row["threads"] for row in rows if "threads" in row})
    count = " and ".join(map(str, threads))
    words = ", ".join(f"commit {commit} of {date}" for commit, date in origins)
    return (
        f"(`benchmarks/run.py {table.case}`, {words}; {machine['cores']} cores of {machine['model']}, {count} "
        f"thread{'s' * (threads != [1])} of the BLAS.)"
    )


def renewed(text: str) -> str:
    """A page with the figures as they are now."""

    def filled(mark: re.Match[str]) -> str:
        kind, name = mark[1], mark[2]
        if kind == "measured":
            table = TABLES[name]
            return f"<!-- measured: {name} -->\n{in_markdown(table, results(table.case))}\n<!-- end -->"
        case, words = FIGURES[name]
        rows = results(case).get("rows", {})
        return f"<!-- figure: {name} -->{words(rows) if rows else 'not measured yet'}<!-- end -->"

    return _MARK.sub(filled, text)


def stale() -> dict[Path, str]:
    """Pages that are not as they should be, and how they should be."""
    pages = {page: page.read_text(encoding="utf-8") for page in PAGES}
    return {page: new for page, text in pages.items() if (new := renewed(text)) != text}


def write() -> None:
    """Write the pages that are stale."""
    for page, text in stale().items():
        page.write_text(text, encoding="utf-8")
        print(f"written: {page.relative_to(ROOT)}")


def main() -> int:
    """Write the pages, or with --check say which are stale."""
    if "--check" not in sys.argv[1:]:
        write()
        return 0
    pages = stale()
    for page in pages:
        print(f"{page.relative_to(ROOT)} does not have the figures of benchmarks/results; run benchmarks/figures.py")
    return int(bool(pages))


if __name__ == "__main__":
    raise SystemExit(main())
