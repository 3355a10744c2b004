"""A scene and HTML around it: a page of its own, a section of a report, a frame in a notebook; none needs a network."""

from __future__ import annotations

import html
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem.tolerances import TOL
from morembs.fem.viewer.packing import pack_shape, pack_whole, whole_steps
from morembs.fem.viewer.prediction import Prediction
from morembs.fem.viewer.scene import Feature, Group, Motion, Surface

# The module in the order in which its parts are put behind each other.
PROGRAM = ("reading.js", "drawing.js", "picking.js", "viewer.js", "frames.js", "pointer.js", "panel.js")


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """All that one viewer shows.

    ``frames`` are points (3,) m of interfaces by name, or (4, 3) with axes as rows behind them, ``frame_nodes`` labels
    of the nodes that they move with, by default those nearest to them; ``view`` (3, 3) rows to
    the right, upwards, and to the viewer; ``mac`` (k1, k2) compares the modes of two motions, ``side_by_side`` shows
    the first two at once; ``picks`` is whether a click gives a line of a job, whose numbers are in ``unit``: ``length``
    m (of the points, 1) each.
    """

    title: str
    surfaces: tuple[Surface, ...]
    motions: tuple[Motion, ...] = ()
    groups: tuple[Group, ...] = ()
    features: tuple[Feature, ...] = ()
    frames: Mapping[str, Floats] = field(default_factory=dict)
    frame_nodes: Mapping[str, Ints] = field(default_factory=dict)
    view: Floats = field(default_factory=lambda: np.eye(3))
    mac: Mapping[tuple[int, int], Floats] = field(default_factory=dict)
    side_by_side: bool = False
    picks: bool = False
    unit: str = "m"
    length: float = 1.0
    notes: tuple[str, ...] = ()

    def _repr_html_(self) -> str:
        return embed(self)

    def page(self) -> str:
        """The scene as a page of its own, to be written to a file .html."""
        return viewer_page(self)

    @property
    def facts(self) -> dict[str, Any]:
        """How much is drawn."""
        return {
            "triangles": sum(len(surface.triangles) for surface in self.surfaces),
            "points": sum(len(surface.points) for surface in self.surfaces),
            "shapes": sum(len(motion.shapes) for motion in self.motions),
        }


def viewer_page(scene: Scene, picture: str = "") -> str:
    """The scene as a whole page; ``picture``, the address of a still one, is shown where no script runs.

    >>> page = viewer_page(mesh.view())
    >>> page.startswith("<!DOCTYPE html>"), "http" in page
    (True, False)
    """
    title = html.escape(scene.title)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}</title>\n{viewer_head()}\n</head>\n"
        f'<body class="morembs-page">\n<main>\n<h1>{title}</h1>\n{viewer_section(scene, picture)}\n</main>\n</body>\n'
        "</html>\n"
    )


def viewer_section(scene: Scene, picture: str = "") -> str:
    """The scene within a page that has ``viewer_head()`` once; it begins when it is scrolled to or its details open."""
    still = ""
    if picture:
        still = f'<img src="{html.escape(picture)}" alt="{html.escape(scene.title)}, a still picture">'
    # Within a script only "<" can end it.
    data = json.dumps(document_of(scene), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return section_of(f'<script type="application/json">{data}</script>', still)


def section_of(data: str, still: str = "") -> str:
    """The section around a script element with the document of a scene; both are HTML."""
    return (
        f'<div class="morembs-viewer"><div class="still">{still}'
        f"<noscript><p>A picture that moves needs JavaScript.</p></noscript></div>{data}</div>"
    )


@cache
def viewer_head() -> str:
    """What a page with sections has once: the style and the program."""
    folder = files("morembs.fem.viewer")
    style, *parts = (folder.joinpath(name).read_text(encoding="utf-8") for name in ("viewer.css", *PROGRAM))
    program = "".join(map(bare_program, parts))
    return f'<style>\n{style}</style>\n<script type="module">\n{program}</script>'


def bare_program(text: str) -> str:
    """A script without comments and indentation, which are a tenth of a page."""
    lines = (line.strip() for line in text.splitlines())
    return "".join(f"{line}\n" for line in lines if line and not line.startswith("//"))


def embed(scene: Scene) -> str:
    """The scene in a frame, as notebooks show it: nothing of it touches the page around.

    Notebooks that are not trusted take the frame away and leave its text.
    """
    page, title = html.escape(viewer_page(scene)), html.escape(scene.title)
    return (
        f'<iframe title="{title}" srcdoc="{page}" sandbox="allow-scripts allow-downloads" '
        'allow="clipboard-write" loading="lazy" style="width:100%;height:36rem;border:0">'
        f"{title} is not shown, as this notebook is not trusted: run the cell, or trust the notebook.</iframe>"
    )


def document_of(scene: Scene) -> dict[str, Any]:
    """The scene in numbers and texts of JSON, as ``viewer.js`` reads it.

    Raises:
        InputError: nothing to draw, or places, displacements, frequencies or times that are no finite numbers.
    """
    _refuse_undrawable(scene)
    whole = np.concatenate([surface.points for surface in scene.surfaces])
    low, high = whole.min(axis=0), whole.max(axis=0)
    middle, half = (low + high) / 2, float(np.linalg.norm(high - low)) / 2 or 1.0
    document: dict[str, Any] = {
        "title": scene.title,
        "middle": middle.tolist(),
        "half": half,
        "unit": {"name": scene.unit, "length": scene.length},
        "view": scene.view.tolist(),
        **_surfaces_and_motions(scene, middle, half),
        "groups": [_group(group) for group in scene.groups],
        "frames": [_frame(scene, name, np.atleast_2d(rows)) for name, rows in scene.frames.items()],
        "picks": scene.picks,
        "mac": [[one, two, np.round(values, 3).tolist()] for (one, two), values in scene.mac.items()],
        "sideBySide": scene.side_by_side,
        "notes": [*scene.notes, *(surface.note for surface in scene.surfaces if surface.note)],
    }
    if scene.features:
        owner = np.full(len(scene.surfaces[0].triangles), -1, dtype=np.int64)
        for number, feature in enumerate(scene.features):
            owner[feature.triangles] = number
        document["owner"] = pack_whole(owner)
        document["features"] = [{"select": feature.select, "about": feature.about} for feature in scene.features]
    return document


def _refuse_undrawable(scene: Scene) -> None:
    numbers = [(f"coordinates of {scene.title}", surface.points) for surface in scene.surfaces]
    if not sum(len(points) for _, points in numbers):
        raise InputError(f"{scene.title} has no nodes, so there is nothing to show", kind="missing", keyword="nodes")
    for motion in scene.motions:
        numbers.append((f"displacements of {motion.name}", motion.shapes))
        numbers.append((f"{'times' if motion.over_time else 'frequencies'} of {motion.name}", motion.values))
    numbers += [(f"the frame of the interface {name!r}", rows) for name, rows in scene.frames.items()]
    for what, values in numbers:
        if not np.isfinite(values).all():
            raise InputError(f"{what}: NaN or infinity cannot be shown; check the run that made them")


def _frame(scene: Scene, name: str, rows: Floats) -> dict[str, Any]:
    """A frame, and for each surface that moves the points that it moves with."""
    axes = rows[1:] if len(rows) > 1 else np.eye(3)
    labels = scene.frame_nodes.get(name, np.empty(0, dtype=np.int64))
    nodes = [_beside(surface, rows[0], labels).tolist() for surface in scene.surfaces] if scene.motions else []
    return {"name": name, "at": rows[0].tolist(), "axes": axes.tolist(), "nodes": nodes}


def _beside(surface: Surface, point: Floats, labels: Ints) -> Ints:
    """Some points of a surface with these labels; where it has none of them, those nearest to ``point`` (3,)."""
    rows = np.flatnonzero(np.isin(surface.node_ids, labels))
    if not len(rows):
        distance = np.linalg.norm(surface.points - point, axis=1)
        return np.sort(np.argsort(distance, kind="stable")[: TOL.frame_points])
    return rows[:: -(-len(rows) // TOL.frame_points)]


def _surfaces_and_motions(scene: Scene, middle: Floats, half: float) -> dict[str, Any]:
    """Surfaces, and what moves on them."""
    places = [
        np.round((surface.points - middle) / half * TOL.drawn_place_steps).astype(np.int64)
        for surface in scene.surfaces
    ]
    across = [Prediction.across_edges(surface.triangles) for surface in scene.surfaces]
    planes = [each.of_plane(at) for each, at in zip(across, places, strict=True)]
    # Shapes so far of each surface, modes alone: steps over time are like none of another motion.
    known: list[list[Ints]] = [[] for _ in scene.surfaces]
    return {
        "surfaces": [_surface(*each) for each in zip(scene.surfaces, places, across, strict=True)],
        "motions": [_motion(each, planes[each.surface], known[each.surface]) for each in scene.motions],
    }


def _surface(surface: Surface, places: Ints, across: Prediction) -> dict[str, Any]:
    """Columns b and c of triangles are differences to a, which are small."""
    triangles = surface.triangles.copy()
    triangles[:, 1:] -= triangles[:, :1]
    return {
        "points": pack_whole(places, across),
        "scale": 1 / TOL.drawn_place_steps,
        "fewer": bool(surface.note),
        "labels": pack_whole(surface.node_ids),
        "triangles": pack_whole(triangles),
        "sides": pack_whole(surface.sides),
    }


def _motion(motion: Motion, plane: Prediction, known: list[Ints]) -> dict[str, Any]:
    """Shapes one by one, each with a scale of its own; those of modes are added to the ones ``known``."""
    pairs = [whole_steps(shape, TOL.drawn_shape_steps) for shape in motion.shapes]
    earlier = () if motion.over_time else tuple(known)
    document: dict[str, Any] = {
        "name": motion.name,
        "surface": motion.surface,
        "values": [float(value) for value in motion.values],
        "overTime": motion.over_time,
        "shapes": [pack_shape(whole, plane, earlier) | {"scale": scale} for whole, scale in pairs],
    }
    if not motion.over_time:
        known += [whole for whole, _ in pairs]
    if motion.stress is not None:
        colors = [whole_steps(values[:, None], TOL.drawn_color_steps) for values in motion.stress]
        document["stress"] = [pack_whole(whole, plane) | {"scale": scale} for whole, scale in colors]
    return document


def _group(group: Group) -> dict[str, Any]:
    texts = {key: getattr(group, key) for key in ("name", "kind", "about", "select") if getattr(group, key)}
    parts = {
        key: pack_whole(getattr(group, key)) for key in ("triangles", "nodes", "lines") if len(getattr(group, key))
    }
    return {**texts, "count": group.count or len(group.nodes) or len(group.triangles), **parts}
