"""What people see of a simulation: sections of a report, by its document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from morembs.app.report.sections import Section


def sections_of(document: Mapping[str, Any]) -> Sequence[Section]:
    """Bodies, largest reactions and energy of a finished run."""
    restarts = f", {document['restarts']} restarts at events" if document["restarts"] else ""
    head = f"{document['begin']:g} to {document['end']:g} s, {document['times']:,} times kept{restarts}"
    sections = [
        Section(
            title=f"{Path(document['job']).name}: {head}",
            columns=("body", "kind", "coordinates", "markers"),
            rows=[
                (name, body["kind"], str(body["coordinates"]), ", ".join(body["markers"]) or "none")
                for name, body in document["bodies"].items()
            ],
        )
    ]
    if document["largest_reactions"]:
        rows = [
            (name, f"{each['force']:.4g}", f"{each['moment']:.4g}")
            for name, each in document["largest_reactions"].items()
        ]
        sections.append(Section(title="largest reactions", columns=("joint", "N", "Nm"), rows=rows))
    lines = [
        f"energy: largest kinetic {document['energy']['kinetic_max']:.4g} J, balance kept within "
        f"{document['energy']['drift']:.2g} J"
    ]
    lines += [
        f"{name}: largest von Mises stress {each['von_mises_pa'] / 1e6:,.4g} MPa at node {each['node']}, "
        f"{each['time_s']:g} s"
        for name, each in document["stress"].items()
    ]
    return [*sections, Section(lines=lines)]
