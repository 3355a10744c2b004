"""Sizes of reports, in a terminal and as pages."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ReportStyle:
    """Sizes of layout, each named by its quantity."""

    # Elastic frequencies of a body: that evaluate prints where no number is given, of a report, on a page, and
    # in its JSON.
    evaluated_frequencies: int = 6
    reported_frequencies: int = 10
    page_frequencies: int = 5
    document_frequencies: int = 20
    # Significant digits of the lowest frequency of a page, and digits behind the point at most.
    frequency_digits: int = 4
    frequency_decimals: int = 4
    # Modes of a matrix of MAC, and at each speed of a Campbell diagram, of a page.
    mac_modes: int = 10
    campbell_modes: int = 12
    # Columns of a table of frequencies, and terms of a ranking.
    bodies_per_table: int = 2
    ranked_terms: int = 8
    # Characters in a line of a pipe or a file, and of a table at most.
    pipe_width: int = 160
    max_table_width: int = 1000

    # What is kept of an older report: goes up with the form of pictures and of what scripts read.
    kept_form: int = 2
    # Quality of shaded pictures, of 100, and colors of those of lines: by eye, as of the drawing itself.
    shaded_quality: int = 85
    line_colors: int = 64
    # Pictures of a page: width and height in inches, dots per inch.
    row_picture: tuple[float, float, int] = (1.6, 1.0, 80)
    shapes_picture: tuple[float, float, int] = (9.0, 4.0, 90)
    # Elastic modes that a viewer in a report shows: twelve parts of 6,000 triangles have 2.4 MB.
    viewer_modes: int = 12
    # Parts with a section in the page itself: of more parts each has a page in the folder beside it.
    sections_in_page: int = 20
    # Dots per inch and number of colors of the picture where no script runs: a fifth of the bytes of a full one.
    still_dots: int = 72
    still_colors: int = 48
    response_picture: tuple[float, float, int] = (9.0, 4.6, 90)
    curves_picture: tuple[float, float, int] = (9.0, 2.8, 90)
    # Width of a curve over time in points, opacity of the grid behind it, and curves that a legend names at most.
    curve_line: float = 1.3
    grid_opacity: float = 0.3
    named_curves: int = 8


STYLE = ReportStyle()
