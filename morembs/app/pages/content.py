"""What a report says of a body file, as plain values: its JSON has them as they are, its page shows them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from morembs.app.report.certificates import MEASURES
from morembs.app.report.style import STYLE
from morembs.app.report.words import clean_center
from morembs.body.body import Body
from morembs.body.stored import StoredBodies

# Options of a reduction that say how large or how exact it was asked to be.
_ASKED = ("order", "modes", "tolerance", "moments", "up_to_hz")


def content_of(stored: StoredBodies) -> dict[str, Any]:
    """What a body file holds: SI units, frequencies in Hz without rigid motions, no number as None."""
    # Not at the top: what checks the path of a report does without.
    from morembs.app.jobs.compare import recommend_body

    bodies = {name: _body(body) for name, body in stored.bodies.items()}
    return {
        "bodies": bodies,
        "shown": recommend_body({name: _limit(body) for name, body in stored.bodies.items()}),
        "dofs": _whole(stored.recipe.get("dofs")),
        "mass_kg": float(stored.mass),
        "center_of_mass_m": clean_center(stored.center_of_mass, stored.mass, stored.inertia).tolist(),
        "warnings": [str(warning) for warning in stored.warnings],
        "interfaces": {
            name: {"coupling": str(each.coupling), "nodes": len(each.node_ids)}
            for name, each in stored.interfaces.items()
        },
        **origin_of(stored.provenance, str(stored.recipe.get("source") or "model")),
    }


def origin_of(provenance: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Where a file comes from: the stages of its job, the files that were read, solver and version."""
    inputs = provenance.get("inputs") or {}
    return {
        "stages": _stages(provenance),
        "inputs": dict(zip(*(_texts(inputs.get(key, [])) for key in ("file", "sha256")), strict=True)),
        "origin": {
            "source": source,
            "solver": str(provenance.get("solver", "-")),
            "written by": f"morembs {provenance.get('morembs_version', '-')}",
            "at": str(provenance.get("created", "-")),
        },
    }


def _body(body: Body) -> dict[str, Any]:
    """A body: what was asked for, its certificate by measures, and its first elastic frequencies."""
    elastic = body.frequencies_hz[body.rigid_count :]
    recipe, known = body.recipe, body.certificate
    content: dict[str, Any] = {
        "method": str(recipe.get("method", "-")),
        "order": len(body.mass_matrix),
        "asked": {key: recipe[key] for key in _ASKED if isinstance(recipe.get(key), int | float | str)},
        "frequencies_hz": [float(f) for f in elastic[: STYLE.document_frequencies]],
        "kind": "none",
        "measure": "",
        "limits": {},
        "band_hz": None,
        "notes": "",
    }
    if known is None:
        return content
    floor = known.damping_floor
    assumed = [f"damping of {100 * floor:.3g} % of critical assumed beside its own"] if floor else []
    content |= {
        "kind": known.kind,
        "band_hz": [float(f) for f in known.band_hz],
        "notes": "; ".join([*assumed, *known.notes]),
    }
    if known.limits:
        content["measure"] = known.measure
        content["limits"] = {name: _finite(known.limits[name].upper) for name in MEASURES}
    return content


def _limit(body: Body) -> float | None:
    return body.certificate.limit.upper if body.certificate is not None and body.certificate.limits else None


def _stages(origin: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    from morembs.app.jobs.document import steps_in_turn

    seconds, peaks = dict(origin.get("seconds") or {}), dict(origin.get("peak_memory_bytes") or {})
    return {
        name: {"seconds": float(seconds[name]), "peak_memory_bytes": int(peaks.get(name, 0))}
        for name in steps_in_turn(seconds)
    }


def _whole(value: Any) -> int | None:
    return None if value is None else int(value)


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _texts(values: Any) -> list[str]:
    return [each.decode() if isinstance(each, bytes) else str(each) for each in np.atleast_1d(values).tolist()]
