"""Sizes of the pictures of jobs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PictureStyle:
    """Sizes of layout, each named by its quantity."""

    # Dots per inch.
    dots_per_inch: int = 150
    # Widths of lines in points: of the full model, of a body, of limits and tolerances, of grids and fine grids.
    full_line: float = 2.4
    body_line: float = 1.3
    limit_line: float = 0.9
    grid_line: float = 0.6
    fine_grid_line: float = 0.4
    # Dots of a limit and the gaps between them, in widths of its line.
    limit_dots: tuple[float, float] = (1, 1.5)
    # Heights in inches of a picture: its margin, what shapes and what a response add.
    margin_height: float = 0.35
    shapes_height: float = 4.7
    response_height: float = 5.2
    # Ratios of the heights of its parts: title, shapes, response.
    title_ratio: float = 0.3
    shapes_ratio: float = 4.2
    response_ratio: float = 4.6
    # Place of its title, as parts of the width and of the height of that part.
    title_left: float = 0.025
    title_bottom: float = 0.25
    # Ratio of the heights of the panels of a response.
    upper_panel_ratio: float = 1.7
    # Edges of these panels, as parts of their figure, and the gap between them, as a part of their mean height.
    panel_left: float = 0.115
    panel_right: float = 0.975
    panel_top: float = 0.92
    panel_gap: float = 0.2
    # Lower edge.
    panel_bottom: float = 0.115
    # A comparison of contenders: inches, and the left edge of its title as a part of its width.
    contenders_height: float = 4.6
    contenders_title_left: float = 0.01
    # Upper end of an axis of frequencies over the highest one.
    frequency_room: float = 1.05


STYLE = PictureStyle()
