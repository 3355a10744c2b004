"""The modes of one body as a scene of the viewer."""

from __future__ import annotations

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.body.drawing import viewed_axes
from morembs.body.shapes import faces_of
from morembs.body.vtkhdf_series import Grid, View
from morembs.fem.viewer.page import Scene
from morembs.fem.viewer.scene import Motion, Surface
from morembs.fem.viewer.skin import dotted_surface, drawn_surface


def scene_of_view(view: View, stress: Floats | None = None) -> Scene:
    """The modes of one body; ``stress`` (k, n) of them at the nodes of the view.

    Raises:
        InputError: no modes, or coordinates that are no numbers.
    """
    surface, rows = surface_of(view.body, view.grid, view.node_ids)
    if not len(view.motion):
        raise InputError(f"{view.body} has no elastic modes to show")
    motion = Motion(
        name=view.body,
        surface=0,
        shapes=view.motion[:, rows],
        values=view.frequencies_hz,
        stress=None if stress is None else stress[:, rows],
    )
    return Scene(
        title=f"Modes of {view.body}",
        surfaces=(surface,),
        motions=(motion,),
        frames=view.interfaces,
        view=viewed_axes(surface.points),
    )


def surface_of(name: str, grid: Grid, node_ids: Ints) -> tuple[Surface, Ints]:
    faces = faces_of(grid)
    if not np.isfinite(grid.points).all():
        raise InputError(f"coordinates of {name}: NaN or infinity cannot be shown; check the run that made them")
    # Beams, assemblies, and bodies that keep the nodes of their interfaces alone.
    if not any(len(nodes) for nodes in faces.values()):
        return dotted_surface(grid.points, node_ids)
    return drawn_surface(grid.points, node_ids, faces)
