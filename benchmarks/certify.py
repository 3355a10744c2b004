"""Case about certificates: what they and ``auto`` cost beside one factorisation of the stiffness.

A free beam of steel with a rigid interface at either end, so 12 motions, and 20 modes below 1.25 times the band. CPU
seconds on one thread are compared, which other work on the machine disturbs less than the clock.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from measure import Report, Row, Settings, child, in_rounds

SIZES, QUICK, BODIES = (25_000, 74_000), (2_200,), 3
BAND_HZ, TOLERANCE, LOSS = (0.0, 5000.0), 1e-3, 0.01
RATIOS = {
    "scratch": "reference and first certificate, modes known",
    "auto": "auto with its certificate, modes known",
    "after": "certify one body after auto",
}
_COLUMNS = (
    ("dofs", "dofs", "n"),
    ("factor", "factor s", "s"),
    ("modes", "modes s", "s"),
    ("scratch", "certificate s", "s"),
    ("auto", "auto s", "s"),
    ("after", "after auto s", "s"),
    ("body", "per body s", "s"),
    ("order", "order", "n"),
    ("reference_order", "reference", "n"),
)


def certify(settings: Settings) -> None:
    """Certificates and ``auto`` beside the factorisation with the solve of its loads."""
    settings = replace(settings, threads=1)
    measures: dict[str, Callable[[], Row]] = {
        f"beam {dofs:,}": lambda dofs=dofs: child("certify", settings, dofs=dofs)
        for dofs in (QUICK if settings.quick else SIZES)
    }
    rounds = in_rounds(measures, settings.repeat)
    report = Report("certify", settings)
    report.add(rounds)
    report.table("certify: CPU seconds; factor s with the solve of 12 loads, per body beside others", _COLUMNS)
    for name, rows in rounds.items():
        for key, words in RATIOS.items():
            values = [row[key] / row["factor"] for row in rows if key in row]
            report.compare(f"{name}: {words}, over the factorisation", values)
    report.write()


def measure(spec: dict[str, Any], steel: Callable[[str, int], Any]) -> Row:
    """In a child: CPU seconds of each step."""
    import numpy as np

    from morembs.certificate.certify import certify
    from morembs.fem.interface import make_interface
    from morembs.problem import Damping, Problem
    from morembs.reducers import AutoReducer, FreeInterface
    from morembs.responses.band import beyond

    model, band = steel("beam", spec["dofs"]), list(BAND_HZ)
    x = model.nodes.xyz[:, 0]
    faces = [
        make_interface(model, name=name, nodes=np.flatnonzero(np.abs(x - end) < 1e-9), coupling="rigid")
        for name, end in (("a", x.min()), ("b", x.max()))
    ]
    row: Row = {"dofs": model.size}

    def timed(name: str, work: Callable[[], Any]) -> Any:
        start = time.process_time()
        result = work()
        row[name] = time.process_time() - start
        return result

    def ready() -> Problem:
        problem = Problem(model, faces, damping=Damping(structural=LOSS))
        timed("factor", lambda: problem.free_free.flexibility(problem.B.toarray()))
        timed("modes", lambda: problem.elastic_modes(below=beyond(band[1])))
        return problem

    with ready() as problem:
        free = FreeInterface(modes=12).reduce(problem, "free")
        timed("scratch", lambda: certify(problem, [free], band))
    with ready() as problem:
        body = timed("auto", lambda: AutoReducer(band_hz=band, tolerance=TOLERANCE).reduce(problem))
        timed("after", lambda: certify(problem, [body], band))
        others = [FreeInterface(modes=12 + n).reduce(problem, str(n)) for n in range(BODIES)]
        timed("body", lambda: certify(problem, others, band))
    row["body"] /= BODIES
    return {**row, "order": body.order, "reference_order": body.recipe["reference_order"]}


CASES: dict[str, Callable[[Settings], None]] = {"certify": certify}
