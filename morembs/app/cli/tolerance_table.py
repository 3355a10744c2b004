"""All tolerances of the package with the comments that derive or cite them, read from its own sources."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, fields
from importlib import import_module
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2]


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One field of the tolerances of a ``room``: its ``name``, its ``value`` and the ``reason`` for that."""

    room: str
    name: str
    value: object
    reason: str


def tolerances() -> Iterator[Quantity]:
    """Those of all rooms, in their order in the files."""
    for file in sorted(PACKAGE.rglob("tolerances.py")):
        module = ".".join(file.relative_to(PACKAGE.parent).with_suffix("").parts)
        held, reasons = import_module(module).TOL, _reasons(file.read_text(encoding="utf-8"))
        for field in fields(held):
            yield Quantity(
                room=module.removeprefix("morembs.").removesuffix(".tolerances"),
                name=field.name,
                value=getattr(held, field.name),
                reason=reasons[field.name],
            )


def _reasons(source: str) -> dict[str, str]:
    """The comment above each field; fields of one group may share that above the first."""
    reasons, above = {}, ""
    for words, name in re.findall(r"((?: {4}# .*\n)*) {4}(\w+): \w", source):
        above = re.sub(r"\s*# (--- .*\n)?", " ", words).strip() or above
        reasons[name] = above
    return reasons
