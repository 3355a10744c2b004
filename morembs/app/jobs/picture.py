"""The picture of a job: mode shapes of the reduced body, and its frequency response against the full model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, cast

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, SubFigure

from morembs.app.jobs.compare import FrequencyResponse
from morembs.app.jobs.style import STYLE
from morembs.base.charts import COLORS, FULL_COLOR
from morembs.body import Body
from morembs.body.drawing import draw_shapes
from morembs.body.shapes import Shapes
from morembs.certificate.tolerances import TOL as CERTIFICATE
from morembs.storage.safefile import replacing


def draw(path: Path, bodies: Sequence[Body], shapes: Shapes | None, response: FrequencyResponse | None) -> None:
    """Write the picture (png, pdf or svg by the ending of ``path``); the old one stays if that fails.

    Raises:
        OutputError: the file cannot be written.
    """
    style = {"font.size": 9, "axes.titlesize": 10, "font.family": "DejaVu Sans", "svg.hashsalt": "morembs"}
    with mpl.rc_context(cast(Any, style)):
        height = STYLE.margin_height + (STYLE.shapes_height if shapes is not None else 0.0)
        height += STYLE.response_height if response is not None else 0.0
        figure = Figure(figsize=(10.0, height), dpi=STYLE.dots_per_inch, facecolor="white")
        FigureCanvasAgg(figure)
        _fill(figure, bodies, shapes, response)
        save(figure, path)


def save(figure: Figure, path: Path) -> None:
    """Write ``figure`` as the kind of file that its name says, without dates: whole, or not at all.

    Raises:
        OutputError: the file cannot be written.
    """
    dates = {"png": {"Software": None}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
    kind = path.suffix.lower().lstrip(".")
    with replacing(path) as file:
        figure.savefig(cast(IO[bytes], file), format=kind, metadata=dates.get(kind))


def _fill(figure: Figure, bodies: Sequence[Body], shapes: Shapes | None, response: FrequencyResponse | None) -> None:
    source = bodies[0].part.source or "model"
    first = next((body for body in bodies if shapes is not None and body.name == shapes.body), bodies[0])
    drawn = (True, shapes is not None, response is not None)
    ratios = (STYLE.title_ratio, STYLE.shapes_ratio, STYLE.response_ratio)
    heights = [ratio for ratio, there in zip(ratios, drawn, strict=True) if there]
    head, *rows = list(figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False).ravel())
    title = f"{source}, reduced to {first.reduced.order} coordinates ({first.name})"
    head.text(STYLE.title_left, STYLE.title_bottom, title, ha="left", va="center", fontweight="bold", fontsize=12)
    if shapes is not None:
        draw_shapes(rows.pop(0), shapes)
    if response is not None:
        draw_response(rows.pop(0), response)


def draw_response(figure: Figure | SubFigure, response: FrequencyResponse) -> None:
    """The size of the transfer functions above, the relative error of the reduced ones below."""
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[STYLE.upper_panel_ratio, 1.0])
    figure.subplots_adjust(
        left=STYLE.panel_left,
        right=STYLE.panel_right,
        top=STYLE.panel_top,
        bottom=STYLE.panel_bottom,
        hspace=STYLE.panel_gap,
    )
    hz = response.frequencies_hz
    upper.loglog(hz, response.full, color=FULL_COLOR, linewidth=STYLE.full_line, label="full model")
    for number, name in enumerate(response.reduced):
        color = COLORS[number % len(COLORS)]
        upper.loglog(
            hz, response.reduced[name], color=color, linewidth=STYLE.body_line, linestyle=(0, (5, 2)), label=name
        )
        lower.loglog(
            hz,
            np.maximum(response.error[name], CERTIFICATE.least_drawn_error),
            color=color,
            linewidth=STYLE.body_line,
            label=name,
        )
        if name in response.bound:
            ends, limit = response.bound[name]
            limit = np.where(np.isfinite(limit), np.maximum(limit, CERTIFICATE.least_drawn_error), np.nan)
            lower.loglog(
                ends,
                limit,
                color=color,
                linewidth=STYLE.limit_line,
                linestyle=(0, STYLE.limit_dots),
                label=f"{name}, limit",
            )
        if name in response.tolerance:
            lower.axhline(response.tolerance[name], color=color, linewidth=STYLE.limit_line, linestyle=(0, (6, 3)))
    upper.set_title("Elastic frequency response between the interfaces", loc="left")
    upper.set_ylabel("‖H‖ in m/N")
    lower.set_ylabel("error")
    meanings = ["solid: pointwise, |E| / |H|"]
    meanings += ["dotted: limit of it"] if response.bound else []
    meanings += ["dashed: tolerance"] if response.tolerance else []
    lower.set_title("    ".join(meanings), loc="left", fontsize="small")
    lower.set_xlabel("frequency in Hz")
    upper.legend(frameon=False, ncols=min(4, 1 + len(response.reduced)), loc="best")
    for panel in (upper, lower):
        panel.grid(True, which="major", color="#d0d4d8", linewidth=STYLE.grid_line)
        panel.grid(True, which="minor", color="#eceef0", linewidth=STYLE.fine_grid_line)
        panel.set_xlim(hz[hz > 0][0], hz[-1])
        panel.spines[["top", "right"]].set_visible(False)
