"""A body to look at: its first elastic modes on its cells, drawn or given to PyVista."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

import numpy as np

from morembs.base.errors import InputError
from morembs.base.optional import optional
from morembs.body.tolerances import TOL

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from morembs.body.vtkhdf_series import View


class Viewed(ABC):
    """What can be looked at: a body just made, or one read from its file."""

    @abstractmethod
    def view(self, modes: int = TOL.viewed_modes) -> View:
        """The first elastic ``modes``, or as many as there are.

        Raises:
            InputError: no positive count was asked for, or the body keeps no nodes.
        """

    def plot(self, modes: int = 4) -> Figure:
        """The first elastic ``modes`` drawn with Matplotlib; a notebook shows the figure, ``savefig`` keeps it.

        Raises:
            InputError: a body that keeps no elements, or has no elastic modes.
        """
        from matplotlib.figure import Figure

        from morembs.body.drawing import draw_shapes
        from morembs.body.shapes import shapes_on

        view = self.view(modes)
        shapes = shapes_on(view)
        if shapes is None:
            raise InputError(
                f'{view.body} has no elastic modes or no elements to show them on; keep nodes = "all" or "skin" of a '
                "model with elements"
            )
        # Inches, at 100 dots each.
        figure = Figure(figsize=(10.0, 4.7), dpi=100)
        draw_shapes(figure, shapes)
        return figure

    def to_pyvista(self, modes: int = 4) -> Any:
        """The body as a ``pyvista.UnstructuredGrid`` with the first elastic ``modes`` (n, 3) as point data.

        ``mode 1``, ``mode 2``, ... have unit modal mass, ``node`` is the label of each node, and the field
        ``frequencies_hz`` (k,) holds their frequencies.

        Raises:
            InputError: PyVista is not installed, or the body keeps no nodes.
        """
        pyvista = optional("pyvista", "to_pyvista")
        view = self.view(modes)
        begins, sizes = view.grid.offsets[:-1], np.diff(view.grid.offsets)
        cells = np.insert(view.grid.connectivity, begins, sizes)
        grid = pyvista.UnstructuredGrid(cells, np.array(view.grid.types), np.array(view.grid.points))
        grid.point_data["node"] = np.array(view.node_ids)
        for number, shape in enumerate(view.motion, start=1):
            grid.point_data[f"mode {number}"] = shape
        grid.field_data["frequencies_hz"] = view.frequencies_hz
        return grid
