"""The tables of measured figures in README and docs, and the figures within their sentences."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from job_times import JOBS
from measure import Row, shown

Rows = dict[str, Row]
# Heading, key of a row or what to make of one, unit of ``measure.shown``.
Column = tuple[str, str | Callable[[Row], Any], str]


@dataclass(frozen=True)
class Table:
    """Rows of results in Markdown: ``rows`` are (words, name of the row in the results of ``case``)."""

    case: str
    head: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[str, str], ...]


def _same(*names: str) -> tuple[tuple[str, str], ...]:
    return tuple((name, name) for name in names)


_PEAK: Column = ("peak of the process, MB", "process_peak_bytes", "MB")
_DOFS: Column = ("dofs", "dofs", "n")
_FACTOR: tuple[Column, ...] = (
    _DOFS,
    ("threads", "threads", "n"),
    ("analysis, s", "analyse_seconds", "s"),
    ("factorisation, s", "factor_seconds", "s"),
    ("GF/s", "gflops", "f"),
    ("of DGEMM", "share_of_dgemm", "%"),
    ("with its check, processor s", "factor_cpu_seconds", "s"),
    ("30 columns, s", "solve_30_seconds", "s"),
    ("memory, GB", "factor_peak_bytes", "GB"),
    ("backward error", "backward_error", "e"),
)
_WAYS: tuple[Column, ...] = (
    _DOFS,
    ("factorisation, s", "factor_seconds", "s"),
    ("100 columns, s", "solve_100_seconds", "s"),
    ("memory, GB", "factor_peak_bytes", "GB"),
    ("backward error", "backward_error", "e"),
)
_MODES: tuple[Column, ...] = (
    ("analysis and factorisation, s", "ready_seconds", "s"),
    ("those of the count, s", "count_seconds", "s"),
    ("all, s", "all_seconds", "s"),
    ("all, processor s", "all_processor", "s"),
    ("columns solved", "solve_columns", "n"),
    ("passes over a factor", "passes", "n"),
    ("residual", "residual", "e"),
)
_BODIES = ("50 modes, cube", "12 modes, rod", "300 modes, beam", "300 modes, cube")
_REDUCTIONS = (
    ("crankshaft", "crankshaft 104,000", "morembs"),
    ("with pyMOR's parts", "crankshaft 104,000", "pyMOR, block"),
    ("crankshaft", "crankshaft 26,000", "morembs"),
    ("with pyMOR's parts", "crankshaft 26,000", "pyMOR, block"),
    ("pyMOR's SOBHIReductor", "crankshaft 26,000", "pyMOR, SOBHIReductor"),
    ("cube", "cube 26,000", "morembs"),
    ("with pyMOR's parts", "cube 26,000", "pyMOR, block"),
)
_SECONDS: Column = ("seconds", "seconds", "s")
_STEP: Column = ("ms per step", "step_seconds", "ms")
_OFFLINE: Column = ("offline, s", "offline_seconds", "s")

# fmt: off
TABLES: dict[str, Table] = {
    "jobs": Table(
        "million", "whole job, mesh to body, 30 modes of Craig-Bampton",
        (
            _DOFS, ("budget, GiB", "budget_bytes", "GiB"), ("seconds", "seconds", "n"),
            ("factorisation alone, s", lambda row: row["factor"]["seconds"], "n"),
            ("passes over it", "passes", "n"), ("columns", "columns", "n"),
            ("peak of the process, GiB", "process_peak_bytes", "GiB"),
        ),
        (
            ("crankshaft", "crankshaft 1,000,000 in 4 GiB"), ("crankshaft", "crankshaft 1,000,000 in 2.5 GiB"),
            ("cube", "cube 1,000,000 in 8 GiB"), ("beam, certified to 2500 Hz", "beam 2,000,000 in 6 GiB, certified"),
        ),
    ),
    "factor": Table("factor", "cube of ten-node tetrahedra", _FACTOR, tuple(
        (f"`{name}`", f"{name} {size}k, threads: {threads}")
        for size, counts in ((59, (1, 2)), (104, (1, 2)), (305, (2,))) for threads in counts
        for name in ("cholmod", "mumps", "mumps-embedded", "pardiso")
    )),
    "others": Table("medium", "the same cube, other solvers", _WAYS, _same("cholmod", "umfpack", "amg")),
    "disk": Table("large", "the same cube, on disk and in single precision", (
        *_WAYS[:2], ("30 columns, s", "solve_30_seconds", "s"), *_WAYS[2:]
    ), _same("mumps", "mumps on disk", "mumps-mixed")),
    "assembly": Table(
        "parts", "K and M",
        (
            _DOFS, ("processor seconds", "cpu_seconds", "s"), ("K and M, MB", "bytes_of_K_and_M", "MB"),
            ("memory over K and M, these included", lambda row: row["peak_rise_bytes"] / row["bytes_of_K_and_M"], "x"),
        ),
        (
            ("cube of 235,824 tet10", "assemble_million"), ("cube of 48,000 tet10", "assemble_cube"),
            ("the same by the forms of scikit-fem", "assemble_cube_scikit_fem"),
        ),
    ),
    "couple": Table(
        "parts", "matrices of the coupled body",
        (
            _DOFS, ("seconds", "seconds", "s"), ("processor seconds", "cpu_seconds", "s"),
            ("the system's part", "system_seconds", "s"), _PEAK,
        ),
        (("beam with rigid ends, in memory", "couple_beam"), ("arrays in scratch files", "couple_beam_in_files")),
    ),
    "modes": Table("modes", "lowest modes of free bodies", _MODES, tuple(
        (f"{body}: {words}", f"{body}: {name}") for body in _BODIES
        for words, name in (
            ("with the count", "block Lanczos with count"), ("ARPACK", "ARPACK without count"),
            ("SLEPc", "SLEPc without count"),
        )
    )),
    "krylov": Table(
        "krylov", "Krylov reduction at 3 points, 12 loads, order 72",
        (_DOFS, _SECONDS, ("factorisations", "factorisations", "n"), ("memory, GB", "peak_rise_bytes", "GB"),
         ("error", "response_error", "e")),
        tuple((words, f"{body}: {who}") for words, body, who in _REDUCTIONS),
    ),
    "published": Table(
        "published", "model and method",
        (
            _DOFS, ("order", "order", "n"), ("H2 error", "h2_error", "e"), ("pyMOR", "pymor_h2_error", "e"),
            ("H-infinity error", "hinf_error", "e"), ("pyMOR", "pymor_hinf_error", "e"), _SECONDS,
            ("pyMOR", "pymor_seconds", "s"),
        ),
        tuple(
            (f"{model}, {words}", f"{model}, {method}")
            for model in ("triple chain", "mass-spring-damper chain", "sandwich beam")
            for method, words in (("krylov", "Krylov"), ("irka", "IRKA"), ("fv", "BT, fv"), ("pv", "BT, pv"))
        ),
    ),
    "workers": Table(
        "workers", "cube, one body on several processes",
        (
            _DOFS, ("threads of each", "threads", "n"), ("reduction, s", "reduce_seconds", "s"),
            ("processor seconds of all", "cpu_seconds", "s"),
            ("peak of the job's process, MB", "process_peak_bytes", "MB"),
            ("of each of the others", "each_peak_bytes", "MB"), ("of all", "all_peak_bytes", "MB"),
            ("negative pivots", "negative_pivots", "n"), ("difference of frequencies", "frequency_difference", "e"),
            ("of matrices", "matrix_difference", "e"),
        ),
        tuple((words, name) for words, name in (
            ("Krylov at 8 shifts", "8 shifts, 1 worker"), ("on 2 workers", "8 shifts, 2 workers"),
            ("on 2 threads", "8 shifts, 1 worker, 2 threads"), ("30 modes, `mumps`", "30 modes, 1 process"),
            ("2 ranks", "30 modes, 2 ranks"),
        )),
    ),
    "sweep": Table(
        "krylov", "200 damped frequencies of the full model", (_DOFS, _SECONDS, ("error", "response_error", "e")),
        (("by the reference model", "crankshaft 26,000: full_response, damped"),
         ("factorised one by one", "crankshaft 26,000: direct sweep, damped")),
    ),
    "forecast of time": Table(
        "forecast-time", "whole jobs, one thread",
        (_DOFS, ("forecast, s", "forecast_seconds", "s"), ("processor seconds", "processor", "s"),
         ("forecast over job", "ratio", "x")),
        _same(*JOBS),
    ),
    "start": Table(
        "startup", "whole processes", (("processor seconds", "cpu_seconds", "s"), _PEAK),
        _same("import numpy, scipy.sparse, h5py", "morembs --version", "morembs --help", "morembs info",
              "morembs reduce"),
    ),
    "certify": Table(
        "certify", "processor seconds",
        (
            _DOFS, ("factorisation", "factor", "s"), ("modes", "modes", "s"),
            ("reference and first certificate", "scratch", "s"), ("`auto`, certified", "auto", "s"),
            ("a further body", "body", "s"),
        ),
        (("beam", "beam 25,000"), ("beam", "beam 74,000")),
    ),
    "fmu": Table(
        "fmu", "body of order 40",
        (
            ("million steps a minute", lambda row: 1e-6 * row["steps_a_minute"], "f"),
            ("growth of the memory, MB", "growth_bytes", "MB"),
        ),
        _same("linear", "floating"),
    ),
    "deck": Table(
        "parts", "Abaqus deck of nodes and hexahedra, until the mesh is there",
        (("text, MB", "file_bytes", "MB"), ("processor seconds", "cpu_seconds", "s"),
         ("MB a second", lambda row: 1e-6 * row["file_bytes"] / row["cpu_seconds"], "n")),
        (("hex8", "read_deck"),),
    ),
    "deck text": Table(
        "deck-text", "decks of nearly one block, from text to mesh and materials",
        (("text, MB", "file_bytes", "MB"), ("processor seconds", "cpu_seconds", "s"), ("MB a second", "speed", "n")),
        _same("abaqus, nine digits: nodes", "abaqus, 17 digits: nodes", "abaqus: elements",
              "nastran, small fields: nodes", "nastran, large fields: nodes", "nastran, free fields: nodes",
              "nastran, small fields: elements", "nastran, free fields: elements", "ansys: nodes", "ansys: elements"),
    ),
    "switching": Table(
        "switching", "tables of static modes",
        (
            _DOFS, ("candidates", "candidates", "n"), ("basis, s", "basis_seconds", "n"),
            ("tables, s", "table_seconds", "n"), _PEAK,
        ),
        _same("line, band 24", "surface, all pairs"),
    ),
    "moving load": Table(
        "steps", "a step of the moving load, ms",
        (("all nodes candidates", lambda row: _each(row, "all"), "text"),
         ("41 candidates", lambda row: _each(row, "few"), "text")),
        (("40, 120, 400 elements", "moving load"),),
    ),
    "rail": Table(
        "steps", "1500 steps on the rail, s",
        (("all dofs", "full_seconds", "s"), ("all static modes (from 64 steps)", "static_seconds", "s"),
         ("switched", "switched_seconds", "s")),
        (("60,095 dofs", "rail"),),
    ),
    "offline": Table(
        "gmp", "offline stage",
        (
            ("coordinates", "coordinates", "n"), ("points", "points", "n"),
            ("in tables and checks", "equilibria", "n"), ("solved", "solved", "n"),
            ("processor seconds", "cpu_seconds", "s"), _SECONDS,
        ),
        (
            ("rod, 240 elements, 0.83 rad, tolerance 1e-6", "rod"), ("symmetries not used", "rod, symmetries not used"),
            ("two workers", "rod, two workers"), ("solid, 0.6 rad, tolerance 2e-3", "solid"),
            ("symmetries not used", "solid, symmetries not used"), ("two workers", "solid, two workers"),
        ),
    ),
    "slider-crank": Table("steps", "slider-crank", (("coordinates", "coordinates", "n"), _STEP, _OFFLINE), tuple(
        (words, f"slider-crank: {words}") for words in (
            "full, 240 elements", "GMP, 240 elements", "full, 960 elements", "GMP, 960 elements", "Exudyn, 48 elements",
        )
    )),
    "pendulum": Table("steps", "pendulum", (_STEP,), (
        ("mechanism of `morembs.dynamics.nonlinear`", "pendulum: mechanism"),
        ("body of `morembs.dynamics.multibody`", "pendulum: body"),
    )),
}


# fmt: on
def _each(row: Row, kind: str) -> str:
    return ", ".join(f"{1e3 * row[f'{kind}_{count}_seconds']:.3g}" for count in (40, 120, 400))


def _budgets(rows: Rows) -> str:
    """How many models kept within their budgets."""
    shares = [row["share"] for row in rows.values() if "share" in row]
    within, refused = sum(share <= 1.05 for share in shares), len(rows) - len(shares)
    words = f"; {refused} were refused four times in a row" if refused else ""
    return f"{within} of {len(rows)} kept within 1.05 of their budget (median {statistics.median(shares):.2f}){words}"


def _ratio(rows: Rows, first: str, second: str, key: str) -> str:
    return f"{rows[first][key] / rows[second][key]:.2f}"


def _one_point(rows: Rows) -> str:
    costs = [row["one_ratio"] for row in rows.values() if "one_ratio" in row]
    return f"{min(costs):.1f} to {max(costs):.1f}"


def shown_with_unit(value: Any, unit: str) -> str:
    """A figure within a sentence or a cell; errors have no unit."""
    return shown(value, unit) + (f" {unit}" if unit in ("s", "GB") else "")


def _beside(ours: str, theirs: str, who: str, columns: tuple[tuple[str, str], ...]) -> Callable[[Rows], str]:
    """Cells of README: a row of ours, one of another program or method, and the commit of the first."""

    def cells(rows: Rows) -> str:
        own, other = (
            ", ".join(shown_with_unit(rows[name][key], unit) for key, unit in columns) for name in (ours, theirs)
        )
        return f"{own} | {who}: {other} | {rows[ours]['commit']}"

    return cells


def _within_a_row(name: str, key: str, unit: str) -> Callable[[Rows], str]:
    """Cells of README: a quantity of ours and of pyMOR that one row holds, and its commit."""

    def cells(rows: Rows) -> str:
        own, other = (shown_with_unit(rows[name][which], unit) for which in (key, f"pymor_{key}"))
        return f"{own} | pyMOR: {other} | {rows[name]['commit']}"

    return cells


def _decks(rows: Rows) -> str:
    """Cells of README: mean time of the decks that ccx computes and both ways take; decks with the same frequencies."""
    both = [
        row["ways"]
        for row in rows.values()
        if row["program"] == "computes" and all(row["ways"].get(way, {}).get("taken") for way in ("own", "calculix"))
    ]
    own, engine = (f"{sum(ways[way]['seconds'] for ways in both) / len(both):.2f} s" for way in ("own", "calculix"))
    equal = sum(ways["own"].get("difference", 1.0) <= 1e-6 for ways in both)
    link = "[file](benchmarks/results/decks.json)"
    return f"{own} a deck, {equal} of {len(both)} equal | CalculiX's matrices: {engine} a deck | {link}"


# Name -> case, and what to make of its rows.
FIGURES: dict[str, tuple[str, Callable[[Rows], str]]] = {
    "budgets": ("budgets", _budgets),
    "embedded": (
        "factor",
        lambda rows: _ratio(rows, "mumps-embedded 104k, threads: 1", "mumps 104k, threads: 1", "factor_cpu_seconds"),
    ),
    "assembly": ("parts", lambda rows: _ratio(rows, "assemble_cube", "assemble_cube_scikit_fem", "cpu_seconds")),
    "one point": ("krylov", _one_point),
    **{
        f"{count} modes of the {body}": (
            "modes",
            _beside(
                f"{count} modes, {body}: block Lanczos with count",
                f"{count} modes, {body}: ARPACK without count",
                "ARPACK",
                (("all_seconds", "s"),),
            ),
        )
        for count, body in ((50, "cube"), (300, "beam"), (12, "rod"))
    },
    "krylov of the crankshaft": (
        "krylov",
        _beside(
            "crankshaft 104,000: morembs",
            "crankshaft 104,000: pyMOR, block",
            "built from pyMOR",
            (("seconds", "s"), ("peak_rise_bytes", "GB")),
        ),
    ),
    "irka of the chain": ("published", _within_a_row("mass-spring-damper chain, irka", "hinf_error", "e")),
    "balanced truncation of the chain": ("published", _within_a_row("triple chain, fv", "seconds", "s")),
    "floating frames": ("frames", _beside("100,000: morembs", "100,000: Exudyn", "Exudyn", (("seconds", "s"),))),
    "decks of CalculiX": ("decks", _decks),
}
