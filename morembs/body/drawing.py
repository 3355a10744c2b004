"""Mode shapes drawn flat, without a display, for pictures, reports and notebooks."""

from __future__ import annotations

from typing import Any, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import TriMesh
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure, SubFigure
from matplotlib.patheffects import withStroke
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from morembs.base.charts import FULL_COLOR
from morembs.base.types import Floats
from morembs.body.shapes import Shapes
from morembs.body.tolerances import TOL

COLORS = mpl.colormaps["viridis"]
LIGHT = np.array([-0.35, 0.55, 0.76])  # from above left, in the frame of the picture
REST_COLOR = "#dcdfe3"


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
    up, side = np.radians(TOL.view_tilt), np.radians(TOL.view_turn)
    about_x = np.array([[1, 0, 0], [0, np.cos(up), -np.sin(up)], [0, np.sin(up), np.cos(up)]])
    about_y = np.array([[np.cos(side), 0, np.sin(side)], [0, 1, 0], [-np.sin(side), 0, np.cos(side)]])
    return np.asarray(about_x @ about_y @ axes)


def draw_shapes(figure: Figure | SubFigure, shapes: Shapes) -> None:
    """The undeformed body in grey and the mode on it, coloured by its displacement; its interfaces on the first."""
    count = len(shapes.motion)
    rows = 1 if count == 1 else 2
    axes = figure.subplots(rows, -(-count // rows), squeeze=False)
    # Parts of the figure: the tenth on the right is for the scale of colors.
    figure.subplots_adjust(left=0.02, right=0.90, top=0.90, bottom=0.03, wspace=0.04, hspace=0.16)
    for number, panel in enumerate(axes.ravel()):
        panel.set_axis_off()
        if number < count:
            _draw_mode(panel, shapes, number)
            # A place for the title saves Matplotlib from laying out the axes, which are not shown, to find one.
            panel.set_title(f"mode {number + 1}: {shapes.frequencies_hz[number]:,.1f} Hz", y=1.0)
    _mark_interfaces(axes[0, 0], shapes)
    # Left and lower edge, width and height, in the middle of that tenth.
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
    points, frame = _in_view(shapes)
    largest = TOL.drawn_displacement * float(np.ptp(points, axis=0).max())
    motion = shapes.motion[number] @ frame.T
    size = np.linalg.norm(motion, axis=1)
    # Which way a mode points has no meaning: its largest motion goes upwards or to the viewer.
    sign = 1.0 if motion[size.argmax(), 1:].sum() >= 0 else -1.0
    # A mode of what lies under the skin alone leaves the skin at rest.
    top = float(size.max()) or 1.0
    moved = points + sign * largest / top * motion
    _paint(panel, points, shapes.triangles, None)
    _paint(panel, moved, shapes.triangles, size / top)
    panel.set_aspect("equal")
    panel.autoscale_view()


def _in_view(shapes: Shapes) -> tuple[Floats, Floats]:
    """The points about their middle in the frame of the picture, and that frame."""
    frame = viewed_axes(shapes.points)
    return (shapes.points - shapes.points.mean(axis=0)) @ frame.T, frame


def _mark_interfaces(panel: Axes, shapes: Shapes) -> None:
    _, frame = _in_view(shapes)
    for name, point in shapes.interfaces.items():
        x, y, _ = (point - shapes.points.mean(axis=0)) @ frame.T
        panel.plot(x, y, "o", color="white", markeredgecolor=FULL_COLOR, markersize=4)
        label = panel.annotate(name, (x, y), xytext=(4, 4), textcoords="offset points", fontsize=7)
        label.set_path_effects([withStroke(linewidth=2, foreground="white")])


def _paint(panel: Axes, points: Floats, triangles: NDArray[np.int64], size: Floats | None) -> None:
    """Triangles seen along the third axis, the farthest first; grey without ``size`` (n,)."""
    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)
    visible = np.flatnonzero(normal[:, 2] > 0)
    order = visible[np.argsort(corners[visible, :, 2].mean(axis=1), kind="stable")]
    if not len(order):  # all of it is seen edge-on
        return
    if size is None:
        colors = np.tile(to_rgba(REST_COLOR), (3 * len(order), 1))
    else:
        # Faces that are seen edge-on keep 62 % of their color.
        shade = 0.62 + 0.38 * np.clip(normal[order] @ (LIGHT / np.linalg.norm(LIGHT)), 0, 1)
        colors = np.asarray(COLORS(size[triangles[order]].ravel()))
        colors[:, :3] *= np.repeat(shade, 3)[:, None]
    # Each triangle has corners of its own, so that edges of the body stay sharp; drawn in one call.
    x, y = corners[order, :, :2].reshape(-1, 2).T
    skin = TriMesh(Triangulation(x, y, np.arange(len(x)).reshape(-1, 3)), rasterized=True)
    skin.set_facecolor(cast(Any, colors))
    # Its limits come from the corners: Matplotlib would take them from an outline of every triangle.
    panel.add_collection(skin, autolim=False)
    panel.update_datalim(np.column_stack([x, y]))
