"""Reports for a terminal, a pipe or a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table

from morembs.app.report.sections import Place, Section
from morembs.app.report.style import STYLE
from morembs.app.report.words import bytes_words


def say(console: Console, *lines: str) -> None:
    """Print sentences as they are: only a terminal breaks them, and nothing in them is markup."""
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False)


def print_sections(console: Console, sections: Sequence[Section]) -> None:
    """Print each with its title, table and sentences."""
    for section in sections:
        if section.columns:
            table = plain_table(*section.columns)
            for row in section.rows:
                table.add_row(*map(escape, row))
            print_table(console, section.title, table)
        say(console, *section.lines)


def print_document(
    console: Console, document: Mapping[str, Any], sections: Sequence[Section], shown_warnings: Sequence[str] = ()
) -> None:
    """A finished job by the ``sections`` of its document; a terminal omits the warnings of ``shown_warnings``."""
    first, *others = [line for section in sections if section.place == Place.SUMMARY for line in section.lines]
    console.print(f"[bold]{Path(document['job']).name}[/]: {escape(first)}", highlight=False, soft_wrap=True)
    say(console, *others)
    print_sections(console, [section for section in sections if section.place == Place.TABLES])
    print_sections(console, [_cost(document)])
    console.print()
    print_sections(console, [section for section in sections if section.place == Place.REMARKS])
    say(
        console,
        *(f"warning: {text}" for text in document["warnings"] if text not in shown_warnings or not console.is_terminal),
    )
    print_written(console, document["written"])


def print_written(console: Console, files: Sequence[object]) -> None:
    """The files that were written."""
    say(console, "written: " + ", ".join(map(str, files)))


def _cost(document: Mapping[str, Any]) -> Section:
    seconds, peaks = document["seconds"], document["peak_memory_bytes"]
    rows = [(name, f"{seconds[name]:.2f}", bytes_words(peaks[name])) for name in seconds]
    rows.append(("all", f"{sum(seconds.values()):.2f}", bytes_words(document["job_peak_memory_bytes"])))
    return Section(title="cost", columns=("stage", "seconds", "peak memory"), rows=rows)


def plain_table(*columns: str) -> Table:
    """A table without lines: a column of names and columns of numbers."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column(columns[0], no_wrap=True)
    for column in columns[1:]:
        table.add_column(column, justify="right")
    table.show_header = any(columns)
    return table


def print_table(console: Console, title: str, table: Table) -> None:
    """Print a table; on a terminal that is too narrow its lines run on below, and no word or number is broken."""
    console.print(f"\n[bold]{title}[/]", highlight=False, soft_wrap=True)
    for column in table.columns:
        texts = [str(column.header), *map(str, column.cells)]
        words = texts if column.no_wrap else [word for text in texts for word in text.split()]
        column.min_width = max(map(len, words), default=0)
    width = console.width
    console.width = max(
        width, Measurement.get(console, console.options.update(width=STYLE.max_table_width), table).minimum
    )
    console.print(table, crop=False)
    console.width = width
