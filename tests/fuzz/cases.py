"""Named jobs of defects that were found, which run before all others."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tests.fuzz.trials import FAULTS, Folder, Outcome

CASES: dict[str, Callable[[Folder], None]] = {}


def run(name: str, folder: Path, *, keep: bool = False) -> Outcome:
    """The outcome of one case."""
    outcome = Outcome(name, features={"case": name}, command=f'make attack ARGS="jobs --case {name}"')
    place = Folder(folder / name, outcome)
    CASES[name](place)
    if outcome.result not in FAULTS and not keep:
        place.close()
    return outcome
