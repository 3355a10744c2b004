"""The page of a simulation: its tables and pictures, made from the file of its result."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from morembs.app.pages.pictures import data_address, picture_of
from morembs.app.pages.rendering import link_to, render_page
from morembs.app.report.style import STYLE
from morembs.app.simulations.picture import pictures_of
from morembs.app.simulations.report import sections_of
from morembs.app.simulations.result_file import read_recording
from morembs.storage.safefile import replacing


def write_simulation_page(page: Path, system: Path, result: Path, document: Mapping[str, Any]) -> None:
    """Write the page of a run of ``system``, whose ``document`` is that of ``SimulationResult``.

    Raises:
        OutputError: the page cannot be written.
    """
    recording = read_recording(result)
    inputs = recording.provenance["inputs"]
    drawn = [(name, picture_of(STYLE.curves_picture, draw, "lines")) for name, draw in pictures_of(recording)]
    text = render_page(
        "simulation.html",
        title=system.stem,
        system=system.name,
        system_link=link_to(system, page),
        result=result.name,
        result_link=link_to(result, page),
        warnings=recording.warnings,
        sections=sections_of(str(system), document),
        pictures=[(name, data_address(base64.b64encode(file).decode())) for name, file in drawn],
        text=recording.system,
        changes=recording.changes,
        origin=recording.provenance,
        inputs=[(file.decode(), total.decode()) for file, total in zip(inputs["file"], inputs["sha256"], strict=True)],
    )
    with replacing(page) as file:
        file.write(text.encode())
