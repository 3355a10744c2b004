"""Charts as data: what ``figure`` draws with Matplotlib, a page draws of the same by its own script (``plain``)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from morembs.base.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Colors of bodies in turn; the full model has that of the text.
COLORS = ("#d1495b", "#2e86ab", "#3d9970", "#b5651d", "#7b4fa3", "#607d8b")
FULL_COLOR = "#202020"
Dash = Literal["solid", "dashed", "dotted", "dots"]
_DASHES: dict[Dash, Any] = {"solid": "-", "dashed": (0, (5, 2)), "dotted": (0, (1, 1.5)), "dots": ""}


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve:
    """A line through ``x``, ``y`` (n,), or ``dots``; where y is not a number it has a gap. ``color`` counts from 0
    through the colors of bodies, None is that of the full model."""

    name: str
    x: Floats
    y: Floats
    color: int | None = None
    dash: Dash = "solid"


@dataclass(frozen=True, kw_only=True, eq=False)
class Panel:
    """Curves over one axis."""

    y_label: str
    curves: Sequence[Curve]
    x_label: str = "frequency in Hz"
    x_log: bool = True
    y_log: bool = True

    def draw(self, axes: Axes) -> None:
        """Draw it with Matplotlib."""
        for curve in self.curves:
            axes.plot(
                curve.x,
                curve.y,
                color=_color(curve.color),
                linestyle=_DASHES[curve.dash],
                # In points.
                linewidth=2.0 if curve.color is None else 1.2,
                marker="." if curve.dash == "dots" else "",
                label=curve.name,
            )
        axes.set(
            xlabel=self.x_label,
            ylabel=self.y_label,
            xscale="log" if self.x_log and _has_positive(c.x for c in self.curves) else "linear",
            yscale="log" if self.y_log and _has_positive(c.y for c in self.curves) else "linear",
        )
        axes.grid(True, color="#d0d4d8", linewidth=0.5)
        axes.legend(frameon=False)
        axes.spines[["top", "right"]].set_visible(False)

    def plain(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "kind": "curves",
            "x_label": self.x_label,
            "y_label": self.y_label,
            "x_log": self.x_log,
            "y_log": self.y_log,
            "curves": [
                {"name": c.name, "x": _plain(c.x), "y": _plain(c.y), "color": c.color, "dash": c.dash}
                for c in self.curves
            ],
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Bars:
    """A bar for each of ``names``, of ``values`` (n,), with what is written beside each."""

    label: str
    names: Sequence[str]
    values: Floats
    texts: Sequence[str]

    def draw(self, axes: Axes) -> None:
        """Draw it with Matplotlib."""
        bars = axes.barh(range(len(self.names)), self.values, color=COLORS[1])
        axes.set_yticks(range(len(self.names)), self.names)
        axes.bar_label(bars, self.texts, padding=3)
        axes.invert_yaxis()
        # A third more for the words.
        axes.set_xlim(0, 1.3 * float(max(self.values, default=1.0)) or 1.0)
        axes.set_xlabel(self.label)
        axes.spines[["top", "right"]].set_visible(False)

    def plain(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "kind": "bars",
            "label": self.label,
            "names": list(self.names),
            "values": _plain(self.values),
            "texts": list(self.texts),
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Matrix:
    """Shares (r, c) from 0 to 1, with the names of rows and columns."""

    row_label: str
    column_label: str
    rows: Sequence[str]
    columns: Sequence[str]
    values: Floats

    def draw(self, axes: Axes) -> None:
        """Draw it with Matplotlib."""
        image = axes.imshow(self.values, vmin=0, vmax=1, cmap="viridis")
        axes.set_xticks(range(len(self.columns)), self.columns, rotation=90)
        axes.set_yticks(range(len(self.rows)), self.rows)
        axes.set(xlabel=self.column_label, ylabel=self.row_label)
        axes.figure.colorbar(image, ax=axes)

    def plain(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "kind": "matrix",
            "row_label": self.row_label,
            "column_label": self.column_label,
            "rows": list(self.rows),
            "columns": list(self.columns),
            "values": [_plain(row) for row in self.values],
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Chart:
    """Panels below each other under one ``title``; ``note`` explains lines."""

    title: str
    panels: Sequence[Panel | Bars | Matrix]
    note: str = ""

    def figure(self) -> Figure:
        """The chart drawn with Matplotlib; a notebook shows the figure, ``savefig`` keeps it."""
        from matplotlib.figure import Figure

        count = len(self.panels)
        # Inches: a panel of a chart of one is as high as two of a chart of several.
        figure = Figure(figsize=(8.0, 4.5 if count == 1 else 3.0 * count), layout="constrained", facecolor="white")
        shared = all(isinstance(panel, Panel) for panel in self.panels)
        panels = figure.subplots(count, 1, squeeze=False, sharex=shared)
        for panel, axes in zip(self.panels, panels[:, 0], strict=True):
            panel.draw(axes)
            if shared:
                axes.label_outer()
        panels[0, 0].set_title(self.title, loc="left")
        if self.note:
            figure.supxlabel(self.note, fontsize="small")
        return figure

    def plain(self) -> dict[str, Any]:
        """As plain values, with six digits. Where a curve has the ``x`` of an earlier one of the chart, it has its
        number in place of them."""
        panels = [panel.plain() for panel in self.panels]
        known: list[list[float | None]] = []
        for curve in (curve for panel in panels for curve in panel.get("curves", ())):
            known.append(curve["x"])
            first = known.index(curve["x"])
            if first < len(known) - 1:
                curve["x"] = first
        return {"title": self.title, "note": self.note, "panels": panels}


def _has_positive(rows: Iterable[Floats]) -> bool:
    """True if an axis of ratios has a place for any of the numbers."""
    return any(bool((np.asarray(row) > 0).any()) for row in rows)


def _color(number: int | None) -> str:
    return FULL_COLOR if number is None else COLORS[number % len(COLORS)]


def _plain(values: Floats) -> list[float | None]:
    """Six digits of each; None for what is no finite number."""
    return [float(f"{x:.6g}") if math.isfinite(x) else None for x in np.asarray(values, dtype=float).tolist()]
