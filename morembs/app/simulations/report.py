"""What people see of a simulation: an outline of its file, and sections of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from morembs.app.report.sections import Section
from morembs.app.simulations.result_file import Recording
from morembs.base.types import Floats


def outline(recording: Recording) -> dict[str, Any]:
    """The file of a simulation in plain values: bodies, largest reactions, contacts and energy, SI units."""
    energy, time = recording.energy, recording.time
    balance = energy.kinetic + energy.potential - energy.work
    summary: dict[str, Any] = {
        "bodies": {
            name: {"kind": body.kind, "coordinates": body.coordinates.shape[1], "markers": list(body.markers)}
            for name, body in recording.bodies.items()
        },
        "begin": float(time[0]),
        "end": float(time[-1]),
        "times": len(time),
        "restarts": int((np.diff(time) == 0).sum()),
        "largest_reactions": {
            name: {"force": _largest(joint.reaction[:, :3]), "moment": _largest(joint.reaction[:, 3:])}
            for name, joint in recording.joints.items()
        },
        "energy": {"kinetic_max": float(energy.kinetic.max()), "drift": float(np.abs(balance - balance[0]).max())},
        "contacts": {
            name: {"force": float(each.force.max()), "touching": float((each.force > 0).any(axis=1).mean())}
            for name, each in recording.contacts.items()
        },
        "sliders": {name: {"displacement": _largest(each.displacement)} for name, each in recording.sliders.items()},
        "warnings": list(recording.warnings),
    }
    for name, events in (("impacts", recording.impacts), ("switches", recording.switches)):
        if events is not None:
            summary[name] = len(events.time)
    return summary


def _largest(vectors: Floats) -> float:
    return float(np.linalg.norm(vectors, axis=1).max())


def sections_of(name: str, summary: Mapping[str, Any]) -> Sequence[Section]:
    """Tables of an outline, or of the document of a run, which has more."""
    head = f"{summary['begin']:g} to {summary['end']:g} s, {summary['times']:,} times"
    events = [f"{summary[key]:,} {key}" for key in ("restarts", "impacts", "switches") if summary.get(key)]
    bodies = [
        (body, each["kind"], str(each["coordinates"]), ", ".join(each["markers"]) or "none")
        for body, each in summary["bodies"].items()
    ]
    title = f"{Path(name).name}: {', '.join([head, *events])}"
    sections = [Section(title=title, columns=("body", "kind", "coordinates", "markers"), rows=bodies)]
    tables = {
        "largest reactions": ("joint", {"force": "N", "moment": "Nm"}, summary["largest_reactions"]),
        "contacts": ("contact", {"force": "largest N", "touching": "part of the times"}, summary["contacts"]),
        "paths below loads": ("slider", {"displacement": "largest m"}, summary["sliders"]),
    }
    for title, (first, columns, rows) in tables.items():
        if rows:
            cells = [(each, *(f"{values[key]:.4g}" for key in columns)) for each, values in rows.items()]
            sections.append(Section(title=title, columns=(first, *columns.values()), rows=cells))
    energy = summary["energy"]
    lines = [f"energy: largest kinetic {energy['kinetic_max']:.4g} J, balance kept within {energy['drift']:.2g} J"]
    lines += [
        f"{body}: largest von Mises stress {each['von_mises_pa'] / 1e6:,.4g} MPa at node {each['node']}, "
        f"{each['time_s']:g} s"
        for body, each in summary.get("stress", {}).items()
    ]
    return [*sections, Section(lines=lines)]
