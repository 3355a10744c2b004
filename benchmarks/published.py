"""Case about published second-order models: Krylov, IRKA and balanced truncation, here and by pyMOR.

Two models are made by published_models.py from the papers. The third needs sandwich_beam_168.mat of the collection
NLEVP (github.com/ftisseur/nlevp, folder private): the environment variable MOREMBS_NLEVP is the folder of that file.
pyMOR is a test dependency: pip install pymor. All runs are on one thread of the BLAS.

    python benchmarks/published.py

runs the smallest model alone, and ends with 1 where an error is larger than the one on record.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from measure import HERE, Report, Row, Settings, child, in_rounds

# Model -> order of the reduced ones.
ORDERS = {"triple chain": 12, "mass-spring-damper chain": 10, "sandwich beam": 10}
METHODS = ("krylov", "irka", "fv", "pv")
PROGRAMS = ("morembs", "pyMOR")
FOLDER = "MOREMBS_NLEVP"
# An error above the one on record by more than its round-off.
_LARGER = 1.001
_KEYS = ("h2_error", "hinf_error", "seconds")
_COLUMNS = (
    ("dofs", "dofs", "n"),
    ("order", "order", "n"),
    ("h2_error", "H2 error", "e"),
    ("pymor_h2_error", "pyMOR", "e"),
    ("hinf_error", "H-infinity error", "e"),
    ("pymor_hinf_error", "pyMOR", "e"),
    ("seconds", "s", "s"),
    ("pymor_seconds", "pyMOR", "s"),
)


def published(settings: Settings) -> None:
    """All models by all methods and both programs in turn."""
    single = replace(settings, threads=1)
    models = ["mass-spring-damper chain"] if settings.quick else list(ORDERS)
    names = [(model, method, who) for model in models for method in METHODS for who in PROGRAMS]
    rounds = in_rounds({", ".join(each): _measured(single, *each) for each in names}, settings.repeat)
    report = Report("published", single)
    for model in models:
        for method in METHODS:
            first, second = (rounds[f"{model}, {method}, {who}"] for who in PROGRAMS)
            pairs = zip(first, second, strict=False)
            report.add({f"{model}, {method}": [_beside(ours, theirs) for ours, theirs in pairs]})
    report.table("published models: errors over the norms of the full model; -: unstable, or not installed", _COLUMNS)
    report.write()


def _beside(ours: Row, theirs: Row) -> Row:
    """A row of both programs, and why there is none of pyMOR."""
    reason = {"pymor_error": theirs["error"]} if "error" in theirs else {}
    return {**ours, **{f"pymor_{key}": theirs.get(key) for key in _KEYS}, **reason}


def _measured(settings: Settings, model: str, method: str, who: str) -> Callable[[], Row]:
    data = os.environ.get(FOLDER, "")
    return lambda: child("published", settings, model=model, method=method, who=who, order=ORDERS[model], data=data)


CASES: dict[str, Callable[[Settings], None]] = {"published": published}


def larger_errors(rows: Mapping[str, Row], recorded: Mapping[str, Row]) -> list[str]:
    """Errors of ``rows`` that are larger than those on record, or missing, in words."""
    found = []
    for name, row in rows.items():
        for key in ("h2_error", "hinf_error"):
            now, before = row.get(key), recorded[name][key]
            if before is not None and (now is None or now > _LARGER * before):
                found.append(f"{name}: {key} is {now}, {before} is on record")
    return found


def main() -> int:
    """Run the smallest model; 1 where an error is larger than the one on record."""
    with tempfile.TemporaryDirectory() as folder:
        published(Settings(folder=Path(folder), results=Path(folder), quick=True, repeat=1))
        rows = json.loads((Path(folder) / "published.json").read_text())["rows"]
    found = larger_errors(rows, json.loads((HERE / "results" / "published.json").read_text())["rows"])
    print(*found or [f"{len(rows)} rows, no error larger than on record"], sep="\n")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
