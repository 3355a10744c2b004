"""Case about Krylov reduction: ours and pyMOR's at the same points, and what a reduction costs beside its solves.

A free body of steel with two rigid interfaces, so 12 loads, and Rayleigh damping; see interpolation.py.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from measure import Report, Rounds, Row, Settings, child, in_rounds, ratios, required

Spec = dict[str, Any]


class Asked(NamedTuple):
    """A shape of models.py, its highest frequency of interest, and which of pyMOR's ways are measured."""

    shape: str
    dofs: int
    top_hz: float
    tangential: bool

    @property
    def name(self) -> str:
        """Name in tables."""
        return f"{self.shape} {self.dofs:,}"

    def spec(self, settings: Settings) -> Spec:
        """Options of every measurement of this body."""
        return {
            "shape": self.shape,
            "dofs": self.dofs,
            "top_hz": self.top_hz,
            "ratio": RATIO,
            "points": POINTS,
            "shifts_hz": [part * self.top_hz for part in SHIFTS],
            "moments": MOMENTS,
            "file": str(settings.folder / f"{self.shape}_{self.dofs}_exact.npz"),
        }

    @property
    def others(self) -> tuple[str, ...]:
        """Names of the ways of pyMOR."""
        return (BLOCK, TANGENTIAL) if self.tangential else (BLOCK,)


# The highest frequency takes in about 15 modes of the crankshaft and 25 of the cube. pyMOR's tangential reductor
# takes 20 minutes and more on the cube, for it factorises 24 times as often.
BODIES = (
    Asked("crankshaft", 26_000, 2_000.0, True),
    Asked("crankshaft", 104_000, 2_000.0, True),
    Asked("cube", 26_000, 40_000.0, False),
)
SWEPT = Asked("crankshaft", 26_000, 2_000.0, False)
QUICK = Asked("cube", 2_200, 40_000.0, True)
# Damping ratio at the highest frequency and at a tenth of it; expansion points as parts of the highest frequency.
# Two real blocks of ours per point make as many columns as real and imaginary part of pyMOR's one.
RATIO, SHIFTS, MOMENTS = 0.01, (0.2, 0.55, 0.9), 2
# Frequencies at which the errors are measured, and those of the long sweep.
POINTS, SWEEP, QUICK_SWEEP = 20, 200, 30
TOLERANCE = 1e-8
# A reduction by pyMOR is stopped then, and what all of its factorisations would take is estimated.
LIMIT_SECONDS = 240.0
OURS, BLOCK, TANGENTIAL = "morembs", "pyMOR, block", "pyMOR, SOBHIReductor"
DIRECT, REFERENCE = "direct sweep", "full_response"
_DAMPING = {"damped": RATIO, "undamped": 0.0}
_RATIOS = {"seconds": "seconds", "cpu_seconds": "CPU seconds", "peak_rise_bytes": "memory"}
_COSTS = {
    "one_ratio": "seconds, analysis known",
    "one_cpu_ratio": "CPU seconds, analysis known",
    "cold_cpu_ratio": "CPU seconds, with the analysis",
}
_COLUMNS = (
    ("dofs", "dofs", "n"),
    ("points", "points", "n"),
    ("order", "order", "n"),
    ("seconds", "seconds", "s"),
    ("cpu_seconds", "CPU s", "s"),
    ("more_than_seconds", "more than s", "s"),
    ("factorisations", "factors", "n"),
    ("peak_rise_bytes", "peak MB", "MB"),
    ("response_error", "error", "e"),
    ("factor_seconds", "factor s", "s"),
    ("solve_seconds", "solve s", "s"),
    ("one_seconds", "one point s", "s"),
    ("one_ratio", "ratio", "x"),
    ("ten_seconds", "ten points s", "s"),
    ("ten_factorisations", "factors", "n"),
    ("ten_analyses", "analyses", "n"),
    ("load_average", "load", "f"),
)


def krylov(settings: Settings) -> None:
    """Reductions with equal points and orders, what they cost beside a factorisation, and frequency sweeps."""
    bodies, swept = ((QUICK,), QUICK) if settings.quick else (BODIES, SWEPT)
    for body in bodies:
        required("interpolation", settings, what="direct", **body.spec(settings))
    measures: dict[str, Callable[[], Row]] = {}
    for body in bodies:
        spec = body.spec(settings)
        measures[f"{body.name}: {OURS}"] = _measure("ours", spec, settings)
        for who in body.others:
            measures[f"{body.name}: {who}"] = _measure(
                "pymor", spec, settings, block=who == BLOCK, limit_seconds=LIMIT_SECONDS
            )
    measures |= {f"{body.name}: cost": _measure("cost", body.spec(settings), settings) for body in bodies}
    measures |= _sweeps(swept, settings)
    rounds = in_rounds(measures, settings.repeat)
    report = Report("krylov", settings)
    report.add(rounds)
    report.table(
        f"krylov: reduction at {len(SHIFTS)} points, 12 loads; error of the elastic response at {POINTS} frequencies\n"
        "peak MB: highest memory less what was resident before; ratio: one point over one numerical factorisation and\n"
        "the solve of its loads, the analysis known; factor s: all factorisations, or one of those for the ratio",
        _COLUMNS,
    )
    _compare(report, rounds, bodies, swept)
    report.write()


def _sweeps(body: Asked, settings: Settings) -> dict[str, Callable[[], Row]]:
    """Responses at many frequencies, direct and then by the reference model, with damping and without."""
    measures = {}
    for words, ratio in _DAMPING.items():
        spec = {
            **body.spec(settings),
            "points": QUICK_SWEEP if settings.quick else SWEEP,
            "ratio": ratio,
            "file": str(settings.folder / f"sweep_{words}.npz"),
            "tolerance": TOLERANCE,
        }
        measures[f"{body.name}: {DIRECT}, {words}"] = _measure("direct", spec, settings)
        measures[f"{body.name}: {REFERENCE}, {words}"] = _measure("reference", spec, settings)
    return measures


def _compare(report: Report, rounds: Rounds, bodies: Sequence[Asked], swept: Asked) -> None:
    for body in bodies:
        for who in body.others:
            for key, words in _RATIOS.items():
                pair = [(f"{body.name}: {name}", key) for name in (who, OURS)]
                # Where pyMOR was stopped, its estimate.
                if not all(row.get("seconds") for row in rounds[pair[0][0]]) and key != "peak_rise_bytes":
                    pair[0], words = (pair[0][0], f"estimated_{key}"), f"{words} (estimated)"
                report.compare(f"{body.name}: {who} over {OURS}, {words}", ratios(rounds, *pair))
        for key, words in _COSTS.items():
            values = [row[key] for row in rounds[f"{body.name}: cost"] if key in row]
            report.compare(f"{body.name}: one point over factorisation and solve, {words}", values)
    for words in _DAMPING:
        for key in ("seconds", "cpu_seconds"):
            pair = [(f"{swept.name}: {who}, {words}", key) for who in (DIRECT, REFERENCE)]
            report.compare(f"{swept.name}: {DIRECT} over {REFERENCE}, {words}, {_RATIOS[key]}", ratios(rounds, *pair))


def _measure(what: str, spec: Spec, settings: Settings, **more: object) -> Callable[[], Row]:
    def measured() -> Row:
        # Other work on the machine shows in this.
        load = os.getloadavg()[0]
        row = child("interpolation", settings, what=what, **spec, **more)
        if "resident_bytes" in row and "peak_rise_bytes" not in row:
            row["peak_rise_bytes"] = row["process_peak_bytes"] - row["resident_bytes"]
        return {**row, "load_average": load}

    return measured


CASES: dict[str, Callable[[Settings], None]] = {"krylov": krylov}
