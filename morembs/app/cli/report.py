"""What people get to see of forecasts and of comparisons."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from morembs.app.jobs.pareto import Contender
from morembs.app.report.sections import Section
from morembs.app.report.text import print_sections, print_written, say
from morembs.app.report.words import bytes_words
from morembs.base.progress import duration_words

# Rows and stages of a forecast that their keys do not explain.
LABELS = {
    "start": "start of Python",
    "stiffness_nonzeros": "nonzeros of K",
    "mass_nonzeros": "nonzeros of M",
    "matrices_bytes": "memory of K and M",
    "factor_entries": "nonzeros of the factor",
    "factor_flops": "operations of the factorisation",
    "factor_bytes": "memory of the factor",
    "scratch_bytes": "scratch files",
    "columns_bytes": "memory of the bases",
    "peak_memory_bytes": "peak memory",
    "factor_seconds": "factorisation in s",
    "reduction_seconds": "reductions",
    "seconds": "whole job",
    "shift_factor_entries": "nonzeros of the largest factor at a shift",
    "shift_factor_bytes": "memory of that factor",
    "shift_seconds": "factorisations at shifts in s",
    "processes": "workers or ranks beside it",
    "process_bytes": "memory of each of them",
    "all_processes_bytes": "peak memory of all processes",
    "witness_bytes": "size of the witness",
}
# Left out where there is nothing beside the one factorisation and the one process.
BESIDE = (
    *("shift_factor_entries", "shift_factor_bytes", "shift_seconds", "processes", "process_bytes"),
    "witness_bytes",
)


def print_forecast(console: Console, forecast: Mapping[str, Any]) -> None:
    """A checked job with the forecast of its time and memory, by its document."""
    rows = [
        (LABELS.get(key, key.removesuffix("_bytes").replace("_", " ")), _format_fact(key, value))
        for key, value in forecast.items()
        if key not in ("job", "warnings", "choice", "inputs") and (value or key not in BESIDE)
    ]
    count = len(forecast["warnings"])
    warned = f" can be run, with {count} warning{'s' if count > 1 else ''} below" if count else " is sound"
    print_sections(console, [Section(title=forecast["job"] + warned, columns=("", ""), rows=rows)])
    if forecast["choice"]:
        say(console, f"solver: {forecast['choice']}")
    for text in forecast["warnings"]:
        console.print(f"[yellow]warning:[/] {escape(text)}", highlight=False, soft_wrap=True)
    say(console, f"to run it: morembs reduce {shlex.quote(forecast['job'])}")


def _format_fact(key: str, value: Any) -> str:
    """A value of a forecast in words."""
    if key == "interface_nodes":
        return ", ".join(f"{name} {count:,}" for name, count in value.items()) or "none"
    if key == "reduction_seconds":
        known = ", ".join(f"{name} {duration_words(seconds)}" for name, seconds in value.items())
        return f"{known} (within a factor of three)" if known else "no forecast"
    if key == "seconds":
        longest = max(value, key=lambda name: value[name])
        return f"about {duration_words(sum(value.values()))}, longest step: {LABELS.get(longest, longest)}"
    if key == "extent":
        return " x ".join(f"{length:.4g}" for length in value) + " m"
    if key.endswith("_bytes"):
        return bytes_words(value)
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def print_contenders(console: Console, job: str, compared: Sequence[Contender], written: Sequence[Path]) -> None:
    """Reductions side by side; a star marks those on the Pareto front of size and error."""
    rows = []
    for contender in compared:
        known = contender.bound, contender.mean_error, contender.static_error, contender.held_error
        rows.append(
            (
                ("* " if contender.best else "  ") + contender.name,
                str(contender.order),
                f"{contender.error:.1e}",
                *("-" if value is None else f"{value:.1e}" for value in known),
                f"{contender.seconds:.2f}",
                bytes_words(contender.peak_memory_bytes),
            )
        )
    measures = " and ".join(sorted({contender.measure for contender in compared}))
    legend = (
        f"error: reached in the band, limit: not exceeded in it, by the measure of the certificate ({measures}); mean, "
        "pointwise: of |E(f)| / |H(f)| at the stored frequencies; held: the same with one interface held still, median "
        "over the band, worst interface; seconds: what reductions share (modes, the reference model) counts for the "
        "first that needs it; peak memory: of the process during it"
    )
    heads = ("body", "order", "error", "limit", "mean, pointwise", "static", "held, median", "seconds", "peak memory")
    title = f"{job}: reductions compared, * on the Pareto front of order and error"
    print_sections(console, [Section(title=title, columns=heads, rows=rows, lines=[legend])])
    print_written(console, written)
