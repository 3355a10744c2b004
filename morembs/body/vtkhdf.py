"""The /VTKHDF group: mesh and eigenmode shapes as ParaView reads them (VTKHDF 1.0, unstructured grid)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import numpy as np

from morembs.base.types import Floats, Ints
from morembs.body.tolerances import TOL

if TYPE_CHECKING:
    from morembs.reducers.base import ReducedModel


class CellType(IntEnum):
    """Cell types of VTK (vtkCellType.h)."""

    VERTEX = 1


class GridVersion:
    """Versions of VTKHDF."""

    # ParaView 5.11 refuses any other number; it has all that a static grid needs.
    STATIC = (1, 0)
    # Temporal data came with it.
    TEMPORAL = (2, 0)


VTK_VERTEX = CellType.VERTEX


@dataclass(frozen=True, kw_only=True, eq=False)
class CellBlock:
    """Cells of one VTK type: ``connectivity`` (nc, k) rows of the selected nodes."""

    vtk: int
    connectivity: Ints


def write_grid(group: Any, points: Any, cells: Sequence[CellBlock]) -> None:
    """Fill the HDF5 ``group`` with the mesh; ``points`` (n, 3) is a dataset of the same file, hard-linked."""
    group["Points"] = points
    n_cells = sum(len(c.connectivity) for c in cells)
    n_links = sum(c.connectivity.size for c in cells)
    write_head(group, GridVersion.STATIC, len(points), n_cells, n_links)
    connectivity = group.create_dataset("Connectivity", (n_links,), np.int64)
    offsets = group.create_dataset("Offsets", (n_cells + 1,), np.int64)
    types = group.create_dataset("Types", (n_cells,), np.uint8)
    offsets[0] = cell = link = 0
    for block in cells:
        count, size = block.connectivity.shape
        if not count:
            continue
        connectivity[link : link + count * size] = block.connectivity.ravel()
        offsets[cell + 1 : cell + count + 1] = link + size * np.arange(1, count + 1)
        types[cell : cell + count] = block.vtk
        cell, link = cell + count, link + count * size
    group.create_group("PointData")
    group.create_group("FieldData")


def write_head(group: Any, version: tuple[int, int], points: int, cells: int, links: int) -> None:
    """What makes an HDF5 ``group`` an unstructured grid, and its numbers of points, cells and nodes of cells."""
    group.attrs["Version"] = np.array(version, dtype=np.int64)
    group.attrs["Type"] = np.bytes_("UnstructuredGrid")
    for name, count in (("Points", points), ("Cells", cells), ("ConnectivityIds", links)):
        group.create_dataset(f"NumberOf{name}", data=np.array([count], dtype=np.int64))


def shown_modes(reduced: ReducedModel) -> Floats:
    """First elastic eigenvectors (n, k) of the reduced pencil, k <= 20, mass-normalised.

    The sign is that of the largest coordinate, which is made positive (the first one of equals).
    """
    _, vectors = reduced.modes()
    X: Floats = vectors[:, reduced.rigid_count : reduced.rigid_count + TOL.vtk_modes]
    if not X.size:
        return X
    size = np.abs(X)
    first = np.argmax(size > (1 - TOL.equal_coordinate) * size.max(axis=0), axis=0)
    return np.asarray(X * np.sign(X[first, np.arange(X.shape[1])]))


def write_modes(
    group: Any, name: str, basis: Any, modes: Floats, frequencies_hz: Floats, check: Callable[[], None]
) -> None:
    """Shapes ``basis @ modes`` as PointData NAME_mode_001, ... (n_nodes, 3), single precision.

    Args:
        group: the HDF5 group /VTKHDF.
        basis: HDF5 dataset (3 n_nodes, n) of the body ``name``; read in blocks of rows.
        modes: (n, k) of ``shown_modes``.
        frequencies_hz: (k,), stored as the field NAME_frequencies_hz.
        check: called after each block; raises what went wrong with the file.
    """
    count = modes.shape[1]
    n_nodes = basis.shape[0] // 3
    shapes = [
        group.create_dataset(f"PointData/{name}_mode_{number:03d}", (n_nodes, 3), np.float32)
        for number in range(1, count + 1)
    ]
    if count:
        group.create_dataset(f"FieldData/{name}_frequencies_hz", data=frequencies_hz)
    step = max(1, TOL.vtk_block_bytes // (24 * max(1, len(modes))))
    for start in range(0, n_nodes if count else 0, step):
        stop = min(start + step, n_nodes)
        # Column by column, as the columns are the pieces on the disk.
        block = np.empty((len(modes), 3 * (stop - start)))
        for column, row in enumerate(block):
            row[:] = basis[3 * start : 3 * stop, column]
        for shape, values in zip(shapes, modes.T @ block, strict=True):
            shape[start:stop] = values.reshape(-1, 3)
        check()
