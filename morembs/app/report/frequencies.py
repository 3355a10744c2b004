"""Frequencies of bodies beside those of the full model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from morembs.app.report.sections import Section
from morembs.app.report.style import STYLE
from morembs.app.report.tolerances import TOL
from morembs.app.report.words import percent
from morembs.base.types import Floats

# Coordinates that follow responses.
RESPONSES = {"krylov", "gramian", "balanced"}


def frequency_sections(document: Mapping[str, Any]) -> Iterator[Section]:
    """Elastic frequencies, those of the full model first where they are known; side by side as far as 80 columns go."""
    bodies = list(document["bodies"].items())
    full = None if document["full_frequencies_hz"] is None else np.asarray(document["full_frequencies_hz"])
    for first in range(0, len(bodies), STYLE.bodies_per_table):
        columns, rows = _table(full, dict(bodies[first : first + STYLE.bodies_per_table]))
        dash = "-: the body has no such mode, or none that stands for one of the full model"
        yield Section(
            title="free-free frequencies, rigid-body modes left out",
            columns=columns,
            rows=rows,
            lines=[dash] if full is not None and any("-" in row for row in rows) else [],
        )


def _table(full: Floats | None, bodies: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    rigid = next(iter(bodies.values()))["rigid_count"] if full is None else int((full == 0).sum())
    columns = ["mode"] + ["full Hz"] * (full is not None)
    frequencies = []
    for name, body in bodies.items():
        held = ", held" if body["rigid_count"] < rigid else ""
        columns += [f"{name} Hz{held}"] + ["off by %"] * (full is not None)
        own = np.asarray(body["frequencies_hz"])[body["rigid_count"] :]
        follows = full is not None and RESPONSES.intersection(body["mode_kind"])
        frequencies.append(beside(full[rigid:], own) if full is not None and follows else own)
    rows = []
    for number in range(STYLE.reported_frequencies if full is None else len(full) - rigid):
        row = [str(number + 1)] + ([] if full is None else [f"{full[rigid + number]:,.2f}"])
        for body, own in zip(bodies.values(), frequencies, strict=True):
            known = number < len(own) and np.isfinite(own[number])
            row.append(f"{own[number]:,.2f}" if known else "-")
            if full is not None:
                # Modes beyond those kept are not approximations of anything; held bodies have other modes.
                kinds = body["mode_kind"]
                by_modes = "rigid" in kinds and not RESPONSES.intersection(kinds)
                kept = kinds.count("elastic") if by_modes else len(own)
                fits = known and number < kept and body["rigid_count"] == rigid
                row.append(percent(own[number] / full[rigid + number] - 1) if fits else "-")
        rows.append(row)
    return columns, rows


def beside(full: Floats, own: Floats) -> Floats:
    """(k,) of ``own`` frequencies (n,), ascending, the one that stands for each of ``full`` (k,), nan where none does:
    bodies that follow responses have modes of no load neither in number nor in order."""
    partner, first = np.full(len(full), np.nan), 0
    for k, hz in enumerate(full):
        near = first + int(np.abs(own[first:] - hz).argmin()) if first < len(own) else len(own)
        if near < len(own) and abs(own[near] - hz) <= TOL.same_row * hz:
            partner[k], first = own[near], near + 1
    return partner
