"""Structured meshes of hexahedra: boxes, and any shape that a grid of points is mapped to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem.elements import TYPES
from morembs.fem.mesh import ElementBlock, Mesh, Nodes


def grid_cells(shape: Sequence[int], element: str = "hex20") -> Ints:
    """Nodes (ne, k) of the hexahedra on a grid of ``shape`` points, as rows of the flattened grid.

    ``hex8`` has its corners on neighbouring points; ``hex20`` and ``hex27`` also use the points between two corners.

    Raises:
        InputError: another element, or a grid whose length is not an integer number of elements.
    """
    if element not in ("hex8", "hex20", "hex27"):
        raise InputError(f"element {element!r} was given; a grid is filled by hex8, hex20 or hex27", keyword="element")
    step = 1 if element == "hex8" else 2
    if any(count < step + 1 or (count - 1) % step for count in shape):
        raise InputError(
            f"a grid of {tuple(shape)} points was given; {element} needs a multiple of {step}, plus 1",
            kind="value",
            keyword="shape",
        )
    local = (step * TYPES[element].reference).astype(np.int64)
    cells = np.meshgrid(*(np.arange((count - 1) // step) for count in shape), indexing="ij")
    first = step * np.stack(cells, axis=-1).reshape(-1, 1, 3)
    return np.asarray(np.ravel_multi_index(tuple(np.moveaxis(first + local, -1, 0)), tuple(shape)))


def grid_mesh(points: Floats, element: str = "hex20") -> Mesh:
    """Mesh of hexahedra on a grid of ``points`` (a, b, c, 3) m; see ``grid_cells``. Right-handed in its indices."""
    used, nodes = np.unique(cells := grid_cells(points.shape[:3], element), return_inverse=True)
    return Mesh(
        nodes=Nodes(ids=np.arange(1, len(used) + 1), xyz=points.reshape(-1, 3)[used]),
        blocks=(ElementBlock(type=element, nodes=nodes.reshape(cells.shape), ids=np.arange(1, len(cells) + 1)),),
        source="grid",
    )


def box_mesh(size: Sequence[float], cells: Sequence[int], element: str = "hex20") -> Mesh:
    """Box [0, size] m of ``cells`` hexahedra along x, y and z."""
    counts = np.asarray(cells) * (1 if element == "hex8" else 2) + 1
    steps = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1)
    return grid_mesh(steps / (counts - 1) * np.asarray(size), element)
