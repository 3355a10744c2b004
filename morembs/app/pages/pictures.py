"""Drawings as files that are small in a page: each kind of drawing has an encoding of its own."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from morembs.app.report.style import STYLE

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL.Image import Image

# Small ones and their files beside pages are PNG; of shaded skins WebP takes half of the bytes of a PNG of 256 colors,
# without its dots; lines have few colors.
Kind = Literal["small", "shaded", "lines"]


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture of a part: the ``name`` under which it is kept, its words, width and height in inches with dots per
    inch, and what draws it, which says whether there was anything to draw."""

    name: str
    alt: str
    size: tuple[float, float, int]
    draw: Callable[[Figure], bool]
    kind: Kind = "small"

    def encode(self) -> bytes:
        """The drawing as a file; nothing where nothing is drawn."""
        return picture_of(self.size, self.draw, self.kind)


def picture_of(size: tuple[float, float, int], draw: Callable[[Figure], bool], kind: Kind = "small") -> bytes:
    """A drawing as a file, PNG or WebP; nothing where nothing is drawn."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    width, height, dots = size
    with mpl.rc_context({"font.size": 9, "axes.titlesize": 10, "font.family": "DejaVu Sans"}):
        figure = Figure(figsize=(width, height), dpi=dots, facecolor="white")
        FigureCanvasAgg(figure)
        if not draw(figure):
            return b""
        pixels = io.BytesIO()
        figure.savefig(pixels, format="png")
    return _encode(Image.open(pixels).convert("RGB"), kind)


def _encode(drawn: Image, kind: Kind) -> bytes:
    from PIL import Image, features

    file = io.BytesIO()
    if kind == "shaded" and features.check("webp"):
        drawn.save(file, format="webp", quality=STYLE.shaded_quality, method=6)
        return file.getvalue()
    # The colors that lie farthest apart, and between them dots of these, or the nearest one of a line.
    count = STYLE.line_colors if kind == "lines" else 256
    dither = Image.Dither.NONE if kind == "lines" else Image.Dither.FLOYDSTEINBERG
    colors = drawn.quantize(count, method=Image.Quantize.MAXCOVERAGE)
    _whiten(colors)
    drawn.quantize(count, palette=colors, dither=dither).save(file, format="png", optimize=True)
    return file.getvalue()


def _whiten(colors: Image) -> None:
    """Make the lightest color of a palette that of the paper: another white is seen on it."""
    from PIL import ImageColor

    palette, white = colors.getpalette() or [], ImageColor.getrgb("white")
    if palette:
        lightest = max(range(0, len(palette), 3), key=lambda at: min(palette[at : at + 3]))
        palette[lightest : lightest + 3] = white
        colors.putpalette(palette)
        colors.load()  # what quantizes reads


def data_address(source: str) -> str:
    """The address of a picture that was encoded, as base64, within a page."""
    return f"data:image/{'webp' if source.startswith(WEBP_START) else 'png'};base64,{source}"


# The first bytes of each kind of file in base64.
PNG_START, WEBP_START = "iVBORw0KGgo", "UklGR"
