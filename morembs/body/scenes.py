"""Bodies and recovered motions as scenes of the viewer: modes, stress shapes, two bodies beside each other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.body.charts import mac
from morembs.body.drawing import viewed_axes
from morembs.body.tolerances import TOL
from morembs.body.view_scene import surface_of
from morembs.body.vtkhdf_series import Grid
from morembs.fem.viewer.page import Scene
from morembs.fem.viewer.scene import Motion, Surface
from morembs.storage.hdf5 import reading

if TYPE_CHECKING:
    from morembs.body.body import Body


def scene_of_bodies(
    bodies: Sequence[Body], title: str, *, names: Sequence[str] = (), shown: int = 0, modes: int = TOL.viewed_modes
) -> Scene:
    """Bodies of one part, or of several, with the MAC of their ``modes``; the one at place ``shown`` comes first.

    Bodies of one file share a surface; of other bodies than the first fewer modes are kept, so that a page stays small.
    Those of two parts are shown side by side.

    Raises:
        InputError: none has modes, or a file is gone or damaged.
    """
    order = sorted(range(len(bodies)), key=lambda place: place != shown)
    surfaces: list[Surface] = []
    rows: list[Ints] = []
    motions: list[Motion] = []
    frames: dict[str, Floats] = {}
    known: dict[int, int] = {}
    counts = iter(_counts(len(bodies), modes))
    for place in order:
        body = bodies[place]
        part = id(body.file if body.part is None else body.part)
        if part not in known:
            view = body.view(modes)
            surface, chosen = surface_of(body.name, view.grid, view.node_ids)
            known[part] = len(surfaces)
            surfaces.append(surface)
            rows.append(chosen)
            frames.update({name: at for name, at in view.interfaces.items() if name not in frames})
        at = known[part]
        shapes = body.modes(next(counts))[:, rows[at]]
        if not len(shapes):
            continue
        motions.append(
            Motion(
                name=names[place] if names else body.name,
                surface=at,
                shapes=shapes,
                values=body.frequencies_hz[body.rigid_count :][: len(shapes)],
                stress=_stress(body, len(shapes), surfaces[at].node_ids),
            )
        )
    if not motions:
        raise InputError(f"{bodies[0].name} has no elastic modes to show")
    mac, notes = _compare_modes(motions, surfaces)
    return Scene(
        title=title,
        surfaces=tuple(surfaces),
        motions=tuple(motions),
        frames=frames,
        view=viewed_axes(surfaces[0].points),
        mac=mac,
        side_by_side=len(surfaces) > 1 and len(motions) > 1,
        notes=notes,
    )


def _counts(bodies: int, modes: int) -> list[int]:
    """How many modes of each body a page has."""
    rest = max(1, min(modes // 3, TOL.viewed_modes_of_all // max(1, bodies)))
    return [modes, *([rest] * (bodies - 1))]


def _stress(body: Body, count: int, labels: Ints) -> Floats | None:
    """Von Mises stress (k, n) of the first elastic modes at the nodes with these labels, NaN where it is unknown."""
    if not body.has_recovery:
        return None
    # Not at the top: most bodies are shown without stress.
    from morembs.fem.stress_operator import von_mises

    recovery = body.recovery()
    modes = body.reduced.modes()[1][:, body.rigid_count : body.rigid_count + count]
    size = von_mises(recovery.at(modes.T))
    order = np.argsort(recovery.points, kind="stable")
    starts = np.flatnonzero(np.append(True, np.diff(recovery.points[order]) > 0))
    # A node where materials meet is a point for each of them: the larger stress is shown.
    largest = np.maximum.reduceat(size[:, order], starts, axis=1)
    points = recovery.points[order][starts]
    place = np.minimum(np.searchsorted(points, labels), len(points) - 1)
    return np.where(points[place] == labels, largest[:, place], np.nan)


def _compare_modes(
    motions: Sequence[Motion], surfaces: Sequence[Surface]
) -> tuple[dict[tuple[int, int], Floats], tuple[str, ...]]:
    """MAC of the modes of all pairs of motions at nodes that both have."""
    found, notes = {}, []
    for j, two in enumerate(motions):
        for i, one in enumerate(motions[:j]):
            a, b, by_nearest = _common(surfaces[one.surface], surfaces[two.surface], one.surface == two.surface)
            if not len(a):
                notes.append(f"{one.name} and {two.name} are at other places, so that no MAC compares them")
                continue
            if by_nearest:
                notes.append(f"MAC of {one.name} and {two.name}: by the nearest nodes, as they have other meshes")
            found[i, j] = mac(one.shapes[:, a], two.shapes[:, b])
    return found, tuple(notes)


def _common(one: Surface, two: Surface, same: bool) -> tuple[Ints, Ints, bool]:
    """Rows of the points of both that are at one place, or nearest each other; and whether they are apart."""
    if same:
        rows = np.arange(len(one.points))
        return rows, rows, False
    # Not at the top: a search for neighbours is needed for two parts only.
    from scipy.spatial import cKDTree

    size = float(np.linalg.norm(np.ptp(one.points, axis=0)))
    distance, nearest = cKDTree(two.points).query(one.points)
    rows = np.flatnonzero(distance <= TOL.compared_distance * size)
    exact = distance[rows].max(initial=0.0) <= TOL.equal_coordinate * size
    return rows, nearest[rows], not exact


def scene_of_series(path: Path, title: str) -> Scene:
    """A motion that ``recover`` wrote, at some of its steps: a player.

    Raises:
        InputError: not such a file, or damaged.
    """
    with reading(path, "a recovered motion") as file:
        group: Any = file.get("VTKHDF", {})
        if "Steps" not in group or "PointData" not in group:
            raise InputError(f"{path} has no steps over time; expected a file that morembs recover wrote")
        times = np.atleast_1d(group["Steps/Values"][()])
        if not len(times):
            raise InputError(f"{path} has no steps over time; write it again", kind="file", keyword=path.name)
        grid = Grid(**{name: group[name.capitalize()][()] for name in ("points", "connectivity", "offsets", "types")})
        n, data = len(grid.points), group["PointData"]
        # Files of earlier versions have no labels.
        labels = file["node_ids"][()] if "node_ids" in file else np.arange(n)
        frames, frame_nodes = _frames_of(file)
        surface, rows = surface_of(str(path), grid, labels)
        max_steps = max(2, min(TOL.viewed_steps, TOL.viewed_numbers // max(1, 3 * len(rows))))
        steps = np.unique(np.linspace(0, len(times) - 1, min(len(times), max_steps)).round().astype(int))
        name = "motion" if "motion" in data else "displacement"
        shapes = np.array([data[name][step * n : (step + 1) * n][rows] for step in steps], dtype=float)
        shapes = shapes.reshape(len(steps), len(rows), 3)
        stress = None
        if "von_mises" in data:
            stress = np.array([data["von_mises"][step * n : (step + 1) * n][rows] for step in steps], dtype=float)
            stress = stress.reshape(len(steps), len(rows))
    note = f"{len(steps)} of {len(times)} steps are shown" if len(steps) < len(times) else ""
    return Scene(
        title=title,
        surfaces=(surface,),
        motions=(Motion(name=path.name, surface=0, shapes=shapes, values=times[steps], over_time=True, stress=stress),),
        frames=frames,
        frame_nodes=frame_nodes,
        view=viewed_axes(surface.points),
        notes=(note,) if note else (),
    )


def _frames_of(file: Any) -> tuple[dict[str, Floats], dict[str, Ints]]:
    """Frames (4, 3) of the interfaces in a file of a motion, and labels of their nodes, by name."""
    groups = file.get("interfaces", {})
    return {name: groups[name]["frame"][()] for name in groups}, {name: groups[name]["node_ids"][()] for name in groups}
