"""What stands in the section of a part: the table below is its contents page.

Each is a function of the part that gives HTML as ``Markup``, empty where the part has none of it. Values get into it
by ``Markup.format`` or ``as_json`` alone, which escape them. Tables of stages are not here: a stage has them itself
(``JobStage.sections`` and ``on_page``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from morembs.app.jobs.viewing import stored_scene
from morembs.app.pages.kept import KeptParts, as_json, key_of, sum_of
from morembs.app.pages.pictures import Kind, Picture, data_address
from morembs.app.report.style import STYLE
from morembs.base.errors import InputError
from morembs.body.file import read_body
from morembs.body.stored import StoredBodies
from morembs.body.tolerances import TOL as BODY
from morembs.fem.viewer.page import PROGRAM, Scene, document_of, section_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from morembs.base.charts import Chart
    from morembs.body.shapes import Shapes


@dataclass(frozen=True, kw_only=True, eq=False)
class PartPage:
    """A part on its way into a page: the body ``file``, its ``sha256``, what the page says of it (``content``).

    ``stored`` is read when it is asked for, unless it is ``fresh``: a part that has not changed goes without.
    ``is_alone`` says that it has a page of its own.
    """

    name: str
    file: Path
    sha256: str
    content: Mapping[str, Any]
    is_alone: bool = False
    fresh: StoredBodies | None = None
    kept: KeptParts = field(default_factory=lambda: KeptParts(()))

    @cached_property
    def stored(self) -> StoredBodies:
        """All of the body file.

        Raises:
            InputError: it cannot be read.
        """
        return read_body(self.file) if self.fresh is None else self.fresh

    @property
    def shown(self) -> str:
        """Name of the body that stands for the part."""
        return str(self.content["shown"])

    @property
    def holds_members(self) -> bool:
        """True if the file holds planar members."""
        return bool(self.content.get("members"))

    @property
    def key(self) -> str:
        """Under which pictures of this body file are kept."""
        return key_of(self.sha256)

    @cached_property
    def shapes(self) -> Shapes | None:
        """The first modes of the body that is shown on its skin; None where it keeps no nodes, or no elements."""
        from morembs.body.shapes import shapes_on

        return shapes_on(self.stored.bodies[self.shown].view(BODY.drawn_modes)) if len(self.stored.node_ids) else None

    def source(self, picture: Picture) -> str:
        """A picture in base64, as it was kept or drawn now; empty where nothing is drawn, which is kept too."""
        return self.kept.picture(f"{self.key}:{picture.name}", picture.encode)

    def image(self, picture: Picture) -> Markup:
        """A picture as an image of a page; where nothing is drawn, a mark that says so to a later report."""
        key, source = f"{self.key}:{picture.name}", self.source(picture)
        if not source:
            return Markup('<template data-key="{}"></template>').format(key)
        width, height, dots = picture.size
        image = '<img data-key="{}" data-sum="{}" src="{}" alt="{}" width="{:.0f}" height="{:.0f}">'
        return Markup(image).format(key, sum_of(source), data_address(source), picture.alt, width * dots, height * dots)


def _member_picture(part: PartPage, name: str, alt: str, size: tuple[float, float, int]) -> Picture:
    def draw(figure: Figure) -> bool:
        from morembs.app.pages.members import draw_member

        return draw_member(figure, part.file, part.shown, bare=size == STYLE.row_picture)

    return Picture(name=name, alt=alt, size=size, draw=draw, kind="small" if size == STYLE.row_picture else "lines")


def _shapes_picture(
    part: PartPage,
    name: str,
    alt: str,
    size: tuple[float, float, int],
    draw: Callable[[Figure, Shapes], object],
    kind: Kind = "small",
) -> Picture:
    def draw_if_any(figure: Figure) -> bool:
        if part.shapes is not None:
            draw(figure, part.shapes)
        return part.shapes is not None

    return Picture(name=name, alt=alt, size=size, draw=draw_if_any, kind=kind)


def row_picture(part: PartPage) -> Picture:
    """The first mode, or shapes of a planar member, for the row of the part."""
    if part.holds_members:
        return _member_picture(part, "row", f"shapes of {part.name}", STYLE.row_picture)
    from morembs.body.drawing import draw_first

    return _shapes_picture(part, "row", f"first mode of {part.name}", STYLE.row_picture, draw_first)


def icon(part: PartPage) -> Markup:
    """The picture of the row as the icon of the page of a part, where a later report finds it again."""
    picture = row_picture(part)
    source = part.source(picture)
    text = '<link rel="icon" data-key="{0}:row" data-sum="{1}" href="data:image/png;base64,{2}">'
    return Markup(text).format(part.key, sum_of(source), source) if source else part.image(picture)


def mode_pictures(part: PartPage) -> Markup:
    """Four modes of the body that is shown, or shapes of a planar member over its end angles."""
    if part.holds_members:
        alt = f"shapes of {part.shown} of {part.name}"
        return part.image(_member_picture(part, "modes", alt, STYLE.shapes_picture))
    from morembs.body.drawing import draw_shapes

    alt = f"modes of {part.shown} of {part.name}"
    return part.image(_shapes_picture(part, "modes", alt, STYLE.shapes_picture, draw_shapes, "shaded"))


def response_picture(part: PartPage) -> Markup:
    """The response with its certificates, of all bodies."""
    if part.holds_members:
        return Markup("")
    from morembs.app.jobs.compare import certified_response
    from morembs.app.jobs.picture import draw_response

    def draw(figure: Figure) -> bool:
        response = certified_response(list(part.stored.bodies.values()))
        if response is not None:
            draw_response(figure, response)
        return response is not None

    alt = f"response and error of {part.name}"
    return part.image(Picture(name="response", alt=alt, size=STYLE.response_picture, draw=draw, kind="lines"))


def viewer(part: PartPage) -> Markup:
    """The modes as they move; on a page of its own they are there at once."""
    try:
        data = as_json(part.kept.data(f"{part.key}:viewer", lambda: document_of(_scene(part))))
    except InputError:
        return Markup("")  # there is nothing to show
    script = Markup('<script type="application/json" data-key="{}:viewer" data-sum="{}">{}</script>')
    inner = Markup(section_of(script.format(part.key, sum_of(data), data)))
    text = '<details class="morembs-look"{}><summary>Look at it: modes that move</summary>{}</details>'
    return Markup(text).format(Markup(" open" if part.is_alone else ""), inner)


def _scene(part: PartPage) -> Scene:
    return stored_scene(part.stored, part.name, part.shown, STYLE.viewer_modes)


def charts(part: PartPage) -> Markup:
    """Responses with their limits, modal density, MAC, Campbell diagram and cost, drawn by a script; without one, the
    picture of the responses."""
    plain = part.kept.data(f"{part.key}:charts", lambda: [chart.plain() for chart in _charts(part)])
    data = as_json(plain)
    text = (
        '<div class="charts"><script type="application/json" data-key="{}:charts" data-sum="{}">{}</script></div>'
        "<noscript>{}</noscript>"
    )
    return Markup(text).format(part.key, sum_of(data), data, response_picture(part))


def _charts(part: PartPage) -> Iterator[Chart]:
    from morembs.body.charts import cost_chart

    if not part.holds_members:
        yield from _body_charts(part)
    stages = part.content["stages"]
    if stages:
        seconds, memory = (
            {name: stage[key] for name, stage in stages.items()} for key in ("seconds", "peak_memory_bytes")
        )
        yield cost_chart(seconds, memory)


def _body_charts(part: PartPage) -> Iterator[Chart]:
    from morembs.body.charts import campbell_chart, density_chart, mac_chart
    from morembs.certificate.charts import certificate_chart

    bodies, shown = part.stored.bodies, part.stored.bodies[part.shown]
    known = {name: body.certificate for name, body in bodies.items() if body.certificate is not None}
    if known:
        yield certificate_chart(known)
    elastic = {name: body.frequencies_hz[body.rigid_count :] for name, body in bodies.items()}
    if any(((hz > 0) & (hz < math.inf)).any() for hz in elastic.values()):
        yield density_chart(elastic, shown.full_frequencies_hz)
    for body in bodies.values():
        if body is not shown and shown.modes(1).size and body.modes(1).size:
            yield mac_chart(shown, body, STYLE.mac_modes)
    if shown.spin is not None:
        yield campbell_chart(shown, None, STYLE.campbell_modes)


# One line for each, in the order in which they stand in the section of a part.
SECTIONS: tuple[Callable[[PartPage], Markup], ...] = (mode_pictures, viewer, charts)
# Scripts and style sheets that a page with sections holds once: package and file.
SCRIPTS: tuple[tuple[str, str], ...] = (
    ("morembs.app.pages", "charts.js"),
    *(("morembs.fem.viewer", name) for name in PROGRAM),
)
STYLES: tuple[tuple[str, str], ...] = (
    ("morembs.app.pages", "page.css"),
    ("morembs.app.pages", "charts.css"),
    ("morembs.fem.viewer", "viewer.css"),
)
