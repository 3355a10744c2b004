"""VTKHDF time series of a body on its mesh (version 2.0, for ParaView 5.12 or VTK 9.3 and later).

The mesh is stored once; each point field is one dataset with the steps behind each other, one chunk for each.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from morembs.base import progress
from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.body.recovery_shapes import Recovery, read_recovery
from morembs.body.vtkhdf import GridVersion, write_head
from morembs.storage.checksums import Checksums
from morembs.storage.hdf5 import reading
from morembs.storage.storable import text
from morembs.storage.writer import writing

if TYPE_CHECKING:
    from morembs.fem.viewer.page import Scene


@dataclass(frozen=True, kw_only=True, eq=False)
class Grid:
    """Mesh as VTK keeps it: ``points`` (n, 3) m, ``connectivity``, ``offsets`` (nc + 1,), ``types`` (nc,)."""

    points: Floats
    connectivity: NDArray[np.int64]
    offsets: NDArray[np.int64]
    types: NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """``motion`` (k, n, 3) of elastic modes at the nodes of ``grid``, whose labels are ``node_ids`` (n,), with
    ``frequencies_hz`` (k,); ``interfaces`` their points (3,) in m by name. A notebook shows the ``scene`` of it."""

    body: str
    grid: Grid
    node_ids: NDArray[np.int64]
    motion: Floats
    frequencies_hz: Floats
    interfaces: Mapping[str, Floats]
    scene: Callable[[View], Scene]

    def _repr_html_(self) -> str:
        return self.scene(self)._repr_html_()


def read_grid(path: Path) -> Grid:
    """Mesh of the body file ``path``.

    Raises:
        InputError: the file is damaged or has no mesh.
    """
    with reading(path, "a body file") as file:
        Checksums(path, file).verify(lambda name: re.fullmatch("VTKHDF(/[^/]+)?", name) is not None)
        group = file["VTKHDF"]
        grid = Grid(
            points=group["Points"][()],
            connectivity=group["Connectivity"][()],
            offsets=group["Offsets"][()],
            types=group["Types"][()],
        )
    if not len(grid.points):
        raise InputError(
            f"{path} keeps no nodes, so there is nothing to show; write it again with nodes = 'skin'",
            kind="file",
            keyword=path.name,
        )
    return grid


def stored_modes(path: Path, body: str, count: int) -> Floats:
    """Shapes (k, n, 3) of the first elastic modes of a body, at most ``count`` of them.

    Raises:
        InputError: the file is damaged.
    """
    with reading(path, "a body file") as file:
        held = file.get("VTKHDF/PointData", {})
        names = [name for number in range(1, count + 1) if (name := f"{body}_mode_{number:03d}") in held]
        return np.array([held[name][()] for name in names], dtype=float).reshape(len(names), -1, 3)


def stored_recovery(path: Path, body: str, *, stress: bool = True) -> Recovery | None:
    """Recovery of the body named ``body`` in a file, None if it has none; without ``stress`` of displacements only.

    Raises:
        InputError: the file is damaged or the recovery incomplete.
    """
    with reading(path, "a body file") as file:
        Checksums(path, file).verify(lambda name: name.startswith(f"bodies/{body}/recovery/"))
        group = file.get(f"bodies/{body}/recovery")
        return None if group is None else read_recovery(group, stress=stress)


def read_arrays(path: Path) -> dict[str, Any]:
    """All datasets of an HDF5 file, by name.

    Raises:
        InputError: not a readable HDF5 file, or one with groups, in which arrays would be overlooked.
    """
    with reading(path, "a trajectory in HDF5") as file:
        groups = [name for name, item in file.items() if not isinstance(item, h5py.Dataset)]
        if groups:
            raise InputError(f"{path} holds a group {groups[0]!r}; expected arrays only, none of them in a group")
        return {name: item[()] for name, item in file.items()}


def write_series(
    path: str | Path,
    grid: Grid,
    times: Floats,
    fields: Mapping[str, int],
    steps: Iterable[Mapping[str, Any]],
    *,
    notes: Callable[[], Sequence[str]] = tuple,
    beside: Mapping[str, Any] | None = None,
) -> Path:
    """Write the point ``fields`` (name -> number of components) at ``times`` (nt,) in s, in single precision.

    ``steps`` gives for each time the values (n, components) of each field, and is asked for one after the other;
    an interrupted or failed run leaves the old file or none. ``notes``, asked for at the end, are kept as /notes; what
    readers of VTKHDF do not know, as labels of nodes, stands ``beside`` by name.

    Raises:
        OutputError: the file cannot be written (folder missing or read-only, disk full).
    """
    target, n, nt = Path(path), len(grid.points), len(times)
    with writing(target, sealed=False) as out:
        out.name_step("the mesh")
        group = out.file.create_group("VTKHDF")
        write_head(group, GridVersion.TEMPORAL, n, len(grid.types), len(grid.connectivity))
        for name, values in vars(grid).items():
            group.create_dataset(name.capitalize(), data=values)
        for name, values in (beside or {}).items():
            out.file.create_dataset(name, data=values)
        _write_steps(group, times, fields, n)
        data = {}
        for name, width in fields.items():
            shape, chunk = ((nt * n,), (n,)) if width == 1 else ((nt * n, width), (n, width))
            data[name] = group.create_dataset(f"PointData/{name}", shape, np.float32, chunks=chunk)
        out.check()
        for number, step in enumerate(steps):
            out.name_step(f"step {number + 1} of {nt}")
            for name, values in step.items():
                field = np.asarray(values, dtype=np.float32)
                data[name][number * n : (number + 1) * n] = field.reshape(data[name].chunks)
                out.check()
            progress.update(f"{number + 1} of {nt} steps written")
        if lines := notes():
            out.put("notes", text(*lines))
    return target


def _write_steps(group: Any, times: Floats, fields: Mapping[str, int], n: int) -> None:
    """Where each step begins: always at the same mesh, and at its own rows of each field."""
    nt = len(times)
    steps = group.create_group("Steps")
    steps.attrs["NSteps"] = np.int64(nt)
    steps.create_dataset("Values", data=np.asarray(times, dtype=np.float64))
    zero = np.zeros(nt, dtype=np.int64)
    steps.create_dataset("NumberOfParts", data=zero + 1)
    for name in ("PartOffsets", "PointOffsets"):
        steps.create_dataset(name, data=zero)
    for name in ("CellOffsets", "ConnectivityIdOffsets"):
        steps.create_dataset(name, data=zero[:, None])
    for name in fields:
        steps.create_dataset(f"PointDataOffsets/{name}", data=n * np.arange(nt, dtype=np.int64))
