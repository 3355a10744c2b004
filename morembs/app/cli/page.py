"""A report: one HTML file with a row and a section for each part, made from body files; it needs no other file."""

from __future__ import annotations

import base64
import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from morembs.app.report.certificates import MEASURES
from morembs.app.report.style import STYLE
from morembs.app.report.words import bytes_words
from morembs.base.errors import InputError, MorembsError
from morembs.base.progress import duration_words
from morembs.base.summary import upwards
from morembs.body.file import read_body
from morembs.body.stored import StoredBodies
from morembs.body.tolerances import TOL as BODY
from morembs.storage.safefile import check_writable, replacing
from morembs.version import VERSION

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A job of a report: its ``state`` (``done``, ``unchanged``, ``failed``), the ``message`` of a failed one, and of
    another the body file ``output`` and what it cost, where that is known, and the ``document`` of its run."""

    name: str
    job: str
    output: str = ""
    state: str
    message: str = ""
    seconds: float | None = None
    peak_memory_bytes: int | None = None
    document: Mapping[str, Any] | None = None


def check_report(path: Path | None) -> None:
    """Check, before the work begins, that a report can be written.

    Raises:
        InputError: another ending than .html.
        OutputError: the folder cannot be written.
    """
    if path is None:
        return
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--report {path} was given; expected a name that ends in .html")
    check_writable(path)


def write_report(path: Path, entries: Sequence[Entry], title: str) -> None:
    """Write the report of some jobs, from the body files that they wrote.

    Raises:
        OutputError: the file cannot be written.
    """
    # Not at the top: commands without a report do without it.
    from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

    environment = Environment(
        loader=PackageLoader("morembs.app.cli", "."),
        autoescape=select_autoescape(default=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    parts = [_part(number, entry, path) for number, entry in enumerate(entries, start=1)]
    text = environment.get_template("page.html").render(title=title, parts=parts, version=VERSION, measures=MEASURES)
    with replacing(path) as file:
        file.write(text.encode())


def _part(number: int, entry: Entry, report: Path) -> dict[str, Any]:
    """What the page says of a part; a body file that cannot be read is a failure of its own."""
    said: dict[str, Any] = {
        "number": number,
        "name": entry.name,
        "state": entry.state,
        "message": entry.message,
        "job": _link(entry.job, report),
        "small": "",
    }
    if entry.state == "failed":
        return said
    try:
        return said | _content(read_body(entry.output), entry, report)
    except MorembsError as error:
        return said | {"state": "failed", "message": str(error)}


def _content(stored: StoredBodies, entry: Entry, report: Path) -> dict[str, Any]:
    """What a body file holds, and what the stages of its job tell."""
    # Not at the top: what checks the path of a report does without.
    from morembs.app.jobs.document import sections_of, steps_in_turn

    bodies, origin = [_body(name, stored) for name in stored.bodies], stored.provenance
    shown = _recommended(bodies)
    seconds, peaks = dict(origin.get("seconds") or {}), dict(origin.get("peak_memory_bytes") or {})
    inputs = origin.get("inputs") or {}
    return {
        "bodies": bodies,
        **_pictures(stored, shown["name"]),
        "row": _row(stored, shown, entry),
        "shown": shown["name"],
        "body": _link(entry.output, report),
        "warnings": list(stored.warnings),
        "interfaces": {name: (each.coupling, len(each.node_ids)) for name, each in stored.interfaces.items()},
        "stages": [
            (name, f"{seconds[name]:.2f} s", bytes_words(peaks.get(name, 0))) for name in steps_in_turn(seconds)
        ],
        "sections": [] if entry.document is None else sections_of(entry.document, pages=True),
        "inputs": list(zip(*(_texts(inputs.get(key, [])) for key in ("file", "sha256")), strict=True)),
        "origin": [
            ("source", str(stored.recipe.get("source") or "model")),
            ("solver", str(origin.get("solver", "-"))),
            ("written by", f"morembs {origin.get('morembs_version', '-')}"),
            ("at", str(origin.get("created", "-"))),
        ],
        "center": ", ".join(f"{x:.4g}" for x in stored.center_of_mass),
        "file": Path(entry.output).name,
    }


def _row(stored: StoredBodies, shown: Mapping[str, Any], entry: Entry) -> dict[str, Any]:
    """The line of a part in the table, by the body that is ``shown``."""
    seconds, memory = entry.seconds, entry.peak_memory_bytes
    return {
        "dofs": _number(stored.recipe.get("dofs")),
        "order": _number(shown["order"]),
        "error": (shown["value"], shown["limits"][shown["measure"]] if shown["limits"] else "-"),
        "frequencies": shown["frequencies"][: STYLE.page_frequencies],
        "lowest": shown["lowest"],
        "mass": (stored.mass, f"{stored.mass:.4g} kg"),
        "seconds": (-1, "-") if seconds is None else (seconds, duration_words(seconds)),
        "memory": (-1, "-") if memory is None else (memory, bytes_words(memory)),
    }


def _body(name: str, stored: StoredBodies) -> dict[str, Any]:
    """A body in a line: its certificate by measures, and its first elastic frequencies."""
    body = stored.bodies[name]
    elastic = body.frequencies_hz[body.rigid_count :]
    said: dict[str, Any] = {
        "name": name,
        "order": len(body.mass_matrix),
        "method": str(body.recipe.get("method", "-")),
        "limits": {},
        "frequencies": [f"{f:,.6g}" for f in elastic[: 2 * STYLE.page_frequencies]],
        "lowest": min(elastic, default=-1.0),
        "kind": "none",
        "band": "",
        "measure": "",
        "value": float("inf"),
        "notes": "",
    }
    known = body.certificate
    if known is None:
        return said
    said["kind"] = known.kind
    said["band"] = "{:,.6g} to {:,.6g} Hz".format(*known.band_hz)
    floor = known.damping_floor
    assumed = [f"damping of {100 * floor:.3g} % of critical assumed beside its own"] if floor else []
    said["notes"] = "; ".join([*assumed, *known.notes])
    if known.limits:
        said |= {"measure": known.measure, "value": known.limit.upper}
        said["limits"] = {name: upwards(known.limits[name].upper) for name in MEASURES}
    return said


def _recommended(bodies: Sequence[dict[str, Any]]) -> dict[str, Any]:
    from morembs.app.jobs.compare import recommended

    name = recommended({body["name"]: body["value"] if body["limits"] else None for body in bodies})
    return next(body for body in bodies if body["name"] == name)


def _pictures(stored: StoredBodies, shown: str) -> dict[str, Any]:
    """The first mode for the row; four modes and the response with its certificates for the section."""
    from morembs.app.jobs.compare import certified_response
    from morembs.app.jobs.picture import draw_response
    from morembs.body.drawing import draw_first, draw_shapes
    from morembs.body.shapes import shapes_on

    shapes = shapes_on(stored.bodies[shown].view(BODY.drawn_modes)) if len(stored.node_ids) else None
    response = certified_response(list(stored.bodies.values()))
    pictures = []
    if shapes is not None:
        pictures.append((f"modes of {shown}", _png(STYLE.shapes_picture, lambda figure: draw_shapes(figure, shapes))))
    if response is not None:
        pictures.append(
            ("response and error", _png(STYLE.response_picture, lambda figure: draw_response(figure, response)))
        )
    small = "" if shapes is None else _png(STYLE.row_picture, lambda figure: draw_first(figure, shapes))
    return {"small": small, "pictures": pictures}


def _png(size: tuple[float, float, int], draw: Any) -> str:
    """A drawing as a picture within the page."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    width, height, dots = size
    with mpl.rc_context({"font.size": 9, "axes.titlesize": 10, "font.family": "DejaVu Sans"}):
        figure: Figure = Figure(figsize=(width, height), dpi=dots, facecolor="white")
        FigureCanvasAgg(figure)
        draw(figure)
        file = io.BytesIO()
        figure.savefig(file, format="png", metadata={"Software": None})
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()


def _number(value: Any) -> tuple[float, str]:
    """What a column is sorted by, and what it shows."""
    return (-1.0, "-") if value is None else (float(value), f"{int(value):,}")


def _texts(values: Any) -> list[str]:
    return [each.decode() if isinstance(each, bytes) else str(each) for each in np.atleast_1d(values).tolist()]


def _link(path: str | Path, report: Path) -> tuple[str, str]:
    """Where a page finds a file, and the name that it shows."""
    try:
        target = Path(os.path.relpath(path, report.resolve().parent)).as_posix()
    except ValueError:  # on another drive
        return Path(path).resolve().as_uri(), Path(path).name
    return quote(target), Path(path).name
