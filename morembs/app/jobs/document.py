"""The document of a finished job, which its stages write: text, JSON and pages are views of it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from morembs.app.jobs.stages.stage import STAGES, in_order
from morembs.app.report.sections import Section


def sections_of(document: Mapping[str, Any], pages: bool = False) -> list[Section]:
    """What reports show of a document, or ``pages`` alone: the sections of all stages that find something in it."""
    stages = [stage for stage in STAGES.values() if stage.on_page or not pages]
    return [section for stage in stages for section in stage.sections(document)]


def merge_tables(document: dict[str, Any], added: Mapping[str, Any]) -> None:
    """Add to a document; tables that are there take what is added to them."""
    for key, value in added.items():
        if isinstance(value, Mapping) and isinstance(document.get(key), dict):
            merge_tables(document[key], value)
        else:
            document[key] = value


def steps_in_turn(names: Collection[str]) -> list[str]:
    """Names of steps, which files keep by name, in the order in which they ran; unknown ones come last."""
    known = [step for stage in in_order(list(STAGES.values())) for step in (stage.step, *stage.steps) if step]
    # Planar members are reduced and written by a stage before all others: of a step twice, the last place counts.
    turns = {step: turn for turn, step in enumerate(known)}

    def turn(name: str) -> tuple[int, str]:
        kind = "reduce" if name.startswith("reduce ") else name
        return turns.get(kind, len(turns)), name

    return sorted(names, key=turn)
