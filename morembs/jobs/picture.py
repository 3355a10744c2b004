"""The picture of a job: mode shapes of the reduced body, and its frequency response against the full model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import TriMesh
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure, SubFigure
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from morembs.body import ElasticBody
from morembs.jobs.compare import FrequencyResponse, Shapes
from morembs.storage.safefile import replacing

Floats = NDArray[np.float64]
# Largest displacement drawn, as a part of the longest side of the body.
EXAGGERATION = 0.07
# Slant of the view against the flat side of the body, degrees upwards and sideways.
TILT, TURN = 28.0, -18.0
COLORS = mpl.colormaps["viridis"]
LIGHT = np.array([-0.35, 0.55, 0.76])  # from above left, in the frame of the picture
REST_COLOR = "#dcdfe3"
FULL_COLOR = "#202020"
BODY_COLORS = ("#d1495b", "#2e86ab", "#3d9970", "#b5651d", "#7b4fa3", "#607d8b")


def draw(path: Path, bodies: Sequence[ElasticBody], shapes: Shapes | None, response: FrequencyResponse | None) -> None:
    """Write the picture (png, pdf or svg by the ending of ``path``); the old one stays if that fails.

    Raises:
        OutputError: the file cannot be written.
    """
    style = {"font.size": 9, "axes.titlesize": 10, "font.family": "DejaVu Sans", "svg.hashsalt": "morembs"}
    with mpl.rc_context(cast(Any, style)):
        height = 0.35 + (4.7 if shapes is not None else 0.0) + (5.2 if response is not None else 0.0)
        figure = Figure(figsize=(10.0, height), dpi=150, facecolor="white")
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


def _fill(
    figure: Figure, bodies: Sequence[ElasticBody], shapes: Shapes | None, response: FrequencyResponse | None
) -> None:
    source = bodies[0].part.source or "model"
    first = next((body for body in bodies if shapes is not None and body.name == shapes.body), bodies[0])
    heights = [0.3] + [4.2] * (shapes is not None) + [4.6] * (response is not None)
    head, *rows = list(figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False).ravel())
    title = f"{source}, reduced to {first.reduced.order} coordinates ({first.name})"
    head.text(0.025, 0.25, title, ha="left", va="center", fontweight="bold", fontsize=12)
    if shapes is not None:
        draw_shapes(rows.pop(0), shapes)
    if response is not None:
        draw_response(rows.pop(0), response)


def viewed_axes(points: Floats) -> Floats:
    """Rows (3, 3) of the picture's frame: to the right, upwards, towards the viewer.

    The longest principal axis runs to the right and the shortest, the normal of the flat side, towards
    the viewer, slanted a little so that the depth shows.
    """
    _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    # The same sign on every machine: the largest entry is positive.
    axes = axes * np.sign(axes[np.arange(3), np.abs(axes).argmax(axis=1)])[:, None]
    if np.linalg.det(axes) < 0:
        axes[1] = -axes[1]
    up, side = np.radians(TILT), np.radians(TURN)
    about_x = np.array([[1, 0, 0], [0, np.cos(up), -np.sin(up)], [0, np.sin(up), np.cos(up)]])
    about_y = np.array([[np.cos(side), 0, np.sin(side)], [0, 1, 0], [-np.sin(side), 0, np.cos(side)]])
    return np.asarray(about_x @ about_y @ axes)


def draw_shapes(figure: Figure | SubFigure, shapes: Shapes) -> None:
    """The undeformed body in grey and the mode on it, coloured by its displacement; its interfaces on the first."""
    count = len(shapes.motion)
    rows = 1 if count == 1 else 2
    axes = figure.subplots(rows, -(-count // rows), squeeze=False)
    figure.subplots_adjust(left=0.02, right=0.90, top=0.90, bottom=0.03, wspace=0.04, hspace=0.16)
    for number, panel in enumerate(axes.ravel()):
        panel.set_axis_off()
        if number < count:
            _draw_mode(panel, shapes, number)
            panel.set_title(f"mode {number + 1}: {shapes.frequencies_hz[number]:,.1f} Hz")
    _mark_interfaces(axes[0, 0], shapes)
    colors = figure.add_axes((0.925, 0.14, 0.012, 0.64))
    bar = figure.colorbar(ScalarMappable(cmap=COLORS), cax=colors, ticks=[0, 0.5, 1])
    bar.set_label("displacement / largest")
    bar.outline.set_visible(False)


def draw_first(figure: Figure, shapes: Shapes) -> None:
    """The first mode alone, for a small picture."""
    panel = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    panel.set_axis_off()
    _draw_mode(panel, shapes, 0)


def _draw_mode(panel: Axes, shapes: Shapes, number: int) -> None:
    points, frame = _seen(shapes)
    largest = EXAGGERATION * float(np.ptp(points, axis=0).max())
    motion = shapes.motion[number] @ frame.T
    size = np.linalg.norm(motion, axis=1)
    # Which way a mode points has no meaning: its largest motion goes upwards or to the viewer.
    sign = 1.0 if motion[size.argmax(), 1:].sum() >= 0 else -1.0
    moved = points + sign * largest / size.max() * motion
    _paint(panel, points, shapes.triangles, None)
    _paint(panel, moved, shapes.triangles, size / size.max())
    panel.set_aspect("equal")
    panel.autoscale_view()


def _seen(shapes: Shapes) -> tuple[Floats, Floats]:
    """The points about their middle in the frame of the picture, and that frame."""
    frame = viewed_axes(shapes.points)
    return (shapes.points - shapes.points.mean(axis=0)) @ frame.T, frame


def _mark_interfaces(panel: Axes, shapes: Shapes) -> None:
    _, frame = _seen(shapes)
    for name, point in shapes.interfaces.items():
        x, y, _ = (point - shapes.points.mean(axis=0)) @ frame.T
        panel.plot(x, y, "o", color="white", markeredgecolor=FULL_COLOR, markersize=4)
        panel.annotate(name, (x, y), xytext=(4, 4), textcoords="offset points", fontsize=7)


def _paint(panel: Axes, points: Floats, triangles: NDArray[np.int64], size: Floats | None) -> None:
    """Triangles seen along the third axis, the farthest first; grey without ``size`` (n,)."""
    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)
    seen = np.flatnonzero(normal[:, 2] > 0)
    order = seen[np.argsort(corners[seen, :, 2].mean(axis=1), kind="stable")]
    if size is None:
        colors = np.tile(to_rgba(REST_COLOR), (3 * len(order), 1))
    else:
        shade = 0.62 + 0.38 * np.clip(normal[order] @ (LIGHT / np.linalg.norm(LIGHT)), 0, 1)
        colors = np.asarray(COLORS(size[triangles[order]].ravel()))
        colors[:, :3] *= np.repeat(shade, 3)[:, None]
    # Each triangle has corners of its own, so that edges of the body stay sharp; drawn in one call.
    x, y = corners[order, :, :2].reshape(-1, 2).T
    skin = TriMesh(Triangulation(x, y, np.arange(len(x)).reshape(-1, 3)), rasterized=True)
    skin.set_facecolor(cast(Any, colors))
    panel.add_collection(skin)
    panel.update_datalim(np.column_stack([x, y]))


def draw_response(figure: Figure | SubFigure, response: FrequencyResponse) -> None:
    """The size of the transfer functions above, the relative error of the reduced ones below."""
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[1.7, 1.0])
    figure.subplots_adjust(left=0.115, right=0.975, top=0.92, bottom=0.115, hspace=0.2)
    hz = response.frequencies_hz
    upper.loglog(hz, response.full, color=FULL_COLOR, linewidth=2.4, label="full model")
    for number, name in enumerate(response.reduced):
        color = BODY_COLORS[number % len(BODY_COLORS)]
        upper.loglog(hz, response.reduced[name], color=color, linewidth=1.3, linestyle=(0, (5, 2)), label=name)
        lower.loglog(hz, np.maximum(response.error[name], 1e-16), color=color, linewidth=1.3, label=name)
        if name in response.bound:
            ends, limit = response.bound[name]
            limit = np.where(np.isfinite(limit), np.maximum(limit, 1e-16), np.nan)
            lower.loglog(ends, limit, color=color, linewidth=0.9, linestyle=(0, (1, 1.5)), label=f"{name}, limit")
        if name in response.tolerance:
            lower.axhline(response.tolerance[name], color=color, linewidth=0.9, linestyle=(0, (6, 3)))
    upper.set_title("Elastic frequency response between the interfaces", loc="left")
    upper.set_ylabel("‖H‖ in m/N")
    lower.set_ylabel("error")
    meanings = ["solid: pointwise, |E| / |H|"]
    meanings += [f"dotted: limit, {response.measure}"] if response.bound else []
    meanings += [f"dashed: tolerance, {response.measure}"] if response.tolerance else []
    lower.set_title("    ".join(meanings), loc="left", fontsize="small")
    lower.set_xlabel("frequency in Hz")
    upper.legend(frameon=False, ncols=min(4, 1 + len(response.reduced)), loc="best")
    for panel in (upper, lower):
        panel.grid(True, which="major", color="#d0d4d8", linewidth=0.6)
        panel.grid(True, which="minor", color="#eceef0", linewidth=0.4)
        panel.set_xlim(hz[hz > 0][0], hz[-1])
        panel.spines[["top", "right"]].set_visible(False)
