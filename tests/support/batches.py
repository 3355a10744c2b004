"""Batches whose jobs were done."""

from __future__ import annotations

from pathlib import Path

from morembs.app.batches.manifest import Ended, Manifest
from morembs.app.batches.plan import parts_of
from morembs.storage.contents import Content


def remember(folder: Path, manifest: Manifest) -> None:
    """As if each job below ``folder`` had been done."""
    for part in parts_of([folder]):
        for output in part.outputs:
            output.write_bytes(b"a body")
        deck = part.path.with_name("part.inp")
        end = Ended(
            key=part.key,
            inputs={deck: Content.of(deck)},
            facts={},
            outputs={path.resolve(): Content.of(path) for path in part.outputs},
        )
        manifest.record_end(part.loaded.output, end)
